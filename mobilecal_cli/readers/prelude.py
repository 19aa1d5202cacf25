"""Robot description and first messages of a recording."""

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
from mobilecal_cli.readers.containers.recording import Recording
from mobilecal_cli.readers.messages.camera_info import camera_info
from mobilecal_cli.readers.messages.channels import NOT_ITS_TYPE
from mobilecal_cli.readers.signals.transforms import transforms_of

T = TypeVar("T")

#: Messages read per joint-state topic, because several drivers may share it.
JOINT_MESSAGES = 50
#: Messages tried on other topics until one can be decoded.
TRIES = 5


def read_prelude(recording: Recording) -> Prelude:
    """Read the first messages of the topics that describe the robot.

    Each topic is read separately and only as far as needed (one message; 50 joint states). With an index, or after
    the scan that replaces it, blocks without the topic are skipped, so a huge file is not read to its end. An SQLite
    file is scanned to the topic's first (50th) message. If no topic contains a URDF, transforms are sampled over the
    recording.

    Raises:
        RecordingError: the recording is empty.
    """
    if not any(info.count is None or info.count for info in recording.topics):
        raise RecordingError(f"{recording.name}: the recording contains no messages", "record a new one")
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
    infos, unusable = _infos(recording, names.get(CAMERA_INFO, []))
    return Prelude(
        topics=recording.topics,
        infos=infos,
        unusable=unusable,
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
    except RecordingError as error:  # the configuration may not need them
        recording.note(error.message)
        return {}


def _first(recording: Recording, topic: str, read: Callable[[Any], T]) -> list[T]:
    """Value read from the first message of a topic that has it, among the first few."""
    return _read(recording, topic, TRIES, 1, read)


def _read(recording: Recording, topic: str, most: int, enough: int, read: Callable[[Any], T]) -> list[T]:
    """Values read from at most `enough` of a topic's first `most` messages; empty if the topic cannot be read.

    The reason is noted, not raised, because the calibration may not use the topic.
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
                reason = f"{topic}: not a valid {message.type}: {error}"
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


def _infos(recording: Recording, topics: list[str]) -> tuple[dict[str, CameraInfo], dict[str, str]]:
    """Usable calibrations by topic, and why the others are not: zero, not finite, or of an unknown model."""
    infos: dict[str, CameraInfo] = {}
    unusable: dict[str, str] = {}
    for topic in topics:
        for message in _first(recording, topic, lambda message: message):
            try:
                infos[topic] = camera_info(message, topic)
            except RecordingError as error:
                unusable[topic] = error.message
    return infos, unusable
