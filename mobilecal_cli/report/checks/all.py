"""All criteria on a calibration."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from mobilecal_cli.model import Extraction, Solution
from mobilecal_cli.report.at_work import use_checks, uses
from mobilecal_cli.report.check import Check
from mobilecal_cli.report.checks.estimate import (
    height_checks,
    jump_checks,
    noise_checks,
    outlier_checks,
    square_checks,
    unobservable,
)
from mobilecal_cli.report.checks.faults import (
    error_checks,
    leg_checks,
    methods,
    nominal_checks,
    second_solution,
    stereo_error,
    wheel_difference,
)
from mobilecal_cli.report.checks.recording import (
    camera_info,
    mistakes,
    motion_checks,
    rejected,
    station_checks,
)
from mobilecal_cli.report.contradictions import contradiction_checks


def all_checks(solution: Solution, extraction: Extraction, limits: Mapping[str, float]) -> Iterator[Check]:
    """A mistake first, then missing data, then contradictions and faults, then the errors in use.

    Args:
        solution: the solution.
        extraction: the data it was computed from.
        limits: gate → limit of an expected error, replacing the default.
    """
    yield from mistakes(solution)
    yield from station_checks(extraction)
    yield from unobservable(solution, enough=all(use.within for use in uses(solution, limits)))
    if solution.uncertainty is None:
        yield from motion_checks(solution)
    if not extraction.observations:
        return
    yield from camera_info(extraction)
    yield from jump_checks(solution, extraction)
    yield from contradiction_checks(solution, extraction)
    yield second_solution(solution, extraction)
    yield wheel_difference(solution)
    yield from nominal_checks(solution, extraction)
    yield stereo_error(solution, extraction)
    yield from square_checks(solution, extraction)
    yield from height_checks(solution)
    if len(solution.residuals.legs):
        yield from leg_checks(solution, extraction)
        yield from error_checks(solution, extraction)
    if solution.refinement is not None:
        yield methods(solution)
    yield from outlier_checks(solution, extraction)
    yield from noise_checks(solution, extraction)
    yield from use_checks(solution, limits)
    yield rejected(extraction)
