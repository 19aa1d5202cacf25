"""Words and side in the names of topics, joints and number fields: which of them may be wheels or head joints."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Iterable, Sequence
from dataclasses import replace
from itertools import product, takewhile
from typing import TypeVar

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model.rig import SIDES, Side
from mobilecal_cli.model.signals import NumberField, RobotDescription
from mobilecal_cli.model.text import listed

T = TypeVar("T")
HEAD_WORDS = {"head", "neck", "ptu", "camera", "cam", "gimbal", "mast"}
PAN_WORDS = {"pan", "yaw"}
TILT_WORDS = {"tilt", "pitch"}
COMPRESSION_WORDS = {"compressed", "video", "ffmpeg", "h264", "h265", "theora"}
COUNTER_WORDS = {"tick", "ticks", "encoder", "encoders", "enc", "count", "counts"}
_SIDES: dict[str, Side] = {
    **dict.fromkeys(("left", "l", "cameraleft", "leftcamera"), "left"),
    **dict.fromkeys(("right", "r", "cameraright", "rightcamera"), "right"),
}
#: A camera with a number in its name: camera1, camera_0, cam0, fisheye2, infra1.
_NUMBERED_CAMERA = re.compile(r"(?<![a-z])(camera|cam|fisheye|infra|ir)_?([0-9])(?![0-9])", re.IGNORECASE)
_NUMBERED: dict[str, Side] = {"infra1": "left", "infra2": "right", "cam0": "left", "cam1": "right"}


def words(name: str) -> list[str]:
    """Lower-case words of a name: "/leftCamera/image_raw" → ["left", "camera", "image", "raw"]."""
    spaced = re.sub(r"(?<=[a-z0-9])(?=[A-Z])", " ", name)
    return [word for word in re.split(r"[^a-z0-9]+", spaced.lower()) if word]


def side_of(name: str) -> Side | None:
    """The side in a name, None if the name contains neither or both."""
    sides = {side for word in words(name) if (side := _SIDES.get(word) or _NUMBERED.get(word))}
    return sides.pop() if len(sides) == 1 else None


def _uncompressed(name: str) -> tuple[str, ...]:
    """Words of a name without the compression of the images, in which the two halves of a pair may differ."""
    return tuple(word for word in words(name) if word not in COMPRESSION_WORDS)


def mirrored(name: str) -> tuple[str, ...]:
    """Words of a name without its side and compression: equal for the two halves of a pair."""
    return tuple("*" if word in _SIDES or word in _NUMBERED else word for word in _uncompressed(name))


def pairs(names: Iterable[str], numbered: bool = False) -> list[dict[Side, str]]:
    """All pairs of names that differ only in the side, and perhaps in the compression.

    If asked, those of cameras that differ in two consecutive numbers: the lower one is the left one.
    """
    by_key: dict[tuple[str, ...], dict[int, list[str]]] = {}
    for name in sorted(names):
        numbers = {int(number) for _, number in _NUMBERED_CAMERA.findall(name)}
        side = side_of(name)
        if numbered and len(numbers) == 1:
            key, place = _uncompressed(_NUMBERED_CAMERA.sub(r"\1*", name)), numbers.pop()
        elif side is not None and not numbered:
            key, place = mirrored(name), SIDES.index(side)
        else:
            continue
        by_key.setdefault(key, {}).setdefault(place, []).append(name)
    two = (sorted(members.items()) for members in by_key.values() if len(members) == 2)
    return [
        {"left": left, "right": right}
        for (low, lefts), (high, rights) in two
        if high == low + 1
        for left, right in product(lefts, rights)
    ]


def joint_state_names(description: RobotDescription) -> list[str]:
    """Names of all joints in the recording's joint states."""
    return sorted({name for names in description.joint_names.values() for name in names})


def without_joints(description: RobotDescription, names: Collection[str]) -> RobotDescription:
    """The description without some joints in its joint states."""
    kept = {
        topic: tuple(name for name in joints if name not in names)
        for topic, joints in description.joint_names.items()
    }
    return replace(description, joint_names=kept)


def require_topic(key: str, topic: str, present: Iterable[str], what: str = "messages") -> None:
    """Raise a RecordingError, which lists the topics present, if the one that a key states is not one of them."""
    if topic not in (present := sorted(present)):
        raise RecordingError(
            f"{key}: the topic {topic} contains no {what} in this recording",
            f"topics with {what}: {listed(present)}",
        )


#: Words of commands, which are no measurements.
_COMMANDS = {"cmd", "command", "commands", "target", "setpoint", "goal", "desired", "reference"}


def shared_levels(topic: str, images: Iterable[str]) -> int:
    """Levels of namespace that a topic has in common with an image topic: more for those of the same robot."""
    levels = (zip(topic.split("/")[:-1], image.split("/")[:-1], strict=False) for image in images)
    return max(
        (sum(1 for _ in takewhile(lambda level: level[0] == level[1], each)) for each in levels), default=0
    )


def nearest(choices: Iterable[T], topic_of: Callable[[T], str], images: Iterable[str]) -> list[T]:
    """Those of the choices whose topics have most levels of namespace in common with an image topic."""
    levels = [(choice, shared_levels(topic_of(choice), images)) for choice in choices]
    most = max((level for _, level in levels), default=0)
    return [choice for choice, level in levels if level == most]


def of_one_robot(
    description: RobotDescription, images: Iterable[str], configured: Iterable[str]
) -> RobotDescription:
    """The description with each joint on the topics of this robot alone, and with its URDF alone.

    Measured joint states are preferred to commanded ones, then those in the namespace of the cameras to those of other
    robots. Topics that are equally near keep their joints.

    Args:
        images: image topics of the cameras.
        configured: joint-state topics of the configuration, which keep their joints.
    """

    def nearness(topic: str) -> tuple[bool, int]:
        return not _COMMANDS & {*words(topic)}, shared_levels(topic, images)

    images, configured = tuple(images), set(configured)
    nearest: dict[str, tuple[bool, int]] = {}
    for topic, joints in description.joint_names.items():
        nearest |= {joint: max(nearness(topic), nearest.get(joint, (False, 0))) for joint in joints}
    joint_names: dict[str, tuple[str, ...]] = {}
    for topic, joints in description.joint_names.items():
        own = tuple(j for j in joints if topic in configured or nearness(topic) == nearest[j])
        if own or not joints:
            joint_names[topic] = own
    best = max(map(nearness, description.urdfs), default=None)
    urdfs = {topic: text for topic, text in description.urdfs.items() if nearness(topic) == best}
    return replace(description, joint_names=joint_names, urdfs=urdfs)


_HEAD_JOINT_WORDS = PAN_WORDS | TILT_WORDS
_WHEEL_WORDS = {*COUNTER_WORDS, "wheel"}


def may_be_a_reading(topic: str, path: str) -> bool:
    """Whether the names of a topic and a field suggest the reading of a wheel or of a head joint."""
    parts = {*words(topic), *words(path), *_wheel_words(topic), *_wheel_words(path)}
    return bool(parts & (_WHEEL_WORDS | _HEAD_JOINT_WORDS)) and not parts & _COMMANDS


#: Words of the place of a wheel on its side; numbers count as such too.
_PLACES = {"front", "rear", "back", "middle", "mid", "center", "centre", "fore", "aft"}
#: Side and place in one word: fl is front left, lr is left rear.
_CORNERS: dict[str, tuple[Side, str]] = {
    word: (side, place)
    for place in "frbm"
    for side in SIDES
    for word in (f"{place}{side[0]}", f"{side[0]}{place}")
}
CASTER_WORDS = {"caster", "castor", "casters", "castors"}
#: Wheels that no motor drives, and joints that are no wheels.
_NOT_DRIVEN = CASTER_WORDS | {
    "passive", "swivel", "idler", "arm", "gripper", "finger", "steer",
    "steering", "suspension", "rocker", "bogie", "flywheel", "drop",
}  # fmt: skip


def _wheel_words(name: str) -> list[str]:
    """`words`, also of names that are written together or short: "/lwhl_ticks" → ["l", "wheel", "ticks"]."""
    return [part for word in words(name) for part in re.sub("wheels?|whls?", " wheel ", word).split()]


def is_wheel(name: str) -> bool:
    """Whether a joint is named as a driven wheel."""
    return "wheel" in "".join(_wheel_words(name)) and not _NOT_DRIVEN & {*words(name)}


def may_carry_camera(joint: str) -> bool:
    """Whether a joint is not named as one of a wheel, driven or not."""
    return "wheel" not in "".join(_wheel_words(joint)) and not CASTER_WORDS & {*words(joint)}


def wheel_place(name: str) -> tuple[tuple[str, ...], Side, tuple[str, ...]] | None:
    """What is left of a wheel's name without side and place, then its side and its place; None without one side."""
    rest: list[str] = []
    place: list[str] = []
    sides: set[Side] = set()
    for word in _wheel_words(name):
        if word in _CORNERS:
            side, corner = _CORNERS[word]
            sides.add(side)
            place.append(corner)
        elif word in _SIDES:
            sides.add(_SIDES[word])
        else:
            (place if word in _PLACES or word.isdigit() else rest).append(word)
    return (tuple(rest), sides.pop(), tuple(sorted(place))) if len(sides) == 1 else None


def wheel_sets(names: Iterable[str]) -> list[dict[Side, tuple[str, ...]]]:
    """Sets of wheels whose names differ only by side and place; each wheel of a side has one opposite to it."""
    sets: dict[tuple[str, ...], dict[tuple[str, ...], dict[Side, str]]] = {}
    for name in sorted(names):
        wheel = wheel_place(name)
        if wheel is not None:
            rest, side, place = wheel
            sets.setdefault(rest, {}).setdefault(place, {}).setdefault(side, name)
    whole = [[pair for pair in places.values() if len(pair) == 2] for places in sets.values()]
    return [{side: tuple(pair[side] for pair in pairs) for side in SIDES} for pairs in whole if pairs]


#: Numbers of the wheels of each side.
Counters = dict[Side, tuple[NumberField, ...]]


def counters(fields: Iterable[NumberField]) -> list[Counters]:
    """Sets of whole numbers, or of other numbers, that are named as counters of the left and the right wheels.

    Fields named as counters are preferred to those that are only named as something of a wheel; those that never
    change count only where all are so.
    """
    fields = [*fields]
    changing = [field for field in fields if not field.still] or fields
    by_name = {f"{field.topic} {field.path}": field for field in changing}
    for wanted in (COUNTER_WORDS, _WHEEL_WORDS):
        named = [
            name for name in by_name if wanted & {*_wheel_words(name)} and not _NOT_DRIVEN & {*words(name)}
        ]
        sets = [
            {side: tuple(by_name[name] for name in by_side[side]) for side in SIDES}
            for integer in (True, False)
            for by_side in wheel_sets(name for name in named if by_name[name].integer is integer)
        ]
        if sets:
            return sets
    return []


def tick_counters(sets: Sequence[Counters]) -> Counters | None:
    """The only one of the sets of `counters`, if its numbers are whole and jump as a counter does at its end."""
    numbers = [number for by_side in sets for side in SIDES for number in by_side[side]]
    whole = all(number.integer and number.jump is None for number in numbers)
    return sets[0] if len(sets) == 1 and whole else None


def named_as(joint: str, fields: Sequence[NumberField]) -> list[NumberField]:
    """Numbers that share the word of a head joint (pan, tilt, ...) with its name."""
    wanted = _HEAD_JOINT_WORDS & set(words(joint))
    return [field for field in fields if wanted & {*words(field.topic), *words(field.path)}]
