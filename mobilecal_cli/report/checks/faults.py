"""Criteria that find faults: a slipping wheel, a moved board, a wrong encoder setting.

Their limits are wide: they catch faults, not higher noise.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np

from mobilecal_cli.model import Extraction, Solution
from mobilecal_cli.report.check import Check, graded
from mobilecal_cli.report.decomposition import error_parts
from mobilecal_cli.report.numbers import (
    board_distance_m,
    encoder_heading_rad,
    predicted_point_rms_m,
    station_names,
)
from mobilecal_cli.report.values import Outcome

# Point error: encoders with 300 steps per turn (as in the paper) give about 0.5 % of the distance. 1.5 % is
# 0.9 degrees of heading, more than a wheel without slip loses on one leg.
POINT_ERROR_LOOK_PERCENT, POINT_ERROR_BAD_PERCENT = 0.8, 1.5
# Reprojection error as an angle: depth noise does not affect it, so the limit is the same share.
PIXEL_ERROR_BAD = 0.015
# One leg against the median. Errors of consistent legs are distributed like |x| of a normal x: the largest of 11
# is about 3 times the median, the largest of 1000 about 5 times. Short legs have small errors, so an outlier must
# also be large in absolute terms: as a share of the distance, in mm or in the image.
LEG_OUTLIER, LEG_SHARE_LOOK, LEG_SHARE_BAD = 5.0, 0.004, 0.01
MIN_LEGS_FOR_OUTLIERS = 5
# Coarse encoders: an error of one step on both wheels, with a margin for the joints.
ENCODER_STEPS_EXCUSED = 1.5
# Stereo corners against the flat grid of the board: good camera calibrations give 0.1 to 0.3 px.
STEREO_LOOK_PX, STEREO_BAD_PX = 0.6, 1.2
# Two solutions whose errors differ by less than this factor cannot be distinguished.
# Errors beyond this share of the distance to the board are those of solutions that do not fit.
RIVAL_BAD, RIVAL_FITS = 1.5, 0.1
# Linear against refined: the linear method alone has errors up to 2 degrees, 60 mm and 5 % of the wheels.
METHODS_DEG, METHODS_MM, METHODS_WHEELS_PERCENT = 6.0, 200.0, 15.0
# The two wheels of a differential drive are alike; tires and load make a difference of a few percent.
WHEELS_LOOK_PERCENT, WHEELS_BAD_PERCENT = 5.0, 25.0
# A tape measure is good to a few percent; an error above 25 % is a wrong factor (ticks, gear, diameter).
NOMINAL_LOOK_PERCENT, NOMINAL_BAD_PERCENT = 5.0, 25.0


def second_solution(solution: Solution, extraction: Extraction) -> Check:
    """How many times larger the second-best solution's error is; None if there is no second one.

    Linear solutions that do not fit, for example because of a slip, are not compared.
    """
    linear = solution.linear
    kept, rival = linear.point_rms_m, linear.rival_point_rms_m
    single = not math.isfinite(rival)
    ratio = rival / kept if kept > 0 else math.inf
    fits = kept < RIVAL_FITS * board_distance_m(extraction)
    return Check(
        "second_solution",
        ratio if math.isfinite(ratio) else None,
        RIVAL_BAD,
        "pass" if ratio >= RIVAL_BAD or not fits else "fail",
        {"kept_mm": kept * 1e3, "rival_mm": None if single else rival * 1e3, "fits": fits},
    )


def wheel_difference(solution: Solution) -> Check:
    """Relative difference between the wheel radii."""
    right, left = solution.parameters.wheels.radius_right_m, solution.parameters.wheels.radius_left_m
    apart = 100 * (max(right, left) / min(right, left) - 1)
    outcome = graded(apart, WHEELS_LOOK_PERCENT, WHEELS_BAD_PERCENT)
    facts = {"right_mm": right * 1e3, "left_mm": left * 1e3}
    return Check("wheel_difference", apart, WHEELS_BAD_PERCENT, outcome, facts)


def nominal_checks(solution: Solution, extraction: Extraction) -> Iterator[Check]:
    """Each size of the wheels against its nominal value."""
    nominal, wheels = extraction.rig.nominal.wheels, solution.parameters.wheels
    if nominal is None:
        return
    for name in ("radius_right", "radius_left", "separation"):
        size, prior = (float(getattr(each, f"{name}_m")) for each in (wheels, nominal))
        off = 100 * (size / prior - 1)
        yield Check(
            f"nominal.{name}",
            off,
            NOMINAL_BAD_PERCENT,
            graded(abs(off), NOMINAL_LOOK_PERCENT, NOMINAL_BAD_PERCENT),
            {"mm": size * 1e3, "nominal_mm": prior * 1e3},
        )


def stereo_error(solution: Solution, extraction: Extraction) -> Check:
    """Corners against the flat board: with the cameras as estimated, or as stated where there is no estimate."""
    found = solution.uncertainty
    stated = float(np.median([o.reprojection_px for o in extraction.observations]))
    px = stated if found is None else found.noise.pixel_px
    facts = {"stated_px": stated, "cameras": "stated" if found is None else "estimated"}
    outcome = graded(px, STEREO_LOOK_PX, STEREO_BAD_PX)
    return Check("stereo_error", px, STEREO_BAD_PX, outcome, facts)


def methods(solution: Solution) -> Check:
    """Difference between the linear and the refined solution; in shares of its limits, the largest."""
    linear, refined = solution.linear.parameters, solution.parameters
    step = refined.minus(linear)
    angle_deg = float(np.degrees(np.linalg.norm(step[:3])))
    shift_mm = 1e3 * float(np.linalg.norm(step[3:6]))
    wheels = 100 * float(np.abs(linear.wheels.vector / refined.wheels.vector - 1).max())
    found = solution.uncertainty
    if found is not None:  # the linear method knows no fixed values, and unobservable ones only roughly
        known = [bool(found.observable[part].all()) for part in (slice(3), slice(3, 6), slice(6, 9))]
        angle_deg, shift_mm, wheels = (
            value if ok else 0.0 for value, ok in zip((angle_deg, shift_mm, wheels), known, strict=True)
        )
    limits = (METHODS_DEG, METHODS_MM, METHODS_WHEELS_PERCENT)
    largest = max(value / limit for value, limit in zip((angle_deg, shift_mm, wheels), limits, strict=True))
    facts = {"angle_deg": angle_deg, "shift_mm": shift_mm, "wheels_percent": wheels, "limits": limits}
    return Check("methods", largest, 1.0, _at_most(solution, "fail") if largest > 1 else "pass", facts)


def _at_most(solution: Solution, outcome: Outcome) -> Outcome:
    """A warning instead of a failure where the estimate has its own outlier test and estimates the cameras."""
    return "warning" if outcome == "fail" and solution.uncertainty is not None else outcome


def leg_checks(solution: Solution, extraction: Extraction) -> Iterator[Check]:
    """The leg with the largest error against the median leg."""
    residuals, names = solution.residuals, station_names(extraction)
    if len(residuals.legs) < MIN_LEGS_FOR_OUTLIERS:
        return
    excused = ENCODER_STEPS_EXCUSED * encoder_heading_rad(solution, extraction)
    share_look, share_bad = max(LEG_SHARE_LOOK, excused), max(LEG_SHARE_BAD, excused)
    for kind, errors, scale in (
        ("point", residuals.leg_point_rms_m * 1e3, board_distance_m(extraction) * 1e3),
        ("reprojection", residuals.leg_reprojection_px, float(solution.cameras.left.K[0, 0])),
    ):
        worst, median = int(np.argmax(errors)), float(np.median(errors))
        first, second = residuals.legs[worst]
        error = float(errors[worst])
        far = error > LEG_OUTLIER * median
        facts = {"from": names[first], "to": names[second], "median": median, "times_median": LEG_OUTLIER}
        outcome = _at_most(solution, graded(error / scale, share_look, share_bad)) if far else "pass"
        yield Check(f"leg_outlier.{kind}", error, share_bad * scale, outcome, facts)


def error_checks(solution: Solution, extraction: Extraction) -> Iterator[Check]:
    """Point error and reprojection error, without what is no error of the calibration.

    That is the depth noise of the cameras, and what joints, floor and wheels cause at their noise levels, which have
    limits of their own.
    """
    error, distance = solution.point_rms_m, board_distance_m(extraction)
    predicted = predicted_point_rms_m(extraction, solution)
    parts = [part for name, part in error_parts(solution, extraction).items() if name != "corners"]
    explained = predicted**2 + sum(part.m**2 for part in parts)
    unexplained = 100 * math.sqrt(max(error**2 - explained, 0.0)) / distance
    yield Check(
        "point_error",
        unexplained,
        POINT_ERROR_BAD_PERCENT,
        graded(unexplained, POINT_ERROR_LOOK_PERCENT, POINT_ERROR_BAD_PERCENT),
        {"error_mm": error * 1e3, "depth_noise_mm": predicted * 1e3, "distance_m": distance},
    )
    limit_px = PIXEL_ERROR_BAD * float(solution.cameras.left.K[0, 0])
    px = math.sqrt(max(solution.reprojection_rms_px**2 - sum(part.px**2 for part in parts), 0.0))
    facts = {"error_px": solution.reprojection_rms_px}
    yield Check("reprojection_error", px, limit_px, graded(px, math.inf, limit_px), facts)
