"""What a constant of the robot changes, and the derivative of the prediction by it.

There is one class for each place where a constant enters: stamps, joint positions, the head's chain, the cameras,
the board, the base, and the wheels. `constants` has the rows.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.kinematics import Increments, JointFrames, Unevenness
from mobilecal_cli.likelihood.measurements import Measurements
from mobilecal_cli.model.arrays import BoolArray, FloatArray
from mobilecal_cli.model.rig import CameraRig, HeadChain, JointLink, LensCorrection


class Effect:
    """What a constant changes."""

    __slots__ = ()

    def offered(self, data: Measurements) -> bool:
        """Whether this recording can show the constant at all."""
        return True


def _in_motion(data: Measurements) -> BoolArray:
    """(N,) stations that show an offset of stamps."""
    return data.moving & bool(data.joint_tracks)


@dataclass(frozen=True, slots=True)
class Clock(Effect):
    """Offset of the stamps of joints or wheels against the cameras', s: those in motion are read at another moment.

    Attributes:
        of: "joints" or "wheels".
        log: the recording that it belongs to; None for all.
    """

    of: Literal["joints", "wheels"]
    log: int | None = None

    def stations(self, data: Measurements) -> BoolArray:
        """(N,) those of the recording."""
        every = np.ones(data.stations, dtype=np.bool_)
        return every if self.log is None else np.asarray(data.log == self.log)

    def offered(self, data: Measurements) -> bool:
        """Only stations in motion show an offset."""
        return bool((self.stations(data) & _in_motion(data)).any())


# -- joints -----------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class JointReading(Effect):
    """Changes the position of one joint.

    Attributes:
        joint: its column.
        error: "zero", its zero offset, rad or m; "scale", the relative error of its reading; "play", its backlash, rad
            or m: the whole play between its two approach directions.
    """

    joint: int
    error: Literal["zero", "scale", "play"]

    def offered(self, data: Measurements) -> bool:
        """Only a joint that was approached from both directions shows its play."""
        return self.error != "play" or bool(np.ptp(data.approach_direction[:, self.joint]))

    def rate(self, data: Measurements) -> FloatArray:
        """(N, J) derivative of the joint positions by the value."""
        by_error: dict[str, FloatArray | float] = {
            "zero": 1.0,
            "scale": data.joints[:, self.joint],
            "play": -data.approach_direction[:, self.joint] / 2,
        }
        rate = np.zeros_like(data.joints)
        rate[:, self.joint] = by_error[self.error]
        return rate


# -- head chain -------------------------------------------------------------------------------------


@dataclass
class ChainChange:
    """The sum of what all chain constants change, by the index of the link.

    Attributes:
        turn: rotation vector that turns a joint's axis, in the joint's own frame, rad.
        shift: displacement of a joint's origin, in the joint's own frame, m.
    """

    turn: dict[int, FloatArray] = field(default_factory=dict)
    shift: dict[int, FloatArray] = field(default_factory=dict)

    def apply(self, chain: HeadChain) -> HeadChain:
        """The chain after the change."""
        links = list(chain.links)
        for index in {*self.turn, *self.shift}:
            link = links[index]
            assert isinstance(link, JointLink)
            turn = se3.exp_so3(self.turn.get(index, np.zeros(3)))
            links[index] = replace(link, axis=turn @ link.axis, shift_m=self.shift.get(index, np.zeros(3)))
        return replace(chain, links=tuple(links))


@dataclass(frozen=True, slots=True)
class ChainEffect(Effect):
    """Changes a joint of the head's chain, in the joint's own frame.

    Attributes:
        link: index of the joint's link.
        of: attribute of `ChainChange`. "turn": nothing moves at the joint's zero; "shift": all that follows moves.
        along: the vector that a value of one adds to it.
    """

    link: int
    of: Literal["turn", "shift"]
    along: tuple[float, float, float]

    def add(self, change: ChainChange, value: float) -> None:
        """Add a value to the change."""
        vectors: dict[int, FloatArray] = getattr(change, self.of)
        vectors[self.link] = vectors.get(self.link, np.zeros(3)) + value * np.array(self.along)

    def twist(self, frames: JointFrames, change: ChainChange) -> FloatArray:
        """(N, 6) derivative of the head poses by the value: left twists in the base's frame."""
        along = np.array(self.along)
        if self.of == "shift":
            return frames.frames[self.link].shifted(along)
        # exp(u) R exp(-u) turns by (I - R) u, about the joint's origin.
        turn = change.turn.get(self.link, np.zeros(3))
        return frames.by_axis(self.link, se3.left_jacobian_so3(turn) @ along)


# -- cameras ----------------------------------------------------------------------------------------


@dataclass
class CameraChange:
    """The sum of what all camera constants change; the first axis of the arrays is the camera.

    Attributes:
        turn: (C, 3) rotation vector of each camera about the first one's axes, from the left, rad.
        swing: (C, 3) rotation vector of its position about the first camera's axes, rad.
        length: (C, 1) relative change of its distance from the first camera.
        shift: (C, 3) displacement along the first camera's axes, m.
        focal: (C, 2) relative change of fx and fy.
        principal: (C, 2) change of (cx, cy) in shares of the image width.
        lens: (C, L) see `LensCorrection`.
        delay_s: (C, 1) time of its images against their stamps: the points move in the camera meanwhile, s.
        readout_s: (C, 1) time between its first and last row, exposed before and after the stamp, s.
    """

    turn: FloatArray
    swing: FloatArray
    length: FloatArray
    shift: FloatArray
    focal: FloatArray
    principal: FloatArray
    lens: FloatArray
    delay_s: FloatArray
    readout_s: FloatArray

    @classmethod
    def none(cls, cameras: int, lens_terms: int = 4) -> CameraChange:
        """No change of a number of cameras."""
        return cls(*(np.zeros((cameras, size)) for size in (3, 3, 1, 3, 2, 2, lens_terms, 1, 1)))

    def late_s(self, camera: int, rows: FloatArray) -> FloatArray:
        """Time after the stamp at which corners in rows (..., from -1/2 to 1/2) are exposed, s."""
        return np.asarray(self.delay_s[camera] + self.readout_s[camera] * rows)

    def apply(self, rig: CameraRig) -> CameraRig:
        """The cameras after the change."""
        each, poses = [], []
        for k, (stated, T_c_camera) in enumerate(zip(rig.each, rig.T_c_each, strict=True)):
            T = T_c_camera.copy()
            T[:3, :3] = se3.exp_so3(self.turn[k]) @ T[:3, :3]
            T[:3, 3] = (1 + self.length[k]) * se3.exp_so3(self.swing[k]) @ T[:3, 3] + self.shift[k]
            poses.append(T)
            K = stated.K.copy()
            K[[0, 1], [0, 1]] *= 1 + self.focal[k]
            K[:2, 2] += self.principal[k] * stated.width
            lens = LensCorrection(self.lens[k], stated.K[:2, 2]) if np.any(self.lens[k]) else None
            each.append(replace(stated, K=K, correction=lens))
        return replace(rig, each=tuple(each), T_c_each=np.stack(poses))


#: Attributes of `CameraChange`: those of a camera's pose in the first one but for the baseline's length, of the camera
#: itself, and of its clock.
POSE, INTRINSICS, TIMES = ("turn", "swing", "shift"), ("focal", "principal", "lens"), ("delay_s", "readout_s")


class ImageEffect(Effect):
    """Changes the cameras or the board, not the camera's pose."""

    __slots__ = ()

    def concerns(self, camera: int) -> bool:
        """Whether the pixels of a camera depend on this."""
        return True


@dataclass(frozen=True, slots=True)
class CameraEffect(ImageEffect):
    """Changes one camera, or all alike.

    Attributes:
        of: attribute of `CameraChange`.
        along: the vector that a value of one adds to it, or to the first of its numbers.
        camera: index; None for all.
    """

    of: str
    along: tuple[float, ...]
    camera: int | None

    def offered(self, data: Measurements) -> bool:
        """Only corners in the camera show it, and a time only in motion."""
        shown = data.seen if self.camera is None else data.seen[:, self.camera]
        return bool(shown.any()) and (self.of not in TIMES or bool(_in_motion(data).any()))

    def add(self, change: CameraChange, value: float) -> None:
        """Add a value to the change."""
        of = slice(None) if self.camera is None else self.camera
        getattr(change, self.of)[of, ..., : len(self.along)] += value * np.array(self.along)

    def concerns(self, camera: int) -> bool:
        """Whether the pixels of a camera depend on this."""
        return self.camera in (None, camera)


# -- board ------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, eq=False)
class BoardEffect(ImageEffect):
    """Changes the board's shape.

    Attributes:
        displacement: corners as stated, (M, 3) m → their displacement by a value of one, (M, 3) m.
    """

    displacement: Callable[[FloatArray], FloatArray]

    def offered(self, data: Measurements) -> bool:
        """Only corners show it."""
        return not data.posed


def resized(points_k: FloatArray, x: float, y: float) -> FloatArray:
    """Relative size along the two axes: corners move away from the board's origin."""
    return points_k * [x, y, 0.0]


def sheared(points_k: FloatArray) -> FloatArray:
    """Angle between rows and columns, less 90 degrees: corners move along x, in proportion to y."""
    return np.asarray(points_k[:, [1, 1, 2]] * [1.0, 0.0, 0.0])


def bent(points_k: FloatArray, axis: int) -> FloatArray:
    """Parabola along x (0) or y (1): how far the middle stands out from the line between the edges."""
    out = np.zeros_like(points_k)
    out[:, 2] = 1 - _from_middle(points_k)[:, axis] ** 2
    return out


def twisted(points_k: FloatArray) -> FloatArray:
    """Saddle: how far the board's corners stand out, two diagonal ones to the front and two to the back."""
    out = np.zeros_like(points_k)
    out[:, 2] = np.prod(_from_middle(points_k)[:, :2], axis=1)
    return out


def _from_middle(points_k: FloatArray) -> FloatArray:
    """(M, 3) places from -1 to 1 along each axis of the board."""
    middle = (points_k.max(axis=0) + points_k.min(axis=0)) / 2
    return np.asarray((points_k - middle) / np.maximum(np.ptp(points_k, axis=0) / 2, 1e-9))


# -- base and wheels --------------------------------------------------------------------------------


class FloorEffect(Effect, ABC):
    """Changes how the base stands: its roll, pitch and height against the plane of x and y."""

    __slots__ = ()

    @abstractmethod
    def stance(self, data: Measurements, base: FloatArray) -> FloatArray:
        """(N, 3) roll, pitch (rad) and height (m) by a value of one, at base poses, see `State.base`."""

    def stance_by_base(self, data: Measurements, base: FloatArray) -> FloatArray:
        """(N, 3, 3) derivative of these by a step of the base along its own x and y (m), and of its heading (rad)."""
        return np.zeros((len(base), 3, 3))


@dataclass(frozen=True, slots=True)
class BaseLean(FloorEffect):
    """Roll (0) or pitch (1) of the base against the floor's normal, the same at all stations, rad."""

    axis: int

    def stance(self, data: Measurements, base: FloatArray) -> FloatArray:
        """(N, 3) roll, pitch (rad) and height (m) by a value of one."""
        return np.broadcast_to(np.eye(3)[self.axis], (len(base), 3))


_FLOOR_REACH_M = 100.0  # no polynomial goes further: a fit that is lost there must not overflow


@dataclass(frozen=True, slots=True)
class FloorShape(FloorEffect):
    """Height of the floor in one recording: x^a y^b, m, at a place (x, y), m, in the recording's world frame.

    Attributes:
        powers: a and b.
        log: the recording that it belongs to.
        terms: number of terms of the whole shape.
    """

    powers: tuple[int, int]
    log: int
    terms: int

    def offered(self, data: Measurements) -> bool:
        """Only the images of a base that drives to more places than a floor has terms show it."""
        return not data.motions and int(((data.log == self.log) & data.drives).sum()) > self.terms

    def _derivative(self, data: Measurements, base: FloatArray, by_x: int, by_y: int) -> FloatArray:
        """(N,) so many times by x and by y, 0 in other recordings."""
        (a, b), (x, y) = self.powers, np.clip(base[:, :2].T, -_FLOOR_REACH_M, _FLOOR_REACH_M)
        factor = math.perm(a, by_x) * math.perm(b, by_y) * (data.log == self.log)
        return np.asarray(factor * x ** max(a - by_x, 0) * y ** max(b - by_y, 0))

    def stance(self, data: Measurements, base: FloatArray) -> FloatArray:
        """(N, 3) roll, pitch (rad) and height (m) by a value of one."""
        height, by_x, by_y = (self._derivative(data, base, *by) for by in ((0, 0), (1, 0), (0, 1)))
        cos, sin = np.cos(base[:, 2]), np.sin(base[:, 2])
        return np.stack([cos * by_y - sin * by_x, -cos * by_x - sin * by_y, height], axis=1)

    def stance_by_base(self, data: Measurements, base: FloatArray) -> FloatArray:
        """(N, 3, 3) derivative of these by a step of the base."""
        left, back, _ = self.stance(data, base).T
        xx, xy, yy = (self._derivative(data, base, *by) for by in ((2, 0), (1, 1), (0, 2)))
        cos, sin = np.cos(base[:, 2]), np.sin(base[:, 2])
        T = np.array([[cos, sin], [-sin, cos]]).transpose(2, 0, 1)
        curvature = T @ np.array([[xx, xy], [xy, yy]]).transpose(2, 0, 1) @ T.mT
        by = np.zeros((len(base), 3, 3))
        by[:, 0, :2], by[:, 1, :2] = curvature[:, 1], -curvature[:, 0]
        by[:, 0, 2], by[:, 1, 2] = back, -left
        by[:, 2, :2] = np.stack([-back, left], axis=1)
        return by


@dataclass(frozen=True, slots=True)
class FloorDrift(Effect):
    """Drift over a floor that carries the base along, as a carpet does: m in the world frame, per m of the wheels.

    Attributes:
        axis: x (0) or y (1).
        log: the recording that it belongs to.
    """

    axis: int
    log: int

    def offered(self, data: Measurements) -> bool:
        """Only a base that drives shows it."""
        return bool(((data.log == self.log) & data.drives).any())

    def carried(self, data: Measurements, heading: FloatArray, rolled_m: FloatArray) -> FloatArray:
        """(L, 2) displacement over each leg in the frame of its start by a value of one, m.

        Args:
            data: L legs.
            heading: (L,) at their starts, rad.
            rolled_m: (L,) mean distance that the wheels roll.
        """
        cos, sin = np.cos(heading), np.sin(heading)
        along = np.stack([sin, cos] if self.axis else [cos, -sin], axis=1)
        return np.asarray(along * (rolled_m * (data.log[data.legs[:, 0]] == self.log))[:, None])


class Rolling(Effect, ABC):
    """Changes how far the wheels turn in the steps of the legs, against what is read."""

    __slots__ = ()

    @abstractmethod
    def further(self, steps: Increments, value: float) -> FloatArray:
        """(2, n) rotation of the right and left wheel in each step that a value adds, rad."""

    @abstractmethod
    def by_value(self, steps: Increments, value: float) -> FloatArray:
        """(2, n) derivative of it by the value."""


@dataclass(frozen=True, slots=True)
class Widening(Rolling):
    """Relative change of the effective separation in some turns: of wheels that slip, or that do not stand alike.

    Attributes:
        of: see `Increments.unevenness`.
    """

    of: Unevenness

    def offered(self, data: Measurements) -> bool:
        """Only several wheels a side slip in every turn."""
        return data.sources.several_wheels or self.of != "rate"

    def further(self, steps: Increments, value: float) -> FloatArray:
        """(2, n) wheels at the mean separation turn the base by less where the effective one is wider."""
        uneven = steps.unevenness(self.of)
        return -value * uneven / (1 + value * uneven) * _apart(steps)

    def by_value(self, steps: Increments, value: float) -> FloatArray:
        """(2, n) derivative of it by the value."""
        uneven = steps.unevenness(self.of)
        return -uneven / (1 + value * uneven) ** 2 * _apart(steps)


def _apart(steps: Increments) -> FloatArray:
    """(2, n) rotation of the right and left wheel beside their mean, rad."""
    half = (steps.right_rad - steps.left_rad) / 2
    return np.stack([half, -half])


@dataclass(frozen=True, slots=True)
class WheelDelay(Rolling):
    """Delay of the right wheel's readings against the left one's, s: both are read at a mean time.

    A late reading lacks what the wheel turned meanwhile: more, the faster it turns.
    """

    def offered(self, data: Measurements) -> bool:
        """Only wheels with readings of their own, over time."""
        return not data.sources.of_odometry and not data.motions

    def further(self, steps: Increments, value: float) -> FloatArray:
        """(2, n) what each wheel turns faster by at the end of a step, for half of the delay."""
        return value * self.by_value(steps, value)

    def by_value(self, steps: Increments, value: float) -> FloatArray:
        """(2, n) derivative of it by the value."""
        return np.asarray(steps.changes[0].T * [[0.5], [-0.5]])


@dataclass(frozen=True, slots=True)
class WheelSmoothing(Rolling):
    """Variance of the window over which a driver smooths the wheels' readings, s^2; the square of a low-pass time.

    With a window of variance v around a delay that is the clock's, a reading is ``phi + v / 2 phi''`` to second order.
    """

    def offered(self, data: Measurements) -> bool:
        """Only stations in motion show it."""
        return bool(_in_motion(data).any()) and not data.motions

    def further(self, steps: Increments, value: float) -> FloatArray:
        """(2, n) what the wheels turn more than is read, for a smoothing."""
        return value * self.by_value(steps, value)

    def by_value(self, steps: Increments, value: float) -> FloatArray:
        """(2, n) derivative of it by the value."""
        return np.asarray(-steps.changes[1].T / 2)
