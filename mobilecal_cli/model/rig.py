"""The robot: cameras, head chain, wheels and board, and the topics with their data."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Annotated, Literal

import numpy as np

from mobilecal_cli.model.arrays import FloatArray, ReadOnly

Side = Literal["left", "right"]
SIDES: tuple[Side, Side] = ("left", "right")
Distortion = Literal["none", "plumb_bob", "rational_polynomial", "equidistant"]


@dataclass(frozen=True, slots=True, eq=False)
class Intrinsics(ReadOnly):
    """Image size, intrinsics and distortion of one camera.

    Attributes:
        frame_id: the optical frame's name.
        width, height: image size, px.
        K: (3, 3) intrinsics, px.
        D: (n,) distortion coefficients in OpenCV's order: n = 0 none, 5 plumb_bob, 8 (or 12, 14)
            rational_polynomial, 4 equidistant.
        distortion: model of D.
    """

    frame_id: str
    width: int
    height: int
    K: Annotated[FloatArray, 3, 3]
    D: Annotated[FloatArray, "n"]
    distortion: Distortion


@dataclass(frozen=True, slots=True, eq=False)
class CameraInfo(Intrinsics):
    """Calibration of one camera from the recording, for the pixels of the images as recorded.

    Binning and region of interest are already applied to K and P. K is that of the raw images.

    Attributes:
        R: (3, 3) rotation from raw to rectified camera coordinates.
        P: (3, 4) projection of rectified coordinates, px; P[0, 3] = -fx * baseline in the right camera.
    """

    R: Annotated[FloatArray, 3, 3]
    P: Annotated[FloatArray, 3, 4]


@dataclass(frozen=True, slots=True, eq=False)
class LensCorrection(ReadOnly):
    """A displacement of pixels on top of a camera's distortion model, the same for every model.

    Attributes:
        shares: (L,) two radial and two tangential terms, their displacement at the image corner in shares of the image
            width, and where there are more, waves over the image; see `camera.lens_terms`.
        center_px: (2,) principal point that the first terms count from.
    """

    shares: Annotated[FloatArray, "L"]
    center_px: Annotated[FloatArray, 2]


@dataclass(frozen=True, slots=True, eq=False)
class Camera(Intrinsics):
    """Pinhole camera with distortion: maps points in the optical frame to pixels.

    Attributes:
        correction: displacement of the pixels on top of the distortion model; None for a camera as stated.
    """

    correction: LensCorrection | None = None


@dataclass(frozen=True, slots=True, eq=False)
class CameraRig(ReadOnly):
    """The cameras, rigidly joined: one or more. Frame c is the optical frame of the first one.

    Attributes:
        names: of the cameras: "left" and "right" for a stereo pair.
        each: the cameras, for the images as recorded (raw or rectified).
        T_c_each: (C, 4, 4) coordinates of each camera to those of the first, m; the first one is the identity.
        rectified: the images are rectified, so the frames are the rectified optical frames.
        R_rect: (C, 3, 3) raw to rectified coordinates of each camera (`CameraInfo.R`).
        reference: name of the camera of the calibrated head-eye transform.
        calibrated: a stereo pair, calibrated together: its baseline gives the scale. The poses of other cameras are
            from a drawing of the robot, which states them less exactly.
    """

    names: tuple[str, ...]
    each: tuple[Camera, ...]
    T_c_each: Annotated[FloatArray, "C", 4, 4]
    rectified: bool
    R_rect: Annotated[FloatArray, "C", 3, 3]
    reference: str
    calibrated: bool = False

    def __post_init__(self) -> None:
        sizes = {len(self.names), len(set(self.names)), len(self.each), len(self.T_c_each), len(self.R_rect)}
        if len(sizes) > 1 or (self.calibrated and len(self.each) != 2) or self.reference not in self.names:
            raise ValueError(f"cameras {self.names} with reference {self.reference!r}: numbers do not match")
        ReadOnly.__post_init__(self)

    @property
    def first(self) -> Camera:
        """The camera whose frame is c."""
        return self.each[0]

    @property
    def of_reference(self) -> Camera:
        """The camera of the head-eye transform."""
        return self.each[self.names.index(self.reference)]

    @property
    def digest(self) -> str:
        """SHA-256 of the cameras' numbers, to nine digits; as stated, they are those of one description."""
        numbers = [
            self.T_c_each,
            self.R_rect,
            *(array for camera in self.each for array in (camera.K, camera.D)),
        ]
        texts = (f"{value + 0.0:.9g}" for array in numbers for value in np.ravel(array).tolist())
        return hashlib.sha256(" ".join(texts).encode()).hexdigest()

    @property
    def baseline_m(self) -> float | None:
        """Distance between the optical centers of a stereo pair, m; None for other cameras."""
        return float(np.linalg.norm(self.T_c_each[1][:3, 3])) if self.calibrated else None

    @property
    def images_words(self) -> str:
        """Where the whole board must be, in texts."""
        return {1: "the image", 2: "both images"}.get(len(self.each), "an image")

    @property
    def cameras_words(self) -> str:
        """What must see the whole board, in texts."""
        return {1: "the camera sees", 2: "both cameras see"}.get(len(self.each), "a camera sees")

    def some(self, cameras: Sequence[int]) -> CameraRig:
        """Some of the cameras, by their indices; c stays the frame of the first of all."""
        names = tuple(self.names[k] for k in cameras)
        return CameraRig(
            names,
            tuple(self.each[k] for k in cameras),
            self.T_c_each[list(cameras)],
            self.rectified,
            self.R_rect[list(cameras)],
            names[0],
        )

    @property
    def T_c_reference(self) -> FloatArray:
        """Reference camera coordinates to those of the first camera, (4, 4), m."""
        T: FloatArray = self.T_c_each[self.names.index(self.reference)]
        return T


def camera_words(name: str) -> str:
    """A camera in texts: "left" → "left camera", "camera" → "camera"."""
    return name if "cam" in name else f"{name} camera"


def shots_words(cameras: int) -> str:
    """What some cameras record at one moment, in texts."""
    return {1: "images", 2: "stereo pairs"}.get(cameras, "groups of images")


@dataclass(frozen=True, slots=True, eq=False)
class FixedLink(ReadOnly):
    """A constant transform in the chain.

    Attributes:
        T_parent_child: (4, 4) child coordinates to parent coordinates, m.
    """

    T_parent_child: Annotated[FloatArray, 4, 4]


@dataclass(frozen=True, slots=True, eq=False)
class JointLink(ReadOnly):
    """A joint in the chain: its motion about or along its axis is multiplier * reading + offset.

    Attributes:
        joint: name in the joint states.
        axis: (3,) unit vector in the joint's own frame.
        kind: revolute (rad) or prismatic (m).
        multiplier, offset: from a URDF <mimic>; 1 and 0 otherwise. offset in rad or m.
        shift_m: (3,) displacement of the joint's origin, in the joint's own frame; zero in a chain as stated.
    """

    joint: str
    axis: Annotated[FloatArray, 3]
    kind: Literal["revolute", "prismatic"] = "revolute"
    multiplier: float = 1.0
    offset: float = 0.0
    shift_m: Annotated[FloatArray, 3] = field(default_factory=lambda: np.zeros(3))


@dataclass(frozen=True, slots=True, eq=False)
class HeadChain:
    """The known geometry from vehicle frame v to head frame h.

    Attributes:
        base_frame: name of v: x forward, y left, z up, origin midway between the wheels.
        head_frame: name of h, the last link of the pan-tilt chain.
        links: fixed and moving links, in order from v to h.
        pan, tilt: joint names for texts and plots ("" if there is none).
    """

    base_frame: str
    head_frame: str
    links: tuple[FixedLink | JointLink, ...]
    pan: str = ""
    tilt: str = ""

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints, each once, in order from the base."""
        return tuple(dict.fromkeys(link.joint for link in self.links if isinstance(link, JointLink)))

    @property
    def prismatic(self) -> frozenset[str]:
        """Names of the prismatic joints, with readings in m."""
        return frozenset(
            link.joint for link in self.links if isinstance(link, JointLink) and link.kind == "prismatic"
        )

    @property
    def joint_units(self) -> tuple[float, ...]:
        """What one unit of joint noise is for each joint: 1 rad of a revolute, 0.1 m of a prismatic one."""
        return tuple(0.1 if name in self.prismatic else 1.0 for name in self.joints)


@dataclass(frozen=True, slots=True)
class Markers:
    """Markers on a board. They identify its corners, so a partial view is sufficient.

    Attributes:
        kind: "charuco": markers in the white squares of a checkerboard, whose inner corners are used; "aprilgrid":
            a grid of tags, whose own corners are used.
        dictionary: marker family by its OpenCV name, such as "DICT_5X5_100".
        share: charuco: side of a marker; aprilgrid: gap between two tags; both as shares of `Board.square_m`.
        first_id: id of the first marker.
        border_bits: width of the markers' black border, in cells of their code.
    """

    kind: Literal["charuco", "aprilgrid"]
    dictionary: str
    share: float
    first_id: int = 0
    border_bits: int = 1


@dataclass(frozen=True, slots=True)
class Board:
    """The calibration board. Frame k: x along a row of corners, y along a column, z = x cross y, away from a
    camera in front of the board; origin at corner 0 (aprilgrid: bottom left corner of the first tag, which is at the
    bottom left, as Kalibr prints it).

    Attributes:
        columns, rows: inner corners along x and along y; aprilgrid: tags.
        square_m: size of a square (aprilgrid: of a tag), m; None if a stereo baseline gives the scale.
        markers: None for a plain checkerboard.
    """

    columns: int
    rows: int
    square_m: float | None = None
    markers: Markers | None = None

    @property
    def corners(self) -> int:
        """Number of corners. Corner index: row * columns + column; aprilgrid: four times the tag's index, plus 0 to 3
        clockwise from the tag's top left.
        """
        return self.columns * self.rows * (4 if self._tags else 1)

    @property
    def _tags(self) -> bool:
        return self.markers is not None and self.markers.kind == "aprilgrid"

    def grid(self) -> FloatArray:
        """Corner positions in units of one square (aprilgrid: one tag), (corners, 3), z = 0."""
        row, column = np.divmod(np.arange(self.columns * self.rows), self.columns)
        if not self._tags or self.markers is None:
            return np.stack([column, row, np.zeros(len(row))], axis=1).astype(np.float64)
        pitch = 1 + self.markers.share
        tags = np.stack([column * pitch, -row * pitch - 1, np.zeros(len(row))], axis=1)
        within = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
        return np.asarray((tags[:, None, :] + within).reshape(-1, 3), dtype=np.float64)


@dataclass(frozen=True, slots=True)
class WheelSource:
    """Source of one wheel's rotation in the recording.

    Attributes:
        topic: name of the topic.
        joint: a joint name in `sensor_msgs/JointState` messages of that topic, or None.
        field: a path into any message ("data", "left.ticks", "values[0]"), or None.
        ticks_per_revolution: counter steps per turn of the wheel; None: the field is an angle in rad.
        bits: width of a counter that wraps around; None: as its readings show.
        sign: +1, or -1 for a counter that decreases when the robot drives forward.
        baked_in: wheels from which a nav_msgs/Odometry topic was computed; None for other topics.
        assumed: `baked_in` is not known but assumed, so that results are factors of the odometry, not lengths.
        separation_share: relative standard deviation of the separation in `baked_in`, where it is assumed.
        others: further wheels of this side; the side's rotation is the mean of all.
        unread: joints of further wheels of this side, which turn with it but are not read; None if not stated.
    """

    topic: str
    joint: str | None = None
    field: str | None = None
    ticks_per_revolution: float | None = None
    bits: int | None = None
    sign: Literal[1, -1] = 1
    baked_in: WheelGeometry | None = None
    assumed: bool = False
    separation_share: float = 0.0
    others: tuple[WheelSource, ...] = ()
    unread: tuple[str, ...] | None = None

    @property
    def every(self) -> tuple[WheelSource, ...]:
        """All wheels of the side that are read, each by itself."""
        return (replace(self, others=(), unread=None), *self.others)

    @property
    def where(self) -> str:
        """Part of the messages that is read, for people."""
        return ", ".join(wheel.joint or wheel.field or "odometry" for wheel in self.every)


@dataclass(frozen=True, slots=True, eq=False)
class JointTransform:
    """Source of one joint's reading: the transform of the link that the joint moves.

    Attributes:
        topic: topic of type tf2_msgs/TFMessage.
        parent, child: frames of the links.
        T_parent_child: (4, 4) at the joint's zero, m.
        axis: (3,) unit vector in the joint's frame.
        kind: type of the joint.
    """

    topic: str
    parent: str
    child: str
    T_parent_child: FloatArray
    axis: FloatArray
    kind: Literal["revolute", "prismatic"]

    @property
    def where(self) -> str:
        """Part of the messages that is read, for people."""
        return f"{self.parent} to {self.child}"


StereoLayout = Literal["separate", "side_by_side", "stacked"]


@dataclass(frozen=True, slots=True)
class JointField:
    """Source of one joint's reading in messages that are not joint states.

    Attributes:
        topic: name of the topic.
        field: a path into any message ("data", "pan.angle", "values[0]").
        scale: rad (or m) of one unit of the field.
    """

    topic: str
    field: str
    scale: float = 1.0

    @property
    def where(self) -> str:
        """Part of the messages that is read, for people."""
        return self.field


#: Topic of joint states, or what is read of other messages.
JointSource = str | JointField | JointTransform


@dataclass(frozen=True, slots=True)
class Sources:
    """The topics used.

    Attributes:
        image: image topic of each camera.
        info: camera-info topic of each camera, "" if the camera calibration is not from the recording.
        joints: head joint → its joint-state topic, or its source in other messages.
        wheels: source of each wheel.
        layout: the images of the cameras in separate messages, or both of a pair in one image of one topic.
    """

    image: Mapping[str, str]
    info: Mapping[str, str]
    joints: Mapping[str, JointSource]
    wheels: Mapping[Side, WheelSource]
    layout: StereoLayout = "separate"

    @property
    def joint_topics(self) -> list[str]:
        """The joint-state topics with the head's joints, each once."""
        return sorted({topic for topic in self.joints.values() if isinstance(topic, str)})

    @property
    def elsewhere(self) -> dict[str, JointField | JointTransform]:
        """Head joint → its source, of those that are not in joint states."""
        return {name: source for name, source in self.joints.items() if not isinstance(source, str)}

    @property
    def motion(self) -> frozenset[str]:
        """The topics with the motion of base and head."""
        wheels = (wheel for source in self.wheels.values() for wheel in source.every)
        return frozenset(
            {*self.joint_topics, *(source.topic for source in (*wheels, *self.elsewhere.values()))}
        )

    @property
    def assumed_wheels(self) -> WheelGeometry | None:
        """Wheels assumed for odometry whose driver's wheels are unknown: results are factors of them."""
        return None if self.assumed_odometry is None else self.assumed_odometry.wheels

    @property
    def assumed_odometry(self) -> AssumedOdometry | None:
        """`assumed_wheels`, with their topic and the uncertainty of their separation."""
        source = next((source for source in self.wheels.values() if source.assumed), None)
        if source is None or source.baked_in is None:
            return None
        return AssumedOdometry(source.topic, source.baked_in, source.separation_share)

    @property
    def of_odometry(self) -> bool:
        """Whether the rotations of the wheels follow from the base's odometry."""
        return any(source.baked_in is not None for source in self.wheels.values())

    @property
    def several_wheels(self) -> bool:
        """Whether a side has more than one wheel: the base turns with slip."""
        return any(source.others or source.unread for source in self.wheels.values())


@dataclass(frozen=True, slots=True)
class WheelGeometry:
    """Wheel radii and their separation, all in m."""

    radius_right_m: float
    radius_left_m: float
    separation_m: float

    @classmethod
    def of(cls, sizes_m: FloatArray) -> WheelGeometry:
        """Wheels of (right radius, left radius, separation), (3,) m."""
        right, left, separation = (float(size) for size in sizes_m)
        return cls(right, left, separation)

    @property
    def vector(self) -> FloatArray:
        """(3,) right radius, left radius, separation, m."""
        return np.array([self.radius_right_m, self.radius_left_m, self.separation_m])

    @property
    def positive(self) -> bool:
        """Whether all three are: other wheels are impossible."""
        return bool(np.all(self.vector > 0))


@dataclass(frozen=True, slots=True)
class AssumedOdometry:
    """Odometry of a driver with unknown wheels. It is read as the rotation of assumed wheels, and the result is the
    factors between these and the wheels that explain the motion.

    With the factors kR, kL and m of the right and left radius and of the separation b, odometry of a run ds and a turn
    means (kR + kL)/2 ds + (kR - kL) b/4 turn, and a turn of (kR - kL)/(m b) ds + (kR + kL)/(2 m) turn. So distance and
    rotation do not depend on the assumed wheels. The difference kR - kL is in proportion to the assumed separation:
    only the drift (kR - kL)/(m b) shows.

    Attributes:
        topic: of the odometry.
        wheels: the assumed wheels.
        separation_share: relative standard deviation of their separation.
    """

    topic: str
    wheels: WheelGeometry
    separation_share: float = 0.0

    @property
    def units(self) -> FloatArray:
        """(9,) what one is of each of the nine parameters, with factors in place of the wheels: m for these."""
        return np.concatenate([np.ones(6), self.wheels.vector])

    def factors(self, wheels: WheelGeometry) -> dict[str, float]:
        """Each of the `FACTORS` for estimated wheels."""
        right, left, separation = (wheels.vector / self.wheels.vector).tolist()
        linear = (right + left) / 2
        return dict(zip(FACTORS, (right, left, separation, linear, linear / separation), strict=True))

    def factors_std(self, wheels: WheelGeometry, covariance: FloatArray) -> dict[str, float]:
        """Standard deviation of each, from the covariance of the wheels, (3, 3) m^2, and of the assumed separation."""
        right, left, separation, linear, _ = self.factors(wheels).values()
        of_angular = [0.5 / separation, 0.5 / separation, -linear / separation**2]
        J = np.vstack([np.eye(3), [0.5, 0.5, 0.0], of_angular]) / self.wheels.vector
        half = (right - left) / 2 * self.separation_share
        apart = np.array([half, -half, 0.0, 0.0, 0.0])
        of_factors = J @ covariance @ J.T + np.outer(apart, apart)
        return dict(zip(FACTORS, np.sqrt(np.diag(of_factors)).tolist(), strict=True))


#: What odometry is wrong by, in the order of `AssumedOdometry.factors`: as diff_drive_controller takes it, then as
#: drivers take it that scale distance and rotation.
FACTORS = (
    "right_wheel_radius_multiplier",
    "left_wheel_radius_multiplier",
    "wheel_separation_multiplier",
    "linear_scale",
    "angular_scale",
)


@dataclass(frozen=True, slots=True, eq=False)
class Nominal(ReadOnly):
    """Nominal values, used for unobservable parameters and to unwrap large turns.

    Attributes:
        T_h_reference: (4, 4) reference camera coordinates to head coordinates, or None.
        wheels: nominal wheels, or None.
    """

    T_h_reference: Annotated[FloatArray, 4, 4] | None = None
    wheels: WheelGeometry | None = None

    def over(self, other: Nominal) -> Nominal:
        """These values, and those of the other where there are none."""
        T = other.T_h_reference if self.T_h_reference is None else self.T_h_reference
        return Nominal(T, self.wheels or other.wheels)


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """The robot before the calibration.

    Attributes:
        cameras: the cameras.
        chain: kinematic chain from base to head.
        nominal: nominal values.
        sources: the topics used.
        setting_sources: setting → its source ("flag", "file", "log", "default", ...), for the report.
        noise: name → standard deviation given by the user, see `Noise`; the others are estimated.
        prior_sigmas: kind or name of a constant, or "all" → its prior standard deviation, see `KINDS`; 0 if the
            stated value is exact, infinite (math.inf) if nothing is known.
    """

    cameras: CameraRig
    chain: HeadChain
    nominal: Nominal
    sources: Sources
    setting_sources: Mapping[str, str]
    noise: Mapping[str, float] = field(default_factory=dict)
    prior_sigmas: Mapping[str, float] = field(default_factory=dict)
