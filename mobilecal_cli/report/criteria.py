"""What a criterion of a verdict is: a function that compares a figure of a calibration with its limit, in sentences."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Literal, NamedTuple

from mobilecal_cli.model.observations import Extraction
from mobilecal_cli.model.solution import Evaluation, Provenance, Solution
from mobilecal_cli.model.text import capitalized, wrapped
from mobilecal_cli.report.comparison import Change
from mobilecal_cli.report.use import uses

Outcome = Literal["pass", "warning", "fail", "not_enough"]
CHANGED = "jump"  # id of the criterion of changes inside the recording


@dataclass(frozen=True, eq=False)
class Case:
    """A calibration: what the criteria judge, and what a report is made from.

    Attributes:
        solution, extraction: the solution and its data.
        provenance: version, time, recordings and settings.
        gates: the user's limits by the name of the metric; those on an expected error in use replace the default limit.
        trial: the evaluation on held-out stations, if any.
        change: from the last calibration or from the nominal values, if there is either.
    """

    solution: Solution
    extraction: Extraction
    provenance: Provenance
    gates: Mapping[str, float] = field(default_factory=dict)
    trial: Evaluation | None = None
    change: Change | None = None

    @cached_property
    def checks(self) -> tuple[Check, ...]:
        """What every criterion finds, evaluated once; also figures alone. Measured poses have no pixels.

        Beside a change that fails, what may be its effect is a warning: the advice would be false.
        """
        without = {"px"} if self.extraction.measured else set()
        found = [(each, check) for each in CRITERIA for check in each.judge(self, *each.metrics)]
        found = [(each, check) for each, check in found if check.unit not in without]
        changed = any(check.id == CHANGED and check.outcome == "fail" for _, check in found)
        found = [(each, check.worded(self.extraction.worded)) for each, check in found]
        return tuple(
            replace(check, outcome="warning") if changed and each.of_change and check.why else check
            for each, check in found
        )

    @property
    def accurate(self) -> bool:
        """Whether all expected errors in use are within their limits; also where none are known."""
        return all(use.value <= use.limit for use in uses(self.solution, self.gates))


@dataclass(frozen=True, slots=True)
class Check:
    """One criterion of the verdict, with its sentences; `Metric.check` makes it.

    Attributes:
        id: its name for programs; a part after the first dot distinguishes criteria of one kind ("noise.joint").
        value: as measured, None where it is unknown.
        limit: beyond it the outcome is "fail" or "not_enough"; None for a criterion without a number.
        outcome: "pass", "warning" (which passes), "fail" or "not_enough" (too little data to decide).
        name: the criterion; "" for a figure alone, which gates can limit and no criterion judges.
        measured_text, limit_text: values with their units.
        why: a sentence; empty for "pass".
        next_step: what to do then; empty for "pass".
        unit: of value and limit, "" for counts and ratios.
        at_least: whether the limit is a lower one.
        section: of the page, which shows what is judged.
    """

    id: str
    value: float | None
    limit: float | None
    outcome: Outcome
    name: str
    measured_text: str
    limit_text: str
    why: str
    next_step: str
    unit: str
    at_least: bool
    section: str

    @property
    def label(self) -> str:
        """The outcome in words."""
        return self.outcome.replace("_", " ")

    def worded(self, text: Callable[[str], str]) -> Check:
        """The same, with each text in other words."""
        return replace(self, name=text(self.name), why=text(self.why), next_step=text(self.next_step))

    @property
    def met(self) -> bool:
        """Whether the criterion is met, also with a warning."""
        return self.outcome in ("pass", "warning")


@dataclass(frozen=True, slots=True)
class Metric:
    """A figure that a gate can limit, by a lower limit if `at_least`.

    The name is for `--gate`, in `metrics` of report.json, and the id of the criterion that judges it. The unit is ""
    or "1" for counts and ratios. If the name ends in a unit, the value has this unit. `section` is that of its checks.
    """

    name: str
    unit: str = ""
    at_least: bool = False
    section: str = "checks"

    @property
    def after(self) -> str:
        """The unit with a space before it, after a number; "" for none."""
        return f" {self.unit}" if self.unit not in ("", "1") else ""

    def check(
        self,
        value: float | None,
        limit: float | None = None,
        name: str = "",
        next_step: str = "",
        *,
        part: str = "",
        measured: str = "",
        at_limit: str = "",
        why: str = "",
        passes: bool | None = None,
        beyond: Outcome | None = None,
    ) -> Check:
        """The figure against its limit; a signed figure counts by its size.

        Args:
            value, limit, name, next_step: see `Check`; a figure alone has a value only.
            part: of the id, after the name of the metric.
            measured, at_limit: value and limit as texts, where more than the numbers is to be said.
            why: what is wrong, where that is not name, value and limit.
            passes: whether it is within its limit, where that is no comparison of two numbers.
            beyond: outcome if it is not; by default "not_enough" for a lower limit and "fail" for an upper one.
        """
        if passes is None:
            bound = 0.0 if limit is None else limit
            passes = value is not None and (value >= bound if self.at_least else abs(value) <= bound)
        measured = measured or ("unknown" if value is None else f"{value:.3g}{self.after}")
        if limit is not None:
            at_limit = at_limit or f"at {'least' if self.at_least else 'most'} {limit:.4g}{self.after}"
        why = why or f"{capitalized(name)}: {measured}. Limit: {at_limit}."
        return Check(
            id=f"{self.name}.{part}" if part else self.name,
            value=value,
            limit=limit,
            outcome="pass" if passes else beyond or ("not_enough" if self.at_least else "fail"),
            name=name,
            measured_text=measured,
            limit_text=at_limit,
            why="" if passes else why,
            next_step="" if passes else next_step,
            unit=self.unit,
            at_least=self.at_least,
            section=self.section,
        )


def check_lines(checks: Iterable[Check]) -> list[str]:
    """All criteria for the terminal, escaped, with what to do where one is not met."""
    lines = []
    for check in checks:
        start, indent = f"  {check.label:<11} ", " " * 14
        lines += wrapped(f"{check.name}: {check.measured_text} ({check.limit_text})", start, indent)
        lines += wrapped(f"{check.why} {check.next_step}", indent, indent) if check.why else []
    return lines


_Judge = Callable[..., Iterator[Check]]


class Criterion(NamedTuple):
    """A criterion, or several of one kind: a function of a calibration and the metrics, without checks where it does
    not apply.

    Gates can limit the metrics of gated criteria: not those that arise only where something is wrong. A change inside
    the recording may be the cause `of_change`.
    """

    metrics: tuple[Metric, ...]
    gated: bool
    of_change: bool
    judge: _Judge


#: All criteria of a calibration in the order of the verdict: the first that is not met decides.
CRITERIA: list[Criterion] = []


def criterion(*metrics: Metric, gated: bool = True, of_change: bool = False) -> Callable[[_Judge], _Judge]:
    """Add a function to the criteria of a calibration; see `Criterion`."""

    def registered(judge: _Judge) -> _Judge:
        CRITERIA.append(Criterion(metrics, gated, of_change, judge))
        return judge

    return registered
