"""Kinematics of the pan-tilt head: pose of frame h for joint readings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.model import FixedLink, FloatArray, HeadChain, JointLink


def joint_motion(link: JointLink, reading: FloatArray) -> FloatArray:
    """Motion of one joint: readings (...) in rad or m → (..., 4, 4)."""
    amount = np.asarray(link.multiplier * reading + link.offset)[..., None] * link.axis
    if link.kind == "revolute":
        return se3.transform(se3.exp_so3(amount), link.shift_m)
    return se3.transform(np.eye(3), link.shift_m + amount)


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


@dataclass(frozen=True, slots=True, eq=False)
class JointFrames:
    """Each moving link's frame before its own motion, and that motion, at N stations.

    Attributes:
        links: index in the chain → the link.
        T_v_j: index → (N, 4, 4) joint coordinates to vehicle coordinates, before the motion, m.
        motion: index → (N, 4, 4) the motion.
    """

    links: Mapping[int, JointLink]
    T_v_j: Mapping[int, FloatArray]
    motion: Mapping[int, FloatArray]

    @classmethod
    def at(cls, chain: HeadChain, joints: FloatArray) -> JointFrames:
        """Frames for joint positions (N, J), rad or m."""
        column = {name: i for i, name in enumerate(chain.joints)}
        T = np.broadcast_to(np.eye(4), (len(joints), 4, 4))
        links, frames, motions = {}, {}, {}
        for index, link in enumerate(chain.links):
            if isinstance(link, FixedLink):
                T = T @ link.T_parent_child
                continue
            links[index], frames[index] = link, T
            motions[index] = joint_motion(link, joints[:, column[link.joint]])
            T = T @ motions[index]
        return cls(links, frames, motions)

    def by_axis(self, index: int, turn: FloatArray) -> FloatArray:
        """(N, 6) left twists in the vehicle's frame by turning a joint's axis about (3,) in the joint's frame."""
        link, R, p = self.links[index], self.T_v_j[index][:, :3, :3], self.T_v_j[index][:, :3, 3]
        moved = self.motion[index]
        twist = np.zeros((len(p), 6))
        if link.kind == "prismatic":
            amount = (moved[:, :3, 3] - link.shift_m) @ link.axis
            twist[:, 3:] = R @ np.cross(turn, link.axis) * amount[:, None]
            return twist
        twist[:, :3] = (R @ (turn - moved[:, :3, :3] @ turn)[..., None])[..., 0]
        origin = p + R @ link.shift_m
        twist[:, 3:] = np.cross(origin, twist[:, :3])
        return twist

    def by_origin(self, index: int, along: FloatArray) -> FloatArray:
        """(N, 6) left twists in the vehicle's frame by shifting a joint's origin along (3,) in the joint's frame."""
        R = self.T_v_j[index][:, :3, :3]
        return np.concatenate([np.zeros((len(R), 3)), R @ along], axis=1)


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
