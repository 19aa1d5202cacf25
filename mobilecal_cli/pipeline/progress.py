"""Progress reports of long work."""

from __future__ import annotations

from typing import Protocol


class Progress(Protocol):
    """Callback for progress."""

    def __call__(self, stage: str, done: int, total: int | None) -> None:
        """Report that `done` of `total` (None: unknown) items of a stage are done."""


def silent(stage: str, done: int, total: int | None) -> None:
    """Ignore progress."""
