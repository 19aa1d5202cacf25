"""What a recording says of the robot before it is read: description, first messages, and numbers in other messages."""

from __future__ import annotations

import re
from collections import defaultdict
from collections.abc import Callable, Collection, Iterator, Sequence
from contextlib import suppress
from itertools import chain, islice
from typing import TypeVar

import numpy as np

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model.rig import CameraInfo
from mobilecal_cli.model.signals import (
    CAMERA_INFO,
    IMAGES,
    JOINT_STATE,
    ODOMETRY,
    STRING,
    TRANSFORMS,
    NumberField,
    RobotDescription,
)
from mobilecal_cli.readers.containers.recording import Recording
from mobilecal_cli.readers.containers.storage import Extent
from mobilecal_cli.readers.messages import NOT_ITS_TYPE, FieldPath, frame_of
from mobilecal_cli.readers.messages.types import Decoded, leaves_of
from mobilecal_cli.readers.signals.camera_infos import camera_info
from mobilecal_cli.readers.signals.joints import SAMPLED_BYTES, transforms_of
from mobilecal_cli.readers.signals.wheels import wraps

T = TypeVar("T")

#: Messages read per joint-state topic, because several drivers may share it.
JOINT_MESSAGES = 50
#: Names of joints that are kept of a topic.
MOST_JOINTS = 2**15
#: Messages tried on other topics until one can be decoded.
TRIES = 5
#: Topics of one type that are read separately, each only as far as needed; more are read in one pass.
SEPARATE = 16


def read_description(recording: Recording) -> RobotDescription:
    """Read the first messages of the topics that describe the robot.

    Each topic is read separately and only as far as needed (one message; 50 joint states). Blocks without the
    topic are skipped, so a huge file is not read to its end. An SQLite file is scanned to the topic's first (50th)
    message. More than 16 topics of a type are read in one pass. If no topic contains a URDF, all transforms are sampled
    over the recording, otherwise those of frames that do not move.

    Raises:
        RecordingError: the recording is empty.
    """
    if not any(info.count for info in recording.topics):
        raise RecordingError(f"{recording.name}: the recording contains no messages", "record a new one")
    names: defaultdict[str, list[str]] = defaultdict(list)
    for info in recording.topics:
        names[info.type].append(info.name)
    images = [topic for kind in IMAGES for topic in names[kind]]
    described = [topic for topic in names[STRING] if "robot_description" in topic]
    texts = _first(recording, described, lambda message: str(message.data))
    # A semantic description (SRDF) is of a robot without links.
    semantic = {topic for topic, text in texts.items() if "<robot" in text and "<link" not in text}
    urdfs = {topic: text for topic, text in texts.items() if text.strip() and topic not in semantic}
    infos, unusable = _infos(recording, names[CAMERA_INFO])
    image_frames = _first(recording, images, lambda message: frame_of(message.header))
    joints = _read(
        recording, names[JOINT_STATE], JOINT_MESSAGES, lambda message: list(map(str, message.name))
    )
    frames = _first(
        recording,
        names[ODOMETRY],
        lambda message: (frame_of(message.header), str(message.child_frame_id).lstrip("/")),
    )
    static = [topic for topic in names[TRANSFORMS] if topic.endswith("static")]
    if urdfs:  # they may lack frames that do not move
        first = _read(recording, static, JOINT_MESSAGES, lambda message: message)
        transforms = transforms_of(chain(*first.values()))
    else:
        transforms = transforms_of(_sampled(recording, names[TRANSFORMS]))
    return RobotDescription(
        topics=recording.topics,
        infos=infos,
        unusable=unusable,
        image_frames=image_frames,
        joint_names={
            topic: tuple(islice(dict.fromkeys(chain(*lists)), MOST_JOINTS)) for topic, lists in joints.items()
        },
        urdfs=urdfs,
        transforms=transforms,
        odometry_frames=frames,
    )


def _sampled(recording: Recording, topics: Sequence[str]) -> Iterator[Decoded]:
    """Messages of some topics that can be decoded; a long recording is read in parts."""
    try:
        for message in recording.messages(topics, Extent(SAMPLED_BYTES)) if topics else ():
            with suppress(RecordingError, *NOT_ITS_TYPE):
                yield message.decode()
    except RecordingError as error:  # the configuration may not need them
        recording.note(error.message)


def _first(recording: Recording, topics: Sequence[str], read: Callable[[Decoded], T]) -> dict[str, T]:
    """Value read from the first message of each topic that has it, among the first few."""
    several = _read(recording, topics, 1, read)
    return {topic: values[0] for topic, values in several.items() if values}


def _read(
    recording: Recording, topics: Sequence[str], enough: int, read: Callable[[Decoded], T]
) -> dict[str, list[T]]:
    """At most `enough` values of each topic, from as many or a few first messages; none if a topic cannot be read.

    The reason is noted, not raised, because the calibration may not use the topic.
    """
    most = max(enough, TRIES)
    values: dict[str, list[T]] = {topic: [] for topic in topics}
    reasons = {topic: error.message for topic, error in recording.unsupported(topics).items()}
    readable = [topic for topic in topics if topic not in reasons]
    together = [readable] if len(readable) > SEPARATE else [[topic] for topic in readable]
    for group in together:
        left = {topic: min(most, recording.topic(topic).count or most) for topic in group}
        try:
            for message in recording.messages(group):
                topic = message.topic
                if topic not in left:
                    continue
                left[topic] -= 1
                try:
                    values[topic].append(read(message.decode()))
                except RecordingError as error:
                    reasons[topic] = error.message
                except NOT_ITS_TYPE as error:
                    reasons[topic] = f"{topic}: not a valid {message.channel.type}: {error}"
                if not left[topic] or len(values[topic]) == enough:
                    del left[topic]
                    if not left:
                        break
        except RecordingError as error:
            reasons.update(dict.fromkeys(left, error.message))
    for topic, reason in reasons.items():
        if not values[topic]:
            recording.note(reason)
    return values


def _infos(
    recording: Recording, topics: Sequence[str]
) -> tuple[dict[str, CameraInfo], dict[str, RecordingError]]:
    """Usable calibrations by topic, and why the others are not: unreadable, zero, not finite, of an unknown model."""
    infos: dict[str, CameraInfo] = {}
    unusable: dict[str, RecordingError] = {}
    messages = _first(recording, topics, lambda message: message)
    for topic in topics:
        if topic in messages:
            try:
                infos[topic] = camera_info(messages[topic], topic)
            except RecordingError as error:
                unusable[topic] = error
        elif recording.topic(topic).count:
            unusable[topic] = recording.nothing_read(topic)
    return infos, unusable


#: Messages read per topic to see whether a counter wraps around.
_MESSAGES = 20_000
#: Fields that are no readings.
_NOT_READINGS = {"header", "stamp", "layout", "timestamp"}
_STANDARD = re.compile(r"std_msgs/msg/U?Int(8|16|32|64)")


def number_fields(
    recording: Recording, topics: Collection[str], wanted: Callable[[str, str], bool]
) -> tuple[NumberField, ...]:
    """Numbers in the messages of some topics.

    Args:
        topics: its topics.
        `wanted`: whether a number at a topic and a path is of interest.

    Returns:
        The numbers, by topic and path; a topic that cannot be read has none.
    """
    fields: list[NumberField] = []
    for topic in sorted(topics):
        try:
            fields += _of_topic(recording, topic, wanted)
        except RecordingError as error:  # the calibration may not use the topic
            recording.note(error.message)
    return tuple(fields)


def _of_topic(
    recording: Recording, topic: str, wanted: Callable[[str, str], bool]
) -> tuple[NumberField, ...]:
    messages = islice(recording.messages([topic]), _MESSAGES)
    first = next(messages, None)
    if first is None:
        return ()
    decoded = first.decode()
    paths = [
        FieldPath(path)
        for path, value in leaves_of(decoded)
        if isinstance(value, (int, float, np.number))
        and not isinstance(value, bool)
        and _NOT_READINGS.isdisjoint(path.split("."))
        and wanted(topic, path)
    ]
    if not paths:
        return ()
    series: dict[str, list[int | float]] = {path.text: [] for path in paths}
    for message in chain([first], messages):
        decoded = message.decode()
        for path in paths:
            series[path.text].append(path.number(decoded, topic, "the field"))
    standard = _STANDARD.fullmatch(first.channel.type)
    bits = int(standard[1]) if standard else None
    fields = []
    for name, values in series.items():
        # Other numbers do not start again, and neither do larger ones, which JSON may contain.
        whole = all(isinstance(value, int) and abs(value) < 2**64 for value in values)
        starts_again = wraps(np.array(values, dtype=np.float64)) if whole else (None, None)
        still = len(values) > 1 and len({*values}) == 1
        fields.append(NumberField(topic, name, isinstance(values[0], int), bits, *starts_again, still))
    return tuple(fields)
