"""Simulated robots with known parameters.

Each robot is defined once, by its joints in order. The head chain, the URDF and the simulator's own forward
kinematics are derived from that definition independently.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from typing import Literal

import numpy as np
from scipy.spatial.transform import Rotation

from mobilecal_cli.model import (
    CameraInfo,
    FixedLink,
    FloatArray,
    HeadChain,
    JointLink,
    Nominal,
    Rig,
    Sources,
    StereoRig,
    WheelGeometry,
    WheelSource,
)
from mobilecal_cli.simulate.stereo import stereo_infos, stereo_rig

Vector = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class RobotJoint:
    """One joint of the head chain, as in a URDF.

    Attributes:
        name: the joint's name, "" for a fixed one.
        link: name of its child link.
        xyz_m, rpy_rad: origin in the parent link (fixed-axis roll, pitch, yaw).
        axis: unit vector; unused for a fixed joint.
        limit_rad: joint limit in both directions, rad.
    """

    name: str
    link: str
    xyz_m: Vector
    rpy_rad: Vector = (0.0, 0.0, 0.0)
    axis: Vector = (0.0, 0.0, 1.0)
    limit_rad: float = 2.5


def pose(xyz_m: FloatArray | Vector, rotation: Rotation) -> FloatArray:
    """(4, 4) transform of a rotation and the child's origin, m."""
    T = np.eye(4)
    T[:3, :3] = rotation.as_matrix()
    T[:3, 3] = xyz_m
    return T


@dataclass(frozen=True, slots=True, eq=False)
class SimulatedRobot:
    """A robot with known ground truth: `T_h_c` and `wheels` are the values that a calibration estimates.

    Attributes:
        name: of the robot.
        joints: from base to head.
        pan, tilt: names of the pan and the tilt joint.
        infos: CameraInfo of the left and right camera.
        T_h_c: (4, 4) true head-eye transform: left camera to head coordinates, m.
        wheels: true wheel radii and separation.
        nominal_wheels: nominal values, used in the URDF.
        T_h_c_nominal: (4, 4) nominal head-eye transform, used in the URDF.
        encoder_step_rad: resolution of the wheel encoders, rad.
        wheel_signal: wheels as positions in the joint states, or as separate tick counters.
        ticks_per_revolution, tick_bits: of the tick counters.
        joint_noise_rad: sigma of one joint reading, rad.
        joint_rate_hz: rate of the joint states (and ticks), Hz.
    """

    name: str
    joints: tuple[RobotJoint, ...]
    pan: str
    tilt: str
    infos: tuple[CameraInfo, CameraInfo]
    T_h_c: FloatArray
    wheels: WheelGeometry
    nominal_wheels: WheelGeometry
    T_h_c_nominal: FloatArray
    encoder_step_rad: float
    wheel_signal: Literal["joint_states", "ticks"] = "joint_states"
    ticks_per_revolution: int = 4096
    tick_bits: Literal[8, 16, 32, 64] = 16
    joint_noise_rad: float = np.radians(0.01)
    joint_rate_hz: int = 50

    @property
    def base_frame(self) -> str:
        """Name of the base frame."""
        return "base_link"

    @property
    def head_frame(self) -> str:
        """Name of the head frame."""
        return self.joints[-1].link

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Names of the moving joints, from the base."""
        return tuple(joint.name for joint in self.joints if joint.name)

    @property
    def rig_cameras(self) -> StereoRig:
        """The stereo pair, for raw images."""
        return stereo_rig(*self.infos)

    @property
    def chain(self) -> HeadChain:
        """The head chain in the solver's format."""
        links: list[FixedLink | JointLink] = []
        for joint in self.joints:
            links.append(FixedLink(pose(joint.xyz_m, Rotation.from_euler("xyz", joint.rpy_rad))))
            if joint.name:
                links.append(JointLink(joint.name, np.array(joint.axis)))
        return HeadChain(self.base_frame, self.head_frame, tuple(links), self.pan, self.tilt)

    def head_pose(self, joints_rad: FloatArray) -> FloatArray:
        """T_v_h from the simulator's own forward kinematics: (J,) → (4, 4)."""
        T_v_h = np.eye(4)
        angles = iter(joints_rad)
        for joint in self.joints:
            T_v_h = T_v_h @ pose(joint.xyz_m, Rotation.from_euler("xyz", joint.rpy_rad))
            if joint.name:
                T_v_h = T_v_h @ pose((0, 0, 0), Rotation.from_rotvec(next(angles) * np.array(joint.axis)))
        return T_v_h

    def topics(self, compressed: bool = False) -> Sources:
        """The topics of this robot's recordings."""
        suffix = "/compressed" if compressed else ""
        ticks, per_turn = self.wheel_signal == "ticks", float(self.ticks_per_revolution)
        return Sources(
            image={
                "left": f"/stereo/left/image_raw{suffix}",
                "right": f"/stereo/right/image_raw{suffix}",
            },
            info={"left": "/stereo/left/camera_info", "right": "/stereo/right/camera_info"},
            joints=("/joint_states",),
            wheels={
                "left": WheelSource("/wheel_ticks/left", None, "data", per_turn, self.tick_bits)
                if ticks
                else WheelSource("/joint_states", "wheel_left_joint"),
                "right": WheelSource("/wheel_ticks/right", None, "data", per_turn, self.tick_bits)
                if ticks
                else WheelSource("/joint_states", "wheel_right_joint"),
            },
        )

    def rig(self, nominal: bool = True) -> Rig:
        """Robot description for a calibration.

        Args:
            nominal: whether to include nominal values as priors.
        """
        prior = Nominal(self.T_h_c_nominal, self.nominal_wheels) if nominal else Nominal()
        resolved = dict.fromkeys(("cameras", "head", "wheels", "nominal"), "default")
        return Rig(self.rig_cameras, self.chain, prior, self.topics(), resolved)


def _head_eye(euler_zyx_deg: Vector, translation_mm: Vector) -> FloatArray:
    """T_h_c from the angles (ax, ay, az) of Table 1, with R = Rz(az) Ry(ay) Rx(ax), and mm."""
    # The lower-case sequence in scipy rotates about fixed axes: first x, then y, then z.
    rotation = Rotation.from_euler("xyz", euler_zyx_deg, degrees=True)
    return pose(np.array(translation_mm) / 1000, rotation)


def _nominal_head_eye(T_h_c: FloatArray) -> FloatArray:
    """Nominal head-eye transform, a few degrees and centimeters from the true one."""
    beside = pose((0.012, -0.008, 0.015), Rotation.from_euler("xyz", (1.5, -2.0, 1.0), degrees=True))
    result: FloatArray = T_h_c @ beside
    return result


@cache
def paper_robot() -> SimulatedRobot:
    """Robot of the paper's Table 1 (optimized column): pitch and roll joints below a pan-tilt head."""
    T_h_c = _head_eye((-164.22, 89.38, -166.40), (13.60, -64.34, -70.77))
    quarter = np.pi / 2
    return SimulatedRobot(
        name="paper",
        joints=(
            RobotJoint(
                "torso_pitch_joint", "torso_pitch_link", (0.04, 0.0, 0.35), axis=(0, 1, 0), limit_rad=0.5
            ),
            RobotJoint(
                "torso_roll_joint", "torso_roll_link", (0.0, 0.0, 0.10), axis=(1, 0, 0), limit_rad=0.5
            ),
            RobotJoint("head_pan_joint", "head_pan_link", (0.03, 0.0, 0.42), axis=(0, 0, 1), limit_rad=1.9),
            RobotJoint("head_tilt_joint", "head_tilt_link", (0.02, 0.0, 0.06), axis=(0, 1, 0), limit_rad=1.0),
            # Denavit-Hartenberg frame: x forward, y down, z left.
            RobotJoint("", "head_link", (0.05, 0.0, 0.03), (-quarter, 0.0, 0.0)),
        ),
        pan="head_pan_joint",
        tilt="head_tilt_joint",
        infos=stereo_infos("stereo"),
        T_h_c=T_h_c,
        wheels=WheelGeometry(radius_right_m=0.22330, radius_left_m=0.22767, separation_m=0.50870),
        nominal_wheels=WheelGeometry(radius_right_m=0.225, radius_left_m=0.225, separation_m=0.500),
        T_h_c_nominal=_nominal_head_eye(T_h_c),
        encoder_step_rad=np.radians(1.2),
    )


@cache
def tick_robot() -> SimulatedRobot:
    """Small robot with a pan-tilt head and 16-bit tick counters with 4096 ticks per revolution."""
    # Camera axes (right, down, forward) in a head frame (x forward, y left, z up), mounted with a small
    # rotation.
    optical = Rotation.from_matrix([[0, 0, 1], [-1, 0, 0], [0, -1, 0]])
    T_h_c = pose((0.045, 0.0615, 0.032), Rotation.from_euler("xyz", (1.2, -2.1, 1.7), degrees=True) * optical)
    return SimulatedRobot(
        name="tick",
        joints=(
            RobotJoint("pan_joint", "pan_link", (0.08, 0.0, 0.62), axis=(0, 0, 1), limit_rad=2.2),
            RobotJoint("tilt_joint", "tilt_link", (0.0, 0.0, 0.05), axis=(0, 1, 0), limit_rad=1.0),
            RobotJoint("", "head_link", (0.03, 0.0, 0.02)),
        ),
        pan="pan_joint",
        tilt="tilt_joint",
        infos=stereo_infos("stereo", focal_px=520.0, shift_px=6.0),
        T_h_c=T_h_c,
        wheels=WheelGeometry(radius_right_m=0.0824, radius_left_m=0.0817, separation_m=0.3372),
        nominal_wheels=WheelGeometry(radius_right_m=0.082, radius_left_m=0.082, separation_m=0.340),
        T_h_c_nominal=_nominal_head_eye(T_h_c),
        encoder_step_rad=2 * np.pi / 4096,
        wheel_signal="ticks",
        ticks_per_revolution=4096,
        tick_bits=16,
    )


ROBOTS: dict[str, Callable[[], SimulatedRobot]] = {"paper": paper_robot, "tick": tick_robot}
