"""Kinematics of the pan-tilt head: pose of frame h for joint readings."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.rig import FixedLink, HeadChain, JointLink
from mobilecal_cli.model.text import visible

# Larger differences are those of another chain: of lengths in m, of the elements of rotation matrices and axes.
_SAME = 1e-6
_VERTICAL = 0.8  # cosine of an axis and the vertical, from which on a position along it is a height
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


def unlike_joints(chain: HeadChain, other: HeadChain) -> list[int]:
    """Numbers of the joints in which two chains differ, or in the transform before them; the first may be elsewhere.

    Mimic joints count as joints of their own: their multipliers and offsets are not compared.
    """
    own, known = joint_frames(chain)[0], joint_frames(other)[0]
    unlike = list(range(min(len(own), len(known)), max(len(own), len(known))))
    for number, ((link, T), (another, T_other)) in enumerate(zip(own, known, strict=False)):
        off = [link.axis - another.axis, (T - T_other)[:3, : 4 if number else 3]]
        same = (link.joint, link.kind) == (another.joint, another.kind)
        if not same or max(float(np.abs(each).max()) for each in off) > _SAME:
            unlike.append(number)
    return unlike


def head_pose(chain: HeadChain, joints: FloatArray) -> FloatArray:
    """Pose of the head, T_v_h(q): head coordinates to vehicle coordinates.

    Args:
        chain: the kinematic chain.
        joints: (..., J) readings in the order of `chain.joints`, rad or m.

    Returns:
        (..., 4, 4), m.
    """
    return JointFrames.at(chain, joints).T_v_h


@dataclass(frozen=True, slots=True, eq=False)
class JointFrame:
    """A moving link's frame before its own motion, and that motion, for any number of readings.

    Attributes:
        link: the link.
        column: of its joint among the readings.
        R_v_j, p_v_j: (..., 3, 3) and (..., 3) joint coordinates to vehicle coordinates; the origin as shifted, m.
        motion: (..., 4, 4) the motion.
    """

    link: JointLink
    column: int
    R_v_j: FloatArray
    p_v_j: FloatArray
    motion: FloatArray

    def turned(self, axis: FloatArray) -> FloatArray:
        """(..., 6) twists of rotations (..., 3) in the vehicle's frame about the joint's origin."""
        return np.concatenate([axis, np.cross(self.p_v_j, axis)], axis=-1)

    def shifted(self, along: FloatArray) -> FloatArray:
        """(..., 6) twists of shifts (..., 3) in the joint's frame."""
        shift = (self.R_v_j @ along[..., None])[..., 0]
        return np.concatenate([np.zeros_like(shift), shift], axis=-1)


@dataclass(frozen=True, slots=True, eq=False)
class JointFrames:
    """All moving links of a chain. Derivatives are left twists in the vehicle's frame, T -> exp(twist) T.

    Attributes:
        joints: number of joints.
        frames: index of a moving link in the chain → its frame.
        T_v_h: (..., 4, 4) head coordinates to vehicle coordinates, m.
    """

    joints: int
    frames: Mapping[int, JointFrame]
    T_v_h: FloatArray

    @classmethod
    def at(cls, chain: HeadChain, joints: FloatArray) -> JointFrames:
        """Frames for joint positions (..., J), rad or m."""
        T: FloatArray = np.broadcast_to(np.eye(4), (*joints.shape[:-1], 4, 4))
        frames, names = {}, chain.joints
        for index, link in enumerate(chain.links):
            if isinstance(link, FixedLink):
                T = T @ link.T_parent_child
                continue
            column, R = names.index(link.joint), T[..., :3, :3]
            motion = joint_motion(link, joints[..., column])
            frames[index] = JointFrame(link, column, R, T[..., :3, 3] + R @ link.shift_m, motion)
            T = T @ motion
        return cls(len(names), frames, T)

    def by_joints(self) -> FloatArray:
        """(..., 6, J) twists by the joint positions."""
        twists = np.zeros((*self.T_v_h.shape[:-2], 6, self.joints))
        for frame in self.frames.values():
            along = frame.link.multiplier * frame.link.axis
            turns = frame.link.kind == "revolute"
            twists[..., frame.column] += frame.turned(frame.R_v_j @ along) if turns else frame.shifted(along)
        return twists

    def by_axis(self, index: int, turn: FloatArray) -> FloatArray:
        """(..., 6) twists by turning a joint's axis about (3,) in the joint's frame."""
        frame = self.frames[index]
        link, moved = frame.link, frame.motion
        if link.kind == "prismatic":
            amount = (moved[..., :3, 3] - link.shift_m) @ link.axis
            return frame.shifted(np.cross(turn, link.axis) * amount[..., None])
        return frame.turned((frame.R_v_j @ (turn - moved[..., :3, :3] @ turn)[..., None])[..., 0])


def head_jacobian(chain: HeadChain, joints: FloatArray) -> FloatArray:
    """Jacobian J with T_v_h(q + dq) = T_v_h(q) exp(J dq) to first order: (..., J) readings → (..., 6, J)."""
    frames = JointFrames.at(chain, joints)
    return se3.adjoint(se3.inverse(frames.T_v_h)) @ frames.by_joints()


def head_eye_words(names: Collection[str], chain: HeadChain, joints: FloatArray) -> list[str]:
    """Some numbers of the head-eye transform in plain words, such as "the camera's height".

    Args:
        names: of some of the nine parameters, such as "t_z"; those of the wheels are left out.
        chain: from the base to the head.
        joints: (N, J) readings at the stations.
    """
    # How vertical each axis of the head is.
    upright = np.abs(np.median(head_pose(chain, joints)[:, 2, :3], axis=0))
    height = f"t_{'xyz'[int(np.argmax(upright))]}" if upright.max() > _VERTICAL else ""
    words = ["the camera's height"] if height in names else []
    for prefix, word, along in (("r_", "rotation", "about"), ("t_", "position", "along")):
        axes = [name[-1] for name in names if name.startswith(prefix) and name != height]
        which = f" {along} {' and '.join(axes)} of {visible(chain.head_frame)}" if len(axes) < 3 else ""
        words += [f"the camera's {word}{which}"] if axes else []
    return words


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
