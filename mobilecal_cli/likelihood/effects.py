"""What a constant of the robot changes, and the derivative of the prediction by it.

There is one base class for each place where a constant enters: joint positions, the head's chain, the cameras, the
board, and the wheels' stamps. `nuisance` has the rows.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, field, replace

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.kinematics import JointFrames
from mobilecal_cli.likelihood.measurements import Measurements
from mobilecal_cli.model import CameraRig, FloatArray, HeadChain, JointLink, LensCorrection


class Effect:
    """What a constant changes."""

    __slots__ = ()

    def offered(self, data: Measurements) -> bool:
        """Whether this recording can show the constant at all."""
        return True


class JointEffect(Effect, ABC):
    """Changes the joints' positions."""

    __slots__ = ()

    @abstractmethod
    def rate(self, data: Measurements, value: float) -> FloatArray:
        """(N, J) derivative of the joint positions by the value."""

    def shift(self, data: Measurements, value: float) -> FloatArray:
        """(N, J) to be added to the joint readings, rad or m."""
        shift: FloatArray = value * self.rate(data, value)
        return shift


@dataclass(frozen=True, slots=True)
class JointClock(JointEffect):
    """Offset of the joints' stamps, s: joints in motion are read at another moment."""

    def offered(self, data: Measurements) -> bool:
        """Only stations in motion show an offset."""
        return bool(data.moving.any()) and bool(data.joint_tracks)

    def shift(self, data: Measurements, value: float) -> FloatArray:
        """(N, J) motion of the joints within the offset."""
        return data.joint_shift(value)

    def rate(self, data: Measurements, value: float) -> FloatArray:
        """(N, J) joint rates."""
        return data.joint_rates(value)


@dataclass(frozen=True, slots=True)
class OneJointEffect(JointEffect):
    """Changes the position of one joint, by its column."""

    joint: int

    @abstractmethod
    def own_rate(self, data: Measurements) -> FloatArray | float:
        """(N,) derivative of this joint's positions by the value."""

    def rate(self, data: Measurements, value: float) -> FloatArray:
        """(N, J) derivative of the joint positions by the value."""
        rate = np.zeros_like(data.joints)
        rate[:, self.joint] = self.own_rate(data)
        return rate


@dataclass(frozen=True, slots=True)
class JointZero(OneJointEffect):
    """Zero offset of a joint, rad or m."""

    def own_rate(self, data: Measurements) -> FloatArray | float:
        """The same at all stations."""
        return 1.0


@dataclass(frozen=True, slots=True)
class JointScale(OneJointEffect):
    """Relative error of a joint's reading."""

    def own_rate(self, data: Measurements) -> FloatArray | float:
        """The reading."""
        return data.joints[:, self.joint]


@dataclass(frozen=True, slots=True)
class JointPlay(OneJointEffect):
    """Backlash of a joint, rad or m: the whole play between its two approach directions."""

    def offered(self, data: Measurements) -> bool:
        """Only a joint that was approached from both directions shows its play."""
        return bool(np.ptp(data.approach_direction[:, self.joint]))

    def own_rate(self, data: Measurements) -> FloatArray | float:
        """Half of the approach direction, negative."""
        return -data.approach_direction[:, self.joint] / 2


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


class ChainEffect(Effect, ABC):
    """Changes the head's chain."""

    __slots__ = ()

    @abstractmethod
    def add(self, change: ChainChange, value: float) -> None:
        """Add a value to the change."""

    @abstractmethod
    def twist(self, frames: JointFrames, change: ChainChange) -> FloatArray:
        """(N, 6) derivative of the head poses by the value: left twists in the base's frame."""


@dataclass(frozen=True, slots=True)
class AxisTurn(ChainEffect):
    """Rotation of a joint's axis about a direction in the joint's own frame, rad: nothing moves at the joint's zero."""

    link: int
    about: tuple[float, float, float]

    def add(self, change: ChainChange, value: float) -> None:
        """Add to the rotation vector."""
        change.turn[self.link] = change.turn.get(self.link, np.zeros(3)) + value * np.array(self.about)

    def twist(self, frames: JointFrames, change: ChainChange) -> FloatArray:
        """exp(u) R exp(-u) turns by (I - R) u, about the joint's origin."""
        turn = change.turn.get(self.link, np.zeros(3))
        return frames.by_axis(self.link, se3.left_jacobian_so3(turn) @ np.array(self.about))


@dataclass(frozen=True, slots=True)
class OriginShift(ChainEffect):
    """Shift of a joint's origin along a direction in the joint's own frame, m: all that follows moves with it."""

    link: int
    along: tuple[float, float, float]

    def add(self, change: ChainChange, value: float) -> None:
        """Add to the displacement."""
        change.shift[self.link] = change.shift.get(self.link, np.zeros(3)) + value * np.array(self.along)

    def twist(self, frames: JointFrames, change: ChainChange) -> FloatArray:
        """A translation along the direction."""
        return frames.frames[self.link].shifted(np.array(self.along))


@dataclass
class CameraChange:
    """The sum of what all camera constants change; the first axis of the arrays is the camera.

    Attributes:
        turn: (C, 3) rotation vector of each camera about the first one's axes, from the left, rad.
        swing: (C, 3) rotation vector of its position about the first camera's axes, rad.
        length: (C,) relative change of its distance from the first camera.
        shift: (C, 3) displacement along the first camera's axes, m.
        focal: (C, 2) relative change of fx and fy.
        principal: (C, 2) change of (cx, cy) in shares of the image width.
        lens: (C, 4) see `LensCorrection`.
        delay_s: (C,) see `ImageDelay`.
        readout_s: see `ReadOut`.
    """

    turn: FloatArray
    swing: FloatArray
    length: FloatArray
    shift: FloatArray
    focal: FloatArray
    principal: FloatArray
    lens: FloatArray
    delay_s: FloatArray
    readout_s: float = 0.0

    @classmethod
    def none(cls, cameras: int) -> CameraChange:
        """No change of a number of cameras."""

        def zeros(*size: int) -> FloatArray:
            return np.zeros((cameras, *size))

        return cls(zeros(3), zeros(3), zeros(), zeros(3), zeros(2), zeros(2), zeros(4), zeros())

    def late_s(self, camera: int, rows: FloatArray) -> FloatArray:
        """Time after the stamp at which corners in rows (..., from -1/2 to 1/2) are exposed, s."""
        return np.asarray(self.delay_s[camera] + self.readout_s * rows)

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
        return replace(rig, each=tuple(each), T_c_each=tuple(poses))


@dataclass(frozen=True, slots=True, eq=False)
class Sight:
    """The predicted corners of one camera, at which derivatives are taken.

    Attributes:
        camera: index of the camera.
        stated, rig: the cameras as stated, and with all constants applied.
        change: what was applied.
        pixels: (N, M, 2) predicted pixels before the lens correction.
        terms: (N, M, 4, 2) displacements by a lens correction of one, term by term.
        through: (N, M, 2, 2) derivative of the pixels after the correction by those before; None for the identity.
        points_c: (N, M, 3) corners in the first camera's frame, m.
        by_point_c: (3, N, M, 2) derivative of the corrected pixels by the point in the first camera's frame, px/m.
        velocity_c: (N, M, 3) of the corners in the first camera's frame, m/s.
        rows: (N, M) row of each corner from the middle of the image, in image heights.
    """

    camera: int
    stated: CameraRig
    rig: CameraRig
    change: CameraChange
    pixels: FloatArray
    terms: FloatArray
    through: FloatArray | None
    points_c: FloatArray
    by_point_c: FloatArray
    velocity_c: FloatArray
    rows: FloatArray

    def by_shift(self, shift_c: FloatArray) -> FloatArray:
        """(N, M, 2) derivative of the pixels where the points move by (N, M, 3) in the first camera's frame, m."""
        by_x, by_y, by_z = self.by_point_c
        moved: FloatArray = by_x * shift_c[..., 0, None]
        moved += by_y * shift_c[..., 1, None]
        moved += by_z * shift_c[..., 2, None]
        return moved

    def corrected(self, shift: FloatArray) -> FloatArray:
        """(N, M, 2) displacements of pixels before the correction as displacements after it."""
        return shift if self.through is None else np.asarray((self.through @ shift[..., None])[..., 0])


class CameraEffect(Effect, ABC):
    """Changes the cameras."""

    __slots__ = ()

    def offered(self, data: Measurements) -> bool:
        """Only corners show it."""
        return not data.posed.all()

    @abstractmethod
    def add(self, change: CameraChange, value: float) -> None:
        """Add a value to the change."""

    @abstractmethod
    def pixels(self, sight: Sight) -> FloatArray | None:
        """(N, M, 2) derivative of a camera's predicted pixels, or None where it does not depend on this."""


@dataclass(frozen=True, slots=True)
class OneCameraEffect(CameraEffect):
    """Changes one camera, by its index."""

    camera: int

    def offered(self, data: Measurements) -> bool:
        """Only corners in this camera show it."""
        return bool(data.seen[:, self.camera].any())

    def pixels(self, sight: Sight) -> FloatArray | None:
        """None for the other cameras."""
        return self.own_pixels(sight) if sight.camera == self.camera else None

    @abstractmethod
    def own_pixels(self, sight: Sight) -> FloatArray:
        """(N, M, 2) derivative of this camera's predicted pixels."""


class PoseEffect(OneCameraEffect):
    """Changes the pose of a camera in the first one."""

    __slots__ = ()


@dataclass(frozen=True, slots=True)
class CameraTurn(PoseEffect):
    """Rotation of a camera about an axis of the first one, rad."""

    axis: int

    def add(self, change: CameraChange, value: float) -> None:
        """Add to the rotation vector."""
        change.turn[self.camera, self.axis] += value

    def own_pixels(self, sight: Sight) -> FloatArray:
        """R_c_r -> exp(rho) R_c_r turns the points the other way about the camera's center."""
        axis = se3.left_jacobian_so3(sight.change.turn[self.camera])[:, self.axis]
        arm = sight.points_c - sight.rig.T_c_each[self.camera][:3, 3]
        return -sight.by_shift(np.cross(axis, arm))


@dataclass(frozen=True, slots=True)
class CameraShift(PoseEffect):
    """Displacement of a camera along an axis of the first one, m."""

    axis: int

    def add(self, change: CameraChange, value: float) -> None:
        """Add to the displacement."""
        change.shift[self.camera, self.axis] += value

    def own_pixels(self, sight: Sight) -> FloatArray:
        """The camera moves along the axis."""
        return -sight.by_shift(np.eye(3)[self.axis])


@dataclass(frozen=True, slots=True)
class BaselineTurn(PoseEffect):
    """Rotation of a camera's baseline about a direction in the first camera's frame, rad."""

    about: tuple[float, float, float]

    def add(self, change: CameraChange, value: float) -> None:
        """Add to the rotation vector."""
        change.swing[self.camera] += value * np.array(self.about)

    def own_pixels(self, sight: Sight) -> FloatArray:
        """The camera moves around the first one."""
        turn = se3.left_jacobian_so3(sight.change.swing[self.camera]) @ np.array(self.about)
        return -sight.by_shift(np.cross(turn, sight.rig.T_c_each[self.camera][:3, 3]))


@dataclass(frozen=True, slots=True)
class BaselineScale(PoseEffect):
    """Relative change of a camera's distance from the first one."""

    def add(self, change: CameraChange, value: float) -> None:
        """Add to the scale."""
        change.length[self.camera] += value

    def own_pixels(self, sight: Sight) -> FloatArray:
        """The camera moves along the baseline."""
        length = 1 + sight.change.length[self.camera]
        return -sight.by_shift(sight.rig.T_c_each[self.camera][:3, 3] / length)


@dataclass(frozen=True, slots=True)
class FocalLength(OneCameraEffect):
    """Relative change of a camera's focal lengths fx and fy."""

    x: float = 1.0
    y: float = 1.0

    def add(self, change: CameraChange, value: float) -> None:
        """Add to both."""
        change.focal[self.camera] += value * np.array([self.x, self.y])

    def own_pixels(self, sight: Sight) -> FloatArray:
        """Pixels move away from the principal point."""
        shares = np.array([self.x, self.y]) / (1 + sight.change.focal[self.camera])
        return sight.corrected((sight.pixels - sight.rig.each[self.camera].K[:2, 2]) * shares)


@dataclass(frozen=True, slots=True)
class PrincipalPoint(OneCameraEffect):
    """Shift of a camera's principal point along x (0) or y (1), in shares of the image width."""

    axis: int

    def add(self, change: CameraChange, value: float) -> None:
        """Add to cx or cy."""
        change.principal[self.camera, self.axis] += value

    def own_pixels(self, sight: Sight) -> FloatArray:
        """All pixels move alike."""
        shift = np.zeros_like(sight.pixels)
        shift[..., self.axis] = sight.stated.each[self.camera].width
        return sight.corrected(shift)


@dataclass(frozen=True, slots=True)
class LensTerm(OneCameraEffect):
    """One term of a camera's lens correction, in shares of the image width; see `camera.lens_terms`."""

    term: int

    def add(self, change: CameraChange, value: float) -> None:
        """Add to the term."""
        change.lens[self.camera, self.term] += value

    def own_pixels(self, sight: Sight) -> FloatArray:
        """The displacement by a correction of one."""
        return sight.terms[..., self.term, :]


@dataclass(frozen=True, slots=True)
class ImageDelay(OneCameraEffect):
    """Time of a camera's images against their stamps, s: the points move in the camera meanwhile."""

    def offered(self, data: Measurements) -> bool:
        """Only corners in motion show a delay."""
        has_corners = bool(data.seen[:, self.camera].any())
        return has_corners and bool(data.moving.any()) and bool(data.joint_tracks)

    def add(self, change: CameraChange, value: float) -> None:
        """Add to the delay."""
        change.delay_s[self.camera] += value

    def own_pixels(self, sight: Sight) -> FloatArray:
        """Pixels move as their points do."""
        return sight.by_shift(sight.velocity_c)


@dataclass(frozen=True, slots=True)
class ReadOut(CameraEffect):
    """Time between the first and the last row of every camera's images, s.

    Rows are exposed around the stamp, the first before and the last after it.
    """

    def offered(self, data: Measurements) -> bool:
        """Only corners in motion show it."""
        return not data.posed.all() and bool(data.moving.any()) and bool(data.joint_tracks)

    def add(self, change: CameraChange, value: float) -> None:
        """Add to the read-out time."""
        change.readout_s += value

    def pixels(self, sight: Sight) -> FloatArray | None:
        """Pixels move as their points do."""
        return sight.by_shift(sight.velocity_c * sight.rows[..., None])


class BoardEffect(Effect, ABC):
    """Changes the board's shape."""

    __slots__ = ()

    def offered(self, data: Measurements) -> bool:
        """Only corners show it."""
        return not data.posed.all()

    @abstractmethod
    def displacement(self, points_k: FloatArray) -> FloatArray:
        """(M, 3) displacement of the corners by a value of one, m; points_k: as stated, (M, 3) m."""


@dataclass(frozen=True, slots=True)
class BoardScale(BoardEffect):
    """Relative size of the board along its two axes."""

    along_x: float
    along_y: float

    def displacement(self, points_k: FloatArray) -> FloatArray:
        """Corners move away from the board's origin."""
        return points_k * [self.along_x, self.along_y, 0.0]


@dataclass(frozen=True, slots=True)
class BoardBend(BoardEffect):
    """Bend of the board along x (0) or y (1): how far its middle stands out from the line between its edges, m."""

    axis: int

    def displacement(self, points_k: FloatArray) -> FloatArray:
        """A parabola."""
        along = points_k[:, self.axis]
        half = max(float(np.ptp(along)) / 2, 1e-9)
        out = np.zeros_like(points_k)
        out[:, 2] = 1 - ((along - (along.max() + along.min()) / 2) / half) ** 2
        return out


@dataclass(frozen=True, slots=True)
class BoardTwist(BoardEffect):
    """Twist of the board: how far its corners stand out, two diagonal ones to the front and two to the back, m."""

    def displacement(self, points_k: FloatArray) -> FloatArray:
        """A saddle."""
        middle = (points_k.max(axis=0) + points_k.min(axis=0)) / 2
        half = np.maximum(np.ptp(points_k, axis=0) / 2, 1e-9)
        out = np.zeros_like(points_k)
        out[:, 2] = np.prod(((points_k - middle) / half)[:, :2], axis=1)
        return out


@dataclass(frozen=True, slots=True)
class BoardShear(BoardEffect):
    """Angle between the board's rows and columns, less 90 degrees, rad."""

    def displacement(self, points_k: FloatArray) -> FloatArray:
        """Corners move along x, in proportion to y."""
        return points_k[:, [1, 1, 2]] * [1.0, 0.0, 0.0]


@dataclass(frozen=True, slots=True)
class BaseLean(Effect):
    """Roll (0) or pitch (1) of the base against the floor's normal, the same at all stations, rad."""

    axis: int


@dataclass(frozen=True, slots=True)
class TurnSlip(Effect):
    """Relative change of the effective separation per turning rate over its mean: wheels that slip in turns."""

    def offered(self, data: Measurements) -> bool:
        """Only several wheels a side slip in every turn."""
        return data.several_wheels


@dataclass(frozen=True, slots=True)
class WheelClock(Effect):
    """Offset of the wheels' stamps, s: legs are cut at another moment."""

    def offered(self, data: Measurements) -> bool:
        """Only stations in motion show an offset."""
        return bool(data.moving.any()) and bool(data.joint_tracks)
