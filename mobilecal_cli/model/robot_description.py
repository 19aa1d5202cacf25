"""Topics of a recording and the robot description found in its first messages."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.rig import CameraInfo

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
    """

    topic: str
    path: str
    integer: bool
    bits: int | None = None
    wraps: int | None = None
    jump: int | None = None


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
