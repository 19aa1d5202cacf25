"""The verdict on a calibration: PASS, FAIL or NOT ENOUGH, with the reason and the next step.

PASS means that the expected errors in use are within their limits (`at_work`), and that nothing contradicts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

from mobilecal_cli.model import Evaluation, Extraction, Solution
from mobilecal_cli.report.at_work import default_errors
from mobilecal_cli.report.changes import Change, change_checks
from mobilecal_cli.report.check import Check, Checks
from mobilecal_cli.report.checks import all_checks
from mobilecal_cli.report.gates import Gate, figures_of, gate_checks, use_limits
from mobilecal_cli.report.numbers import board_distance_m
from mobilecal_cli.report.values import CheckData, Level, Outcome, VerdictData
from mobilecal_cli.report.wording import words
from mobilecal_cli.report.wording.use import passed

#: Outcome of a check → the verdict that it alone decides.
LEVELS: dict[Outcome, Level] = {"not_enough": "NOT ENOUGH", "fail": "FAIL"}


@dataclass(frozen=True, slots=True)
class Verdict:
    """Whether a calibration can be used.

    Attributes:
        level: "PASS", "FAIL" or "NOT ENOUGH".
        reason: one or two sentences.
        next_step: what to do now.
        checks: every criterion.
        metrics: name → value of every figure that gates can limit, None if unknown.
    """

    level: Level
    reason: str
    next_step: str
    checks: Checks = field(default_factory=Checks)
    metrics: Mapping[str, float | None] = field(default_factory=dict)


def judge(
    solution: Solution,
    extraction: Extraction,
    gates: Sequence[Gate] = (),
    trial: Evaluation | None = None,
    change: Change | None = None,
) -> Verdict:
    """The verdict on a solution. The first criterion that is not met decides.

    Args:
        solution: the solution.
        extraction: the data it was computed from.
        gates: limits of the user on the metrics; those on an expected error replace the default limit.
        trial: evaluation on the held-out stations, if any.
        change: difference from the last calibration, if there is one.
    """
    found = [*all_checks(solution, extraction, use_limits(gates)), *change_checks(change)]
    metrics = figures_of(solution, extraction, trial, found)
    checks = Checks((*found, *gate_checks(gates, metrics)))
    decisive = next((check for check in checks if check.outcome in LEVELS), None)
    if decisive is not None:
        return decided_by(decisive, checks, metrics)
    found_errors = None if solution.uncertainty is None else default_errors(solution.uncertainty.at_work)
    point_mm, distance_m = solution.point_rms_m * 1e3, board_distance_m(extraction)
    reason, next_step = passed(
        len(extraction.observations), point_mm, distance_m, solution.method, found_errors
    )
    look = [words(check) for check in checks if check.outcome == "warning"]
    if look:
        next_step += f" Check first: {look[0].why} {look[0].next_step}"
    return Verdict("PASS", reason, next_step, checks, metrics)


def decided_by(check: Check, checks: Checks, metrics: Mapping[str, float | None] | None = None) -> Verdict:
    """The verdict where one check decides."""
    said = words(check)
    return Verdict(LEVELS[check.outcome], said.why, said.next_step, checks, metrics or {})


def reasons_of(verdict: Verdict) -> tuple[str, ...]:
    """One sentence or two for each criterion that is not met; none for PASS."""
    return tuple(words(check).why for check in verdict.checks if check.outcome in LEVELS)


def check_data(check: Check) -> CheckData:
    """A criterion as numbers and sentences."""
    said, met = words(check), check.outcome == "pass"
    return CheckData(
        id=check.id,
        value=check.value,
        limit=check.limit,
        unit=check.unit,
        at_least=check.at_least,
        outcome=check.outcome,
        name=said.name,
        measured_text=said.measured,
        limit_text=said.limit,
        why="" if met else said.why,
        next_step="" if met else said.next_step,
    )


def verdict_data(verdict: Verdict) -> VerdictData:
    """A verdict as numbers and sentences."""
    checks = tuple(check_data(check) for check in verdict.checks)
    return VerdictData(level=verdict.level, reason=verdict.reason, next_step=verdict.next_step, checks=checks)
