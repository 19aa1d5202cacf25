"""One criterion of the verdict."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Outcome = Literal["good", "look", "bad", "short"]

# With less motion the signal of a parameter is about as small as the noise.
MIN_TURNED_DEG, MIN_DRIVEN_M = 20.0, 0.2


@dataclass(frozen=True, slots=True)
class Check:
    """One criterion.

    Attributes:
        name: label.
        measured, limit: values with units, as text.
        outcome: "good", "look" (passes with a warning), "bad" (fails) or "short" (not enough data).
        why: the reason if it is not good.
        next_step: what to do in that case.
    """

    name: str
    measured: str
    limit: str
    outcome: Outcome
    why: str
    next_step: str


def graded(value: float, look: float, bad: float) -> Outcome:
    """The outcome of a value with two upper limits."""
    return "bad" if value > bad else "look" if value > look else "good"
