"""Criteria on the maximum-likelihood estimate: observability, noise, outliers, scale."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from mobilecal_cli.model import NINE, Extraction, Solution
from mobilecal_cli.report.check import LEAST_MOTION, Check, graded
from mobilecal_cli.report.numbers import station_names
from mobilecal_cli.report.values import Outcome

# Stated square size against the stereo measurement; a difference scales all lengths.
SQUARE_LOOK_PERCENT, SQUARE_BAD_PERCENT = 1.0, 3.0
# Share of outliers that a robust estimate tolerates.
OUTLIERS_BAD_PERCENT = 30.0
# Noise levels (look, bad). The estimate allows for them, so the limits are wide.
JOINT_DEG, JOINT_MM, WHEEL = (0.2, 0.4), (0.35, 0.7), (0.015, 0.03)
FLOOR_DEG, STAMP_MS, WHEEL_SHARE_PERCENT = (0.3, 1.5), (2.0, 20.0), (1.0, 5.0)
HEIGHT_MM = (4.0, 30.0)
# A jump that moves the result by more than this makes it neither the old nor the new one.
JUMP_SHIFT_SIGMAS = 2.0


def unobservable(solution: Solution, *, enough: bool) -> Iterator[Check]:
    """Parameters that the recording does not determine, and the motion that would.

    Args:
        solution: the solution.
        enough: whether all expected errors are within their limits all the same.
    """
    found, motion = solution.uncertainty, solution.motion
    if found is None:
        return
    seen = zip(NINE, found.observable, found.fixed, strict=True)
    fixed = [name for name, ok, by_user in seen if not (ok or by_user)]
    if not fixed:
        return
    cures = []
    if set(fixed) & set(NINE[:6]):
        cures.append("tilt the head up and down by 15 degrees or more between stops, and pan it")
    if set(fixed) & set(NINE[6:]):
        turns, drives = (motion[key] >= LEAST_MOTION[key] for key in ("turned_deg", "driven_m"))
        cures.append(
            "turn the base by 20 degrees or more between stops"
            if drives and not turns
            else "drive forward and back by 20 cm or more between stops"
            if turns and not drives
            else "drive and turn the base between stops"
        )
    yield Check(
        "observable",
        9 - len(fixed),
        9,
        "warning" if enough else "not_enough",
        facts={"unobservable": fixed, "cures": cures},
    )


def outlier_checks(solution: Solution, extraction: Extraction) -> Iterator[Check]:
    """Outliers, and kinds of measurements with so many of them that they are noise."""
    if solution.uncertainty is None:
        return
    gross = [o for o in solution.outliers if o.kind != "corners"]
    stations = len(extraction.observations)
    share = 100 * len(gross) / max(1, stations)
    outcome: Outcome = "fail" if share > OUTLIERS_BAD_PERCENT else "warning" if gross else "pass"
    facts = {"count": len(gross), "stations": stations, "first": gross[0].text if gross else ""}
    yield Check("outliers", share, OUTLIERS_BAD_PERCENT, outcome, facts)
    if solution.noisy:
        yield Check("outliers_as_noise", len(solution.noisy), 0, "warning", {"kinds": solution.noisy})


def noise_checks(solution: Solution, extraction: Extraction) -> Iterator[Check]:
    """Noise levels of joints, wheels, floor and time stamps, if they are not zero."""
    if solution.uncertainty is None:
        return
    noise, chain = solution.uncertainty.noise, extraction.rig.chain
    slides = bool(chain.joints) and len(chain.prismatic) == len(chain.joints)
    joint = (
        ("sliding_joint", 1e3 * chain.joint_units[0] * noise.joint_rad, JOINT_MM)
        if slides
        else ("joint", float(np.degrees(noise.joint_rad)), JOINT_DEG)
    )
    moving = not all(o.at_rest for o in extraction.observations)
    for name, level, (look, bad) in (
        joint,
        ("wheel", noise.wheel_rad_per_sqrt_rad, WHEEL),
        ("wheel_share", 100 * noise.wheel_share, WHEEL_SHARE_PERCENT),
        ("floor", float(np.degrees(noise.floor_rad)), FLOOR_DEG),
        ("stamp", 1e3 * noise.stamp_s if moving else 0.0, STAMP_MS),
    ):
        if level:
            yield Check(f"noise.{name}", level, bad, graded(level, look, bad), {"usual": look})


def jump_checks(solution: Solution, extraction: Extraction) -> Iterator[Check]:
    """Moments from which on something is not where it was before."""
    names = station_names(extraction)
    for jump in solution.jumps:
        begin = int(extraction.wheels[jump.log].time_ns[0])
        facts = {"jump": jump, "station": names[jump.station], "at_s": (jump.time_ns - begin) / 1e9}
        value = jump.shift_sigmas if math.isfinite(jump.shift_sigmas) else None
        yield Check("jump", value, JUMP_SHIFT_SIGMAS, "fail", facts)


def height_checks(solution: Solution) -> Iterator[Check]:
    """Noise of the floor's height."""
    if solution.uncertainty is not None and solution.uncertainty.noise.floor_m:
        level, (look, bad) = 1e3 * solution.uncertainty.noise.floor_m, HEIGHT_MM
        yield Check("noise.height", level, bad, graded(level, look, bad), {"usual": look})


def square_checks(solution: Solution, extraction: Extraction) -> Iterator[Check]:
    """Stated square size against the stereo baseline, for methods that do not estimate both."""
    if solution.uncertainty is None and extraction.board.square_m is not None:
        stated = extraction.board.square_m
        seen = float(np.median([o.square_m for o in extraction.observations]))
        off = 100 * (seen / stated - 1)
        outcome = graded(abs(off), SQUARE_LOOK_PERCENT, SQUARE_BAD_PERCENT)
        facts = {"seen_mm": seen * 1e3, "stated_mm": stated * 1e3}
        yield Check("square_size", off, SQUARE_BAD_PERCENT, outcome, facts)
