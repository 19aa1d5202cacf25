"""The sentences of the criteria on a calibration."""

from __future__ import annotations

import math
from collections.abc import Callable

from mobilecal_cli.model.text import visible
from mobilecal_cli.report.check import Check
from mobilecal_cli.report.parameters import std_text
from mobilecal_cli.report.wording.contradictions import contradiction_words
from mobilecal_cli.report.wording.use import MOTION, use_words
from mobilecal_cli.report.wording.words import Words, part

_SLIP = "Check for wheel slip, a moved board, and errors in the head joints or their URDF."
_NOISE = {
    "joint": ("joint readings", "the head joints for play, and the head chain in the URDF"),
    "sliding_joint": ("joint readings", "the head joints for play, and the head chain in the URDF"),
    "wheel": ("wheels", "the wheels for slip"),
    "wheel_share": ("wheels in proportion to their rotation", "the wheels for slip, the tires and the load"),
    "floor": ("floor (roll and pitch of the base)", "that the floor is flat and that the base does not rock"),
    "height": ("floor (height of the base)", "that the floor is flat and that the board does not move"),
    "stamp": ("image time stamps", "that images have hardware time stamps, or stop for each image"),
}
_NOISY = {"views": "stations' images", "legs": "legs' wheel rotations", "readings": "joint readings"}


def _stations(c: Check) -> Words:
    return Words(
        "stations with the board in both images",
        f"{c.value:g}",
        f"at least {c.limit:g}",
        f"The board is in both images at {c.value:g} stations only (limit {c.limit:g}, recommended 12).",
        "Record again with more stops where both cameras see the whole board.",
    )


def _legs(c: Check) -> Words:
    logs = c.facts["logs"]
    return Words(
        "legs between consecutive stations",
        f"{c.value:g} in {logs} recordings",
        f"at least {c.limit:g}",
        f"The {logs} recordings have only {c.value:g} legs between consecutive stations (limit {c.limit:g}).",
        "Record again with more stops in each recording.",
    )


def _mistake(c: Check) -> Words:
    cause, cure = c.facts["cause"], c.facts["cure"]
    before, after = (
        "no solution" if share is None else f"{share:.2g} %" for share in (c.value, c.facts["corrected"])
    )
    return Words(
        "robot description",
        f"{cause}: point error {before} of the distance to the board, {after} when corrected",
        "no mistake found",
        f"The recording does not fit the robot's description: {cause}.",
        f"{cure[0].upper()}{cure[1:]}.",
    )


def _motion(c: Check) -> Words:
    name, more = MOTION[part(c)]
    return Words(
        name,
        f"{c.value:.1f} {c.unit}",
        f"at least {c.limit:g} {c.unit}",
        f"The {name} in the recording is {c.value:.1f} {c.unit} only (limit {c.limit:g}).",
        f"Record again and {more}.",
    )


def _observable(c: Check) -> Words:
    hidden, cures = ", ".join(c.facts["unobservable"]), c.facts["cures"]
    return Words(
        "observable parameters",
        f"{c.value:g} of 9" + (f" (not observable: {hidden})" if hidden else ""),
        "9 of 9",
        f"The recording does not determine {hidden}. The nominal value is kept, with its own uncertainty.",
        f"Record again and {'; '.join(cures)}.",
    )


def _camera_info(c: Check) -> Words:
    return Words(
        "camera_info",
        f"{c.value:g} changes",
        "the same in the whole recording",
        f"{visible(c.facts['note'])}.",
        "Record again with one camera calibration, or state the correct one in rig.yaml.",
    )


def _description(c: Check) -> Words:
    return Words(
        "robot description",
        f"at most {c.value:.1f} sigma from the stated values",
        f"at most {c.limit:g} sigma",
    )


def _second_solution(c: Check) -> Words:
    kept_mm, rival_mm = c.facts["kept_mm"], c.facts["rival_mm"]
    return Words(
        "unique solution",
        "all starts converge to one solution"
        if c.value is None
        else f"second-best point error {c.value:.1f} times larger"
        if c.facts["fits"]
        else f"not compared: the linear solution has a point error of {kept_mm:.0f} mm",
        f"second-best at least {c.limit:g} times larger",
        ""
        if rival_mm is None
        else f"Two different solutions fit almost equally well: point errors {kept_mm:.1f} and {rival_mm:.1f} mm.",
        "State the nominal wheels in rig.yaml, or record smaller turns between stops.",
    )


def _wheel_difference(c: Check) -> Words:
    sizes = f"right {c.facts['right_mm']:.1f} mm, left {c.facts['left_mm']:.1f} mm"
    return Words(
        "difference between the wheel radii",
        f"{c.value:.1f} % ({sizes})",
        f"under {c.limit:g} %",
        f"The wheel radii differ by {c.value:.1f} %: {sizes}.",
        "Check ticks_per_revolution of both wheels, and the tires.",
    )


def _nominal(c: Check) -> Words:
    name = {"radius_right": "right wheel radius", "radius_left": "left wheel radius"}.get(
        part(c), "wheel separation"
    )
    size_mm, nominal_mm = c.facts["mm"], c.facts["nominal_mm"]
    return Words(
        f"{name} against its nominal value",
        f"{size_mm:.1f} mm, {c.value:+.1f} %",
        f"within {c.limit:g} % of {nominal_mm:.1f} mm",
        f"The {name} is {size_mm:.1f} mm, {_times(size_mm / nominal_mm)} the nominal {nominal_mm:.1f} mm.",
        "Measure the robot with a ruler. Check ticks_per_revolution, and that a diameter was not entered as the "
        "radius.",
    )


def _times(ratio: float) -> str:
    for factor, said in ((0.5, "about half of"), (2.0, "about twice")):
        if abs(ratio / factor - 1) < 0.1:
            return said
    return f"{ratio:.2f} times"


def _stereo_error(c: Check) -> Words:
    px, stated = std_text(c.value or 0.0), std_text(c.facts["stated_px"])
    return Words(
        "stereo reprojection error of the board",
        f"{px} px (median)"
        if c.facts["cameras"] == "stated"
        else f"{px} px (with camera_info as stated: {stated} px)",
        f"under {c.limit:g} px",
        f"The stereo reprojection error of the board is {px} px (0.3 px is usual).",
        "Calibrate the stereo pair again (camera_info), and check that the board is flat.",
    )


def _square_size(c: Check) -> Words:
    seen_mm, stated_mm = c.facts["seen_mm"], c.facts["stated_mm"]
    return Words(
        "square size: stereo against stated",
        f"{seen_mm:.2f} mm, {c.value:+.2f} %",
        f"within {c.limit:g} % of {stated_mm:.2f} mm",
        f"The stereo pair measures squares of {seen_mm:.2f} mm, but {stated_mm:.2f} mm is stated.",
        "Measure a square with a ruler. If it is as stated, the stereo baseline in camera_info is wrong.",
    )


def _leg_outlier(c: Check) -> Words:
    kind = "point" if part(c) == "point" else "reprojection"
    factor, median = c.facts["times_median"], c.facts["median"]
    return Words(
        f"largest {kind} error of a leg",
        f"{c.value:.1f} {c.unit} (median {median:.1f} {c.unit})",
        f"under {factor:g} times the median, or under {c.limit:.1f} {c.unit}",
        f"The {kind} error between stations {c.facts['from']} and {c.facts['to']} is {c.value:.1f} {c.unit} "
        f"(median {median:.1f} {c.unit}).",
        "Check for wheel slip and for a moved board between these stations, and record again.",
    )


def _point_error(c: Check) -> Words:
    error_mm, depth_mm, distance_m = c.facts["error_mm"], c.facts["depth_noise_mm"], c.facts["distance_m"]
    return Words(
        "point error",
        f"{error_mm:.1f} mm, {0.1 * error_mm / distance_m:.2f} % of the distance "
        f"(depth noise alone: {depth_mm:.1f} mm)",
        f"under {c.limit:g} % without depth noise and uneven floor",
        f"The point error is {error_mm:.1f} mm at {distance_m:.1f} m (depth noise alone: {depth_mm:.1f} mm).",
        _SLIP,
    )


def _reprojection_error(c: Check) -> Words:
    px = c.facts["error_px"]
    return Words(
        "reprojection error",
        f"{px:.2f} px",
        f"under {c.limit:.1f} px",
        f"The reprojection error is {px:.1f} px (limit {c.limit:.1f} px).",
        _SLIP,
    )


def _methods(c: Check) -> Words:
    f = c.facts
    apart = (
        f"{f['angle_deg']:.1f} degrees, {f['shift_mm']:.0f} mm and {f['wheels_percent']:.1f} % of the wheels"
    )
    limits = f["limits"]
    return Words(
        "linear against refined solution",
        f"differ by {apart}",
        f"under {limits[0]:g} degrees, {limits[1]:g} mm and {limits[2]:g} %",
        f"The linear and the refined solution differ by {apart}.",
        "Check the head joints for play. Then record again with more stops, head motion and turns.",
    )


def _outliers(c: Check) -> Words:
    count, first = c.facts["count"], c.facts["first"]
    return Words(
        "outliers",
        f"{count} in {c.facts['stations']} stations and the legs between them",
        f"under {c.limit:g} %",
        first + (f" Further outliers: {count - 1}." if count > 1 else ""),
        "Find the cause. The result uses the remaining measurements.",
    )


def _outliers_as_noise(c: Check) -> Words:
    kinds = c.facts["kinds"]
    return Words(
        "outliers that are noise",
        ", ".join(kinds),
        "none",
        f"More than a third of the {' and of the '.join(_NOISY[kind] for kind in kinds)} differ from the rest: their "
        "noise is larger than usual. All of them are used, with the noise level that fits them.",
        "See the noise levels in the report.",
    )


def _noise(c: Check) -> Words:
    name, cause = _NOISE[part(c)]
    return Words(
        f"noise of the {name}",
        f"{c.value:.2g} {c.unit}",
        f"under {c.limit:g} {c.unit}",
        f"The noise of the {name} is {c.value:.2g} {c.unit} (below {c.facts['usual']:g} {c.unit} is usual).",
        f"Check {cause}. Then record again.",
    )


_JUMPS = {
    "": ("something", "Check the mounts of head, cameras and board, and the cables"),
    "head mount": ("the camera on the head", "Fasten the camera to the head"),
    "board": ("the board", "Fasten the board"),
    "right camera": ("the right camera against the left one", "Fasten both cameras to their mount"),
    "right wheel": ("the size of the right wheel", "Check the tire, the load and the encoder of this wheel"),
    "left wheel": ("the size of the left wheel", "Check the tire, the load and the encoder of this wheel"),
}


def _jump(c: Check) -> Words:
    jump, since = c.facts["jump"], f"station {c.facts['station']} ({c.facts['at_s']:.1f} s)"
    joint = visible(jump.part.removeprefix("joint "))
    what, cure = _JUMPS.get(
        jump.part, (f"the zero position of {joint}", f"Check the coupling and the encoder of {joint}")
    )
    parts = [f"{1e3 * abs(jump.move_m):.2g} mm"] if jump.move_m else []
    parts += [f"{math.degrees(jump.turn_rad):.2g} degrees"] if jump.turn_rad else []
    size = " by " + " and ".join(parts) if parts else ""
    moved = "moved" if jump.part in ("", "head mount", "board", "right camera") else "changed"
    lost = f"The images of {jump.rejected} stations are not used, because they do not fit those before."
    return Words(
        "changes inside the recording",
        f"{what} {moved}{size} at {since}" if jump.part else f"the images do not fit from {since} on",
        f"moves the result by at most {c.limit:g} sigma",
        f"At {since}, {what} {moved}{size}. {lost if jump.rejected else ''}".rstrip(),
        f"{cure}. Then record again.",
    )


def _rejected(c: Check) -> Words:
    lost, often = f"{c.facts['rejected']} of {c.facts['found']}", c.facts["often"]
    return Words(
        "rejected stations",
        lost,
        f"under {c.limit:g} %",
        f"{lost} stations were rejected{f' (most often: {visible(often)})' if often else ''}.",
        "See the table of rejections in the report, and improve the next recording.",
    )


def _change(c: Check) -> Words:
    moved = f"{c.facts['parameter']} by {c.facts['sigmas']:+.1f} sigma"
    return Words(
        "change since the last calibration",
        f"largest: {moved}",
        f"probability by chance at least {c.limit:g} %",
        f"The robot has changed since {visible(c.facts['against'])}: {moved}.",
        "Check for a loose camera and worn tires. If you find no cause, record and calibrate again.",
    )


def _gate(c: Check) -> Words:
    assert c.limit is not None
    name, measured = part(c), "unknown" if c.value is None else _rounded(c.value, c.limit)
    return Words(
        f"gate {name}",
        measured,
        f"at {'least' if c.at_least else 'most'} {c.limit:g}",
        f"Gate failed: {name} = {measured} (limit {c.limit:g}).",
        "See the report for the cause. `mobilecal suggest` lists stops that improve the result.",
    )


def _rounded(value: float, limit: float) -> str:
    """A value with three digits, or more where three equal the limit."""
    for digits in (3, 6, 9):
        text = f"{value:.{max(digits, len(str(int(abs(value)))))}g}"
        if float(text) != limit or value == limit:
            break
    return text


WORDS: dict[str, Callable[[Check], Words]] = {
    "stations": _stations,
    "legs": _legs,
    "mistake": _mistake,
    "motion": _motion,
    "observable": _observable,
    "camera_info": _camera_info,
    "contradiction": contradiction_words,
    "description": _description,
    "second_solution": _second_solution,
    "wheel_difference": _wheel_difference,
    "nominal": _nominal,
    "stereo_error": _stereo_error,
    "square_size": _square_size,
    "leg_outlier": _leg_outlier,
    "point_error": _point_error,
    "reprojection_error": _reprojection_error,
    "methods": _methods,
    "outliers": _outliers,
    "outliers_as_noise": _outliers_as_noise,
    "noise": _noise,
    "jump": _jump,
    "predicted": use_words,
    "rejected": _rejected,
    "change": _change,
    "gate": _gate,
}
