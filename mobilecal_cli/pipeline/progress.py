"""How long work tells how far it is."""

from __future__ import annotations

from typing import Protocol


class Progress(Protocol):
    """Told by the pipeline what it is doing."""

    def __call__(self, stage: str, done: int, total: int | None) -> None:
        """Take note that `done` of `total` (None: not known) items of a stage are done."""


def silent(stage: str, done: int, total: int | None) -> None:
    """Tell nobody."""
