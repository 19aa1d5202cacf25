"""The errors that a user meets. Each has an exit code of its own; anything else is a bug (exit code 1)."""

from __future__ import annotations

from typing import ClassVar


class MobilecalError(Exception):
    """Base of every error that mobilecal raises on purpose.

    Args:
        message: what is wrong, where, with the numbers.
        hint: what to do next.
    """

    exit_code: ClassVar[int] = 1
    #: The kind in one word, for programs.
    code: ClassVar[str] = "bug"

    def __init__(self, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint


class ConfigError(MobilecalError):
    """An unknown key, a bad value or a bad file in the configuration or on the command line."""

    exit_code = 2
    code = "config"


class RecordingError(MobilecalError):
    """A recording that cannot be read, or lacks a topic, a field or the data that the task needs."""

    exit_code = 3
    code = "recording"


class ObservationError(MobilecalError):
    """The board was not seen at enough stations."""

    exit_code = 4
    code = "observation"


class SolveError(MobilecalError):
    """The nine numbers cannot be had from these observations: not observable, or not converged."""

    exit_code = 5
    code = "solve"


class QualityError(MobilecalError):
    """Solved and written, but a gate failed."""

    exit_code = 6
    code = "quality"


class OutputError(MobilecalError):
    """An output cannot be written, or exists already."""

    exit_code = 7
    code = "output"
