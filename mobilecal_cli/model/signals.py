"""A recording: topics, robot description, signals, stations and rejections. Time is in integer nanoseconds."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from functools import cached_property
from typing import Annotated

import numpy as np

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model.arrays import BoolArray, FloatArray, IntArray, ReadOnly
from mobilecal_cli.model.rig import CameraInfo, Side

#: Message types used in a calibration, in ROS 2 spelling.
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
#: In notes on recordings with more than one calibration of a camera.
CAMERA_INFO_CHANGES = "the camera calibration changes"
#: In notes on joints that move the camera beside the head chain.
CHAIN_ENDS = "the head chain ends"
#: In notes on recorded joints that may do so, by their names.
CHAIN_LACKS = "recorded, but not in the head chain from"
#: In notes on one of several recordings.
UNUSED = "nothing of this recording is used"
IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
JOINT_STATE = "sensor_msgs/msg/JointState"
ODOMETRY = "nav_msgs/msg/Odometry"
STRING = "std_msgs/msg/String"
TRANSFORMS = "tf2_msgs/msg/TFMessage"


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """One topic.

    Attributes:
        name: name of the topic.
        type: message type in ROS 2 spelling, "sensor_msgs/msg/JointState".
        count: number of messages.
    """

    name: str
    type: str
    count: int


@dataclass(frozen=True, slots=True)
class RobotDescription:
    """Robot description from the first messages of a recording.

    Attributes:
        topics: all topics, sorted by name.
        infos: camera-info topic → its first calibration.
        unusable: camera-info topic → why its calibration cannot be used.
        image_frames: image topic → frame_id of its first message.
        joint_names: joint-state topic → names in its first messages, each once.
        urdfs: topic → URDF text.
        transforms: (parent frame, child frame) → (n, 4, 4) samples over the recording, m; with a URDF, of static
            transforms only.
        odometry_frames: odometry topic → frames of its first message, parent and child.
        odometry_ahead_m: `Signals.ahead_m`, once these are read.
        numbers: numbers in other messages that may be the readings of wheels or head joints; read only where joint
            states lack them.
    """

    topics: tuple[TopicInfo, ...]
    infos: Mapping[str, CameraInfo]
    image_frames: Mapping[str, str]
    joint_names: Mapping[str, tuple[str, ...]]
    urdfs: Mapping[str, str]
    transforms: Mapping[tuple[str, str], FloatArray] = field(default_factory=dict)
    unusable: Mapping[str, RecordingError] = field(default_factory=dict)
    odometry_frames: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    odometry_ahead_m: float = 0.0
    numbers: tuple[NumberField, ...] = ()


@dataclass(frozen=True, slots=True)
class NumberField:
    """A number in the messages of one topic, which may be a wheel's counter or a joint's angle.

    Attributes:
        topic, path: where it is; `path` as in rig.yaml ("data", "left.ticks").
        integer: whether it is a whole number.
        bits: width of its type, None if unknown.
        wraps: number of bits at which it was seen to start again; None if it was not.
        jump: size of the jumps where it starts again, if they fit no number of bits.
        still: whether it never changes, as a constant or a setting.
    """

    topic: str
    path: str
    integer: bool
    bits: int | None = None
    wraps: int | None = None
    jump: int | None = None
    still: bool = False


@dataclass(frozen=True, slots=True)
class BoardView:
    """The board in a few images spread over the recording.

    Attributes:
        pictures: number of images searched.
        seen: number of images with a whole board of the most frequent size.
        size: (columns, rows) inner corners, None if no size is the most frequent.
        squares_m: side of a square measured in each stereo pair that shows the board, m.
        stated_m: side of a square as configured, m; None if it is not.
        other_sizes: number of images that show a board of another size, which is no part of this one.
    """

    pictures: int
    seen: int
    size: tuple[int, int] | None
    squares_m: tuple[float, ...] = ()
    stated_m: float | None = None
    other_sizes: int = 0

    @property
    def square_m(self) -> float | None:
        """Median of the measured sides, m; None where there are none."""
        return float(np.median(self.squares_m)) if self.squares_m else None


#: An interval between readings is a pause if it is this long and this many times the usual one. A pause of a wheel is a
#: gap if the wheel turned by more than this during it.
_GAP_S, _GAP_INTERVALS, _GAP_RAD = 0.5, 10, 0.01


def pauses(time_ns: IntArray) -> BoolArray:
    """Which intervals between readings are pauses, (n - 1,)."""
    seconds = np.diff(time_ns) * 1e-9
    usual_s = float(np.median(seconds)) if len(seconds) else 0.0
    return seconds > max(_GAP_S, _GAP_INTERVALS * usual_s)


#: Messages that arrive together are no jump of a joint: slope of a curve over the larger change per longer interval.
_STEEPEST = 3.0
_FEWEST_CURVED = 3  # readings; between two, the curve is a line


@dataclass(frozen=True, eq=False)
class Track(ReadOnly):
    """One quantity over time.

    Between its readings it follows Akima's curve (J. ACM 17, 1970): exact for a steady rate or acceleration, and
    without kinks. A line between readings would cut off where a wheel turns back: with ten readings per second, radii
    came out 0.2 % too large.

    Attributes:
        time_ns: (n,) strictly increasing.
        value: (n,) rad (a revolute joint, a wheel's unwrapped rotation) or m (a prismatic joint).
    """

    time_ns: Annotated[IntArray, "n"]
    value: Annotated[FloatArray, "n"]

    @cached_property
    def _slope(self) -> FloatArray:
        """(n,) slope of the curve at each reading, per ns."""
        from scipy.interpolate import Akima1DInterpolator  # few commands need it

        if len(self.time_ns) < _FEWEST_CURVED:
            way, duration_ns = self.value[-1] - self.value[0], self.time_ns[-1] - self.time_ns[0]
            return np.full(len(self.value), way / max(int(duration_ns), 1))
        offsets = (self.time_ns - self.time_ns[0]).astype(np.float64)  # small enough for exact nanoseconds
        change, interval = (np.pad(np.abs(np.diff(of)), 1, "edge") for of in (self.value, offsets))
        steepest = _STEEPEST * np.maximum(change[1:], change[:-1]) / np.maximum(interval[1:], interval[:-1])
        # What rests is at rest from its first reading on.
        steepest[np.minimum(change[1:], change[:-1]) == 0] = 0.0
        slope = Akima1DInterpolator(offsets, self.value)(offsets, nu=1)
        return np.asarray(np.clip(slope, -steepest, steepest))

    @cached_property
    def _integral(self) -> FloatArray:
        """(n,) integral of the curve up to each reading, times ns."""
        interval, mean = np.diff(self.time_ns), (self.value[1:] + self.value[:-1]) / 2
        return np.append(0.0, np.cumsum(interval * (mean - interval * np.diff(self._slope) / 12)))

    @cached_property
    def _cubic(self) -> FloatArray:
        """(5, n) length of the interval after each reading, ns, and coefficients of the curve by its share."""
        interval = np.maximum(np.diff(self.time_ns, append=self.time_ns[-1]), 1).astype(np.float64)
        way = np.diff(self.value, append=self.value[-1])
        start, end = self._slope * interval, np.append(self._slope[1:], self._slope[-1]) * interval
        return np.stack([interval, self.value, start, 3 * way - 2 * start - end, start + end - 2 * way])

    def _followed(self, times_ns: IntArray, integral: bool = False) -> FloatArray:
        """The curve at some times, or its integral from the first reading on; beyond its ends, the track rests."""
        time_ns = self.time_ns
        inside_ns = np.minimum(np.maximum(times_ns, time_ns[0]), time_ns[-1])
        at = np.searchsorted(time_ns[1:-1], inside_ns, side="right")
        interval, value, start, square, cube = self._cubic.take(at, axis=1)
        s = (inside_ns - time_ns[at]) / interval
        if not integral:
            return np.asarray(value + s * (start + s * (square + s * cube)))
        within = s * (value + s * (start / 2 + s * (square / 3 + s * cube / 4)))
        ends = np.where(times_ns < inside_ns, self.value[0], self.value[-1])
        return np.asarray(self._integral[at] + interval * within + (times_ns - inside_ns) * ends)

    def at(self, times_ns: IntArray) -> FloatArray:
        """Values at some times, (n,) → (n,); before the first and after the last reading, these."""
        return self._followed(times_ns)

    def mean(self, times_ns: IntArray, width_ns: int) -> FloatArray:
        """Mean of the values over an interval of a width around some times, (n,) → (n,)."""
        earlier, later = (
            self._followed(times_ns + side * (width_ns // 2), integral=True) for side in (-1, 1)
        )
        return np.asarray((later - earlier) / (2 * (width_ns // 2)))

    @property
    def gaps(self) -> IntArray:
        """Indices of the readings before a pause during which a wheel turned: its path there is unknown."""
        return np.flatnonzero(pauses(self.time_ns) & (np.abs(np.diff(self.value)) > _GAP_RAD))


def sampled(tracks: Sequence[Track], times_ns: IntArray) -> FloatArray:
    """Values of several tracks (or none) at some times, (n, J)."""
    return np.array([track.at(times_ns) for track in tracks]).reshape(len(tracks), len(times_ns)).T


@dataclass(frozen=True, slots=True, eq=False)
class PictureIndex(ReadOnly):
    """Where the images of one camera are in a recording.

    Attributes:
        time_ns: (n,) their times, strictly increasing; the stamps, unless the camera's clock stepped.
        stamp_ns, log_ns: (n,) their stamps and log times, which together identify a message.
        sequential: video: an image needs those before it.
        since_ns: (n,) time of the first of the identical consecutive images that each belongs to; its own time if it
            differs from the image before it, which is the default for all.
    """

    time_ns: Annotated[IntArray, "n"]
    stamp_ns: Annotated[IntArray, "n"]
    log_ns: Annotated[IntArray, "n"]
    sequential: bool = False
    since_ns: Annotated[IntArray, "n"] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    def __post_init__(self) -> None:
        if not len(self.since_ns):
            object.__setattr__(self, "since_ns", self.time_ns)
        ReadOnly.__post_init__(self)

    def rows(self, rows: IntArray | BoolArray) -> PictureIndex:
        """Some of the images: indices, or True for each."""
        arrays = (self.time_ns[rows], self.stamp_ns[rows], self.log_ns[rows])
        return PictureIndex(*arrays, self.sequential, self.since_ns[rows])

    def at(self, times_ns: Collection[int]) -> PictureIndex:
        """The images with some times."""
        return self.rows(np.isin(self.time_ns, np.array(sorted(times_ns), dtype=np.int64)))


#: Begin of a note on cameras that recorded nothing while the robot moved.
NO_IMAGES = "No images for"
#: In messages on images that cannot be decoded.
DEPTH_IMAGE = "a depth or disparity image, not one of a camera"
#: Part of a note on joints or wheels that are published too slowly.
FEW_READINGS = "too few readings per second"
#: Part of a note on stamps of one topic.
CLOCK_STEPS = "the clock steps back by up to"
#: End of a note on topics that may have a clock of their own.
CLOCK_SET = "their clock was set forward, or the other drivers stopped"
#: Beginning of a note on topics whose stamps differ from the log times by different amounts.
CLOCKS_DIFFER = "clocks differ, or messages come late"
#: In a note on odometry.
TURNS_AT_REST = "the heading changes while the robot stands still"


@dataclass(frozen=True, slots=True, eq=False)
class Signals:
    """A recording, or the piece of it between two steps of a clock, without the image contents.

    Attributes:
        joints: head joint name → track.
        wheels: side → unwrapped wheel rotation, rad, positive when driving forward.
        images: name of each camera → its images.
        notes: irregularities: clocks that step, duplicate stamps, gaps, zero stamps. Whole sentences.
        infos: camera-info topic → calibration in most of its messages, where its first message states another.
        recorded_ns: name of each camera → times of all its images, also of those that are not in `images` because
            another calibration applied, sorted.
        other_images: image topic of no camera → (n,) times of its images.
        ahead_m: how far the base frame of the odometry is ahead of the axle, if wheels are read from it.
    """

    joints: Mapping[str, Track]
    wheels: Mapping[Side, Track]
    images: Mapping[str, PictureIndex]
    notes: tuple[str, ...]
    recorded_ns: Mapping[str, IntArray]
    infos: Mapping[str, CameraInfo] = field(default_factory=dict)
    other_images: Mapping[str, IntArray] = field(default_factory=dict)
    ahead_m: float = 0.0


@dataclass(frozen=True, slots=True)
class Shot:
    """Images of the cameras taken together, to search for the board: the stamp of each, ns; None for no image."""

    times_ns: tuple[int | None, ...]

    @property
    def taken_ns(self) -> list[int]:
        """Stamps of the images that there are."""
        return [time_ns for time_ns in self.times_ns if time_ns is not None]

    @property
    def time_ns(self) -> int:
        """Time of the images: the mean of their stamps."""
        return sum(self.taken_ns) // len(self.taken_ns)

    def split(self, tolerance_ns: float) -> list[Shot]:
        """Shots of images that are within a tolerance, in order of time: the shot itself, if all are."""
        parts: list[Shot] = []
        left = self.taken_ns
        while left:
            together = [time_ns for time_ns in left if time_ns - min(left) <= tolerance_ns]
            parts.append(Shot(tuple(t if t in together else None for t in self.times_ns)))
            left = [time_ns for time_ns in left if time_ns not in together]
        return parts


@dataclass(frozen=True, slots=True, eq=False)
class Station(ReadOnly):
    """A moment at which the board may be visible.

    Attributes:
        index: number in its recording, from 0, sorted by time.
        at_rest: base and head stood still during all shots.
        shots: the images to search: several of each camera at a rest, one otherwise.
        time_ns: mean time of the shots.
        joints: (J,) head joint readings at the shots, in the order of `HeadChain.joints`, rad or m.
        joints_std: (J,) scatter of the readings over the shots; 0 with one shot.
    """

    index: int
    at_rest: bool
    shots: tuple[Shot, ...]
    time_ns: int
    joints: Annotated[FloatArray, "J"]
    joints_std: Annotated[FloatArray, "J"]


class Reason(StrEnum):
    """Why an image, or a station, does not show the board."""

    NO_BOARD = "no board found"
    #: Also of the part of a board that is seen, where too little of it is.
    OCCLUDED = "board partly occluded or outside the image"
    TOO_SMALL = "squares too small"
    BLURRED = "blurred"
    #: A checkerboard with other numbers of corners: more, or others.
    LARGER = "board extends beyond the grid"
    OTHER_SIZE = "board of a different size"
    COLORS = "square colors do not alternate"
    IRREGULAR = "corners not on a regular grid"
    SECOND_BOARD = "second board in view"
    #: Markers are read, but are arranged in another way.
    OTHER_MARKERS = "markers not as stated"
    #: Images of one station that contradict each other.
    INCONSISTENT = "left and right images inconsistent"
    NO_POSE = "no pose of the board"
    #: Of a board that looks the same when rotated.
    AMBIGUOUS = "board orientation ambiguous"
    #: Of a station that one camera alone shows, of a board whose squares are not known.
    SQUARES_UNKNOWN = "size of the squares unknown"


@dataclass(frozen=True, slots=True)
class Rejection:
    """One rejected item and the reason. The report counts them; they are never exceptions.

    Attributes:
        stage: "readers", "stations", "vision" or "solvers".
        reason: a few words, the same for all of a kind.
        detail: the numbers of this item.
        time_ns: its time.
        station: index of its station, -1 if none.
        log: index of the recording.
    """

    stage: str
    reason: str
    detail: str
    time_ns: int
    station: int = -1
    log: int = 0
