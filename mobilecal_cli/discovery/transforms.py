"""The robot's joints from its transforms, for a recording with neither a URDF nor joint states."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.kinematics.urdf import Urdf, UrdfJoint
from mobilecal_cli.model import FloatArray

#: A transform that changes by less is fixed; the transform of a fixed mount does not change at all.
_STILL_RAD, _STILL_M = 2e-3, 5e-4
#: A transform that deviates by more from the motion of a joint is not a joint.
_OFF_RAD, _OFF_M = 0.02, 0.005


def urdf_of_transforms(transforms: Mapping[tuple[str, str], FloatArray]) -> Urdf:
    """Joints that would publish these transforms, each named by its child frame.

    A transform that does not change is a fixed joint. One that only rotates about one axis is revolute, and one that
    only translates along one axis is prismatic. Any other is "floating". A joint is at zero at the first sample; this
    choice does not change the poses of the links.

    Args:
        transforms: (parent, child) → (n, 4, 4) samples of T_parent_child over the recording.
    """
    joints = {child: _joint(parent, child, T) for (parent, child), T in sorted(transforms.items())}
    return Urdf("transforms", joints, {})


def _joint(parent: str, child: str, T: FloatArray) -> UrdfJoint:
    moved = se3.inverse(T[0]) @ T
    turn, way = se3.log_so3(moved[:, :3, :3]), moved[:, :3, 3]
    turned, slid = (float(np.linalg.norm(values, axis=1).max()) for values in (turn, way))
    if turned < _STILL_RAD and slid < _STILL_M:
        return UrdfJoint(child, "fixed", parent, child, T[0], np.array([1.0, 0.0, 0.0]), None)
    values, kind, other = (
        (turn, "revolute", slid < _OFF_M) if turned >= _STILL_RAD else (way, "prismatic", True)
    )
    axis, off = _axis(values)
    limit = _OFF_RAD if kind == "revolute" else _OFF_M
    return UrdfJoint(child, kind if other and off < limit else "floating", parent, child, T[0], axis, None)


def _axis(values: FloatArray) -> tuple[FloatArray, float]:
    """The axis of vectors (n, 3), its largest component positive, and their largest deviation from it."""
    axis = np.linalg.svd(values, full_matrices=False)[2][0]
    axis = axis * np.sign(axis[np.argmax(np.abs(axis))])
    off = values - np.outer(values @ axis, axis)
    return axis, float(np.linalg.norm(off, axis=1).max())
