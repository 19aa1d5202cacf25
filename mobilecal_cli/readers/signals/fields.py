"""Numbers at a field path in messages of any type, over time."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.readers.messages.field_path import FieldPath
from mobilecal_cli.readers.signals.series import Series


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
