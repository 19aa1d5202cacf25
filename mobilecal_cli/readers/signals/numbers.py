"""Numbers in messages of any type: where a counter or a joint's angle may be."""

from __future__ import annotations

import re
from collections.abc import Callable, Collection
from itertools import islice
from typing import Any

import numpy as np

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model import NumberField
from mobilecal_cli.readers.containers.recording import Recording
from mobilecal_cli.readers.messages.equivalents import fields_of
from mobilecal_cli.readers.messages.field_path import FieldPath

#: Messages read per topic to see whether a counter wraps around.
_MESSAGES = 20_000
#: Fields that are no readings.
_NOT_READINGS = {"header", "stamp", "layout", "timestamp"}
_WIDTHS = (8, 16, 32)
#: A counter starts again where it jumps by more than this many times its usual step, at most.
_JUMP = 5
_STANDARD = re.compile(r"std_msgs/msg/U?Int(8|16|32|64)")


def number_fields(
    recording: Recording, topics: Collection[str], wanted: Callable[[str, str], bool]
) -> tuple[NumberField, ...]:
    """Numbers in the messages of some topics.

    Args:
        recording: the open recording.
        topics: its topics.
        `wanted`: whether a number at a topic and a path is of interest.

    Returns:
        The numbers, by topic and path; a topic that cannot be read has none.
    """
    found: list[NumberField] = []
    for topic in sorted(topics):
        try:
            found += _of_topic(recording, topic, wanted)
        except RecordingError as error:  # the calibration may not use the topic
            recording.note(error.message)
    return tuple(found)


def _of_topic(
    recording: Recording, topic: str, wanted: Callable[[str, str], bool]
) -> tuple[NumberField, ...]:
    messages = islice(recording.messages([topic]), _MESSAGES)
    first = next(messages, None)
    if first is None:
        return ()
    decoded = first.decode()
    paths = [FieldPath.parse(path) for path in _paths(decoded) if wanted(topic, path)]
    if not paths:
        return ()
    series: dict[str, list[int | float]] = {
        path.text: [path.number(decoded, topic, "the field")] for path in paths
    }
    for message in messages:
        decoded = message.decode()
        for path in paths:
            series[path.text].append(path.number(decoded, topic, "the field"))
    standard = _STANDARD.fullmatch(first.type)
    bits = int(standard[1]) if standard else None
    return tuple(
        NumberField(topic, name, isinstance(values[0], int), bits, *_wraps(values))
        for name, values in series.items()
    )


def _paths(value: Any, prefix: str = "") -> list[str]:  # noqa: ANN401 - the type is the recording's
    """Paths to the single numbers in a message."""
    found: list[str] = []
    for name, inner in fields_of(value).items():
        if name in _NOT_READINGS:
            continue
        if fields_of(inner):
            found += _paths(inner, f"{prefix}{name}.")
        elif isinstance(inner, (int, float, np.integer, np.floating)) and not isinstance(inner, bool):
            found.append(f"{prefix}{name}")
    return found


def _wraps(values: list[int | float]) -> tuple[int | None, int | None]:
    """How a counter starts again at its end, seen from jumps of nearly its whole range.

    Returns:
        Its width in bits, if the jumps fit one; else the size of its jumps, if there are any.
    """
    if not all(isinstance(value, int) for value in values):
        return None, None
    steps = np.abs(np.diff(np.array(values, dtype=np.float64)))
    spread = max(values) - min(values)
    jumps = steps > spread / 2
    usual = steps[~jumps].max(initial=0.0)
    if not jumps.any() or usual == 0 or steps[jumps].min() < _JUMP * usual:
        return None, None
    for bits in _WIDTHS:
        if spread < 2**bits and steps[jumps].min() > 2**bits - 2 * usual - 1:
            return bits, None
    return None, int(steps[jumps].max())
