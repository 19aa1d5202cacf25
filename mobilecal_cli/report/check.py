"""One criterion of the verdict."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Outcome = Literal["good", "look", "bad", "short"]

# With less movement a parameter rests on a difference about as small as the noise.
MIN_TURNED_DEG, MIN_DRIVEN_M = 20.0, 0.2


@dataclass(frozen=True, slots=True)
class Check:
    """One criterion.

    Attributes:
        name: what was looked at.
        measured, limit: in words with units.
        outcome: "good", "look" (worth a look, passes), "bad" (fails) or "short" (too little data to tell).
        why: a sentence for when it is not good.
        next_step: what to do then.
    """

    name: str
    measured: str
    limit: str
    outcome: Outcome
    why: str
    next_step: str


def graded(value: float, look: float, bad: float) -> Outcome:
    """The outcome of a value that should be small."""
    return "bad" if value > bad else "look" if value > look else "good"
