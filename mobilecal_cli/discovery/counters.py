"""Counters and angles outside of joint states: which numbers of a recording may be wheels or head joints."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from mobilecal_cli.discovery.joints import HEAD_JOINT_WORDS
from mobilecal_cli.discovery.names import mirrored, side_of, words
from mobilecal_cli.discovery.wheels import COUNTER_WORDS
from mobilecal_cli.model import NumberField, Side

#: Words of commands, which are no measurements.
_COMMANDS = {"cmd", "command", "commands", "target", "setpoint", "goal", "desired", "reference"}
_WHEEL_WORDS = {*COUNTER_WORDS, "wheel", "wheels"}


def may_be_a_reading(topic: str, path: str) -> bool:
    """Whether the names of a topic and a field suggest the reading of a wheel or of a head joint."""
    found = {*words(topic), *words(path)}
    return bool(found & (_WHEEL_WORDS | HEAD_JOINT_WORDS)) and not found & _COMMANDS


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
    wanted = HEAD_JOINT_WORDS & set(words(joint))
    return [field for field in fields if wanted & {*words(field.topic), *words(field.path)}]
