"""Pass or fail, in a technician's words: why, and what to do next.

Each criterion is a `Check` with its measured value and its limit. The limits are wide: they catch what is
broken (a slipping wheel, a board that moved, a wrong encoder, a wrong camera calibration), not what is
merely a little noisier than it could be.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.model import Extraction, Solution
from mobilecal_cli.model.text import visible
from mobilecal_cli.report.check import MIN_DRIVEN_M, MIN_TURNED_DEG, Check, Outcome, graded
from mobilecal_cli.report.known import believed, hidden, sigmas, square, wanting
from mobilecal_cli.report.numbers import (
    board_distance_m,
    encoder_heading_rad,
    predicted_point_rms_m,
    rejection_counts,
    station_names,
    stations_looked_at,
)

Level = Literal["PASS", "FAIL", "NOT ENOUGH"]

# Nine unknowns need four stations; twice that leaves enough to tell a wrong answer from a right one.
MIN_STATIONS = 8
# With less movement a parameter rests on a difference about as small as the noise.
MIN_PAN_DEG, MIN_TILT_DEG = 10.0, 5.0
# Corners carried from station to station: encoders with 300 steps a turn (the paper's) give about 0.5 % of
# the distance; 1.5 % is 0.9 degrees of heading, more than a sound wheel and a firm floor lose on one leg.
POINT_ERROR_LOOK, POINT_ERROR_BAD = 0.008, 0.015
# The same in the picture, as an angle: depth noise does not enter, so the limit is the same share.
PIXEL_ERROR_BAD = 0.015
# One leg against the median one. Errors of sound legs spread like |x| of a normal x: of 11 the worst is about
# 3 times the median, of 1000 about 5 times. Legs that hardly move have hardly an error, so what stands out
# must also be large as it is: a share of the distance, in mm or in the picture.
LEG_OUTLIER, LEG_SHARE_LOOK, LEG_SHARE_BAD = 5.0, 0.004, 0.01
MIN_LEGS_FOR_OUTLIERS = 5
# Coarse encoders: both wheels wrong by a whole step turn a leg by so much, and the joints add a little.
ENCODER_STEPS_EXCUSED = 1.5
# Stereo corners against the board's flat grid: good calibrations give 0.1 to 0.3 px.
STEREO_LOOK_PX, STEREO_BAD_PX = 0.6, 1.2
# Another answer whose error is within this factor cannot be told from this one.
RIVAL_BAD = 1.5
# Linear against refined: the linear method's own error is up to 2 degrees, 60 mm, 5 % of the wheels at 12 stations.
METHODS_ROTATION_DEG, METHODS_TRANSLATION_M, METHODS_WHEELS = 6.0, 0.2, 0.15
# The two wheels of a differential drive are of one kind; tyres and load make a few per cent.
WHEELS_APART_LOOK, WHEELS_APART_BAD = 0.05, 0.25
# Tape measures are good to a few per cent; beyond a quarter a number is wrong by a factor (ticks, gear, diameter).
NOMINAL_LOOK, NOMINAL_BAD = 0.05, 0.25
REJECTED_LOOK = 0.5


@dataclass(frozen=True, slots=True)
class Verdict:
    """What to make of a calibration.

    Attributes:
        level: "PASS", "FAIL" or "NOT ENOUGH".
        reason: one sentence.
        next_step: one sentence.
        checks: every criterion that was looked at.
    """

    level: Level
    reason: str
    next_step: str
    checks: tuple[Check, ...] = ()


def judge(solution: Solution, extraction: Extraction, gates: Sequence[Check] = ()) -> Verdict:
    """Judge a solution. Too little data comes before failure: its numbers say nothing either way.

    Args:
        solution: the answer.
        extraction: what it was solved from.
        gates: the user's own criteria, see `gate_checks`.
    """
    checks = (*_checks(solution, extraction), *gates)
    levels: tuple[tuple[Outcome, Level], ...] = (("short", "NOT ENOUGH"), ("bad", "FAIL"))
    for outcome, level in levels:
        for check in checks:
            if check.outcome == outcome:
                return Verdict(level, check.why, check.next_step, checks)
    share = 100 * solution.point_rms_m / board_distance_m(extraction)
    reason = (
        f"{len(extraction.observations)} stations agree with one another to "
        f"{solution.point_rms_m * 1e3:.1f} mm, {share:.1f} % of the distance to the board."
    )
    if solution.uncertainty is not None:
        std = solution.uncertainty.std
        reason += (
            f" The camera is known to {np.degrees(std[:3].max()):.2g} degrees and {std[3:6].max() * 1e3:.2g} mm, "
            f"the wheels to {std[6:].max() * 1e3:.2g} mm (one standard deviation)."
        )
    look = [check for check in checks if check.outcome == "look"]
    next_step = "Use params.yaml on the robot."
    if look:
        next_step += f" Worth a look first: {look[0].why} {look[0].next_step}"
    return Verdict("PASS", reason, next_step, checks)


def _checks(solution: Solution, extraction: Extraction) -> Iterator[Check]:
    yield _stations(extraction)
    yield from hidden(solution)
    yield from _motion(solution)
    if not extraction.observations:
        return
    yield _rival(solution)
    yield _wheels_apart(solution)
    yield from _nominal(solution, extraction)
    yield from _stereo(extraction)
    yield from square(solution, extraction)
    yield from wanting(solution)
    if len(solution.residuals.legs):
        yield from _legs(solution, extraction)
        yield from _errors(solution, extraction)
    if solution.refinement is not None:
        yield _methods(solution)
    yield from sigmas(solution)
    yield from believed(solution, extraction)
    yield _rejected(extraction)


def _stations(extraction: Extraction) -> Check:
    have = len(extraction.observations)
    return Check(
        "stations with the board in both cameras",
        str(have),
        f"at least {MIN_STATIONS}",
        "good" if have >= MIN_STATIONS else "short",
        f"Only {have} stations show the board to both cameras; {MIN_STATIONS} are the least, 12 are good.",
        "Record again with more stops at which both cameras see the whole board.",
    )


def _motion(solution: Solution) -> Iterator[Check]:
    for key, name, unit, least, more in (
        ("pan_range_deg", "the head panned", "degrees", MIN_PAN_DEG, "turn the head further left and right"),
        ("tilt_range_deg", "the head tilted", "degrees", MIN_TILT_DEG, "tilt the head further up and down"),
        ("turned_deg", "the base turned", "degrees", MIN_TURNED_DEG, "let the base turn between stops"),
        ("driven_m", "the base drove", "m", MIN_DRIVEN_M, "let the base drive further between stops"),
    ):
        if key in solution.motion:
            value = solution.motion[key]
            yield Check(
                name,
                f"{value:.1f} {unit}",
                f"at least {least:g} {unit}",
                "good" if value >= least else "short",
                f"In the whole recording {name} by {value:.1f} {unit} only.",
                f"Record again and {more}.",
            )


def _rival(solution: Solution) -> Check:
    linear = solution.linear
    ratio = linear.rival_point_rms_m / linear.point_rms_m if linear.point_rms_m > 0 else np.inf
    single = not np.isfinite(linear.rival_point_rms_m)
    rival_mm, kept_mm = linear.rival_point_rms_m * 1e3, linear.point_rms_m * 1e3
    return Check(
        "only one answer fits",
        "every start ended at the same answer" if single else f"the next best fits {ratio:.1f} times worse",
        f"next best at least {RIVAL_BAD:g} times worse",
        "good" if ratio >= RIVAL_BAD else "bad",
        f"Two different answers fit almost equally well ({kept_mm:.1f} and {rival_mm:.1f} mm).",
        "Give nominal wheel sizes in rig.yaml, or record smaller turns between stops.",
    )


def _wheels_apart(solution: Solution) -> Check:
    wheels = solution.parameters.wheels
    right, left = wheels.radius_right_m, wheels.radius_left_m
    apart = max(right, left) / min(right, left) - 1
    return Check(
        "the two wheels are of like size",
        f"{right * 1e3:.1f} and {left * 1e3:.1f} mm, {100 * apart:.1f} % apart",
        f"under {100 * WHEELS_APART_BAD:g} %",
        graded(apart, WHEELS_APART_LOOK, WHEELS_APART_BAD),
        f"The right wheel's radius comes out at {right * 1e3:.1f} mm, the left one's at {left * 1e3:.1f} mm.",
        "Check ticks_per_revolution of both wheels, and the tyres.",
    )


def _nominal(solution: Solution, extraction: Extraction) -> Iterator[Check]:
    nominal, wheels = extraction.rig.nominal.wheels, solution.parameters.wheels
    if nominal is None:
        return
    for name, value, prior in (
        ("right wheel's radius", wheels.radius_right_m, nominal.radius_right_m),
        ("left wheel's radius", wheels.radius_left_m, nominal.radius_left_m),
        ("wheel separation", wheels.separation_m, nominal.separation_m),
    ):
        ratio = value / prior
        yield Check(
            f"{name} against its nominal value",
            f"{value * 1e3:.1f} mm, {100 * (ratio - 1):+.1f} %",
            f"within {100 * NOMINAL_BAD:g} % of {prior * 1e3:.1f} mm",
            graded(abs(ratio - 1), NOMINAL_LOOK, NOMINAL_BAD),
            f"The {name} comes out at {value * 1e3:.1f} mm, {_times(ratio)} the nominal {prior * 1e3:.1f} mm.",
            "Measure the robot with a ruler, and check ticks_per_revolution and whether a diameter stands "
            "for a radius.",
        )


def _times(ratio: float) -> str:
    for factor, words in ((0.5, "about half of"), (2.0, "about twice")):
        if abs(ratio / factor - 1) < 0.1:
            return words
    return f"{ratio:.2f} times"


def _stereo(extraction: Extraction) -> Iterator[Check]:
    px = float(np.median([o.reprojection_px for o in extraction.observations]))
    yield Check(
        "stereo pair against the flat board",
        f"{px:.2f} px (median)",
        f"under {STEREO_BAD_PX:g} px",
        graded(px, STEREO_LOOK_PX, STEREO_BAD_PX),
        f"The two cameras do not agree on a flat board: {px:.2f} px, where 0.3 px is usual.",
        "Calibrate the stereo pair anew (camera_info), and check that the board is flat.",
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
    far = angle_deg > METHODS_ROTATION_DEG or shift_m > METHODS_TRANSLATION_M or wheels > METHODS_WHEELS
    apart_by = f"{angle_deg:.1f} degrees, {shift_m * 1e3:.0f} mm, {100 * wheels:.1f} % of the wheels"
    return Check(
        "linear and refined solution agree",
        f"apart by {apart_by}",
        f"{METHODS_ROTATION_DEG:g} degrees, {METHODS_TRANSLATION_M * 1e3:g} mm, {100 * METHODS_WHEELS:g} %",
        "bad" if far else "good",
        f"Two ways of solving disagree: by {apart_by}.",
        "Check the head's joints for play; then record again with more stops, head movement and turns.",
    )


def _legs(solution: Solution, extraction: Extraction) -> Iterator[Check]:
    residuals, names = solution.residuals, station_names(extraction)
    if len(residuals.legs) < MIN_LEGS_FOR_OUTLIERS:
        return
    scales = (
        (residuals.leg_point_rms_m * 1e3, board_distance_m(extraction) * 1e3, "mm"),
        (residuals.leg_reprojection_px, float(extraction.rig.cameras.left.K[0, 0]), "px"),
    )
    excused = ENCODER_STEPS_EXCUSED * encoder_heading_rad(solution, extraction)
    share_look, share_bad = max(LEG_SHARE_LOOK, excused), max(LEG_SHARE_BAD, excused)
    for errors, scale, unit in scales:
        worst, median = int(np.argmax(errors)), float(np.median(errors))
        first, second = residuals.legs[worst]
        error, share = float(errors[worst]), float(errors[worst]) / scale
        stands_out = error > LEG_OUTLIER * median
        yield Check(
            f"no leg stands out, in {unit}",
            f"worst {error:.1f} {unit}, median {median:.1f} {unit}",
            f"under {LEG_OUTLIER:g} times the median, or under {share_bad * scale:.1f} {unit}",
            graded(share, share_look, share_bad) if stands_out else "good",
            f"Between stations {names[first]} and {names[second]} something moved that should not: corners "
            f"miss by {error:.1f} {unit}, where {median:.1f} {unit} are usual.",
            "Look for a slipping wheel or a board that was touched between these two, and record again.",
        )


def _errors(solution: Solution, extraction: Extraction) -> Iterator[Check]:
    error, distance = solution.point_rms_m, board_distance_m(extraction)
    predicted = predicted_point_rms_m(extraction, solution)
    # What the cameras' own depth noise explains is no fault of the calibration.
    unexplained = float(np.sqrt(max(error**2 - predicted**2, 0.0)))
    yield Check(
        "corners carried from station to station",
        f"{error * 1e3:.1f} mm, {100 * error / distance:.2f} % of the distance "
        f"(depth noise alone: {predicted * 1e3:.1f} mm)",
        f"under {100 * POINT_ERROR_BAD:g} % beyond depth noise",
        graded(unexplained / distance, POINT_ERROR_LOOK, POINT_ERROR_BAD),
        f"Corners carried from one station to the next miss by {error * 1e3:.1f} mm at {distance:.1f} m.",
        "Check that the wheels did not slip, the board stood still and the head's joints and chain are right.",
    )
    focal_px = float(extraction.rig.cameras.left.K[0, 0])
    px = solution.reprojection_rms_px
    yield Check(
        "the same, in the pictures",
        f"{px:.2f} px",
        f"under {PIXEL_ERROR_BAD * focal_px:.1f} px",
        graded(px, np.inf, PIXEL_ERROR_BAD * focal_px),
        f"Corners carried from one station to the next miss by {px:.1f} px in the pictures.",
        "Check that the wheels did not slip, the board stood still and the head's joints and chain are right.",
    )


def _rejected(extraction: Extraction) -> Check:
    looked, used = stations_looked_at(extraction), len(extraction.observations)
    share = 1 - used / looked
    counts = rejection_counts(extraction)
    often = f" most often: {visible(next(iter(counts))[1])}." if counts else ""
    return Check(
        "stations left out",
        f"{looked - used} of {looked}",
        f"under {100 * REJECTED_LOOK:g} %",
        graded(share, REJECTED_LOOK, np.inf),
        f"{looked - used} of {looked} stations were left out;{often}",
        "See the table of rejections for what to improve in the next recording.",
    )
