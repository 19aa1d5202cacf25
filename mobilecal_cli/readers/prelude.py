"""What the first messages of a recording tell about the robot."""

from __future__ import annotations

from collections.abc import Callable
from itertools import islice
from typing import Any, TypeVar

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model import (
    CAMERA_INFO,
    IMAGES,
    JOINT_STATE,
    STRING,
    TRANSFORMS,
    CameraInfo,
    FloatArray,
    Prelude,
)
from mobilecal_cli.readers.camera_info import camera_info
from mobilecal_cli.readers.channels import NOT_ITS_TYPE
from mobilecal_cli.readers.recording import Recording
from mobilecal_cli.readers.transforms import transforms_of

T = TypeVar("T")

#: So many messages of a joint-state topic are looked at: drivers that share a topic take turns on it.
JOINT_MESSAGES = 50
#: Other topics: so many are tried until one can be decoded.
TRIES = 5


def read_prelude(recording: Recording) -> Prelude:
    """Read the first messages of the topics that describe the robot.

    Each topic is read by itself and only as far as needed (one message; 50 of joint states). With an index, or
    after the walk that stands in for one, blocks without the topic are skipped, so a huge file is not read to
    its end; an SQLite file is scanned to the topic's first (50th) message. Where no topic holds a URDF, the transforms
    are sampled over the recording.

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
        topic: text
        for topic in names.get(STRING, [])
        if "robot_description" in topic
        for text in _first(recording, topic, lambda message: str(message.data))
        if text.strip()
    }
    return Prelude(
        topics=recording.topics,
        infos=_infos(recording, names.get(CAMERA_INFO, [])),
        image_frames={
            topic: frame
            for topic in images
            for frame in _first(recording, topic, lambda message: str(message.header.frame_id))
        },
        joint_names={topic: _joint_names(recording, topic) for topic in names.get(JOINT_STATE, [])},
        urdfs=urdfs,
        transforms={} if urdfs else _transforms(recording, names.get(TRANSFORMS, [])),
    )


def _transforms(recording: Recording, topics: list[str]) -> dict[tuple[str, str], FloatArray]:
    try:
        return transforms_of(recording, topics)
    except RecordingError as error:  # the configuration may do without
        recording.note(error.message)
        return {}


def _first(recording: Recording, topic: str, read: Callable[[Any], T]) -> list[T]:
    """What is read of the topic's first message that has it, if one of the first few has."""
    return _read(recording, topic, TRIES, 1, read)


def _read(recording: Recording, topic: str, most: int, enough: int, read: Callable[[Any], T]) -> list[T]:
    """What is read of up to `enough` messages among the topic's first `most`; a topic that cannot be read gives none.

    The reason is noted, not raised: the topic may be none that the calibration uses.
    """
    result: list[T] = []
    reason = ""
    try:
        for message in islice(recording.messages([topic]), most):
            try:
                decoded = message.decode()
                result.append(read(decoded))
            except RecordingError as error:
                reason = error.message
            except NOT_ITS_TYPE as error:
                reason = f"{topic}: a {message.type} that is none: {error}"
            if len(result) == enough:
                break
    except RecordingError as error:
        reason = error.message
    if reason and not result:
        recording.note(reason)
    return result


def _joint_names(recording: Recording, topic: str) -> tuple[str, ...]:
    messages = _read(
        recording, topic, JOINT_MESSAGES, JOINT_MESSAGES, lambda message: [str(name) for name in message.name]
    )
    return tuple(dict.fromkeys(name for names in messages for name in names))


def _infos(recording: Recording, topics: list[str]) -> dict[str, CameraInfo]:
    """The usable calibrations; the others are noted, or raised where no stereo pair is left without them."""
    infos: dict[str, CameraInfo] = {}
    problems: list[RecordingError] = []
    for topic in topics:
        for message in _first(recording, topic, lambda message: message):
            try:
                infos[topic] = camera_info(message, topic)
            except RecordingError as error:
                problems.append(error)
    if problems and len(infos) < 2:
        raise RecordingError("; ".join(problem.message for problem in problems), problems[0].hint)
    for problem in problems:
        recording.note(f"{problem.message}; it is left out")
    return infos
