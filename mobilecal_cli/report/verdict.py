"""The verdict on a calibration: PASS, FAIL or NOT ENOUGH, with the reason and the next step.

PASS means that the expected errors in use are within their limits (`at_work`), and that nothing contradicts. Each
criterion is a `Check` with its measured value and its limit. The limits of the other criteria are wide: they catch
faults such as a slipping wheel, a moved board or a wrong encoder setting, not higher noise.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.model import CAMERA_INFO_CHANGES, Extraction, Solution
from mobilecal_cli.model.text import visible
from mobilecal_cli.report.at_work import MIN_PAN_DEG, MIN_TILT_DEG, use_checks, use_sentence, uses
from mobilecal_cli.report.check import MIN_DRIVEN_M, MIN_TURNED_DEG, Check, Outcome, graded
from mobilecal_cli.report.contradictions import contradiction_checks
from mobilecal_cli.report.decomposition import ErrorPart, error_parts
from mobilecal_cli.report.known import outliers_and_noise, square, unobservable
from mobilecal_cli.report.numbers import (
    board_distance_m,
    encoder_heading_rad,
    predicted_point_rms_m,
    rejection_counts,
    station_names,
    stations_looked_at,
    std_text,
)

Level = Literal["PASS", "FAIL", "NOT ENOUGH"]

# Nine unknowns need four stations; twice that gives enough redundancy to detect errors.
MIN_STATIONS = 8
# Point error: encoders with 300 steps per turn (as in the paper) give about 0.5 % of the distance. 1.5 % is
# 0.9 degrees of heading, more than a wheel without slip loses on one leg.
POINT_ERROR_LOOK, POINT_ERROR_BAD = 0.008, 0.015
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
RIVAL_BAD = 1.5
# Linear against refined: the linear method alone has errors up to 2 degrees, 60 mm and 5 % of the wheels.
METHODS_ROTATION_DEG, METHODS_TRANSLATION_M, METHODS_WHEELS = 6.0, 0.2, 0.15
# The two wheels of a differential drive are alike; tires and load make a difference of a few percent.
WHEELS_APART_LOOK, WHEELS_APART_BAD = 0.05, 0.25
# A tape measure is good to a few percent; an error above 25 % is a wrong factor (ticks, gear, diameter).
NOMINAL_LOOK, NOMINAL_BAD = 0.05, 0.25
REJECTED_LOOK = 0.5


@dataclass(frozen=True, slots=True)
class Verdict:
    """Whether a calibration can be used.

    Attributes:
        level: "PASS", "FAIL" or "NOT ENOUGH".
        reason: one or two sentences.
        next_step: what to do now.
        checks: every criterion.
    """

    level: Level
    reason: str
    next_step: str
    checks: tuple[Check, ...] = ()


def judge(
    solution: Solution,
    extraction: Extraction,
    gates: Sequence[Check] = (),
    limits: Mapping[str, float] | None = None,
) -> Verdict:
    """The verdict on a solution. The first criterion that is not met decides.

    Args:
        solution: the solution.
        extraction: the data it was computed from.
        gates: criteria of the user, see `gate_checks`.
        limits: gate → limit of an expected error, replacing the default, see `use_limits`.
    """
    checks = (*_checks(solution, extraction, limits or {}), *gates)
    levels: dict[Outcome, Level] = {"short": "NOT ENOUGH", "bad": "FAIL"}
    for check in checks:
        if check.outcome in levels:
            return Verdict(levels[check.outcome], check.why, check.next_step, checks)
    if solution.uncertainty is None:
        reason = (
            f"{_point_error(solution, extraction)} The method {solution.method} gives no standard deviations, so the "
            "expected errors in use are unknown."
        )
        next_step = "Calibrate with --method ml (the default) for a result that the robot can use."
    else:
        reason = f"{_point_error(solution, extraction)} {use_sentence(solution)}"
        next_step = "Use params.yaml on the robot."
    look = [check for check in checks if check.outcome == "look"]
    if look:
        next_step += f" Check first: {look[0].why} {look[0].next_step}"
    return Verdict("PASS", reason, next_step, checks)


def _point_error(solution: Solution, extraction: Extraction) -> str:
    share = 100 * solution.point_rms_m / board_distance_m(extraction)
    return (
        f"The point error over {len(extraction.observations)} stations is {solution.point_rms_m * 1e3:.1f} mm, "
        f"{share:.1f} % of the distance to the board."
    )


def _checks(solution: Solution, extraction: Extraction, limits: Mapping[str, float]) -> Iterator[Check]:
    """All criteria: a mistake first, then missing data, then contradictions and faults, then the errors in use."""
    enough = all(use.within for use in uses(solution, limits))
    yield from _diagnosis(solution)
    yield from _stations(extraction)
    yield from unobservable(solution, enough=enough)
    if solution.uncertainty is None:
        yield from _motion(solution)
    if not extraction.observations:
        return
    yield from _camera_info(extraction)
    yield from contradiction_checks(solution)
    yield from _faults(solution, extraction)
    yield from use_checks(solution, limits)
    yield _rejected(extraction)


def _faults(solution: Solution, extraction: Extraction) -> Iterator[Check]:
    yield _rival(solution)
    yield _wheels_apart(solution)
    yield from _nominal(solution, extraction)
    yield from _stereo(solution, extraction)
    yield from square(solution, extraction)
    if len(solution.residuals.legs):
        yield from _legs(solution, extraction)
        yield from _errors(solution, extraction)
    if solution.refinement is not None:
        yield _methods(solution)
    yield from outliers_and_noise(solution, extraction)


def _stations(extraction: Extraction) -> Iterator[Check]:
    have, logs = len(extraction.observations), len({o.log for o in extraction.observations})
    yield Check(
        "stations with the board in both images",
        str(have),
        f"at least {MIN_STATIONS}",
        "good" if have >= MIN_STATIONS else "short",
        f"The board is in both images at {have} stations only (limit {MIN_STATIONS}, recommended 12).",
        "Record again with more stops where both cameras see the whole board.",
    )
    if logs > 1:
        legs, least = have - logs, MIN_STATIONS - 1
        yield Check(
            "legs between consecutive stations",
            f"{legs} in {logs} recordings",
            f"at least {least}",
            "good" if legs >= least else "short",
            f"The {logs} recordings have only {legs} legs between consecutive stations (limit {least}).",
            "Record again with more stops in each recording.",
        )


def _diagnosis(solution: Solution) -> Iterator[Check]:
    found = solution.diagnosis
    if found is None:
        return
    shares = (found.error_share, found.corrected_share)
    before, after = ("no solution" if share is None else f"{100 * share:.2g} %" for share in shares)
    yield Check(
        "robot description",
        f"{found.cause}: point error {before} of the distance to the board, {after} when corrected",
        "no mistake found",
        "bad",
        f"The recording does not fit the robot's description: {found.cause}.",
        f"{found.cure[0].upper()}{found.cure[1:]}.",
    )


def _motion(solution: Solution) -> Iterator[Check]:
    """Motion of head and base, for methods without standard deviations."""
    for key, name, unit, least, more in (
        (
            "pan_range_deg",
            "pan range of the head",
            "degrees",
            MIN_PAN_DEG,
            "pan the head further left and right",
        ),
        (
            "tilt_range_deg",
            "tilt range of the head",
            "degrees",
            MIN_TILT_DEG,
            "tilt the head further up and down",
        ),
        ("turned_deg", "rotation of the base", "degrees", MIN_TURNED_DEG, "turn the base between stops"),
        ("driven_m", "path length of the base", "m", MIN_DRIVEN_M, "drive the base further between stops"),
    ):
        if key in solution.motion:
            value = solution.motion[key]
            yield Check(
                name,
                f"{value:.1f} {unit}",
                f"at least {least:g} {unit}",
                "good" if value >= least else "short",
                f"The {name} in the recording is {value:.1f} {unit} only (limit {least:g}).",
                f"Record again and {more}.",
            )


def _camera_info(extraction: Extraction) -> Iterator[Check]:
    """One calibration of each camera for the whole recording; the estimate uses the first."""
    changes = [note for note in extraction.notes if CAMERA_INFO_CHANGES in note]
    if changes:
        yield Check(
            "camera_info",
            f"{len(changes)} changes",
            "the same in the whole recording",
            "look",
            f"{visible(changes[0])}.",
            "Record again with one camera calibration, or state the correct one in rig.yaml.",
        )


def _rival(solution: Solution) -> Check:
    linear = solution.linear
    ratio = linear.rival_point_rms_m / linear.point_rms_m if linear.point_rms_m > 0 else np.inf
    single = not np.isfinite(linear.rival_point_rms_m)
    rival_mm, kept_mm = linear.rival_point_rms_m * 1e3, linear.point_rms_m * 1e3
    return Check(
        "unique solution",
        "all starts converge to one solution"
        if single
        else f"second-best point error {ratio:.1f} times larger",
        f"second-best at least {RIVAL_BAD:g} times larger",
        "good" if ratio >= RIVAL_BAD else "bad",
        f"Two different solutions fit almost equally well: point errors {kept_mm:.1f} and {rival_mm:.1f} mm.",
        "State the nominal wheels in rig.yaml, or record smaller turns between stops.",
    )


def _wheels_apart(solution: Solution) -> Check:
    wheels = solution.parameters.wheels
    right, left = wheels.radius_right_m, wheels.radius_left_m
    apart = max(right, left) / min(right, left) - 1
    return Check(
        "difference between the wheel radii",
        f"{100 * apart:.1f} % (right {right * 1e3:.1f} mm, left {left * 1e3:.1f} mm)",
        f"under {100 * WHEELS_APART_BAD:g} %",
        graded(apart, WHEELS_APART_LOOK, WHEELS_APART_BAD),
        f"The wheel radii differ by {100 * apart:.1f} %: right {right * 1e3:.1f} mm, left {left * 1e3:.1f} mm.",
        "Check ticks_per_revolution of both wheels, and the tires.",
    )


def _nominal(solution: Solution, extraction: Extraction) -> Iterator[Check]:
    nominal, wheels = extraction.rig.nominal.wheels, solution.parameters.wheels
    if nominal is None:
        return
    for name, value, prior in (
        ("right wheel radius", wheels.radius_right_m, nominal.radius_right_m),
        ("left wheel radius", wheels.radius_left_m, nominal.radius_left_m),
        ("wheel separation", wheels.separation_m, nominal.separation_m),
    ):
        ratio = value / prior
        yield Check(
            f"{name} against its nominal value",
            f"{value * 1e3:.1f} mm, {100 * (ratio - 1):+.1f} %",
            f"within {100 * NOMINAL_BAD:g} % of {prior * 1e3:.1f} mm",
            graded(abs(ratio - 1), NOMINAL_LOOK, NOMINAL_BAD),
            f"The {name} is {value * 1e3:.1f} mm, {_times(ratio)} the nominal {prior * 1e3:.1f} mm.",
            "Measure the robot with a ruler. Check ticks_per_revolution, and that a diameter was not entered as the "
            "radius.",
        )


def _times(ratio: float) -> str:
    for factor, words in ((0.5, "about half of"), (2.0, "about twice")):
        if abs(ratio / factor - 1) < 0.1:
            return words
    return f"{ratio:.2f} times"


def _stereo(solution: Solution, extraction: Extraction) -> Iterator[Check]:
    """Corners against the flat board: with the cameras as estimated, or as stated where there is no estimate."""
    found = solution.uncertainty
    stated = float(np.median([o.reprojection_px for o in extraction.observations]))
    px = stated if found is None else found.noise.pixel_px
    yield Check(
        "stereo reprojection error of the board",
        f"{std_text(px)} px (median)"
        if found is None
        else f"{std_text(px)} px (with camera_info as stated: {std_text(stated)} px)",
        f"under {STEREO_BAD_PX:g} px",
        graded(px, STEREO_LOOK_PX, STEREO_BAD_PX),
        f"The stereo reprojection error of the board is {std_text(px)} px (0.3 px is usual).",
        "Calibrate the stereo pair again (camera_info), and check that the board is flat.",
    )


def _methods(solution: Solution) -> Check:
    linear, refined = solution.linear.parameters, solution.parameters
    apart = se3.inverse(linear.T_h_c) @ refined.T_h_c
    angle_deg = float(np.degrees(np.linalg.norm(se3.log_so3(apart[:3, :3]))))
    shift_m = float(np.linalg.norm(linear.T_h_c[:3, 3] - refined.T_h_c[:3, 3]))
    a, b = linear.wheels, refined.wheels
    wheels = max(
        abs(a.radius_right_m / b.radius_right_m - 1),
        abs(a.radius_left_m / b.radius_left_m - 1),
        abs(a.separation_m / b.separation_m - 1),
    )
    found = solution.uncertainty
    if found is not None:  # the linear method knows no fixed values, and unobservable ones only roughly
        known = [bool(found.observable[part].all()) for part in (slice(3), slice(3, 6), slice(6, 9))]
        angle_deg, shift_m, wheels = (
            value if ok else 0.0 for value, ok in zip((angle_deg, shift_m, wheels), known, strict=True)
        )
    far = angle_deg > METHODS_ROTATION_DEG or shift_m > METHODS_TRANSLATION_M or wheels > METHODS_WHEELS
    apart_by = f"{angle_deg:.1f} degrees, {shift_m * 1e3:.0f} mm and {100 * wheels:.1f} % of the wheels"
    return Check(
        "linear against refined solution",
        f"differ by {apart_by}",
        f"under {METHODS_ROTATION_DEG:g} degrees, {METHODS_TRANSLATION_M * 1e3:g} mm and {100 * METHODS_WHEELS:g} %",
        _at_most(solution, "bad") if far else "good",
        f"The linear and the refined solution differ by {apart_by}.",
        "Check the head joints for play. Then record again with more stops, head motion and turns.",
    )


def _at_most(solution: Solution, outcome: Outcome) -> Outcome:
    """A warning instead of a failure where the estimate has its own outlier test and estimates the cameras."""
    return "look" if outcome == "bad" and solution.uncertainty is not None else outcome


def _legs(solution: Solution, extraction: Extraction) -> Iterator[Check]:
    residuals, names = solution.residuals, station_names(extraction)
    if len(residuals.legs) < MIN_LEGS_FOR_OUTLIERS:
        return
    scales = (
        ("point", residuals.leg_point_rms_m * 1e3, board_distance_m(extraction) * 1e3, "mm"),
        ("reprojection", residuals.leg_reprojection_px, float(extraction.rig.cameras.left.K[0, 0]), "px"),
    )
    excused = ENCODER_STEPS_EXCUSED * encoder_heading_rad(solution, extraction)
    share_look, share_bad = max(LEG_SHARE_LOOK, excused), max(LEG_SHARE_BAD, excused)
    for kind, errors, scale, unit in scales:
        worst, median = int(np.argmax(errors)), float(np.median(errors))
        first, second = residuals.legs[worst]
        error, share = float(errors[worst]), float(errors[worst]) / scale
        stands_out = error > LEG_OUTLIER * median
        yield Check(
            f"largest {kind} error of a leg",
            f"{error:.1f} {unit} (median {median:.1f} {unit})",
            f"under {LEG_OUTLIER:g} times the median, or under {share_bad * scale:.1f} {unit}",
            _at_most(solution, graded(share, share_look, share_bad)) if stands_out else "good",
            f"The {kind} error between stations {names[first]} and {names[second]} is {error:.1f} {unit} "
            f"(median {median:.1f} {unit}).",
            "Check for wheel slip and for a moved board between these stations, and record again.",
        )


def _errors(solution: Solution, extraction: Extraction) -> Iterator[Check]:
    error, distance = solution.point_rms_m, board_distance_m(extraction)
    predicted = predicted_point_rms_m(extraction, solution)
    floor = error_parts(solution, extraction).get("floor", ErrorPart(0.0, 0.0))
    # Depth noise of the cameras and an uneven floor are no errors of the calibration.
    unexplained = float(np.sqrt(max(error**2 - predicted**2 - floor.m**2, 0.0)))
    yield Check(
        "point error",
        f"{error * 1e3:.1f} mm, {100 * error / distance:.2f} % of the distance "
        f"(depth noise alone: {predicted * 1e3:.1f} mm)",
        f"under {100 * POINT_ERROR_BAD:g} % without depth noise and uneven floor",
        graded(unexplained / distance, POINT_ERROR_LOOK, POINT_ERROR_BAD),
        f"The point error is {error * 1e3:.1f} mm at {distance:.1f} m (depth noise alone: {predicted * 1e3:.1f} mm).",
        "Check for wheel slip, a moved board, and errors in the head joints or their URDF.",
    )
    focal_px = float(extraction.rig.cameras.left.K[0, 0])
    px = solution.reprojection_rms_px
    yield Check(
        "reprojection error",
        f"{px:.2f} px",
        f"under {PIXEL_ERROR_BAD * focal_px:.1f} px",
        graded(max(px**2 - floor.px**2, 0.0), np.inf, (PIXEL_ERROR_BAD * focal_px) ** 2),
        f"The reprojection error is {px:.1f} px (limit {PIXEL_ERROR_BAD * focal_px:.1f} px).",
        "Check for wheel slip, a moved board, and errors in the head joints or their URDF.",
    )


def _rejected(extraction: Extraction) -> Check:
    looked, used = stations_looked_at(extraction), len(extraction.observations)
    share = 1 - used / looked
    counts = rejection_counts(extraction)
    often = f" (most often: {visible(next(iter(counts))[1])})" if counts else ""
    return Check(
        "rejected stations",
        f"{looked - used} of {looked}",
        f"under {100 * REJECTED_LOOK:g} %",
        graded(share, REJECTED_LOOK, np.inf),
        f"{looked - used} of {looked} stations were rejected{often}.",
        "See the table of rejections in the report, and improve the next recording.",
    )
