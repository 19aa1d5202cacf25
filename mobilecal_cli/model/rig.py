"""What the robot is: cameras, head chain, board, and where the log keeps their data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from mobilecal_cli.model.arrays import FloatArray, freeze

Side = Literal["left", "right"]
Distortion = Literal["none", "plumb_bob", "rational_polynomial", "equidistant"]


@dataclass(frozen=True, slots=True, eq=False)
class CameraInfo:
    """One camera's calibration as the log states it, for the pixels as they are in the images.

    Binning and region of interest are already applied to K and P.

    Attributes:
        frame_id: the optical frame's name.
        width, height: image size, px.
        K: (3, 3) raw intrinsics, px.
        D: (n,) distortion coefficients in OpenCV's order: n = 0 none, 5 plumb_bob, 8 (or 12, 14)
            rational_polynomial, 4 equidistant.
        distortion: which model D speaks of.
        R: (3, 3) turns raw camera coordinates into rectified ones.
        P: (3, 4) projection of rectified coordinates, px; P[0, 3] = -fx * baseline in the right camera.
    """

    frame_id: str
    width: int
    height: int
    K: FloatArray
    D: FloatArray
    distortion: Distortion
    R: FloatArray
    P: FloatArray

    def __post_init__(self) -> None:
        freeze(self, K=(3, 3), D=("n",), R=(3, 3), P=(3, 4))


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """A pinhole with distortion: what maps a point in the camera's optical frame to a pixel.

    Attributes:
        frame_id: the optical frame's name.
        width, height: image size, px.
        K: (3, 3) intrinsics, px.
        D: (n,) distortion coefficients, see `CameraInfo`.
        distortion: which model D speaks of.
    """

    frame_id: str
    width: int
    height: int
    K: FloatArray
    D: FloatArray
    distortion: Distortion

    def __post_init__(self) -> None:
        freeze(self, K=(3, 3), D=("n",))


@dataclass(frozen=True, slots=True, eq=False)
class StereoRig:
    """The stereo pair. Frame c is the left camera's optical frame, r the right one's.

    Attributes:
        left, right: the two cameras, for the images as they are in the log (raw or rectified).
        T_c_r: (4, 4) right camera coordinates to left camera coordinates, m.
        rectified: the images are rectified, so c and r are the rectified optical frames.
        R_rect_c, R_rect_r: (3, 3) raw to rectified coordinates of each camera (`CameraInfo.R`).
        reference: the camera that the calibrated head-eye transform speaks of.
    """

    left: Camera
    right: Camera
    T_c_r: FloatArray
    rectified: bool
    R_rect_c: FloatArray
    R_rect_r: FloatArray
    reference: Side = "left"

    def __post_init__(self) -> None:
        freeze(self, T_c_r=(4, 4), R_rect_c=(3, 3), R_rect_r=(3, 3))

    @property
    def baseline_m(self) -> float:
        """Distance between the two optical centres, m."""
        return float(np.linalg.norm(self.T_c_r[:3, 3]))

    @property
    def T_c_reference(self) -> FloatArray:
        """(4, 4) reference camera coordinates to left camera coordinates."""
        return np.eye(4) if self.reference == "left" else self.T_c_r


@dataclass(frozen=True, slots=True, eq=False)
class FixedLink:
    """A constant transform in the chain.

    Attributes:
        T_parent_child: (4, 4) child coordinates to parent coordinates, m.
    """

    T_parent_child: FloatArray

    def __post_init__(self) -> None:
        freeze(self, T_parent_child=(4, 4))


@dataclass(frozen=True, slots=True, eq=False)
class JointLink:
    """A moving joint in the chain: turns or slides along its axis by multiplier * reading + offset.

    Attributes:
        joint: the name in the joint states that is read.
        axis: (3,) unit vector in the joint's own frame.
        kind: revolute (rad) or prismatic (m).
        multiplier, offset: from a URDF <mimic>; 1 and 0 otherwise. offset in rad or m.
    """

    joint: str
    axis: FloatArray
    kind: Literal["revolute", "prismatic"] = "revolute"
    multiplier: float = 1.0
    offset: float = 0.0

    def __post_init__(self) -> None:
        freeze(self, axis=(3,))


@dataclass(frozen=True, slots=True, eq=False)
class HeadChain:
    """The known geometry from vehicle frame v to head frame h.

    Attributes:
        base_frame: name of v: x forward, y left, z up, origin midway between the wheels.
        head_frame: name of h, the last link of the pan-tilt chain.
        links: fixed and moving links, in order from v to h.
        pan, tilt: joint names, for words and plots ("" where there is none).
    """

    base_frame: str
    head_frame: str
    links: tuple[FixedLink | JointLink, ...]
    pan: str = ""
    tilt: str = ""

    @property
    def joints(self) -> tuple[str, ...]:
        """Names of the joints that are read, each once, in order from the base."""
        return tuple(dict.fromkeys(link.joint for link in self.links if isinstance(link, JointLink)))


@dataclass(frozen=True, slots=True)
class Markers:
    """The markers on a board, which number its corners: parts of the board are then enough.

    Attributes:
        kind: "charuco": markers in the white squares of a checkerboard, whose inner corners are used; "aprilgrid":
            a grid of tags, whose own corners are used.
        dictionary: their family, by OpenCV's name, such as "DICT_5X5_100".
        share: charuco: side of a marker; aprilgrid: gap between two tags; both as shares of `Board.square_m`.
        first_id: number of the first marker.
        border_bits: width of the markers' black border, in cells of their code.
    """

    kind: Literal["charuco", "aprilgrid"]
    dictionary: str
    share: float
    first_id: int = 0
    border_bits: int = 1


@dataclass(frozen=True, slots=True)
class Board:
    """The calibration board. Frame k: x along a row of corners, y along a column, z = x cross y pointing away from a
    camera that sees the board's front; origin at corner 0 (of an aprilgrid: at the bottom left corner of the first tag,
    which is itself at the bottom left, as Kalibr prints it).

    Attributes:
        columns, rows: inner corners along x and along y; of an aprilgrid: tags.
        square_m: side of a square (of an aprilgrid: of a tag), m; None when the stereo baseline gives the scale.
        markers: None for a plain checkerboard.
    """

    columns: int
    rows: int
    square_m: float | None = None
    markers: Markers | None = None

    @property
    def corners(self) -> int:
        """Number of corners; corner index = row * columns + column, of an aprilgrid: four times the tag's, and 0 to 3
        clockwise from the tag's top left.
        """
        return self.columns * self.rows * (4 if self._tags else 1)

    @property
    def _tags(self) -> bool:
        return self.markers is not None and self.markers.kind == "aprilgrid"

    def grid(self) -> FloatArray:
        """(corners, 3) corner positions in units of one square (of an aprilgrid: one tag), z = 0."""
        row, column = np.divmod(np.arange(self.columns * self.rows), self.columns)
        if not self._tags or self.markers is None:
            return np.stack([column, row, np.zeros(len(row))], axis=1).astype(np.float64)
        pitch = 1 + self.markers.share
        tags = np.stack([column * pitch, -row * pitch - 1, np.zeros(len(row))], axis=1)
        within = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
        return np.asarray((tags[:, None, :] + within).reshape(-1, 3), dtype=np.float64)


@dataclass(frozen=True, slots=True)
class WheelSource:
    """Where the log keeps one wheel's rotation.

    Attributes:
        topic: the topic.
        joint: a joint name in `sensor_msgs/JointState` messages of that topic, or None.
        field: a path into any message ("data", "left.ticks", "values[0]"), or None.
        ticks_per_revolution: counter steps per turn of the wheel; None: the field is an angle in rad.
        bits: width of the counter, which wraps round; None: it never wraps.
        sign: +1, or -1 for a counter that falls when the robot drives forward.
        baked_in: the topic is nav_msgs/Odometry, made with these wheels; None for all others.
    """

    topic: str
    joint: str | None = None
    field: str | None = None
    ticks_per_revolution: float | None = None
    bits: Literal[8, 16, 32, 64] | None = None
    sign: Literal[1, -1] = 1
    baked_in: WheelGeometry | None = None


@dataclass(frozen=True, slots=True, eq=False)
class JointTransform:
    """Where the log keeps one joint's reading, as the transform of the link that it moves.

    Attributes:
        topic: a topic of tf2_msgs/TFMessage.
        parent, child: the links' frames.
        T_parent_child: (4, 4) at the joint's zero, m.
        axis: (3,) unit vector in the joint's frame.
        kind: of the joint.
    """

    topic: str
    parent: str
    child: str
    T_parent_child: FloatArray
    axis: FloatArray
    kind: Literal["revolute", "prismatic"]

    @property
    def where(self) -> str:
        """What is read of the topic's messages, for people."""
        return f"{self.parent} to {self.child}"


Layout = Literal["separate", "side_by_side", "stacked"]


@dataclass(frozen=True, slots=True)
class JointField:
    """Where the log keeps one joint's reading, in messages that are no joint states.

    Attributes:
        topic: the topic.
        field: a path into any message ("data", "pan.angle", "values[0]").
        scale: rad (or m) of one unit of the field.
    """

    topic: str
    field: str
    scale: float = 1.0

    @property
    def where(self) -> str:
        """What is read of the topic's messages, for people."""
        return self.field


@dataclass(frozen=True, slots=True)
class Sources:
    """The topics in use.

    Attributes:
        image: image topic of each side.
        info: camera-info topic of each side, "" where the calibration comes from elsewhere.
        joints: joint-state topics for the head's joints.
        wheels: each wheel's source.
        elsewhere: the head's joints that are read from other messages than joint states.
        layout: how the two pictures of a stereo pair come: each by itself, or both in one (of one topic).
    """

    image: Mapping[Side, str]
    info: Mapping[Side, str]
    joints: tuple[str, ...]
    wheels: Mapping[Side, WheelSource]
    elsewhere: Mapping[str, JointField | JointTransform] = field(default_factory=dict)
    layout: Layout = "separate"

    @property
    def motion(self) -> frozenset[str]:
        """The topics that tell how base and head move."""
        apart = [*self.wheels.values(), *self.elsewhere.values()]
        return frozenset({*self.joints, *(source.topic for source in apart)})


@dataclass(frozen=True, slots=True)
class WheelGeometry:
    """Wheel radii and their separation, all in m."""

    radius_right_m: float
    radius_left_m: float
    separation_m: float


@dataclass(frozen=True, slots=True, eq=False)
class Nominal:
    """Prior values, used where the log shows nothing (and to unwrap large turns).

    Attributes:
        T_h_reference: (4, 4) reference camera coordinates to head coordinates, or None.
        wheels: nominal wheels, or None.
    """

    T_h_reference: FloatArray | None = None
    wheels: WheelGeometry | None = None

    def __post_init__(self) -> None:
        if self.T_h_reference is not None:
            freeze(self, T_h_reference=(4, 4))


@dataclass(frozen=True, slots=True)
class KnownNoise:
    """Standard deviations that the user states; None where the log is to tell.

    Attributes:
        pixel_px: of one corner coordinate.
        wheel_rad_per_sqrt_rad: of a wheel's rotation over one radian.
        encoder_rad: of one encoder reading.
        joint_rad: of one joint reading.
    """

    pixel_px: float | None = None
    wheel_rad_per_sqrt_rad: float | None = None
    encoder_rad: float | None = None
    joint_rad: float | None = None

    @property
    def given(self) -> dict[str, float]:
        """Name → value of those that are stated."""
        levels = {
            "pixel_px": self.pixel_px,
            "wheel_rad_per_sqrt_rad": self.wheel_rad_per_sqrt_rad,
            "encoder_rad": self.encoder_rad,
            "joint_rad": self.joint_rad,
        }
        return {name: value for name, value in levels.items() if value is not None}


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """Everything that is known of the robot before the calibration.

    Attributes:
        cameras: the stereo pair.
        chain: base to head.
        nominal: prior values.
        sources: topics in use.
        settled_by: setting → what settled it ("flag", "file", "log", "default"), for the report.
        noise: noise levels that need not be estimated.
    """

    cameras: StereoRig
    chain: HeadChain
    nominal: Nominal
    sources: Sources
    settled_by: Mapping[str, str]
    noise: KnownNoise = KnownNoise()
