"""Kinematics of the pan-tilt head: pose of frame h for joint readings."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.model import FixedLink, FloatArray, HeadChain, JointLink

_TILTS = 0.02  # sine of an axis against the vertical: a joint with a smaller one does not tilt


def joint_motion(link: JointLink, reading: FloatArray) -> FloatArray:
    """Motion of one joint: readings (...) in rad or m → (..., 4, 4)."""
    amount = np.asarray(link.multiplier * reading + link.offset)[..., None] * link.axis
    if link.kind == "revolute":
        return se3.transform(se3.exp_so3(amount), link.shift_m)
    return se3.transform(np.eye(3), link.shift_m + amount)


def joint_frames(chain: HeadChain) -> tuple[list[tuple[JointLink, FloatArray]], FloatArray]:
    """The joints, each with its frame at a reading of zero in the one before, (4, 4); and the head in the last one."""
    joints, T = [], np.eye(4)
    for link in chain.links:
        if isinstance(link, FixedLink):
            T = T @ link.T_parent_child
        else:
            joints.append((link, T @ joint_motion(link, np.zeros(()))))
            T = np.eye(4)
    return joints, T


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

    Derivatives are left twists in the vehicle's frame, T -> exp(twist) T, tangent order of `se3`.

    Attributes:
        links: index in the chain → the link.
        R_v_j, p_v_j: index → (N, 3, 3) and (N, 3) joint coordinates to vehicle coordinates, before the motion; the
            origin as shifted, m.
        motion: index → (N, 4, 4) the motion.
        columns: index → column of the joint.
        T_v_h: (N, 4, 4) head coordinates to vehicle coordinates, m.
    """

    links: Mapping[int, JointLink]
    R_v_j: Mapping[int, FloatArray]
    p_v_j: Mapping[int, FloatArray]
    motion: Mapping[int, FloatArray]
    columns: Mapping[int, int]
    T_v_h: FloatArray

    @classmethod
    def at(cls, chain: HeadChain, joints: FloatArray) -> JointFrames:
        """Frames for joint positions (N, J), rad or m."""
        column = {name: i for i, name in enumerate(chain.joints)}
        T: FloatArray = np.broadcast_to(np.eye(4), (len(joints), 4, 4))
        links, rotations, origins, motions, columns = {}, {}, {}, {}, {}
        for index, link in enumerate(chain.links):
            if isinstance(link, FixedLink):
                T = T @ link.T_parent_child
                continue
            links[index], columns[index] = link, column[link.joint]
            rotations[index] = T[:, :3, :3]
            origins[index] = T[:, :3, 3] + T[:, :3, :3] @ link.shift_m
            motions[index] = joint_motion(link, joints[:, columns[index]])
            T = T @ motions[index]
        return cls(links, rotations, origins, motions, columns, T)

    def _about_origin(self, index: int, turn_v: FloatArray) -> FloatArray:
        """(N, 6) twists of rotations (N, 3) in the vehicle's frame about a joint's origin."""
        return np.concatenate([turn_v, np.cross(self.p_v_j[index], turn_v)], axis=1)

    def by_joints(self) -> FloatArray:
        """(N, 6, J) twists by the joint positions."""
        twists = np.zeros((len(self.T_v_h), 6, 1 + max(self.columns.values(), default=-1)))
        for index, link in self.links.items():
            along = self.R_v_j[index] @ (link.multiplier * link.axis)
            if link.kind == "revolute":
                twists[:, :, self.columns[index]] += self._about_origin(index, along)
            else:
                twists[:, 3:, self.columns[index]] += along
        return twists

    def by_axis(self, index: int, turn: FloatArray) -> FloatArray:
        """(N, 6) twists by turning a joint's axis about (3,) in the joint's frame."""
        link, moved = self.links[index], self.motion[index]
        if link.kind == "prismatic":
            amount = (moved[:, :3, 3] - link.shift_m) @ link.axis
            shift = self.R_v_j[index] @ np.cross(turn, link.axis) * amount[:, None]
            return np.concatenate([np.zeros_like(shift), shift], axis=1)
        turned = turn - moved[:, :3, :3] @ turn
        return self._about_origin(index, (self.R_v_j[index] @ turned[..., None])[..., 0])

    def by_origin(self, index: int, along: FloatArray) -> FloatArray:
        """(N, 6) twists by shifting a joint's origin along (3,) in the joint's frame."""
        shift = self.R_v_j[index] @ along
        return np.concatenate([np.zeros_like(shift), shift], axis=1)


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


def unseen_height(chain: HeadChain) -> FloatArray | None:
    """The vertical in the head frame, (3,), if no joint of the head turns about another axis; None if one does.

    Without a tilting joint, no motion of the robot on its floor shows the height of the camera.
    """
    still = np.zeros(len(chain.joints))
    vertical = head_pose(chain, still)[2, :3]
    axes = head_jacobian(chain, still)[:3].T
    if np.any(np.linalg.norm(np.cross(axes, vertical), axis=1) > _TILTS):
        return None
    return np.asarray(vertical)
