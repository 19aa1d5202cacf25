"""An improved head chain as origins and axes of a URDF's joints."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.export.improved import ImprovedChain
from mobilecal_cli.kinematics.urdf import Urdf, UrdfJoint
from mobilecal_cli.model import FixedLink, FloatArray, HeadChain, JointLink

_SAME = 1e-6  # m, and the elements of rotation matrices
_HINT = "give the URDF that the calibration read"


@dataclass(frozen=True, slots=True, eq=False)
class JointOrigin:
    """What a joint of the URDF becomes.

    Attributes:
        name: of the joint in the URDF.
        T_parent_child: (4, 4) at the joint's zero, m.
        axis: (3,) unit vector in the joint's frame.
    """

    name: str
    T_parent_child: FloatArray
    axis: FloatArray


def joint_origins(urdf: Urdf, chain: ImprovedChain) -> tuple[JointOrigin, ...]:
    """New origins and axes of the moving joints between base and head.

    A zero offset turns (or shifts) the origin about the axis, so the joint's readings keep their meaning.

    Raises:
        ConfigError: the chain of the URDF is not the one that the calibration read.
    """
    stated = chain.stated
    path = urdf.path(stated.base_frame, stated.head_frame)
    moving = [joint for joint in path if joint.kind != "fixed"]
    _check(path, stated)
    links = [link for link in chain.improved.links if isinstance(link, JointLink)]
    return tuple(_origin(joint, link, chain) for joint, link in zip(moving, links, strict=True))


def _origin(joint: UrdfJoint, link: JointLink, chain: ImprovedChain) -> JointOrigin:
    offset = link.multiplier * chain.zeros.get(link.joint, 0.0) * link.axis
    if link.kind == "revolute":
        change = se3.transform(se3.exp_so3(offset), link.shift_m)
    else:
        change = se3.transform(np.eye(3), link.shift_m + offset)
    return JointOrigin(joint.name, joint.T_parent_child @ change, link.axis)


def _check(path: tuple[UrdfJoint, ...], chain: HeadChain) -> None:
    """Compare the moving joints with those of the chain, and the transforms between them.

    The first transform may differ: the chain starts between the wheels, the URDF at its base link.
    """
    drawn = _parts([FixedLink(joint.T_parent_child) if joint.kind == "fixed" else joint for joint in path])
    known = _parts(chain.links)
    for number, ((T, joint), (T_known, link)) in enumerate(zip(drawn, known, strict=False)):
        assert isinstance(joint, UrdfJoint)
        assert isinstance(link, JointLink)
        kind = "prismatic" if joint.kind == "prismatic" else "revolute"
        read, multiplier, offset = joint.mimic or (joint.name, 1.0, 0.0)
        same = (kind, read, multiplier, offset) == (link.kind, link.joint, link.multiplier, link.offset)
        same = same and np.allclose(joint.axis, link.axis, rtol=0, atol=_SAME)
        if not same or (number > 0 and not np.allclose(T, T_known, rtol=0, atol=_SAME)):
            raise ConfigError(f"URDF: joint {joint.name!r} is not as in the calibrated robot's chain", _HINT)
    if len(drawn) != len(known):
        raise ConfigError(
            f"URDF: {len(drawn)} joints from {chain.base_frame!r} to {chain.head_frame!r}, {len(known)} in the "
            "calibrated robot's chain",
            _HINT,
        )


def _parts(
    links: tuple[FixedLink | JointLink, ...] | list[FixedLink | UrdfJoint],
) -> list[tuple[FloatArray, JointLink | UrdfJoint]]:
    """Each moving joint, with the transform from the frame of the joint before it to its own, (4, 4)."""
    parts: list[tuple[FloatArray, JointLink | UrdfJoint]] = []
    T = np.eye(4)
    for link in links:
        if isinstance(link, FixedLink):
            T = T @ link.T_parent_child
            continue
        if isinstance(link, UrdfJoint):
            T = T @ link.T_parent_child
        parts.append((T, link))
        T = np.eye(4)
    return parts
