"""Errors for the user. Each kind has its own exit code; anything else is a bug (exit code 1)."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from typing import ClassVar, TypeVar


class MobilecalError(Exception):
    """Base class of the errors; a kind states its exit code, and is called `code`, in one word, by programs.

    Args:
        message: what is wrong and where, with the numbers.
        hint: what to do next.
    """

    exit_code: ClassVar[int]
    code: ClassVar[str]

    def __init_subclass__(cls, exit_code: int) -> None:
        cls.exit_code, cls.code = exit_code, cls.__name__.removesuffix("Error").lower()

    def __init__(self, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.message = message
        self.hint = hint


def noting(hint: str, noted: Iterable[str]) -> str:
    """A hint, and what was noted on the recording."""
    return "; noted: ".join((hint, *noted))


class ConfigError(MobilecalError, exit_code=2):
    """An unknown key, an invalid value or an unreadable file in the configuration or on the command line."""


class RecordingError(MobilecalError, exit_code=3):
    """A recording that cannot be read, or lacks a required topic, field or data."""


class ObservationError(MobilecalError, exit_code=4):
    """The board was detected at too few stations."""


class SolveError(MobilecalError, exit_code=5):
    """The nine parameters cannot be estimated: not observable, or not converged.

    Args:
        message, hint: see `MobilecalError`.
        explained: the message names the cause, so the hint needs no other.
        noted: notes on the recording, without the last dot, that the hint ends with; `cure` is the hint without them.
    """

    def __init__(
        self, message: str, hint: str = "", explained: bool = False, noted: Iterable[str] = ()
    ) -> None:
        self.cure, self.explained, self.noted = hint, explained, tuple(noted)
        super().__init__(message, noting(hint, self.noted))


class QualityError(MobilecalError, exit_code=6):
    """The verdict is not PASS, or a limit is exceeded."""


class OutputError(MobilecalError, exit_code=7):
    """An output cannot be written, or already exists."""


class ResourceError(MobilecalError, exit_code=8):
    """Not enough memory, or not enough space for temporary files."""


Part = TypeVar("Part")
Made = TypeVar("Made")


def usable(
    parts: Iterable[Part], make: Callable[[Part], Made]
) -> tuple[list[Made], dict[int, RecordingError]]:
    """What is made of those parts of a recording that can be used; and number of each other one, from 1 → its error.

    Raises:
        RecordingError: that of the first part, if none can be used.
    """
    made: list[Made] = []
    problems: dict[int, RecordingError] = {}
    for number, part in enumerate(parts, 1):
        try:
            made.append(make(part))
        except RecordingError as error:
            problems[number] = error
    if not made:
        raise problems[1]
    return made, problems
