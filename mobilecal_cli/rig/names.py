"""Words and side in the names of topics, joints and number fields: which of them may be wheels or head joints."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence

from mobilecal_cli.model import NumberField, RobotDescription, Side

HEAD_WORDS = {"head", "neck", "ptu", "camera", "cam", "gimbal", "mast"}
PAN_WORDS = {"pan", "yaw"}
TILT_WORDS = {"tilt", "pitch"}
COUNTER_WORDS = {"tick", "ticks", "encoder", "encoders", "count", "counts"}
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
    found = {side for word in words(name) if (side := _SIDES.get(word) or _NUMBERED.get(word))}
    return found.pop() if len(found) == 1 else None


def mirrored(name: str) -> tuple[str, ...]:
    """Words of a name without its side: equal for the two halves of a pair."""
    return tuple("*" if word in _SIDES or word in _NUMBERED else word for word in words(name))


def pairs(names: Iterable[str]) -> list[dict[Side, str]]:
    """Pairs of left and right names, sorted by the left name."""
    by_key: dict[tuple[str, ...], dict[Side, str]] = {}
    for name in sorted(names):
        side = side_of(name)
        if side is not None:
            by_key.setdefault(mirrored(name), {}).setdefault(side, name)
    return [found for found in by_key.values() if len(found) == 2]


def numbered_pairs(names: Iterable[str]) -> list[dict[Side, str]]:
    """Pairs of names of cameras that differ only in two consecutive numbers, of which the lower one is the left."""
    by_key: dict[str, dict[int, str]] = {}
    for name in sorted(names):
        numbers = {int(number) for _, number in _NUMBERED_CAMERA.findall(name)}
        if len(numbers) == 1:
            by_key.setdefault(_NUMBERED_CAMERA.sub(r"\1*", name), {})[numbers.pop()] = name
    pairs = (sorted(found.items()) for found in by_key.values() if len(found) == 2)
    return [{"left": low[1], "right": high[1]} for low, high in pairs if high[0] == low[0] + 1]


def joint_state_names(description: RobotDescription) -> list[str]:
    """Names of all joints in the recording's joint states."""
    return sorted({name for names in description.joint_names.values() for name in names})


#: Words of commands, which are no measurements.
_COMMANDS = {"cmd", "command", "commands", "target", "setpoint", "goal", "desired", "reference"}
_HEAD_JOINT_WORDS = PAN_WORDS | TILT_WORDS
_WHEEL_WORDS = {*COUNTER_WORDS, "wheel", "wheels"}


def may_be_a_reading(topic: str, path: str) -> bool:
    """Whether the names of a topic and a field suggest the reading of a wheel or of a head joint."""
    found = {*words(topic), *words(path)}
    return bool(found & (_WHEEL_WORDS | _HEAD_JOINT_WORDS)) and not found & _COMMANDS


def wheel_pairs(fields: Iterable[NumberField]) -> list[dict[Side, NumberField]]:
    """Pairs of whole numbers, or of other numbers, that are named as counters of a left and a right wheel."""
    halves: dict[tuple[tuple[str, ...], bool], dict[Side, NumberField]] = {}
    for field in fields:
        name = f"{field.topic} {field.path}"
        side = side_of(name)
        if side is not None and _WHEEL_WORDS & set(words(name)):
            halves.setdefault((mirrored(name), field.integer), {}).setdefault(side, field)
    return [pair for pair in halves.values() if len(pair) == 2]


def named_as(joint: str, fields: Sequence[NumberField]) -> list[NumberField]:
    """Numbers that share the word of a head joint (pan, tilt, ...) with its name."""
    wanted = _HEAD_JOINT_WORDS & set(words(joint))
    return [field for field in fields if wanted & {*words(field.topic), *words(field.path)}]
