"""Field paths: numbers in messages of any type, such as "data", "left.ticks" or "values[0]"."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model import listed
from mobilecal_cli.readers.series import Series
from mobilecal_cli.readers.values import fields_of

_STEP = re.compile(r"([A-Za-z_][A-Za-z0-9_]*)((?:\[\d+\])*)")


@dataclass(frozen=True, slots=True)
class FieldPath:
    """A parsed path.

    Attributes:
        text: as given by the user.
        steps: attribute names and list indices, in order.
    """

    text: str
    steps: tuple[str | int, ...]

    @classmethod
    def parse(cls, text: str) -> FieldPath:
        """Parse a path.

        Raises:
            RecordingError: not a valid path.
        """
        steps: list[str | int] = []
        for part in text.split("."):
            match = _STEP.fullmatch(part.strip())
            if match is None:
                raise RecordingError(
                    f"{text!r} is not a field path", 'use a path such as "data", "left.ticks" or "values[0]"'
                )
            steps.append(match[1])
            steps.extend(int(index) for index in re.findall(r"\[(\d+)\]", match[2]))
        return cls(text, tuple(steps))

    def number(self, message: Any, topic: str, setting: str) -> int | float:  # noqa: ANN401 - the type is the recording's
        """The number at the path.

        Args:
            message: any decoded message.
            topic, setting: topic of the message and key in rig.yaml, for error messages.

        Raises:
            RecordingError: a step is missing, or the value is not a number; the message lists the fields present.
        """
        value = message
        for step in self.steps:
            try:
                value = value[step] if isinstance(step, int) else getattr(value, step)
            except (AttributeError, IndexError, TypeError, KeyError) as error:
                raise RecordingError(
                    f"{topic}: no field {self.text} ({step!r} is missing); fields present: {listed(_paths(message))}",
                    f"correct {setting} in rig.yaml",
                ) from error
        if isinstance(value, (bool, int, np.integer)):
            return int(value)
        if isinstance(value, (float, np.floating)):
            return float(value)
        raise RecordingError(
            f"{topic}: field {self.text} is a {type(value).__name__}, not a number; "
            f"fields present: {listed(_paths(message))}",
            f"correct {setting} in rig.yaml",
        )


def _paths(value: Any, prefix: str = "") -> list[str]:  # noqa: ANN401
    """Paths to the numbers and lists in a message."""
    found: list[str] = []
    for item, inner in fields_of(value).items():
        name = f"{prefix}{item}"
        if fields_of(inner):
            found += _paths(inner, f"{name}.")
        elif isinstance(inner, (list, np.ndarray)):
            found.append(f"{name}[0..{len(inner) - 1}]" if len(inner) else f"{name}[] (empty)")
        elif isinstance(inner, (int, float, np.number)):
            found.append(name)
    return found


class FieldSeries:
    """The number at a field path of each message on a topic.

    Args:
        path: the field path.
        setting: key of the path in rig.yaml, for error messages.
        series: receives the readings.
        scaled: value that is added to the series for a number.

    Raises:
        RecordingError: not a valid path.
    """

    def __init__(self, path: str, setting: str, series: Series, scaled: Callable[[float], float]) -> None:
        self._path, self._setting = FieldPath.parse(path), setting
        self._series, self._scaled = series, scaled
        self._missing = 0
        self._error: RecordingError | None = None

    def take(self, message: Any, time_ns: int, log_ns: int) -> None:  # noqa: ANN401 - the type is the recording's
        """Read one message."""
        try:
            value = self._path.number(message, self._series.topic, self._setting)
        except RecordingError as error:  # a list may be empty in one message, but not in all
            self._missing += 1
            self._error = self._error or error
            return
        self._series.add(time_ns, log_ns, self._scaled(value))

    def check(self, notes: list[str]) -> None:
        """Note missing readings; raise the first error if nothing was read."""
        if self._error is not None:
            if not len(self._series):
                raise self._error
            notes.append(f"{self._series.label}: the field is missing in {self._missing} messages; ignored")
