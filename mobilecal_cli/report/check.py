"""One criterion of the verdict, as numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from mobilecal_cli.report.values import Outcome

#: Extent of the motion → with less, a parameter depends on a difference about as small as the noise.
LEAST_MOTION = {"pan_range_deg": 10.0, "tilt_range_deg": 5.0, "turned_deg": 20.0, "driven_m": 0.2}


@dataclass(frozen=True, slots=True)
class Check:
    """One criterion. Its sentences are in `wording`.

    Attributes:
        id: its name for programs; a part after the first dot distinguishes criteria of one kind ("noise.joint_rad").
        value: as measured, None where it is unknown.
        limit: beyond it the outcome is "fail" or "not_enough"; None for a criterion without a number.
        unit: of both, "" for counts and ratios.
        outcome: "pass", "warning" (which passes), "fail" or "not_enough" (too little data to decide).
        at_least: whether the limit is a lower one.
        facts: further numbers and names that the sentences state.
    """

    id: str
    value: float | None
    limit: float | None
    unit: str
    outcome: Outcome
    at_least: bool = False
    facts: Mapping[str, Any] = field(default_factory=dict)

    @property
    def label(self) -> str:
        """The outcome in words."""
        return self.outcome.replace("_", " ")


class Checks(tuple[Check, ...]):
    """Criteria in order; also by their id: `checks["point_error"].value`."""

    __slots__ = ()

    def __getitem__(self, key: Any) -> Any:  # noqa: ANN401
        """A criterion by its id (KeyError if there is none), or as in a tuple."""
        if not isinstance(key, str):
            return super().__getitem__(key)
        found = {check.id: check for check in self}
        return found[key]


def graded(value: float, look: float, bad: float) -> Outcome:
    """The outcome of a value that should be small."""
    return "fail" if value > bad else "warning" if value > look else "pass"


def enough(value: float, least: float) -> Outcome:
    """The outcome of a value that should not be small."""
    return "pass" if value >= least else "not_enough"
