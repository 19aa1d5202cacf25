"""One criterion of the verdict."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

Outcome = Literal["good", "look", "bad", "short"]
#: Outcome → its label in the report and in report.json.
OUTCOME_LABELS: dict[Outcome, str] = {
    "good": "pass",
    "look": "warning",
    "bad": "fail",
    "short": "not enough",
}

# With less movement, a parameter depends on a difference about as small as the noise.
MIN_TURNED_DEG, MIN_DRIVEN_M = 20.0, 0.2


@dataclass(frozen=True, slots=True)
class Check:
    """One criterion.

    Attributes:
        name: the criterion.
        measured, limit: text with units.
        outcome: "good", "look" (a warning; passes), "bad" (fails) or "short" (too little data to decide).
        why: a sentence for every outcome but "good".
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
