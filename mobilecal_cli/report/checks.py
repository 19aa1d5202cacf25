"""The criteria of a calibration, in the order of the verdict: a mistake first, then missing data, contradictions and
faults, the noise, and the errors in use. Most limits are wide: they catch faults, not higher noise.

A new criterion is a function with the decorator `criterion`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace

import numpy as np

from mobilecal_cli.kinematics import encoder_steps_rad
from mobilecal_cli.likelihood import nuisance
from mobilecal_cli.model import (
    CAMERA_INFO_CHANGES,
    CONTRADICTION_SIGMAS,
    FACTORS,
    MATERIAL_SIGMAS,
    NINE,
    NO_IMAGES,
    AssumedOdometry,
    Evaluation,
    Extraction,
    FloatArray,
    camera_words,
)
from mobilecal_cli.model.text import visible
from mobilecal_cli.report.criteria import Calibration, Check, Metric, Outcome, criterion, enough, graded
from mobilecal_cli.report.findings import contradiction_sentences
from mobilecal_cli.report.numbers import (
    PARAMETERS,
    odometry_factors,
    plain_names,
    reference_std,
    rejection_counts,
    station_names,
    stations_looked_at,
    std_text,
)
from mobilecal_cli.report.use import (
    FIGURES,
    MOTION,
    below_limits,
    missing_motion,
    next_step_of,
    small_motion,
    uses,
)

#: Nine unknowns need four stations; twice that gives enough redundancy to detect errors.
MIN_STATIONS = 8
#: Stations that show whether a camera is where the description says: its pose has six unknowns.
FEWEST_OF_A_CAMERA = 4
#: Largest point error as a share of the distance, and reprojection error as an angle (depth noise does not affect it).
ERROR_BAD = 0.015
#: Priors that are taken wider by a smaller factor do not show it in two digits.
_SHOWN_WIDER = 1.05
#: Ratios to the nominal values that are the same factor, as wheels can be measured to a few percent only.
_ALIKE = 0.1
#: Largest difference of a wheel's size, in percent, from the other wheel's, from its nominal value, or of a factor of
#: odometry from 1: wrong ticks, gears and diameters make larger ones, a tape measure, tires and load a few percent.
_SIZE_BAD = 25.0


def rms(values: FloatArray) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


#: Figures of an evaluation.
EVALUATED: Mapping[Metric, Callable[[Evaluation], float | None]] = {
    Metric("stations", at_least=True): lambda evaluation: float(evaluation.stations),
    Metric("legs", at_least=True): lambda evaluation: float(len(evaluation.legs)),
    Metric("reprojection_rms_px", "px"): lambda evaluation: rms(evaluation.reprojection_px),
    Metric("rotation_rms_deg", "deg"): lambda evaluation: math.degrees(rms(evaluation.rotation_rad)),
    Metric("translation_rms_mm", "mm"): lambda evaluation: rms(evaluation.translation_m) * 1e3,
    Metric("drift_mm_per_m", "mm/m"): lambda evaluation: evaluation.after.mm_per_m,
    Metric("drift_deg_per_turn", "deg"): lambda evaluation: evaluation.after.deg_per_turn,
}


@criterion(
    Metric("reprojection_rms_px", "px"),
    Metric("point_rms_mm", "mm"),
    Metric("left_out"),
    *(Metric(parameter.gate, parameter.unit) for parameter in PARAMETERS),
    *(Metric(f"std.odometry.{name}", "1") for name in FACTORS),
    *(replace(metric, name=f"hold_out.{metric.name}") for metric in EVALUATED),
)
def figures(made: Calibration) -> Iterator[Check]:
    """Figures that no criterion judges; of a robot with odometry alone, its factors have standard deviations."""
    solution, factors = made.solution, odometry_factors(made.extraction.rig, made.solution)
    yield Check("reprojection_rms_px", solution.reprojection_rms_px)
    yield Check("point_rms_mm", solution.point_rms_m * 1e3)
    yield Check("left_out", float(sum(o.kind != "corners" for o in solution.outliers)))
    for parameter, std in zip(PARAMETERS[: 6 if factors else 9], reference_std(solution), strict=False):
        yield Check(parameter.gate, std)
    for name, (_, std) in factors.items():
        yield Check(f"std.odometry.{name}", std)
    if made.trial is not None:
        for metric, of in EVALUATED.items():
            yield Check(f"hold_out.{metric.name}", of(made.trial))


@criterion(Metric("mistake", "%"), gated=False)
def mistake(made: Calibration) -> Iterator[Check]:
    """The mistake in the robot description that explains a bad fit."""
    diagnosis = made.solution.diagnosis
    if diagnosis is None:
        return
    shares = [None if s is None else 100 * s for s in (diagnosis.error_share, diagnosis.corrected_share)]
    said = ("no solution" if share is None else f"{share:.2g} %" for share in shares)
    yield Check(
        "mistake", shares[0], None, "fail",
        "robot description",
        "{}: point error {} of the distance to the board, {} when corrected".format(diagnosis.cause, *said),
        "no mistake found",
        f"The recording does not fit the robot's description: {diagnosis.cause}.",
        f"{diagnosis.cure[0].upper()}{diagnosis.cure[1:]}.",
    )  # fmt: skip


@criterion(Metric("stations", at_least=True), section="stations")
def stations(made: Calibration) -> Iterator[Check]:
    """Number of stations."""
    have, least = len(made.extraction.observations), MIN_STATIONS
    cameras = made.extraction.rig.cameras
    everywhere = all(view.seen.any() for o in made.extraction.observations for view in o.views)
    where = cameras.images_words if everywhere else "an image"
    notes = made.extraction.notes
    causes = [visible(note) for note in notes if NO_IMAGES in note]
    causes += [visible(f"{note}.") for note in notes if CAMERA_INFO_CHANGES in note]
    for (_, reason), count in rejection_counts(made.extraction).items():
        details = {item.detail for item in made.extraction.rejections if item.reason == reason}
        of = f" ({details.pop()})" if len(details) == 1 else ""
        causes.append(visible(f"Not used, {count} time{'s' * (count != 1)}: {reason}{of}."))
    lost = f" {causes[0]}" if causes else ""
    again = "Remove this cause, and record again" if causes else "Record again"
    yield Check(
        "stations", have, least, enough(have, least),
        f"stations with the board in {where}",
        f"{have:g}",
        f"at least {least:g}",
        f"The board is in {where} at {have:g} stations only (limit {least:g}, recommended 12).{lost}",
        f"{again} with more stops where {cameras.cameras_words} the whole board.",
    )  # fmt: skip


@criterion(Metric("camera", at_least=True), gated=False, section="stations")
def blind_camera(made: Calibration) -> Iterator[Check]:
    """A camera that hardly ever shows the board: nothing tests where it is. A stereo pair without one is none.

    A warning for a pair of which one camera shows the board at less than half as many stations as the other, in a
    recording.
    """
    cameras, observations = made.extraction.rig.cameras, made.extraction.observations
    if not any(o.shown for o in observations):
        return  # measured poses
    log = np.array([o.log for o in observations])
    logs, counts = np.unique(log, return_counts=True)
    shows = np.array([[view.seen.any() for view in o.views] for o in observations])
    of_logs = np.stack([shows[log == number].sum(axis=0) for number in logs])
    for k, name in enumerate(cameras.names):
        have, count, least, where = int(of_logs[:, k].sum()), len(observations), FEWEST_OF_A_CAMERA, ""
        outcome: Outcome = "not_enough" if cameras.calibrated else "warning"
        effect = "nothing tests its pose"
        if cameras.calibrated and have >= least:
            at = int(np.argmin(of_logs[:, k] / of_logs.max(axis=1)))
            have, count, least = int(of_logs[at, k]), int(counts[at]), math.ceil(of_logs[at].max() / 2)
            where = f" of recording {at + 1}" if len(logs) > 1 else ""
            outcome, effect = "warning", "the others count with one camera alone"
        if have >= min(least, count):
            continue
        words = camera_words(name)
        yield Check(
            f"camera.{name}", have, least, outcome,
            f"stations with the board in the {words}'s images",
            f"{have:g} of {count}{where}",
            f"at least {least:g}",
            f"The {words} shows the board at {have:g} of {count} stations{where}: {effect}.",
            f"Check the {words}'s images and record again, or leave the {words} out of cameras in rig.yaml.",
        )  # fmt: skip


@criterion(Metric("legs", at_least=True), section="stations")
def legs(made: Calibration) -> Iterator[Check]:
    """Legs between consecutive stations: a criterion for several recordings."""
    logs, least = len({o.log for o in made.extraction.observations}), MIN_STATIONS - 1
    have = float(len(made.extraction.observations) - logs)
    yield Check(
        "legs", have, least, enough(have, least),
        "legs between consecutive stations" if logs > 1 else "",
        f"{have:g} in {logs} recordings",
        f"at least {least:g}",
        f"The {logs} recordings have only {have:g} legs between consecutive stations (limit {least:g}).",
        "Record again with more stops in each recording.",
    )  # fmt: skip


_JUMPS = {
    "": ("something", "Check the mounts of head, cameras and board, the wheels, and the cables"),
    "head mount": ("the camera on the head", "Fasten the camera to the head"),
    "board": ("the board", "Fasten the board"),
    "right camera": ("the right camera against the left one", "Fasten both cameras to their mount"),
    "right wheel": ("the size of the right wheel", "Check the tire, the load and the encoder of this wheel"),
    "left wheel": ("the size of the left wheel", "Check the tire, the load and the encoder of this wheel"),
}


def _jumps(part: str) -> tuple[str, str]:
    """What a part that changed is called, and what to do about it."""
    joint = visible(part.removeprefix("joint "))
    at_joint = (f"the zero position of {joint}", f"Check the coupling and the encoder of {joint}")
    return _JUMPS.get(part, at_joint)


@criterion(Metric("jump", "sigma"), gated=False, section="stations")
def jump(made: Calibration) -> Iterator[Check]:
    """Moments from which on something is not where it was before, and recordings in which it is elsewhere.

    One that moves the result by more than the limit makes it neither the old nor the new one. One that moves it less
    only warns, unless a noise level is beyond its limit: it is the likeliest cause. A recording that differs makes the
    standard deviations wider, and only warns if all expected errors are within their limits all the same.
    """
    names, limit = station_names(made.extraction), MATERIAL_SIGMAS
    usual = all(check.outcome != "fail" for check in (*height_noise(made), *noise(made)))
    first = {o.log: k for k, o in reversed(list(enumerate(made.extraction.observations)))}
    for change in made.solution.jumps:
        at_s = (change.time_ns - int(made.extraction.wheels[change.log].time_ns[0])) / 1e9
        what, cure = _jumps(change.part)
        parts = [f"{std_text(1e3 * abs(change.move_m))} mm"] if change.move_m else []
        parts += [f"{std_text(math.degrees(change.turn_rad))} degrees"] if change.turn_rad else []
        size = " by " + " and ".join(parts) if parts else ""
        if change.also:
            other, also = _jumps(change.also)
            what, size, cure = f"{what} or {other}", "", f"{cure}. {also}"
        moved = "moved" if change.part in ("head mount", "board", "right camera") else "changed"
        images, wheels = change.rejected
        unused = [f"the images of {images} station{'s' * (images > 1)}"] if images else []
        unused += [f"the wheels on {wheels} leg{'s' * (wheels > 1)}"] if wheels else []
        rest = f" Around this time, {' and '.join(unused)} do not fit the others, and are not used."
        lost = rest if unused else ""
        station = f"station {names[change.station]} ({at_s:.1f} s)"
        small = usual and change.shift_sigmas < limit
        if unused or change.station != first[change.log]:
            when, then, harmless = f"at {station}", "Then record again.", small
        else:
            when = f"between recording {change.log + 1} and the other{'s' if len(first) > 2 else ''}"
            then = "Then record again, or calibrate each recording alone."
            harmless = small or all(use.within for use in uses(made.solution, made.gates))
        if small:
            lost = f" That moves the result by {std_text(change.shift_sigmas)} sigma only."
            then = "Do so before the next recording."
        yield Check(
            "jump", change.shift_sigmas if math.isfinite(change.shift_sigmas) else None, limit,
            "warning" if harmless else "fail",
            "changes inside the recording",
            f"{what} {moved}{size} {when}" if change.part else f"images and wheels do not fit around {station}",
            f"moves the result by at most {limit:g} sigma",
            f"{when[0].upper()}{when[1:]}, {what} {moved}{size}.{lost}",
            f"{cure}. {then}",
        )  # fmt: skip


@criterion(Metric("observable", at_least=True), section="stations")
def observable(made: Calibration) -> Iterator[Check]:
    """Parameters that the recording does not determine, and the motion that would.

    A warning if all expected errors are within their limits all the same.
    """
    uncertainty = made.solution.uncertainty
    if uncertainty is None:
        return
    known = uncertainty.observable | uncertainty.fixed | uncertainty.described
    missing = [name for name, ok in zip(NINE, known, strict=True) if not ok]
    if not missing and uncertainty.described.any():  # no joint tilts the camera: its height is not measured
        shown = int(uncertainty.observable.sum())
        yield Check(
            "observable", shown, shown, "pass",
            "observable parameters",
            f"{shown} of {shown} that the motion of this robot can show",
            f"{shown} of {shown}",
        )  # fmt: skip
    elif not missing:
        yield Check("observable", float(len(known)))
    if not missing:
        return
    between = made.solution.between
    if between is not None and any(between.between_std[NINE.index(name)] for name in missing):
        because = "the recordings differ from one another"
        cure = "Calibrate each recording alone, and check that all are of one robot on which nothing was changed."
    else:
        because, cure = _motion_to_add(made, missing)
    within = all(use.within for use in uses(made.solution, made.gates))
    names = plain_names(missing, made.extraction)
    yield Check(
        "observable", 9 - len(missing), 9, "warning" if within else "not_enough",
        "observable parameters",
        f"{9 - len(missing)} of 9 (not observable: {', '.join(missing)})",
        "9 of 9",
        f"{names[0].upper()}{names[1:]} not determined{f': {because}' if because else ''}.",
        cure,
    )  # fmt: skip


def _motion_to_add(made: Calibration, missing: list[str]) -> tuple[str, str]:
    """Why these parameters are not determined, and what to do."""
    head, base = bool(set(missing) & set(NINE[:6])), bool(set(missing) & set(NINE[6:]))
    constants = made.solution.constants.values()
    free = {c.kind for c in constants if c.prior >= nuisance.FREE * nuisance.kind(c.kind).sigma}
    ignored = sorted(free - ({"square_size"} if made.extraction.board.square_m is None else set()))
    if ignored and not below_limits(made.solution.motion, head, base):
        return (
            f"the stated values of {', '.join(ignored)} are ignored",
            "Use them: leave out --estimate, and free in priors of rig.yaml.",
        )
    lacking, cures = missing_motion(made.solution, missing), []
    if set(missing) & set(NINE[:6]):
        cures.append("tilt the head up and down by 15 degrees or more between stops, and pan it")
    if {"turned_deg", "driven_m"} <= set(lacking):
        cures.append("drive and turn the base between stops")
    elif "turned_deg" in lacking:
        cures.append("turn the base by 20 degrees or more between stops")
    elif "driven_m" in lacking:
        cures.append("drive forward and back by 20 cm or more between stops")
    return " and ".join(lacking.values()), f"Record again and {'; '.join(cures)}."


@criterion(*(Metric(f"motion.{key}", MOTION[key].unit, at_least=True) for key in MOTION), section="stations")
def motion(made: Calibration) -> Iterator[Check]:
    """Motion of head and base: a criterion for methods without standard deviations."""
    for key, value in made.solution.motion.items():
        if key not in MOTION:
            continue
        extent, least = MOTION[key], MOTION[key].least
        yield Check(
            f"motion.{key}", value, least, enough(value, least),
            extent.name if made.solution.uncertainty is None else "",
            f"{value:.1f} {extent.unit}",
            f"at least {least:g} {extent.unit}",
            f"The {extent.name} in the recording is {value:.1f} {extent.unit} only (limit {least:g}).",
            f"Record again and {extent.cure}.",
        )  # fmt: skip


@criterion(Metric("camera_info"), gated=False, section="description")
def camera_info(made: Calibration) -> Iterator[Check]:
    """One calibration of each camera for the whole recording; the estimate uses the first."""
    changes = [note for note in made.extraction.notes if CAMERA_INFO_CHANGES in note]
    if changes:
        yield Check(
            "camera_info", len(changes), 0, "warning",
            "camera_info",
            f"{len(changes)} changes",
            "the same in the whole recording",
            f"{visible(changes[0])}.",
            "Record again with one camera calibration, or state the correct one in rig.yaml.",
        )  # fmt: skip


@criterion(Metric("prior", "sigma"), gated=False, section="description")
def prior(made: Calibration) -> Iterator[Check]:
    """Priors of the user that the data contradict; those that move the result fail."""
    uncertainty = made.solution.uncertainty
    for name, (sigmas, shift) in {} if uncertainty is None else uncertainty.asked.items():
        if sigmas > CONTRADICTION_SIGMAS:
            yield Check(
                f"prior.{name}", sigmas, CONTRADICTION_SIGMAS,
                "fail" if shift > MATERIAL_SIGMAS else "warning",
                f"--prior {name}",
                f"{sigmas:.1f} sigma from the data",
                f"at most {CONTRADICTION_SIGMAS:g} sigma",
                f"The value of --prior {name} is {sigmas:.1f} sigma from what the data show. It changes {name} by "
                f"{shift:.1f} standard deviations.",
                f"Correct --prior {name} (m, rad), or leave it out.",
            )  # fmt: skip


@criterion(Metric("contradiction", "sigma"), gated=False, section="description")
def contradiction(made: Calibration) -> Iterator[Check]:
    """The stated values that the data contradict; those that the result depends on fail, and times beside them."""
    solution = made.solution
    some_fail = any(evidence.shift_sigmas > MATERIAL_SIGMAS for evidence in solution.contradictions)
    widths = solution.uncertainty.noise.wider if solution.uncertainty is not None else {}
    for evidence in solution.contradictions:
        what, cure = contradiction_sentences(evidence, solution, made.extraction)
        wider = widths.get(nuisance.family(evidence.kind), 1.0)
        is_cause = some_fail and nuisance.kind(evidence.kind).unit == "s"
        yield Check(
            f"contradiction.{evidence.kind}.{evidence.part}",
            evidence.sigmas,
            CONTRADICTION_SIGMAS,
            "fail" if evidence.shift_sigmas > MATERIAL_SIGMAS or is_cause else "warning",
            f"robot description: {visible(evidence.part)}, {nuisance.kind(evidence.kind).meaning}",
            f"{evidence.sigmas:.1f} sigma from the stated values",
            f"at most {CONTRADICTION_SIGMAS:g} sigma",
            f"{what} It changes the result by up to {evidence.shift_sigmas:.1f} standard deviations."
            + (f" Priors of this kind are taken {wider:.2g} times as wide." if wider > _SHOWN_WIDER else "")
            + (" Other stated values that differ may follow from it." if is_cause else ""),
            cure,
        )


@criterion(Metric("description", "sigma"), section="description")
def description(made: Calibration) -> Iterator[Check]:
    """The largest evidence against stated values, where none is a contradiction."""
    solution = made.solution
    if solution.uncertainty is not None and not solution.contradictions:
        most = max((evidence.sigmas for evidence in solution.evidence), default=0.0)
        yield Check(
            "description", most, CONTRADICTION_SIGMAS, "pass",
            "robot description",
            f"at most {most:.1f} sigma from the stated values",
            f"at most {CONTRADICTION_SIGMAS:g} sigma",
        )  # fmt: skip


@criterion(Metric("second_solution", at_least=True))
def second_solution(made: Calibration) -> Iterator[Check]:
    """How many times larger the second-best solution's error is; None if there is no second one.

    Two solutions whose errors differ by less than the limit cannot be distinguished. Linear solutions that do not fit,
    for example because of a slip, are not compared: their errors are a large share of the distance to the board.
    """
    limit, fitting_share = 1.5, 0.1
    kept, rival = made.solution.linear.point_rms_m, made.solution.linear.rival_point_rms_m
    ratio = rival / kept if kept > 0 else math.inf
    fits = kept < fitting_share * made.extraction.board_distance_m
    errors = f"point errors {kept * 1e3:.1f} and {rival * 1e3:.1f} mm"
    measured = "all starts converge to one solution"
    if math.isfinite(ratio):
        measured = f"second-best point error {ratio:.1f} times larger"
        if not fits:
            measured = f"not compared: the linear solution has a point error of {kept * 1e3:.0f} mm"
    yield Check(
        "second_solution", ratio if math.isfinite(ratio) else None, limit,
        "pass" if ratio >= limit or not fits else "fail",
        "unique solution",
        measured,
        f"second-best at least {limit:g} times larger",
        f"Two different solutions fit almost equally well: {errors}.",
        "State the nominal wheels in rig.yaml, or record smaller turns between stops.",
    )  # fmt: skip


@criterion(Metric("wheel_difference", "%"))
def wheel_difference(made: Calibration) -> Iterator[Check]:
    """Relative difference between the wheel radii."""
    wheels = made.solution.parameters.wheels
    right, left = wheels.radius_right_m, wheels.radius_left_m
    apart = 100 * (max(right, left) / min(right, left) - 1)
    assumed = made.extraction.rig.sources.assumed_wheels
    sizes = f"right {right:.4f} m, left {left:.4f} m"
    if assumed is not None:
        right, left = right / assumed.radius_right_m, left / assumed.radius_left_m
        sizes = f"right {right:.4f}, left {left:.4f} times those of the driver"
    yield Check(
        "wheel_difference", apart, _SIZE_BAD, graded(apart, _SIZE_BAD),
        "difference between the wheel radii",
        f"{apart:.1f} % ({sizes})",
        f"under {_SIZE_BAD:g} %",
        f"The wheel radii differ by {apart:.1f} %: {sizes}.",
        "Measure both wheels, and check ticks_per_revolution or the gear ratio of each."
        if any(wheel.ticks_per_revolution for wheel in made.extraction.rig.sources.wheels.values())
        else "Measure both wheels, and check the gear ratio and the unit of each wheel's positions.",
    )  # fmt: skip


@criterion(*(Metric(f"nominal.{size}", "%") for size in NINE[6:]))
def nominal(made: Calibration) -> Iterator[Check]:
    """Each size of the wheels against its nominal value."""
    stated, wheels = made.extraction.rig.nominal.wheels, made.solution.parameters.wheels
    sources = made.extraction.rig.sources
    if sources.assumed_odometry is not None:
        yield from _factors(made, sources.assumed_odometry)
        return
    if stated is None:
        return
    ratios = dict(zip(NINE[6:], (wheels.vector / stated.vector).tolist(), strict=True))
    for parameter, found_m, stated_m in zip(PARAMETERS[6:], wheels.vector, stated.vector, strict=True):
        ratio = ratios[parameter.name]
        if sources.several_wheels and parameter.name == "separation":
            yield _effective_separation(found_m, stated_m, ratio)
            continue
        off = 100 * (ratio - 1)
        usual = {"about half of": 0.5, "about twice": 2.0}
        times = next((said for said, r in usual.items() if abs(ratio / r - 1) < _ALIKE), f"{ratio:.2f} times")
        yield Check(
            f"nominal.{parameter.name}", off, _SIZE_BAD, graded(abs(off), _SIZE_BAD),
            f"{parameter.label} against its nominal value",
            f"{found_m:.4f} m, {off:+.1f} %",
            f"within {_SIZE_BAD:g} % of {stated_m:.4f} m",
            f"The {parameter.label} is {found_m:.4f} m, {times} the nominal {stated_m:.4f} m.",
            _nominal_cure(parameter.name, ratios, made.extraction),
        )  # fmt: skip


@criterion(Metric("nominal.scale", "%"), gated=False)
def scale_of_one_camera(made: Calibration) -> Iterator[Check]:
    """Whether all sizes of the wheels differ from the nominal ones alike, where one camera alone measures.

    Its scale is that of the stated squares, which nothing else in the images can contradict.
    """
    bad, apart = 5.0, 3.0
    rig, wheels = made.extraction.rig, made.solution.parameters.wheels.vector
    nominal = rig.sources.assumed_wheels or rig.nominal.wheels
    square_m = made.extraction.board.square_m
    if len(rig.cameras.each) > 1 or nominal is None or square_m is None or made.solution.uncertainty is None:
        return
    off = 100 * (wheels / nominal.vector - 1)
    common = float(np.mean(off)) if np.ptp(off) < apart else 0.0
    yield Check(
        "nominal.scale", common, bad, graded(abs(common), bad),
        "common factor of all sizes of the wheels",
        f"{common:+.1f} %" if common else "none",
        f"within {bad:g} %",
        f"Radii and separation of the wheels all differ by {common:+.1f} % from the nominal ones.",
        f"Measure ten squares with a ruler: with one camera, the size of the squares ({square_m:g} m) gives the scale. "
        "If it is as stated, correct the nominal wheels.",
    )  # fmt: skip


def _nominal_cure(name: str, ratios: Mapping[str, float], extraction: Extraction) -> str:
    """What to correct where a wheel's size is not the nominal one: only what its ratio to it can be."""
    like = [other for other, ratio in ratios.items() if abs(ratio / ratios[name] - 1) < _ALIKE]
    if len(like) == len(ratios):
        return (
            "All sizes of the wheels differ by this factor, so the scale is wrong: check the baseline in camera_info "
            "and board.square_m, then nominal.wheels."
        )
    if name == "separation":
        return "Measure the distance between the contact points of the wheels, and correct nominal.wheels."
    causes = []
    if abs(ratios[name] / 0.5 - 1) < _ALIKE:
        causes.append("that nominal.wheels states radii, not diameters")
    if extraction.rig.sources.wheels["right" if name == "radius_right" else "left"].ticks_per_revolution:
        causes.append("ticks_per_revolution")
    else:
        causes.append("the unit of the wheel positions (rad at the wheel, not at the motor)")
    return f"Measure the wheel with a ruler. If it is as stated, check {', and '.join(causes)}."


#: An effective separation is at least the geometric one, and at most this many times.
_LEAST_EFFECTIVE, _MOST_EFFECTIVE = 0.95, 2.5


def _effective_separation(found_m: float, nominal_m: float, ratio: float) -> Check:
    """Effective over nominal separation of a base that turns with slip."""
    usual = _LEAST_EFFECTIVE <= ratio <= _MOST_EFFECTIVE
    return Check(
        "nominal.separation", 100 * (ratio - 1), 100 * (_MOST_EFFECTIVE - 1), "pass" if usual else "fail",
        "effective wheel separation against the nominal one",
        f"{found_m:.4f} m, {ratio:.2f} times",
        f"{_LEAST_EFFECTIVE:g} to {_MOST_EFFECTIVE:g} times {nominal_m:.4f} m",
        f"The effective wheel separation is {found_m:.4f} m, {ratio:.2f} times the nominal {nominal_m:.4f} m.",
        "Check ticks_per_revolution and the sides of the wheels. The effective separation of a skid-steered base is 1 "
        "to 2.5 times the distance between its wheels.",
    )  # fmt: skip


def _factors(made: Calibration, assumed: AssumedOdometry) -> Iterator[Check]:
    """Factors of odometry against 1. That of the separation is larger on bases that turn with slip."""
    values = assumed.factors(made.solution.parameters.wheels)
    for parameter, name, value in zip(PARAMETERS[6:], FACTORS, values.tolist(), strict=False):
        off = 100 * (value - 1)
        ok = parameter.name == "separation" and 1 <= value <= _MOST_EFFECTIVE
        yield Check(
            f"nominal.{parameter.name}", off, _SIZE_BAD, "pass" if ok else graded(abs(off), _SIZE_BAD),
            f"{name.replace('_', ' ')} against 1",
            f"{value:.4f}, {off:+.1f} %",
            f"within {_SIZE_BAD:g} %",
            f"The {name.replace('_', ' ')} of the odometry on {assumed.topic} is {value:.3f}.",
            "Check the wheel radius and the wheel separation in the driver, and board.square_m in rig.yaml.",
        )  # fmt: skip


@criterion(Metric("stereo_error", "px"), section="description")
def stereo_error(made: Calibration) -> Iterator[Check]:
    """Corners against the flat board: with the cameras as estimated, or as stated where there is no estimate.

    Good camera calibrations give 0.1 to 0.3 px.
    """
    bad = 1.2
    uncertainty = made.solution.uncertainty
    stated = float(np.median([o.reprojection_px for o in made.extraction.observations]))
    px = stated if uncertainty is None else uncertainty.noise.pixel_px
    text, pair = std_text(px), made.extraction.rig.cameras.calibrated
    what = "stereo reprojection error" if pair else "reprojection error"
    yield Check(
        "stereo_error", px, bad, graded(px, bad),
        f"{what} of the board",
        f"{text} px (median)" if uncertainty is None
        else f"{text} px (with camera_info as stated: {std_text(stated)} px)",
        f"under {bad:g} px",
        f"The {what} of the board is {text} px (0.3 px is usual).",
        f"Calibrate the {'stereo pair' if pair else 'cameras'} again (camera_info), and check that the board is flat.",
    )  # fmt: skip


@criterion(Metric("square_size", "%"), section="description")
def square_size(made: Calibration) -> Iterator[Check]:
    """Stated square size against the stereo baseline, for methods that do not estimate both."""
    stated, bad = made.extraction.board.square_m, 3.0
    sizes = [o.square_m for o in made.extraction.observations if o.several]
    pair = made.extraction.rig.cameras.calibrated and sizes
    if made.solution.uncertainty is not None or stated is None or not pair:
        return
    measured = float(np.median(sizes))
    off, stated_mm, measured_mm = 100 * (measured / stated - 1), stated * 1e3, measured * 1e3
    yield Check(
        "square_size", off, bad, graded(abs(off), bad),
        "square size: stereo against stated",
        f"{measured_mm:.2f} mm, {off:+.2f} %",
        f"within {bad:g} % of {stated_mm:.2f} mm",
        f"The stereo pair measures squares of {measured_mm:.2f} mm, but {stated_mm:.2f} mm is stated.",
        "Measure a square with a ruler. If it is as stated, the stereo baseline in camera_info is wrong.",
    )  # fmt: skip


_PLAY = ("joint readings", "the head joints for play, and the head chain in the URDF")
_HEIGHT = Metric("noise.height", "mm")
#: Noise level → the largest usual level, the limit, its name, and what to check.
_NOISE = {
    _HEIGHT: (4.0, 30.0, "floor (height of the base)", "that the floor is flat and that the board does not move"),
    Metric("noise.joint", "degrees"): (0.2, 0.4, *_PLAY),
    Metric("noise.sliding_joint", "mm"): (0.35, 0.7, *_PLAY),
    Metric("noise.wheel", "rad per sqrt(rad)"): (0.015, 0.03, "wheels", "the wheels for slip"),
    Metric("noise.wheel_share", "%"): (
        1.0, 5.0, "wheels in proportion to their rotation", "the wheels for slip, the tires and the load",
    ),
    Metric("noise.floor", "degrees"): (
        0.3, 1.5, "floor (roll and pitch of the base)", "that the floor is flat and that the base does not rock",
    ),
    Metric("noise.stamp", "ms"): (
        2.0, 20.0, "image time stamps", "that images have hardware time stamps, or stop for each image",
    ),
}  # fmt: skip
_OTHER_NOISE = [metric for metric in _NOISE if metric != _HEIGHT]


def _noise_checks(made: Calibration, levels: Iterable[Metric]) -> Iterator[Check]:
    """Noise levels that are not zero; the estimate allows for them, so the limits are wide."""
    uncertainty, chain = made.solution.uncertainty, made.extraction.rig.chain
    if uncertainty is None:
        return
    noise, moving = uncertainty.noise, not all(o.at_rest for o in made.extraction.observations)
    slides = bool(chain.joints) and len(chain.prismatic) == len(chain.joints)
    measured = {
        "noise.height": 1e3 * noise.floor_m,
        "noise.joint": 0.0 if slides else math.degrees(noise.joint_rad),
        "noise.sliding_joint": 1e3 * chain.joint_units[0] * noise.joint_rad if slides else 0.0,
        "noise.wheel": noise.wheel_rad_per_sqrt_rad,
        "noise.wheel_share": 100 * noise.wheel_share,
        "noise.floor": math.degrees(noise.floor_rad),
        "noise.stamp": 1e3 * noise.stamp_s if moving else 0.0,
    }
    for metric in levels:
        (usual, bad, name, cause), level = _NOISE[metric], measured[metric.name]
        text = f"{level:.2g} {metric.unit}"
        yield Check(
            metric.name, level, bad, graded(level, bad),
            f"noise of the {name}" if level else "",
            text,
            f"under {bad:g} {metric.unit}",
            f"The noise of the {name} is {text} (below {usual:g} {metric.unit} is usual).",
            f"Check {cause}. Then record again.",
        )  # fmt: skip


@criterion(_HEIGHT, section="limits")
def height_noise(made: Calibration) -> Iterator[Check]:
    """Noise of the floor's height."""
    yield from _noise_checks(made, [_HEIGHT])


def _at_most(made: Calibration, outcome: Outcome) -> Outcome:
    """A warning instead of a failure where the estimate has its own outlier test and estimates the cameras."""
    return "warning" if outcome == "fail" and made.solution.uncertainty is not None else outcome


@criterion(Metric("leg_outlier.point", "mm"), Metric("leg_outlier.reprojection", "px"), section="stations")
def leg_outlier(made: Calibration) -> Iterator[Check]:
    """The leg with the largest error against the median leg, of five legs or more.

    Errors of consistent legs are distributed like |x| of a normal x: the largest of 11 is about 3 times the median, the
    largest of 1000 about 5 times. Short legs have small errors, so an outlier must also be large in absolute terms: as
    a share of the distance, in mm or in the image. With coarse encoders, that is more than an error of one step on both
    wheels, with a margin for the joints.
    """
    least_legs, times, bad, encoder_steps = 5, 5.0, 0.01, 1.5
    residuals, names = made.solution.residuals, station_names(made.extraction)
    if len(residuals.legs) < least_legs:
        return
    wheels = made.solution.parameters.wheels
    right_rad, left_rad = encoder_steps_rad(made.extraction.wheels).tolist()
    step_rad = (wheels.radius_right_m * right_rad + wheels.radius_left_m * left_rad) / wheels.separation_m
    bad = max(bad, encoder_steps * step_rad)
    for kind, unit, errors, scale in (
        ("point", "mm", residuals.leg_point_rms_m * 1e3, made.extraction.board_distance_m * 1e3),
        ("reprojection", "px", residuals.leg_reprojection_px, float(made.solution.cameras.first.K[0, 0])),
    ):
        worst, median = int(np.argmax(errors)), float(np.median(errors))
        first, second = (names[end] for end in residuals.legs[worst])
        error, limit = float(errors[worst]), bad * scale
        far = error > times * median
        yield Check(
            f"leg_outlier.{kind}", error, limit,
            _at_most(made, graded(error / scale, bad)) if far else "pass",
            f"largest {kind} error of a leg",
            f"{error:.1f} {unit} (median {median:.1f} {unit})",
            f"under {times:g} times the median, or under {limit:.1f} {unit}",
            f"The {kind} error between stations {first} and {second} is {error:.1f} {unit} "
            f"(median {median:.1f} {unit}).",
            "Check for wheel slip and for a moved board between these stations, and record again.",
        )  # fmt: skip


#: Largest part of the error → what to check; "" where the parts are unknown.
_ERROR_CURES = {
    "": "Calibrate with --method ml (the default), which names the cause.",
    "corners": "Calibrate the stereo pair again, and check that the board is flat.",
    "joints": "Check the head joints for play, and the head chain in the URDF.",
    "floor": "Record on a flat floor, and check that the base does not rock.",
    "wheels": "Check the wheels for slip, and the board for a move, on the leg with the largest error.",
}


@criterion(Metric("point_error", "%"), Metric("reprojection_error", "px"), section="stations")
def errors(made: Calibration) -> Iterator[Check]:
    """Point error and reprojection error, without what is no error of the calibration.

    That is the depth noise of the cameras, and what joints, floor and wheels cause at their noise levels, which have
    limits of their own; all within three standard deviations of their own mean squares. Point error: encoders with 300
    steps per turn (as in the paper) give about 0.5 % of the distance. 1.5 % is 0.9 degrees of heading, more than a
    wheel without slip loses on one leg.
    """
    solution, bad, sigmas = made.solution, 100 * ERROR_BAD, 3.0
    if not len(solution.residuals.legs):
        return
    error, distance = solution.point_rms_m, made.extraction.board_distance_m
    predicted, every = solution.residuals.corner_noise_m, solution.error_parts
    parts = [part for name, part in every.items() if name != "corners"]
    legs = len(solution.residuals.legs)
    of_corners, of_legs = (
        1 + sigmas * math.sqrt(2 / n) for n in (legs * len(made.extraction.board.grid()), legs)
    )
    explained = predicted**2 * of_corners + sum(part.m**2 for part in parts) * of_legs
    unexplained = 100 * math.sqrt(max(error**2 - explained, 0.0)) / distance
    error_mm, depth = error * 1e3, f"(depth noise alone: {predicted * 1e3:.1f} mm)"
    cause = max(every, key=lambda name: every[name].px, default="")
    cure = _ERROR_CURES[cause]
    of_px = f" The {cause} contribute {std_text(every[cause].px)} px of it." if cause else ""
    yield Check(
        "point_error", unexplained, bad, graded(unexplained, bad),
        "point error",
        f"{error_mm:.1f} mm, {0.1 * error_mm / distance:.2f} % of the distance {depth}",
        f"under {bad:g} % without depth noise and uneven floor",
        f"The point error is {error_mm:.1f} mm at {distance:.1f} m {depth}.",
        cure,
    )  # fmt: skip
    error_px, limit = solution.reprojection_rms_px, ERROR_BAD * float(solution.cameras.first.K[0, 0])
    px = math.sqrt(max(error_px**2 - sum(part.px**2 for part in parts) * of_legs, 0.0))
    yield Check(
        "reprojection_error", px, limit, graded(px, limit),
        "reprojection error",
        f"{error_px:.2f} px",
        f"under {limit:.1f} px",
        f"The reprojection error is {error_px:.1f} px (limit {limit:.1f} px).{of_px}",
        cure,
    )  # fmt: skip


@criterion(Metric("methods"))
def methods(made: Calibration) -> Iterator[Check]:
    """Difference between the linear and the refined solution; in shares of its limits, the largest.

    The linear method alone has errors up to 2 degrees, 60 mm and 5 % of the wheels. It knows no fixed values, and
    unobservable ones only roughly. It uses outliers too: where there are any, a large difference says nothing.
    """
    limits = (6.0, 200.0, 15.0)
    linear, refined = made.solution.linear.parameters, made.solution.parameters
    if made.solution.refinement is None:
        return
    step = refined.minus(linear)
    apart = [
        float(np.degrees(np.linalg.norm(step[:3]))),
        1e3 * float(np.linalg.norm(step[3:6])),
        100 * float(np.abs(linear.wheels.vector / refined.wheels.vector - 1).max()),
    ]
    if made.solution.uncertainty is not None:
        known = [bool(part.all()) for part in made.solution.uncertainty.observable.reshape(3, 3)]
        apart = [value if ok else 0.0 for value, ok in zip(apart, known, strict=True)]
    largest = max(value / limit for value, limit in zip(apart, limits, strict=True))
    if largest > 1 and any(outlier.kind != "corners" for outlier in made.solution.outliers):
        return
    text = "{:.1f} degrees, {:.0f} mm and {:.1f} % of the wheels".format(*apart)
    yield Check(
        "methods", largest, 1.0, _at_most(made, "fail") if largest > 1 else "pass",
        "linear against refined solution",
        f"differ by {text}",
        "under {:g} degrees, {:g} mm and {:g} %".format(*limits),
        f"The linear and the refined solution differ by {text}.",
        "Check the head joints for play. Then record again with more stops, head motion and turns.",
    )  # fmt: skip


@criterion(Metric("outliers", "%"), section="stations")
def outliers(made: Calibration) -> Iterator[Check]:
    """Outliers; the limit is the share that a robust estimate tolerates."""
    if made.solution.uncertainty is None:
        return
    bad, count = 30.0, len(made.extraction.observations)
    gross = [outlier for outlier in made.solution.outliers if outlier.kind != "corners"]
    share = 100 * len(gross) / max(1, count)
    further = f" Further outliers: {len(gross) - 1}." if len(gross) > 1 else ""
    yield Check(
        "outliers", share, bad, "fail" if share > bad else "warning" if gross else "pass",
        "outliers",
        f"{len(gross)} in {count} stations and the legs between them",
        f"under {bad:g} %",
        f"{gross[0].text}{further}" if gross else "",
        "Find the cause. The result uses the remaining measurements.",
    )  # fmt: skip


@criterion(Metric("outliers_as_noise"), gated=False, section="stations")
def outliers_as_noise(made: Calibration) -> Iterator[Check]:
    """Kinds of measurements with so many outliers that they are noise."""
    kinds = made.solution.noisy
    names = {"views": "stations' images", "legs": "legs' wheel rotations", "readings": "joint readings"}
    if made.solution.uncertainty is not None and kinds:
        yield Check(
            "outliers_as_noise", len(kinds), 0, "warning",
            "outliers that are noise",
            ", ".join(kinds),
            "none",
            f"More than a third of the {' and of the '.join(names[kind] for kind in kinds)} differ from the rest: "
            "their noise is larger than usual. All of them are used, with the noise level that fits them.",
            "See the noise levels in the report.",
        )  # fmt: skip


@criterion(*_OTHER_NOISE, section="limits")
def noise(made: Calibration) -> Iterator[Check]:
    """Noise of joints (in mm for a head that only slides), wheels, floor, and time stamps where the robot moves."""
    yield from _noise_checks(made, _OTHER_NOISE)


@criterion(*(Metric(figure.name, figure.unit) for figure in FIGURES), section="limits")
def expected_errors(made: Calibration) -> Iterator[Check]:
    """Whether each expected error in use is within its limit; the least certain first."""
    if made.solution.uncertainty is not None:
        yield from (Check(figure.name, figure.of(made.solution.uncertainty.at_work)) for figure in FIGURES)
    for use in sorted(uses(made.solution, made.gates), key=lambda use: -use.share):
        figure = use.figure
        value = f"{std_text(use.value)} {figure.unit}" if use.value else "fixed by the user"
        yield Check(
            figure.name, use.value, use.limit, "pass" if use.within else "not_enough",
            f"expected error: {figure.meaning}",
            value,
            f"at most {use.limit:g} {figure.unit}",
            f"The expected error (1 sigma) of the {figure.meaning} is {value} (limit {use.limit:g} {figure.unit}). "
            f"{use.limiting}",
            " ".join(small_motion(made.solution, figure))
            or next_step_of(use, made.solution, made.extraction),
        )  # fmt: skip


@criterion(Metric("rejected", "%"), section="stations")
def rejected(made: Calibration) -> Iterator[Check]:
    """Share of rejected stations."""
    look, detected, used = 50.0, stations_looked_at(made.extraction), len(made.extraction.observations)
    share, counts = 100 * (1 - used / detected), rejection_counts(made.extraction)
    often, lost = next(iter(counts))[1] if counts else "", f"{detected - used} of {detected}"
    yield Check(
        "rejected", share, look, "warning" if share > look else "pass",
        "rejected stations",
        lost,
        f"under {look:g} %",
        f"{lost} stations were rejected{f' (most often: {visible(often)})' if often else ''}.",
        "Open the stations in the report, remove the cause, and record again.",
    )  # fmt: skip


@criterion(Metric("change", "%", at_least=True), section="limits")
def change(made: Calibration) -> Iterator[Check]:
    """Whether the robot is unchanged since the last calibration.

    The limit is how often an unchanged robot shows a change this large.
    """
    difference, unlikely = made.change, 1e-4
    if difference is None or difference.p_value is None:
        return
    worst, limit = int(np.argmax(np.abs(np.nan_to_num(difference.sigmas)))), 100 * unlikely
    moved = f"{NINE[worst]} by {float(difference.sigmas[worst]):+.1f} sigma"
    yield Check(
        "change", 100 * difference.p_value, limit, "warning" if difference.p_value < unlikely else "pass",
        "change since the last calibration",
        f"largest: {moved}",
        f"probability by chance at least {limit:g} %",
        f"The robot has changed since {visible(difference.against)}: {moved}.",
        "Check for a loose camera and worn tires. If you find no cause, record and calibrate again.",
    )  # fmt: skip
