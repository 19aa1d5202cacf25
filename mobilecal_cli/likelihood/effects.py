"""What a constant of the robot changes, and the derivative of the prediction by it.

There is one base class for each place where a constant enters: joint positions, the head's pose, the cameras, the
board, and the wheels' stamps. `nuisance.CONSTANTS` has the rows.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.model import FloatArray, Side, StereoRig

if TYPE_CHECKING:
    from mobilecal_cli.likelihood.dataset import Dataset


class Effect:
    """What a constant changes."""

    __slots__ = ()

    def offered(self, data: Dataset) -> bool:
        """Whether this recording can show the constant at all."""
        return True


class JointEffect(Effect, ABC):
    """Changes the joints' positions."""

    __slots__ = ()

    @abstractmethod
    def rate(self, data: Dataset, value: float) -> FloatArray:
        """(N, J) derivative of the joint positions by the value."""

    def shift(self, data: Dataset, value: float) -> FloatArray:
        """(N, J) to be added to the joint readings, rad or m."""
        shift: FloatArray = value * self.rate(data, value)
        return shift


@dataclass(frozen=True, slots=True)
class JointClock(JointEffect):
    """Offset of the joints' stamps, s: joints in motion are read at another moment."""

    def offered(self, data: Dataset) -> bool:
        """Only stations in motion show an offset."""
        return bool(data.moving.any()) and bool(data.joint_tracks)

    def shift(self, data: Dataset, value: float) -> FloatArray:
        """(N, J) motion of the joints within the offset."""
        return data.joint_shift(value)

    def rate(self, data: Dataset, value: float) -> FloatArray:
        """(N, J) joint rates."""
        return data.joint_rates(value)


@dataclass(frozen=True, slots=True)
class JointZero(JointEffect):
    """Zero offset of the joint with a role ("pan" or "tilt"), rad."""

    role: str

    def offered(self, data: Dataset) -> bool:
        """Wherever the head has this joint."""
        return data.joint_with(self.role) is not None

    def rate(self, data: Dataset, value: float) -> FloatArray:
        """(N, J) 1 in this joint's column."""
        rate = np.zeros_like(data.joints)
        if (joint := data.joint_with(self.role)) is not None:
            rate[:, joint] = 1.0
        return rate


@dataclass(frozen=True, slots=True)
class JointPlay(JointEffect):
    """Backlash of the joint with a role, rad: the whole play between its two approach directions."""

    role: str

    def offered(self, data: Dataset) -> bool:
        """Only a joint that was approached from both directions shows its play."""
        joint = data.joint_with(self.role)
        return joint is not None and bool(np.ptp(data.approach_direction[:, joint]))

    def rate(self, data: Dataset, value: float) -> FloatArray:
        """(N, J) half of the approach direction, negative, in this joint's column."""
        rate = np.zeros_like(data.joints)
        if (joint := data.joint_with(self.role)) is not None:
            rate[:, joint] = -data.approach_direction[:, joint] / 2
        return rate


class HeadEffect(Effect, ABC):
    """Changes the head's pose in the base."""

    __slots__ = ()

    @abstractmethod
    def apply(self, T_v_h: FloatArray, value: float) -> FloatArray:
        """(N, 4, 4) head poses with the change."""

    @abstractmethod
    def twist(self, T_v_h: FloatArray) -> FloatArray:
        """(N, 6) derivative of head poses (N, 4, 4) by the value: left twists in the base's frame."""


@dataclass(frozen=True, slots=True)
class MountShift(HeadEffect):
    """Shift of the head's mount along an axis of the base, m."""

    axis: int

    def apply(self, T_v_h: FloatArray, value: float) -> FloatArray:
        """(N, 4, 4) head poses with the shift."""
        T = T_v_h.copy()
        T[:, self.axis, 3] += value
        return T

    def twist(self, T_v_h: FloatArray) -> FloatArray:
        """(N, 6) translation along the axis."""
        twist = np.zeros((len(T_v_h), 6))
        twist[:, 3 + self.axis] = 1.0
        return twist


@dataclass
class CameraChange:
    """The sum of what all camera constants change.

    Attributes:
        turn: (3,) rotation vector of the right camera about the left one's axes, from the left, rad.
        baseline: relative change of the baseline's length.
        focal_px, principal_px: by side, change of fx (fy in proportion) and of (cx, cy).
    """

    turn: FloatArray = field(default_factory=lambda: np.zeros(3))
    baseline: float = 0.0
    focal_px: dict[Side, float] = field(default_factory=lambda: {"left": 0.0, "right": 0.0})
    principal_px: dict[Side, FloatArray] = field(
        default_factory=lambda: {"left": np.zeros(2), "right": np.zeros(2)}
    )

    def apply(self, rig: StereoRig) -> StereoRig:
        """The stereo pair after the change."""
        T = rig.T_c_r.copy()
        T[:3, :3] = se3.exp_so3(self.turn) @ T[:3, :3]
        T[:3, 3] *= 1 + self.baseline
        changed = {}
        for side, camera in (("left", rig.left), ("right", rig.right)):
            K = camera.K.copy()
            K[0, 0] += self.focal_px[side]  # type: ignore[index]
            K[1, 1] += self.focal_px[side] * camera.K[1, 1] / camera.K[0, 0]  # type: ignore[index]
            K[:2, 2] += self.principal_px[side]  # type: ignore[index]
            changed[side] = replace(camera, K=K)
        return replace(rig, left=changed["left"], right=changed["right"], T_c_r=T)


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """The predicted corners of one camera, at which derivatives are taken.

    Attributes:
        side: which camera.
        stated, rig: the stereo pair as stated, and with all constants applied.
        turn: (3,) rotation of the right camera that is part of `rig`, see `CameraChange`.
        at: (N, M, 2) predicted pixels.
        points_c: (N, M, 3) corners in the left camera's frame, m.
        by_point: (N, M, 2, 3) derivative of the pixels by the point in this camera's own frame, px/m.
        by_point_c: (N, M, 2, 3) the same by the point in the left camera's frame.
    """

    side: Side
    stated: StereoRig
    rig: StereoRig
    turn: FloatArray
    at: FloatArray
    points_c: FloatArray
    by_point: FloatArray
    by_point_c: FloatArray


class CameraEffect(Effect, ABC):
    """Changes the stereo pair."""

    __slots__ = ()

    @abstractmethod
    def add(self, change: CameraChange, value: float) -> None:
        """Add a value to the change."""

    @abstractmethod
    def pixels(self, sight: Sight) -> FloatArray | None:
        """(N, M, 2) derivative of a camera's predicted pixels, or None where it does not depend on this."""


@dataclass(frozen=True, slots=True)
class RightTurn(CameraEffect):
    """Rotation of the right camera about an axis of the left one, rad."""

    axis: int

    def add(self, change: CameraChange, value: float) -> None:
        """Add to the rotation vector."""
        change.turn[self.axis] += value

    def pixels(self, sight: Sight) -> FloatArray | None:
        """R_c_r -> exp(rho) R_c_r turns the points the other way about the right camera's center."""
        if sight.side == "left":
            return None
        axis = se3.left_jacobian_so3(sight.turn)[:, self.axis]
        arm = sight.points_c - sight.rig.T_c_r[:3, 3]
        return np.asarray(-np.einsum("nmab,nmb->nma", sight.by_point_c, np.cross(axis, arm)))


@dataclass(frozen=True, slots=True)
class BaselineScale(CameraEffect):
    """Relative change of the stereo baseline."""

    def add(self, change: CameraChange, value: float) -> None:
        """Add to the scale."""
        change.baseline += value

    def pixels(self, sight: Sight) -> FloatArray | None:
        """The right camera moves along the baseline."""
        if sight.side == "left":
            return None
        baseline_r = sight.rig.T_c_r[:3, :3].T @ sight.stated.T_c_r[:3, 3]
        return np.asarray(-sight.by_point @ baseline_r)


@dataclass(frozen=True, slots=True)
class FocalLength(CameraEffect):
    """Change of a camera's focal length fx, px; fy changes in proportion."""

    side: Side

    def add(self, change: CameraChange, value: float) -> None:
        """Add to fx."""
        change.focal_px[self.side] += value

    def pixels(self, sight: Sight) -> FloatArray | None:
        """Pixels move away from the principal point."""
        if sight.side != self.side:
            return None
        K = (sight.rig.left if self.side == "left" else sight.rig.right).K
        return np.asarray((sight.at - K[:2, 2]) / K[0, 0])


@dataclass(frozen=True, slots=True)
class PrincipalPoint(CameraEffect):
    """Shift of a camera's principal point along x (0) or y (1), px."""

    side: Side
    axis: int

    def add(self, change: CameraChange, value: float) -> None:
        """Add to cx or cy."""
        change.principal_px[self.side][self.axis] += value

    def pixels(self, sight: Sight) -> FloatArray | None:
        """All pixels move alike."""
        if sight.side != self.side:
            return None
        shift = np.zeros_like(sight.at)
        shift[..., self.axis] = 1.0
        return shift


class BoardEffect(Effect, ABC):
    """Changes the board's shape."""

    __slots__ = ()

    @abstractmethod
    def displacement(self, points_k: FloatArray) -> FloatArray:
        """(M, 3) displacement of the corners by a value of one, m; points_k: as stated, (M, 3) m."""


@dataclass(frozen=True, slots=True)
class SquareScale(BoardEffect):
    """Relative size of the board's squares."""

    def displacement(self, points_k: FloatArray) -> FloatArray:
        """All corners move away from the board's origin."""
        return points_k


@dataclass(frozen=True, slots=True)
class WheelClock(Effect):
    """Offset of the wheels' stamps, s: legs are cut at another moment."""

    def offered(self, data: Dataset) -> bool:
        """Only stations in motion show an offset."""
        return bool(data.moving.any()) and bool(data.joint_tracks)
