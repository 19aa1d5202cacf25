"""Kinematics of the pan-tilt head: pose of frame h for joint readings."""

from __future__ import annotations

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.model import FixedLink, FloatArray, HeadChain, JointLink


def joint_motion(link: JointLink, reading: FloatArray) -> FloatArray:
    """Motion of one joint: readings (...) in rad or m → (..., 4, 4)."""
    amount = np.asarray(link.multiplier * reading + link.offset)[..., None] * link.axis
    if link.kind == "revolute":
        return se3.transform(se3.exp_so3(amount), np.zeros(3))
    return se3.transform(np.eye(3), amount)


def head_pose(chain: HeadChain, joints: FloatArray) -> FloatArray:
    """Pose of the head, T_v_h(q): head coordinates to vehicle coordinates.

    Args:
        chain: the kinematic chain.
        joints: (..., J) readings in the order of `chain.joints`, rad or m.

    Returns:
        (..., 4, 4), m.
    """
    column = {name: i for i, name in enumerate(chain.joints)}
    T_v_h = np.broadcast_to(np.eye(4), (*joints.shape[:-1], 4, 4))
    for link in chain.links:
        if isinstance(link, FixedLink):
            T_v_h = T_v_h @ link.T_parent_child
        else:
            T_v_h = T_v_h @ joint_motion(link, joints[..., column[link.joint]])
    return T_v_h


def head_jacobian(chain: HeadChain, joints: FloatArray) -> FloatArray:
    """Jacobian J with T_v_h(q + dq) = T_v_h(q) exp(J dq) to first order.

    Args:
        chain: the kinematic chain.
        joints: (..., J) readings, rad or m.

    Returns:
        (..., 6, J) twists in the head frame, tangent order of `se3`.
    """
    column = {name: i for i, name in enumerate(chain.joints)}
    J = np.zeros((*joints.shape[:-1], 6, len(column)))
    # Go from the head back to the base, so that T_joint_h is available at every joint.
    T_link_h = np.broadcast_to(np.eye(4), (*joints.shape[:-1], 4, 4))
    for link in reversed(chain.links):
        if isinstance(link, FixedLink):
            T_link_h = link.T_parent_child @ T_link_h
            continue
        twist = np.zeros(6)
        twist[slice(0, 3) if link.kind == "revolute" else slice(3, 6)] = link.multiplier * link.axis
        J[..., column[link.joint]] += se3.adjoint(se3.inverse(T_link_h)) @ twist
        T_link_h = joint_motion(link, joints[..., column[link.joint]]) @ T_link_h
    return J
