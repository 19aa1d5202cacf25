"""Kinematics of the head chain and the two wheels, with Jacobians."""

from mobilecal_cli.kinematics.head import (
    JointFrames,
    head_eye_words,
    head_jacobian,
    head_pose,
    joint_frames,
    joint_motion,
    unlike_joints,
    unseen_height,
)
from mobilecal_cli.kinematics.motion import (
    DRIVEN_RAD,
    FEWEST_LEGS,
    TILTED_RAD,
    TURNED_RAD,
    MotionSeen,
    motion_seen,
)
from mobilecal_cli.kinematics.wheels import (
    Arcs,
    Increments,
    Unevenness,
    between_steps,
    cut_at,
    encoder_step_rad,
    encoder_steps_rad,
    integrate,
    join,
)
