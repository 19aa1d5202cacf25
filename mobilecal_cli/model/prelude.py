"""What a recording is made of, before any of it is used."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.rig import CameraInfo

#: Message types that have a part in a calibration, in ROS 2 spelling.
CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
JOINT_STATE = "sensor_msgs/msg/JointState"
STRING = "std_msgs/msg/String"
TRANSFORMS = "tf2_msgs/msg/TFMessage"


@dataclass(frozen=True, slots=True)
class TopicInfo:
    """One topic.

    Attributes:
        name: the topic.
        type: message type in ROS 2 spelling, "sensor_msgs/msg/JointState".
        count: number of messages, None when the file does not say.
    """

    name: str
    type: str
    count: int | None


@dataclass(frozen=True, slots=True)
class Prelude:
    """What the first messages of a recording tell about the robot.

    Attributes:
        topics: all topics, in order of name.
        infos: camera-info topic → its first calibration.
        image_frames: image topic → frame_id of its first message.
        joint_names: joint-state topic → names seen in its first messages, each once.
        urdfs: topic → URDF text.
        transforms: (parent frame, child frame) → (n, 4, 4) samples over the recording, m; read only where there is no
            URDF.
    """

    topics: tuple[TopicInfo, ...]
    infos: Mapping[str, CameraInfo]
    image_frames: Mapping[str, str]
    joint_names: Mapping[str, tuple[str, ...]]
    urdfs: Mapping[str, str]
    transforms: Mapping[tuple[str, str], FloatArray] = field(default_factory=dict)
