"""What a criterion of a verdict is: a function that returns its numbers and its sentences."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any, Literal

from mobilecal_cli.model import Evaluation, Extraction, Solution
from mobilecal_cli.report.comparison import Change

Outcome = Literal["pass", "warning", "fail", "not_enough"]
_SEVERITY: tuple[Outcome, ...] = ("pass", "warning", "not_enough", "fail")


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """What the criteria judge.

    Attributes:
        solution, extraction: the solution and its data.
        gates: the user's limits by the name of the metric; those on an expected error in use replace the default limit.
        trial: the evaluation on held-out stations, if any.
        change: from the last calibration or from the nominal values, if there is either.
    """

    solution: Solution
    extraction: Extraction
    gates: Mapping[str, float] = field(default_factory=dict)
    trial: Evaluation | None = None
    change: Change | None = None


@dataclass(frozen=True, slots=True)
class Metric:
    """A figure that a gate can limit, by a lower limit if `at_least`.

    The name is for `--gate`, in `metrics` of report.json, and the id of the criterion that judges it. The unit is ""
    for counts and ratios. If the name ends in a unit, the value has this unit.
    """

    name: str
    unit: str = ""
    at_least: bool = False


@dataclass(frozen=True, slots=True)
class Check:
    """One criterion of the verdict, with its sentences; `limit` is a lower one if `at_least`.

    Attributes:
        id: its name for programs; a part after the first dot distinguishes criteria of one kind ("noise.joint").
        value: as measured, None where it is unknown.
        limit: beyond it the outcome is "fail" or "not_enough"; None for a criterion without a number.
        unit: of both, "" for counts and ratios; of the criteria of a calibration, `criterion` fills it in.
        at_least: whether the limit is a lower one; filled in likewise.
        outcome: "pass", "warning" (which passes), "fail" or "not_enough" (too little data to decide).
        name: the criterion; "" for a figure alone, which gates can limit and no criterion judges.
        measured_text, limit_text: values with their units.
        why: a sentence; empty for "pass".
        next_step: what to do then; empty for "pass".
    """

    id: str
    value: float | None
    limit: float | None = None
    outcome: Outcome = "pass"
    name: str = ""
    measured_text: str = ""
    limit_text: str = ""
    why: str = ""
    next_step: str = ""
    unit: str = field(default="", kw_only=True)
    at_least: bool = field(default=False, kw_only=True)

    def __post_init__(self) -> None:
        if self.outcome == "pass":
            object.__setattr__(self, "why", "")
            object.__setattr__(self, "next_step", "")

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

    @property
    def worst(self) -> Check:
        """The first of those with the most severe outcome."""
        return max(self, key=lambda check: _SEVERITY.index(check.outcome))


def graded(value: float, bad: float) -> Outcome:
    """The outcome of a value that should be small."""
    return "fail" if value > bad else "pass"


def enough(value: float, least: float) -> Outcome:
    """The outcome of a value that should not be small."""
    return "pass" if value >= least else "not_enough"


#: Section of the page with all criteria.
_CHECKS = "checks"
_Judge = Callable[[Calibration], Iterator[Check]]


@dataclass(frozen=True, slots=True)
class Criterion:
    """A criterion, or several of one kind: a function from a calibration to checks, none where it does not apply.

    The name of a metric without a dot also stands for ids with further parts. Gates can limit the metrics of gated
    criteria: not those that arise only where something is wrong. The section of the page shows what is judged.
    """

    metrics: tuple[Metric, ...]
    gated: bool
    judge: _Judge
    section: str = _CHECKS

    def checks(self, made: Calibration) -> Iterator[Check]:
        """The checks, with their units."""
        metrics = {metric.name: metric for metric in self.metrics}
        for check in self.judge(made):
            metric = metrics.get(check.id) or metrics[check.id.partition(".")[0]]
            yield replace(check, unit=metric.unit, at_least=metric.at_least)


#: All criteria of a calibration in the order of the verdict: the first that is not met decides.
CRITERIA: list[Criterion] = []


def criterion(*metrics: Metric, gated: bool = True, section: str = _CHECKS) -> Callable[[_Judge], _Judge]:
    """Add a function to the criteria of a calibration; see `Criterion`."""

    def registered(judge: _Judge) -> _Judge:
        CRITERIA.append(Criterion(metrics, gated, judge, section))
        return judge

    return registered


def section_of(check: Check) -> str:
    """The section of the page that shows what a criterion judges; that of all criteria for a gate."""
    names = {check.id, check.id.partition(".")[0]}
    sections = (each.section for each in CRITERIA if names & {metric.name for metric in each.metrics})
    return next(sections, _CHECKS)
