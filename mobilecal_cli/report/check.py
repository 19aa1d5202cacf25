"""One criterion of the verdict, as numbers."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from mobilecal_cli.report.metrics import metric_of
from mobilecal_cli.report.values import Outcome

#: Extent of the motion → with less, a parameter depends on a difference about as small as the noise.
LEAST_MOTION = {"pan_range_deg": 10.0, "tilt_range_deg": 5.0, "turned_deg": 20.0, "driven_m": 0.2}


_SEVERITY: tuple[Outcome, ...] = ("pass", "warning", "not_enough", "fail")


@dataclass(frozen=True, slots=True)
class Check:
    """One criterion. Its unit is in `metrics`, its sentences are in `wording`.

    Attributes:
        id: its name for programs; a part after the first dot distinguishes criteria of one kind ("noise.joint").
        value: as measured, None where it is unknown.
        limit: beyond it the outcome is "fail" or "not_enough"; None for a criterion without a number.
        outcome: "pass", "warning" (which passes), "fail" or "not_enough" (too little data to decide).
        facts: further numbers and names that the sentences state.
    """

    id: str
    value: float | None
    limit: float | None
    outcome: Outcome
    facts: Mapping[str, Any] = field(default_factory=dict)

    @property
    def unit(self) -> str:
        """Unit of value and limit, "" for counts and ratios."""
        return metric_of(self.id).unit

    @property
    def at_least(self) -> bool:
        """Whether the limit is a lower one."""
        return metric_of(self.id).at_least

    @property
    def share(self) -> float:
        """How much of the limit is used: above 1 beyond it; 0 without a number."""
        if self.value is None or not self.limit:
            return 0.0
        share = abs(self.value / self.limit)
        return 1 / max(share, 1e-300) if self.at_least else share

    @property
    def label(self) -> str:
        """The outcome in words."""
        return self.outcome.replace("_", " ")


class Checks(tuple[Check, ...]):
    """Criteria in order; also by their id: `checks["point_error"].value`."""

    __slots__ = ()

    def __getitem__(self, key: Any) -> Any:  # noqa: ANN401
        """A criterion by its id or kind, or as in a tuple; of a kind ("leg_outlier") the worst.

        Raises:
            KeyError: there is none.
        """
        if not isinstance(key, str):
            return super().__getitem__(key)
        for check in self:
            if check.id == key:
                return check
        alike = [check for check in self if check.id.partition(".")[0] == key]
        if not alike:
            raise KeyError(key)
        return max(alike, key=lambda check: (_SEVERITY.index(check.outcome), check.share))


def graded(value: float, look: float, bad: float) -> Outcome:
    """The outcome of a value that should be small."""
    return "fail" if value > bad else "warning" if value > look else "pass"


def enough(value: float, least: float) -> Outcome:
    """The outcome of a value that should not be small."""
    return "pass" if value >= least else "not_enough"
