"""The verdict on a calibration: PASS, FAIL or NOT ENOUGH, with the reason and the next step.

PASS means that the expected errors in use are within their limits (`at_work`), and that nothing contradicts.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal

from mobilecal_cli.model import Evaluation, Extraction, Solution
from mobilecal_cli.report.at_work import use_sentence
from mobilecal_cli.report.changes import Change, change_checks
from mobilecal_cli.report.check import Checks, Outcome
from mobilecal_cli.report.checks import all_checks
from mobilecal_cli.report.gates import Gate, figures_of, gate_checks, use_limits
from mobilecal_cli.report.numbers import board_distance_m
from mobilecal_cli.report.wording import words

Level = Literal["PASS", "FAIL", "NOT ENOUGH"]


@dataclass(frozen=True, slots=True)
class Verdict:
    """Whether a calibration can be used.

    Attributes:
        level: "PASS", "FAIL" or "NOT ENOUGH".
        reason: one or two sentences.
        next_step: what to do now.
        checks: every criterion.
        metrics: name → value, None if unknown: the figures that gates can limit, and the value of every criterion.
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
    metrics = figures_of(solution, extraction, trial) | {check.id: check.value for check in found}
    checks = Checks((*found, *gate_checks(gates, metrics)))
    levels: dict[Outcome, Level] = {"short": "NOT ENOUGH", "bad": "FAIL"}
    for check in checks:
        if check.outcome in levels:
            said = words(check)
            return Verdict(levels[check.outcome], said.why, said.next_step, checks, metrics)
    if solution.uncertainty is None:
        reason = (
            f"{_point_error(solution, extraction)} The method {solution.method} gives no standard deviations, so the "
            "expected errors in use are unknown."
        )
        next_step = "Calibrate with --method ml (the default) for a result that the robot can use."
    else:
        reason = f"{_point_error(solution, extraction)} {use_sentence(solution)}"
        next_step = "Use params.yaml on the robot."
    look = [words(check) for check in checks if check.outcome == "look"]
    if look:
        next_step += f" Check first: {look[0].why} {look[0].next_step}"
    return Verdict("PASS", reason, next_step, checks, metrics)


def _point_error(solution: Solution, extraction: Extraction) -> str:
    share = 100 * solution.point_rms_m / board_distance_m(extraction)
    return (
        f"The point error over {len(extraction.observations)} stations is {solution.point_rms_m * 1e3:.1f} mm, "
        f"{share:.1f} % of the distance to the board."
    )
