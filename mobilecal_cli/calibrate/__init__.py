"""Progress reports of long work."""

from __future__ import annotations

import os
import reprlib
from collections.abc import Callable
from datetime import UTC, datetime

from mobilecal_cli.errors import ConfigError

#: Callback for progress: a stage, how many of its items are done, and of how many (None: unknown).
Progress = Callable[[str, int, int | None], None]


def silent(stage: str, done: int, total: int | None) -> None:
    """Ignore progress."""


_NAME = "SOURCE_DATE_EPOCH"


def source_date() -> datetime | None:
    """The time that the variable gives, None without it.

    An empty variable is removed: libraries that read it too would fail.

    Raises:
        ConfigError: not a number of seconds, or too large.
    """
    text = os.environ.get(_NAME)
    if not text:
        os.environ.pop(_NAME, None)
        return None
    try:
        return datetime.fromtimestamp(int(text), UTC)
    except (ValueError, OverflowError, OSError) as error:
        raise ConfigError(
            f"{_NAME}: {reprlib.repr(text)} is not a number of seconds since 1970",
            "unset it, or set it to a whole number",
        ) from error
