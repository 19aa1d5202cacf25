"""What the first messages of a recording tell about the robot."""

from __future__ import annotations

from itertools import islice
from typing import Any

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model import CameraInfo, Prelude
from mobilecal_cli.readers.camera_info import camera_info
from mobilecal_cli.readers.recording import Recording

CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
JOINT_STATE = "sensor_msgs/msg/JointState"
IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
STRING = "std_msgs/msg/String"

#: So many messages of a joint-state topic are looked at: drivers that share a topic take turns on it.
JOINT_MESSAGES = 50
#: Other topics: so many are tried until one can be decoded.
TRIES = 5


def read_prelude(recording: Recording) -> Prelude:
    """Read the first messages of the topics that describe the robot.

    Each topic is read by itself and only as far as needed (one message; 50 of joint states). With an index, or
    after the walk that stands in for one, blocks without the topic are skipped, so a huge file is not read to
    its end; an SQLite file is scanned to the topic's first (50th) message.

    Raises:
        RecordingError: the recording is empty, or fewer than two cameras have a usable calibration because
            that of another is zero, not finite or of an unknown model.
    """
    if not any(info.count is None or info.count for info in recording.topics):
        raise RecordingError(f"{recording.name}: the recording holds no messages", "record anew")
    names: dict[str, list[str]] = {}
    for info in recording.topics:
        names.setdefault(info.type, []).append(info.name)
    images = [topic for kind in IMAGES for topic in names.get(kind, [])]
    urdfs = {
        topic: str(message.data)
        for topic in names.get(STRING, [])
        if "robot_description" in topic
        for message in _first(recording, topic)
        if message.data.strip()
    }
    return Prelude(
        topics=recording.topics,
        infos=_infos(recording, names.get(CAMERA_INFO, [])),
        image_frames={
            topic: str(message.header.frame_id) for topic in images for message in _first(recording, topic)
        },
        joint_names={topic: _joint_names(recording, topic) for topic in names.get(JOINT_STATE, [])},
        urdfs=urdfs,
    )


def _first(recording: Recording, topic: str) -> list[Any]:
    """The topic's first message that can be decoded, if one of the first few can."""
    return _decoded(recording, topic, TRIES, enough=1)


def _decoded(recording: Recording, topic: str, most: int, enough: int) -> list[Any]:
    """Up to `enough` decoded messages among the topic's first `most`; a topic that cannot be read gives none.

    The reason is noted, not raised: the topic may be none that the calibration uses.
    """
    result: list[Any] = []
    reason = ""
    try:
        for message in islice(recording.messages([topic]), most):
            try:
                result.append(message.decode())
            except RecordingError as error:
                reason = error.message
            if len(result) == enough:
                break
    except RecordingError as error:
        reason = error.message
    if reason and not result:
        recording.note(reason)
    return result


def _joint_names(recording: Recording, topic: str) -> tuple[str, ...]:
    messages = _decoded(recording, topic, JOINT_MESSAGES, enough=JOINT_MESSAGES)
    return tuple(dict.fromkeys(str(name) for message in messages for name in message.name))


def _infos(recording: Recording, topics: list[str]) -> dict[str, CameraInfo]:
    """The usable calibrations; the others are noted, or raised where no stereo pair is left without them."""
    infos: dict[str, CameraInfo] = {}
    problems: list[RecordingError] = []
    for topic in topics:
        for message in _first(recording, topic):
            try:
                infos[topic] = camera_info(message, topic)
            except RecordingError as error:
                problems.append(error)
    if problems and len(infos) < 2:
        raise RecordingError("; ".join(problem.message for problem in problems), problems[0].hint)
    for problem in problems:
        recording.note(f"{problem.message}; it is left out")
    return infos
