"""Stated values that the data contradict."""

from __future__ import annotations

from collections.abc import Iterator

from mobilecal_cli.model import Evidence, Extraction, Solution
from mobilecal_cli.report.check import Check
from mobilecal_cli.report.values import Outcome
from mobilecal_cli.report.wording.contradictions import SCALES, contradiction_sentences

#: Evidence beyond this is a contradiction (the solver's own limit); the answer depends on it beyond the other.
CONTRADICTION_SIGMAS, SHIFT_SIGMAS = 4.0, 2.0


def contradiction_checks(solution: Solution, extraction: Extraction) -> Iterator[Check]:
    """Whether the data contradict the robot description: each contradiction, or the largest evidence."""
    if solution.uncertainty is None:
        return
    scale_done = False
    for found in each_once(solution):
        is_scale = found.kind in SCALES and solution.scale is not None
        if is_scale and scale_done:
            continue
        scale_done |= is_scale
        outcome: Outcome = "fail" if found.shift_sigmas > SHIFT_SIGMAS else "warning"
        facts = {
            "evidence": found,
            "scale": solution.scale,
            "meanings": _meanings(solution),
            "square_stated": extraction.board.square_m is not None,
            "several": found is solution.contradictions[-1] and len(solution.contradictions) > 1,
        }
        name = f"contradiction.{found.kind}.{found.part}"
        yield Check(name, found.sigmas, CONTRADICTION_SIGMAS, outcome, facts)
    if not solution.contradictions:
        most = max((found.sigmas for found in solution.evidence), default=0.0)
        yield Check("description", most, CONTRADICTION_SIGMAS, "pass")


def each_once(solution: Solution) -> tuple[Evidence, ...]:
    """The contradicted values in order, each once: a prior may have been widened several times."""
    found: dict[tuple[str, str], Evidence] = {}
    for one in solution.contradictions:
        found.setdefault((one.kind, one.part), one)
    return tuple(found.values())


def told(found: Evidence, solution: Solution, extraction: Extraction) -> tuple[str, str]:
    """What the data contradict and by how much, and the cure."""
    square_stated = extraction.board.square_m is not None
    return contradiction_sentences(found, solution.scale, _meanings(solution), square_stated)


def _meanings(solution: Solution) -> dict[str, str]:
    return {name: constant.meaning for name, constant in solution.constants.items()}
