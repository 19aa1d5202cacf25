"""Errors for the user. Each kind has its own exit code; anything else is a bug (exit code 1)."""

from __future__ import annotations

from typing import ClassVar


class MobilecalError(Exception):
    """Base class of the errors.

    Args:
        message: what is wrong and where, with the numbers.
        hint: what to do next.
    """

    exit_code: ClassVar[int] = 1
    #: The kind as one word, for programs.
    code: ClassVar[str] = "bug"

    def __init__(self, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint


class ConfigError(MobilecalError):
    """An unknown key, an invalid value or an unreadable file in the configuration or on the command line."""

    exit_code = 2
    code = "config"


class RecordingError(MobilecalError):
    """A recording that cannot be read, or lacks a required topic, field or data."""

    exit_code = 3
    code = "recording"


class ObservationError(MobilecalError):
    """The board was detected at too few stations."""

    exit_code = 4
    code = "observation"


class SolveError(MobilecalError):
    """The nine parameters cannot be estimated: not observable, or not converged."""

    exit_code = 5
    code = "solve"


class QualityError(MobilecalError):
    """The verdict is not PASS, or a limit is exceeded."""

    exit_code = 6
    code = "quality"


class OutputError(MobilecalError):
    """An output cannot be written, or already exists."""

    exit_code = 7
    code = "output"


class ResourceError(MobilecalError):
    """Not enough memory, or not enough space for temporary files."""

    exit_code = 8
    code = "resource"
