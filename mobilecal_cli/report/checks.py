"""The criteria of a calibration, in the order of the verdict: a mistake first, then missing data, contradictions and
faults, the noise, and the errors in use. Most limits are wide: they catch faults, not higher noise.

A new criterion is a function with the decorator `criterion`.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.kinematics import encoder_steps_rad
from mobilecal_cli.likelihood import jumps
from mobilecal_cli.likelihood.constants import ASSUMED, NINE_SIGMAS, family, kind_of
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.calibration import NINE
from mobilecal_cli.model.findings import CONTRADICTION_SIGMAS, MATERIAL_SIGMAS, STAMP_NOISE_S, WHEEL_NOISE
from mobilecal_cli.model.observations import Extraction
from mobilecal_cli.model.rig import FACTORS, camera_words
from mobilecal_cli.model.signals import (
    CAMERA_INFO_CHANGES,
    CHAIN_ENDS,
    CHAIN_LACKS,
    CLOCK_STEPS,
    NO_IMAGES,
    TURNS_AT_REST,
    UNUSED,
)
from mobilecal_cli.model.solution import ErrorPart, Evaluation, Solution, largest_mean_square
from mobilecal_cli.model.text import capitalized, visible
from mobilecal_cli.report.criteria import CHANGED, Case, Check, Metric, Outcome, criterion
from mobilecal_cli.report.findings import ERROR_PARTS, contradiction_sentences
from mobilecal_cli.report.motion import MOTION, missing_motion, motion_cure, nearer, small_motion
from mobilecal_cli.report.numbers import (
    PARAMETERS,
    odometry_factors,
    percent_text,
    plain_names,
    reference_std,
    rejection_counts,
    station_names,
    stations_looked_at,
    std_text,
)
from mobilecal_cli.report.use import FIGURES, freed_kinds, next_step_of, uses

#: Nine unknowns need four stations; twice that gives enough redundancy to detect errors.
MIN_STATIONS = 8
#: Stations that show whether a camera is where the description says: its pose has six unknowns.
FEWEST_OF_A_CAMERA = 4
#: Largest point error as a share of the distance, and reprojection error as an angle.
ERROR_BAD = 0.015
#: Priors that are taken wider by a smaller factor do not show it in two digits.
_SHOWN_WIDER = 1.05
#: Ratios to the nominal values that are the same factor, as wheels can be measured to a few percent only.
_ALIKE = 0.1
#: Largest difference of a wheel's size, in percent, from the other wheel's, from its nominal value, or of a factor of
#: odometry from 1: wrong ticks, gears and diameters make larger ones, a tape measure, tires and load a few percent.
_SIZE_BAD = 25.0
#: Percent by which radii and separation are all off to one side with one camera: seldom by chance, and too much.
_NOTICED, _TOO_MUCH = 1.5, 5.0
#: Largest share of outliers, in percent: what a robust estimate tolerates.
_MOST_OUTLIERS = 30.0


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
    *(Metric(f"hold_out.{each.name}", each.unit, each.at_least) for each in EVALUATED),
)
def figures(case: Case, *metrics: Metric) -> Iterator[Check]:
    """Figures that no criterion judges; of a robot with odometry alone, its factors have standard deviations."""
    solution, factors = case.solution, odometry_factors(case.extraction.rig, case.solution)
    shown = PARAMETERS[: 6 if factors else 9]
    values: dict[str, float | None] = {
        "reprojection_rms_px": solution.reprojection_rms_px,
        "point_rms_mm": solution.point_rms_m * 1e3,
        "left_out": float(len(solution.gross_outliers)),
        **{p.gate: std for p, std in zip(shown, reference_std(solution), strict=False)},
        **{f"std.odometry.{name}": std for name, (_, std) in factors.items()},
    }
    if case.trial is not None:
        values |= {f"hold_out.{metric.name}": of(case.trial) for metric, of in EVALUATED.items()}
    return (metric.check(values[metric.name]) for metric in metrics if metric.name in values)


@criterion(Metric("mistake", "%"), gated=False)
def mistake(case: Case, metric: Metric) -> Iterator[Check]:
    """The mistake in the robot description that explains a bad fit."""
    diagnosis = case.solution.diagnosis
    if diagnosis is None:
        return
    shares = [None if s is None else 100 * s for s in (diagnosis.error_share, diagnosis.corrected_share)]
    said = ("no solution" if share is None else f"{share:.2g} %" for share in shares)
    yield metric.check(
        shares[0], None, "robot description", f"{capitalized(diagnosis.cure)}.",
        measured="{}: point error {} of the distance to the board, {} when corrected".format(diagnosis.cause, *said),
        at_limit="no mistake found",
        why=f"The recording does not fit the robot's description: {diagnosis.cause}.",
    )  # fmt: skip


@criterion(Metric("stations", at_least=True, section="stations"))
def stations(case: Case, metric: Metric) -> Iterator[Check]:
    """Number of stations."""
    have, cameras = len(case.extraction.observations), case.extraction.rig.cameras
    everywhere = all(view.seen.any() for o in case.extraction.observations for view in o.views)
    where = cameras.images_words if everywhere else "an image"
    shown = f"The board is in {where}"
    name, show = f"stations with the board in {where}", f"where {cameras.cameras_words} the whole board"
    if case.extraction.measured:
        name, shown, show = (
            "stations with a measured pose",
            "The target's pose is measured",
            "and a pose at each",
        )
    notes = case.extraction.notes
    causes = [visible(note) for note in notes if NO_IMAGES in note]
    causes += [visible(f"{note}.") for note in notes if CAMERA_INFO_CHANGES in note]
    for (stage, reason), count in rejection_counts(case.extraction).items():
        items = [item for item in case.extraction.rejections if item.reason == reason]
        what = "time" if items[0].station < 0 else "station"
        if what == "time" and stage == "readers":
            continue  # one image of several: a station without any is an item of its own
        details = {item.detail for item in items}
        of = f" ({details.pop()})" if len(details) == 1 else ""
        causes.append(visible(f"Not used, {count} {what}{'s' * (count != 1)}: {reason}{of}."))
    lost = f" {causes[0]}" if causes else ""
    again = "Remove this cause, and record again" if causes else "Record again"
    closer = capitalized(nearer(case.extraction))
    yield metric.check(
        have, MIN_STATIONS, name, f"{closer or f'{again} with more stops {show}'}.",
        why=f"{shown} at {have} stations only (limit {MIN_STATIONS}, recommended 12).{lost}",
    )  # fmt: skip


@criterion(Metric("camera", at_least=True, section="stations"), gated=False)
def blind_camera(case: Case, metric: Metric) -> Iterator[Check]:
    """A camera that hardly ever shows the board: nothing tests where it is. A stereo pair without one is none.

    A warning for a pair of which one camera shows the board at less than half as many stations as the other.
    """
    cameras, observations = case.extraction.rig.cameras, case.extraction.observations
    if case.extraction.measured:
        return
    count, shows = len(observations), np.array([[view.seen.any() for view in o.views] for o in observations])
    for name, have in zip(cameras.names, shows.sum(axis=0).tolist(), strict=True):
        words, least, effect = camera_words(name), FEWEST_OF_A_CAMERA, "nothing tests its pose"
        outcome: Outcome = "not_enough" if cameras.calibrated else "warning"
        if cameras.calibrated and have >= least:
            least, outcome = math.ceil(shows.sum(axis=0).max() / 2), "warning"
            effect = "the others count with one camera alone"
        if have >= min(least, count):
            continue
        yield metric.check(
            have, least, f"stations with the board in the {words}'s images",
            f"Check the {words}'s images and record again, or leave the {words} out of cameras in rig.yaml.",
            part=name,
            measured=f"{have} of {count}",
            why=f"The {words} shows the board at {have} of {count} stations: {effect}.",
            beyond=outcome,
        )  # fmt: skip


@criterion(Metric("legs", at_least=True, section="stations"))
def legs(case: Case, metric: Metric) -> Iterator[Check]:
    """Legs between consecutive stations: a criterion for several recordings."""
    logs = len({o.log for o in case.extraction.observations})
    have = len(case.extraction.observations) - logs
    yield metric.check(
        float(have), MIN_STATIONS - 1, "legs between consecutive stations" if logs > 1 else "",
        "Record again with more stops in each recording.",
        measured=f"{have} in {logs} recordings",
        why=f"The {logs} recordings have only {have} legs between consecutive stations (limit {MIN_STATIONS - 1}).",
    )  # fmt: skip


@criterion(Metric("prior", "sigma", section="description"), gated=False)
def prior(case: Case, metric: Metric) -> Iterator[Check]:
    """Values and priors of the user that the data contradict; those that move the result fail.

    They come before changes, and what is not shown: with a wrong one, little else may fit.
    """
    uncertainty = case.solution.uncertainty
    if uncertainty is None:
        return
    for options, (sigmas, shift) in uncertainty.asked.items():
        if sigmas > CONTRADICTION_SIGMAS:
            given, one = " and ".join(options), len(options) == 1
            values, are, them = ("value", "is", "it") if one else ("values", "are together", "them")
            yield metric.check(
                sigmas, CONTRADICTION_SIGMAS, f"{given} against the data",
                f"Correct {given} (m, rad, s; scales are relative), or leave {them} out.",
                part=", ".join(option.split()[-1].removeprefix("priors.") for option in options),
                why=f"The {values} of {given} {are} {sigmas:.1f} sigma from what the data show. Without {them}, the "
                f"result changes by up to {shift:.1f} standard deviations. Other findings may follow from it.",
                beyond="fail" if shift > MATERIAL_SIGMAS else "warning",
            )  # fmt: skip


@criterion(Metric("nominal.scale", "%"), gated=False)
def scale(case: Case, metric: Metric) -> Iterator[Check]:
    """Whether all sizes of the wheels are off the nominal ones to the same side: contradictions and changes follow.

    The scale of one camera is that of the stated squares, which nothing else in the images can contradict. With
    several, this is a criterion where all sizes are off by one factor beyond the limit of each. A factor that is off by
    chance is no mistake: such a scale is so uncertain that the verdict is NOT ENOUGH.
    """
    rig, wheels = case.extraction.rig, case.solution.parameters.wheels.vector
    stated, square_m = rig.sources.assumed_wheels or rig.nominal.wheels, case.extraction.board.square_m
    if stated is None or case.solution.uncertainty is None:
        return
    # Where several wheels of a side slip, the separation is wider.
    several = rig.sources.several_wheels
    sizes = NINE[6:8] if several else NINE[6:]
    which = "The radii of the wheels are both" if several else "Radii and separation of the wheels are all"
    off = 100 * (wheels / stated.vector - 1)[: len(sizes)]
    least = int(np.argmin(np.abs(off)))
    common = float(off[least]) if abs(np.sign(off).sum()) == len(off) else 0.0
    why = (
        f"{which} at least {abs(common):.1f} % {'larger' if common > 0 else 'smaller'} than the nominal ones."
    )
    other = "the nominal wheels"
    if rig.sources.assumed_odometry is not None:
        why = f"The odometry's distances are at least {abs(common):.1f} % too {'short' if common > 0 else 'long'}."
        other = "the sizes of the wheels in the odometry's driver"
    std_m = math.sqrt(case.solution.uncertainty.covariance[6 + least, 6 + least])
    by_chance = 100 * CONTRADICTION_SIGMAS * std_m / float(stated.vector[least])
    limit = _TOO_MUCH if several or abs(common) > _TOO_MUCH else _NOTICED
    beyond: Outcome = "warning" if limit < abs(common) <= _TOO_MUCH else "fail"
    cure = (
        f"Measure ten squares with a ruler: with one camera, the size of the squares ({square_m} m) gives the scale. "
        f"If it is as stated, correct {other}."
    )
    if case.extraction.measured:
        cure = "Check the scale of the measured poses: it is that of the wheels."
    if len(rig.cameras.each) > 1 or square_m is None:
        ratios = dict(zip(sizes, (1 + off / 100).tolist(), strict=True))
        limit, beyond, cure = _SIZE_BAD, "fail", _nominal_cure("radius_right", ratios, case)
        one_factor = abs(common) > limit and len(_alike(ratios, "radius_right")) == len(ratios)
        if not one_factor or rig.sources.assumed_odometry is not None:
            return
    if any(jump.part.startswith(jumps.FOCAL) for jump in case.solution.jumps):
        beyond = "warning"  # the sizes follow from a focal length that changes
    yield metric.check(
        common, limit, "common factor of all sizes of the wheels", cure, why=why,
        passes=abs(common) <= max(limit, by_chance), beyond=beyond,
    )  # fmt: skip


_WHEEL_CHANGED = ("changed", "Check the tire, the load and the encoder of this wheel")
#: Part of the robot → what it is called, the verb for its change, and what to do about it.
_PARTS = {
    "": ("something", "changed", "Check the mounts of head, cameras and board, the wheels, and the cables"),
    "board": ("the board", "moved", "Fasten the board"),
    jumps.LEAN: ("the base", "leaned over", "Check the load, the tires and the casters"),
    "board's size": ("the size of the squares", "changed", "Use the same board in all recordings"),
    "board's shape": ("the board's shape", "changed", "Use the same board in all recordings, on a flat plate"),
    "right wheel": ("the size of the right wheel", *_WHEEL_CHANGED),
    "left wheel": ("the size of the left wheel", *_WHEEL_CHANGED),
    "both wheels": (
        "the sizes of both wheels", "changed",
        "Check the tires, the load, and that all recordings show the same board",
    ),
}  # fmt: skip


def _part_words(part: str, extraction: Extraction) -> tuple[str, str, str]:
    """What a part that changed is called, the verb for it, and what to do about it."""
    if part.startswith("joint "):
        joint = visible(part.removeprefix("joint "))
        return f"the zero position of {joint}", "changed", f"Check the coupling and the encoder of {joint}"
    if part == "head mount":
        on = "head" if extraction.rig.chain.joints else "base"
        return f"the camera on the {on}", "moved", f"Fasten the camera to the {on}, and switch autofocus off"
    if part.startswith(jumps.FOCAL):
        return (
            f"the {visible(part)}",
            "changed",
            "Switch autofocus and zoom off, and calibrate this camera again",
        )
    first = camera_words(extraction.rig.cameras.names[0])
    camera = (
        f"the {visible(part)} against the {first}",
        "moved",
        "Fasten the cameras to their mount, and switch autofocus off",
    )
    return _PARTS.get(part, camera)


@criterion(Metric(CHANGED, "sigma", section="stations"), gated=False)
def jump(case: Case, metric: Metric) -> Iterator[Check]:
    """Moments from which on something is not where it was before, and recordings in which it is elsewhere.

    One that moves the result by more than the limit makes it neither the old nor the new one. One that moves it less
    only warns, unless it is the likeliest cause of a noise level that makes the verdict worse, or of many outliers. A
    recording that differs makes the standard deviations wider, and only warns if all expected errors are within their
    limits all the same: if it is used, and is not most of the outliers.
    """
    names, limit = station_names(case.extraction), MATERIAL_SIGMAS
    stations = Counter(o.log for o in case.extraction.observations)
    lost_of = Counter(outlier.log for outlier in case.solution.gross_outliers)
    used = all(100 * lost_of[log] <= _MOST_OUTLIERS * count for log, count in stations.items())
    levels = {check.outcome for check in noise(case, *_NOISE)}
    usual = used and "fail" not in levels and ("warning" not in levels or case.accurate)
    first = {o.log: k for k, o in reversed(list(enumerate(case.extraction.observations)))}
    for change in case.solution.jumps:
        at_s = (change.time_ns - int(case.extraction.wheels[change.log].time_ns[0])) / 1e9
        what, moved, cure = _part_words(change.part, case.extraction)
        parts = [f"{std_text(1e3 * abs(change.move_m))} mm"] if change.move_m else []
        parts += [f"{std_text(math.degrees(change.turn_rad))} degrees"] if change.turn_rad else []
        parts += [f"{std_text(100 * change.share)} %"] if change.share else []
        size = " by " + " and ".join(parts) if parts else ""
        if change.also:
            other, _, also = _part_words(change.also, case.extraction)
            what, size, cure = f"{what} or {other}", "", f"{cure}. {also}"
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
            harmless = small or (case.accurate and used)
        if small:
            lost = f" That moves the result by {std_text(change.shift_sigmas)} sigma only."
            then = "Do so before the next recording."
        yield metric.check(
            change.shift_sigmas if math.isfinite(change.shift_sigmas) else None, limit,
            "changes inside the recording", f"{cure}. {then}",
            measured=f"{what} {moved}{size} {when}",
            at_limit=f"moves the result by at most {limit:g} sigma",
            why=f"{capitalized(when)}, {what} {moved}{size}.{lost}",
            passes=False,
            beyond="warning" if harmless else "fail",
        )  # fmt: skip


@criterion(Metric("contradiction", "sigma", section="description"), gated=False)
def contradiction(case: Case, metric: Metric) -> Iterator[Check]:
    """The stated values that the data contradict; those that the result depends on fail, and times beside them.

    What is only assumed, such as a global shutter, spoils nothing where it is estimated. If any fails, so does the
    strongest, which comes first: one that contradicts less may be an alternative to it.
    """
    solution = case.solution
    spoiling = [
        evidence.shift_sigmas > MATERIAL_SIGMAS and evidence.kind not in ASSUMED
        for evidence in solution.contradictions
    ]
    widths = solution.uncertainty.noise.wider if solution.uncertainty is not None else {}
    for number, evidence in enumerate(solution.contradictions):
        what, cure = contradiction_sentences(evidence, solution, case.extraction)
        wider = widths.get(family(evidence.kind), 1.0)
        is_cause = evidence.late_camera or (
            any(spoiling) and (number == 0 or kind_of(evidence.kind).unit == "s")
        )
        of_others = is_cause and len(solution.contradictions) > 1
        yield metric.check(
            evidence.sigmas, CONTRADICTION_SIGMAS,
            f"robot description: {visible(evidence.part)}, {kind_of(evidence.kind).meaning}", cure,
            part=f"{evidence.kind}.{evidence.part}",
            measured=f"{evidence.sigmas:.1f} sigma from the stated values",
            why=f"{what} It changes the result by up to {evidence.shift_sigmas:.1f} standard deviations."
            + (f" Priors of this kind are taken {std_text(wider)} times as wide." if wider > _SHOWN_WIDER else "")
            + (" Other stated values that differ may follow from it." if of_others else ""),
            passes=False,
            beyond="fail" if spoiling[number] or is_cause else "warning",
        )  # fmt: skip


@criterion(Metric("observable", at_least=True, section="stations"), of_change=True)
def observable(case: Case, metric: Metric) -> Iterator[Check]:
    """Parameters that the recording does not determine, and the motion that would.

    A warning if all expected errors are within their limits all the same.
    """
    uncertainty, name = case.solution.uncertainty, "observable parameters"
    if uncertainty is None:
        return
    known = uncertainty.observable | uncertainty.fixed | uncertainty.described
    missing = [name for name, ok in zip(NINE, known, strict=True) if not ok]
    if not missing:
        if uncertainty.described.any():  # no joint tilts the camera: its height is not measured
            shown = int(uncertainty.observable.sum())
            yield metric.check(shown, shown, name, measured=f"{shown} that the motion of this robot can show")
        else:
            yield metric.check(float(len(known)))
        return
    between = case.solution.between
    if between is not None and any(between.between_std[NINE.index(name)] for name in missing):
        because = ": the recordings differ from one another"
        cure = "Calibrate each recording alone, and check that all are of one robot on which nothing was changed."
    else:
        because, cure = _motion_to_add(case, missing)
    yield metric.check(
        9 - len(missing), 9, name, cure,
        measured=f"{9 - len(missing)} of 9 (not observable: {', '.join(missing)})",
        why=f"{capitalized(plain_names(missing, case.extraction))} not determined{because}.",
        beyond="warning" if case.accurate else "not_enough",
    )  # fmt: skip


def _motion_to_add(case: Case, missing: list[str]) -> tuple[str, str]:
    """Why these parameters are not determined, after a colon, and what to do."""
    free, motion = freed_kinds(case.solution), case.solution.motion
    ignored = sorted(free - ({"square_size"} if case.extraction.board.square_m is None else set()))
    if ignored and not small_motion(motion, missing):
        return (
            f": the stated values of {', '.join(ignored)} are ignored",
            "Use them: leave out the --estimate, or the free prior in rig.yaml, that ignores them.",
        )
    because, cure = missing_motion(motion, missing, case.extraction.rig.chain)
    return f": {because}" if because else "", f"Record again and {cure}."


@criterion(*(Metric(f"motion.{key}", extent.unit, True, "stations") for key, extent in MOTION.items()))
def motion(case: Case, *metrics: Metric) -> Iterator[Check]:
    """Motion of head and base: a criterion for methods without standard deviations."""
    for (key, extent), metric in zip(MOTION.items(), metrics, strict=True):
        if key in case.solution.motion:
            value, judged = case.solution.motion[key], case.solution.uncertainty is None
            cure = f"Record again and {extent.cure}."
            small = f"{value:.1f} {extent.unit} only (limit {extent.least:g})"
            yield metric.check(
                value, extent.least, extent.name if judged else "", cure,
                why=f"The {extent.name} in the recording is {small}.",
            )  # fmt: skip


#: Part of a note → criterion, its name, what the note means for the result, and what to do.
_NOTED = {
    TURNS_AT_REST: (
        Metric("odometry_heading", section="description"), "odometry with the heading of a gyro",
        " The heading comes from a gyro: the wheel separation (or its multiplier) describes the gyro, not the wheels.",
        "Switch the gyro off in the driver of the odometry, or record the wheel joints or counters instead.",
    ),
    CAMERA_INFO_CHANGES: (
        Metric("camera_info", section="description"), "changes of camera_info", "",
        "Record again with one camera calibration, or state the correct one in rig.yaml.",
    ),
    UNUSED: (
        Metric("unused", section="stations"), "recordings without a station", "",
        "Leave it out, or record it again with the whole board in the images.",
    ),
}  # fmt: skip


@criterion(*(metric for metric, *_ in _NOTED.values()), gated=False)
def noted(case: Case, *_: Metric) -> Iterator[Check]:
    """Warnings of what the recording's notes say: the estimate takes the first camera_info and any heading, and leaves
    a recording out in which it sees no board.
    """
    for part, (metric, name, meaning, cure) in _NOTED.items():
        notes = [note for note in case.extraction.notes if part in note]
        if notes:
            why = f"{visible(notes[0])}.{meaning}"
            yield metric.check(len(notes), 0, name, cure, why=why, beyond="warning")


@criterion(Metric("description", "sigma", section="description"))
def description(case: Case, metric: Metric) -> Iterator[Check]:
    """The largest evidence against stated values, where none is a contradiction."""
    solution = case.solution
    if solution.uncertainty is not None and not solution.contradictions:
        most = max((evidence.sigmas for evidence in solution.evidence), default=0.0)
        name = "largest difference from stated values"
        yield metric.check(most, CONTRADICTION_SIGMAS, name, measured=f"{most:.1f} sigma", passes=True)


@criterion(Metric("second_solution", at_least=True))
def second_solution(case: Case, metric: Metric) -> Iterator[Check]:
    """How many times larger the second-best solution's error is; None if there is no second one.

    Two solutions whose errors differ by less than the limit cannot be distinguished. Linear solutions that do not fit,
    for example because of a slip, are not compared: their errors are a large share of the distance to the board.
    """
    limit, fitting_share = 1.5, 0.1
    kept, rival = case.solution.linear.point_rms_m, case.solution.linear.rival_point_rms_m
    ratio = rival / kept if kept > 0 else math.inf
    fits = kept < fitting_share * case.extraction.board_distance_m
    measured = "all starts converge to one solution"
    if math.isfinite(ratio):
        measured = f"second-best point error {ratio:.1f} times larger"
        if not fits:
            measured = f"not compared: the linear solution has a point error of {kept * 1e3:.0f} mm"
    yield metric.check(
        ratio if math.isfinite(ratio) else None, limit, "unique solution",
        "State the nominal wheels in rig.yaml, or record smaller turns between stops.",
        measured=measured,
        at_limit=f"second-best at least {limit:g} times larger",
        why="Two different solutions fit almost equally well: "
        f"point errors {kept * 1e3:.1f} and {rival * 1e3:.1f} mm.",
        passes=ratio >= limit or not fits,
        beyond="fail",
    )  # fmt: skip


@criterion(Metric("wheel_difference", "%"))
def wheel_difference(case: Case, metric: Metric) -> Iterator[Check]:
    """Relative difference between the wheel radii."""
    wheels = case.solution.parameters.wheels
    right, left = wheels.radius_right_m, wheels.radius_left_m
    apart = 100 * (max(right, left) / min(right, left) - 1)
    assumed = case.extraction.rig.sources.assumed_wheels
    sizes = f"right {right:.4f} m, left {left:.4f} m"
    if assumed is not None:
        right, left = right / assumed.radius_right_m, left / assumed.radius_left_m
        sizes = f"right {right:.4f}, left {left:.4f} times those of the driver"
    counters = any(wheel.ticks_per_revolution for wheel in case.extraction.rig.sources.wheels.values())
    signal = "ticks_per_revolution or the gear ratio of each"
    signal = signal if counters else "the gear ratio and the unit of each wheel's positions"
    yield metric.check(
        apart, _SIZE_BAD, "difference between the wheel radii", f"Measure both wheels, and check {signal}.",
        measured=f"{apart:.1f} % ({sizes})",
        why=f"The wheel radii differ by {apart:.1f} %: {sizes}.",
    )  # fmt: skip


@criterion(Metric("wheel_proportion"), gated=False)
def wheel_proportion(case: Case, metric: Metric) -> Iterator[Check]:
    """Separation over the smaller radius, usually 3 to 12, where no nominal wheels show a wrong unit."""
    rig, wheels = case.extraction.rig, case.solution.parameters.wheels
    radius_m = float(wheels.vector[:2].min())
    times, limit = wheels.separation_m / radius_m, 40.0
    if rig.nominal.wheels is None and rig.sources.assumed_wheels is None and times > limit:
        yield metric.check(
            times, limit, "wheel separation over the radius",
            "Check the unit of the wheel readings (rad at the wheel, not degrees or turns of the motor) and "
            "ticks_per_revolution, and state nominal.wheels in rig.yaml.",
            why=f"A wheel radius of {1e3 * radius_m:.2g} mm is unusually small beside a separation of "
            f"{1e3 * wheels.separation_m:.0f} mm.",
            beyond="warning",
        )  # fmt: skip


#: An effective separation of a base that turns with slip is at least the geometric one, and at most so many times.
_LEAST_EFFECTIVE, _MOST_EFFECTIVE = 0.95, 2.5


@criterion(*(Metric(f"nominal.{size}", "%") for size in NINE[6:]))
def nominal(case: Case, *metrics: Metric) -> Iterator[Check]:
    """Each size of the wheels against its nominal value, or each factor of odometry against 1."""
    stated, wheels = case.extraction.rig.nominal.wheels, case.solution.parameters.wheels
    sources = case.extraction.rig.sources
    if sources.assumed_odometry is not None:
        values = sources.assumed_odometry.factors(wheels).items()
        cure = (
            "Check the wheel radius and the wheel separation in the driver, and board.square_m in rig.yaml."
        )
        for metric, (name, value) in zip(metrics, values, strict=False):
            off, slips = 100 * (value - 1), metric is metrics[2] and 1 <= value <= _MOST_EFFECTIVE
            yield metric.check(
                off, _SIZE_BAD, f"{name.replace('_', ' ')} against 1", cure,
                measured=f"{value:.4f}, {off:+.1f} %",
                why=f"The {name.replace('_', ' ')} of the odometry on {sources.assumed_odometry.topic} is {value:.3f}.",
                passes=slips or abs(off) <= _SIZE_BAD,
            )  # fmt: skip
        return
    if stated is None:
        return
    ratios = dict(zip(NINE[6:], (wheels.vector / stated.vector).tolist(), strict=True))
    sizes = zip(metrics, PARAMETERS[6:], wheels.vector, stated.vector, strict=True)
    for metric, parameter, found_m, stated_m in sizes:
        ratio, limit, label = ratios[parameter.name], _SIZE_BAD, parameter.label
        at_limit, passes = f"within {_SIZE_BAD:g} % of {stated_m:.4f} m", None
        cure = _nominal_cure(parameter.name, ratios, case)
        if sources.several_wheels and parameter.name == "separation":
            label, limit = f"effective {label}", 100 * (_MOST_EFFECTIVE - 1)
            at_limit = f"{_LEAST_EFFECTIVE:g} to {_MOST_EFFECTIVE:g} times {stated_m:.4f} m"
            passes = _LEAST_EFFECTIVE <= ratio <= _MOST_EFFECTIVE
            cure = (
                "Check ticks_per_revolution and the sides of the wheels. The effective separation of a skid-steered "
                f"base is 1 to {_MOST_EFFECTIVE:g} times the distance between its wheels."
            )
        usual = {"about half of": 0.5, "about twice": 2.0} if passes is None else {}
        times = next((said for said, r in usual.items() if abs(ratio / r - 1) < _ALIKE), f"{ratio:.2f} times")
        yield metric.check(
            100 * (ratio - 1), limit, f"{label} against its nominal value", cure,
            measured=f"{found_m:.4f} m, {100 * (ratio - 1):+.1f} %",
            at_limit=at_limit,
            why=f"The {label} is {found_m:.4f} m, {times} the nominal {stated_m:.4f} m.",
            passes=passes,
        )  # fmt: skip


def _alike(ratios: Mapping[str, float], name: str) -> list[str]:
    """Sizes whose ratio to the nominal one is that of a size, nearly."""
    return [other for other, ratio in ratios.items() if abs(ratio / ratios[name] - 1) < _ALIKE]


def _nominal_cure(name: str, ratios: Mapping[str, float], case: Case) -> str:
    """What to correct where a wheel's size is not the nominal one: only what its ratio to it can be."""
    like = _alike(ratios, name)
    scale, pair = case.solution.scale, len(case.extraction.rig.cameras.each) > 1
    if len(like) == len(ratios) and scale is not None and not scale.apart:
        return (
            "All sizes of the wheels differ by this factor, and the squares fit the stereo baseline: correct "
            "nominal.wheels."
        )
    if len(like) == len(ratios):
        return (
            "All sizes of the wheels differ by this factor, so the scale is wrong: check "
            f"{'the baseline in camera_info and ' * pair}board.square_m, then nominal.wheels."
        )
    if name == "separation":
        return "Measure the distance between the contact points of the wheels, and correct nominal.wheels."
    causes = []
    if abs(ratios[name] / 0.5 - 1) < _ALIKE:
        causes.append("that nominal.wheels states radii, not diameters")
    if case.extraction.rig.sources.wheels["right" if name == "radius_right" else "left"].ticks_per_revolution:
        causes.append("ticks_per_revolution")
    else:
        causes.append("the unit of the wheel positions (rad at the wheel, not at the motor)")
    return f"Measure the wheel with a ruler. If it is as stated, check {', and '.join(causes)}."


#: Axes of an optical frame (x right, z forward) in those of the camera's body (x forward, z up).
_IN_BODY = se3.transform(np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]]), np.zeros(3))
_BODY = "the pose of the camera's body frame (x forward)"
#: What a stated pose of the camera in the head may be instead → the pose that is meant.
_CONVENTIONS: Mapping[str, Callable[[FloatArray], FloatArray]] = {
    _BODY: lambda T: T @ _IN_BODY,
    "the inverse, the pose of the head in the camera": se3.inverse,
    "the pose of the head in the camera's body frame (x forward)": lambda T: se3.inverse(T) @ _IN_BODY,
    "the pose of an optical frame (z forward), not of the frame of the measured poses (x forward)": (
        lambda T: T @ se3.inverse(_IN_BODY)
    ),
}


@criterion(Metric("nominal.head_eye", "sigma"), gated=False)
def nominal_pose(case: Case, metric: Metric) -> Iterator[Check]:
    """A nominal pose of the camera that is no rough value of the result, and the convention that would explain it.

    What the recording does not show is taken from it: a failure if that is the height, and the place is elsewhere.
    """
    rig, pose, limit = case.extraction.rig, case.solution.T_h_reference, 3.0
    stated, head, frame = rig.nominal.T_h_reference, rig.chain.head_frame, rig.cameras.of_reference.frame_id
    if stated is None:
        return

    def apart(T: FloatArray) -> tuple[float, FloatArray]:
        """In standard deviations of nominal poses; and rotation and distance, (2,) rad and m."""
        by = np.linalg.norm([se3.log_so3(T[:3, :3].T @ pose[:3, :3]), T[:3, 3] - pose[:3, 3]], axis=1)
        return float(np.linalg.norm(by / NINE_SIGMAS[[0, 3]])), by

    sigmas, (angle_rad, distance_m) = apart(stated)
    if sigmas <= limit:
        return
    by = f"by {math.degrees(angle_rad):.0f} degrees and {1e3 * distance_m:.0f} mm"
    others = {said: apart(meant(stated))[0] for said, meant in _CONVENTIONS.items()}
    likely = min(others, key=lambda said: others[said])
    if others[likely] > sigmas / 3:
        likely = ""
    given = "nominal.head_eye"
    cure = f"State the pose of {frame}, the optical frame (x right, z forward), in {head}."
    if case.extraction.measured:
        given = "T_v_c" if case.extraction.motions else "T_h_c"
        cure = f"Give the pose of the frame of the measured poses in {head} as {given}."
    why = f"The pose of the camera differs from {given} {by}."
    if rig.setting_sources.get("nominal head_eye") == "URDF":
        why = f"The pose of the camera differs from that of {frame} in the URDF or the transforms {by}."
        cure = f"Check that the images are of the frame {frame}, and its pose in {head} (m)."
        if likely == _BODY:
            why = (
                f"The frame_id of the images, {frame}, is a body frame in the URDF (x forward), but the pose is that "
                "of the optical frame (z forward)."
            )
            cure = (
                "Set the frame_id of the camera's driver to its optical frame, before you use an exported "
                "description."
            )
    elif likely:
        why = f"{given} looks like {likely}: it differs from the result {by}."
    uncertainty, height = case.solution.uncertainty, ""
    taken = uncertainty is not None and (uncertainty.described & ~uncertainty.with_prior).any()
    if taken and distance_m > limit * NINE_SIGMAS[3]:
        height = " The camera's height, which no motion shows, is taken from it."
    yield metric.check(
        sigmas,
        limit,
        "nominal pose of the camera",
        visible(cure),
        measured=by,
        why=visible(f"{why}{height}"),
        beyond="fail" if height else "warning",
    )


@criterion(Metric("stereo_error", "px", section="description"))
def stereo_error(case: Case, metric: Metric) -> Iterator[Check]:
    """Corners against the flat board: with the cameras as estimated, or as stated where there is no estimate.

    Good camera calibrations give 0.1 to 0.3 px.
    """
    uncertainty = case.solution.uncertainty
    stated = float(np.median([o.reprojection_px for o in case.extraction.observations]))
    px = stated if uncertainty is None else uncertainty.noise.pixel_px
    of = "median" if uncertainty is None else f"with camera_info as stated: {std_text(stated)} px"
    pair = case.extraction.rig.cameras.calibrated
    name = f"{'stereo ' if pair else ''}reprojection error of the board"
    yield metric.check(
        px, 1.2, name,
        f"Calibrate the {'stereo pair' if pair else 'cameras'} again (camera_info), and check that the board is flat.",
        measured=f"{std_text(px)} px ({of})",
        why=f"The {name} is {std_text(px)} px (0.3 px is usual).",
    )  # fmt: skip


@criterion(Metric("square_size", "%", section="description"))
def square_size(case: Case, metric: Metric) -> Iterator[Check]:
    """Stated square size against the stereo baseline, for methods that do not estimate both."""
    stated = case.extraction.board.square_m
    sizes = [o.square_m for o in case.extraction.observations if o.several]
    pair = case.extraction.rig.cameras.calibrated and sizes
    if case.solution.uncertainty is not None or stated is None or not pair:
        return
    measured = float(np.median(sizes))
    off, stated_mm, measured_mm = 100 * (measured / stated - 1), stated * 1e3, measured * 1e3
    yield metric.check(
        off, 3.0, "square size: stereo against stated",
        "Measure a square with a ruler. If it is as stated, the stereo baseline in camera_info is wrong.",
        measured=f"{measured_mm:.2f} mm, {off:+.2f} %",
        why=f"The stereo pair measures squares of {measured_mm:.2f} mm, but {stated_mm:.2f} mm is stated.",
    )  # fmt: skip


_PLAY = (
    "joint readings",
    "the head joints for play, the head chain in the URDF, and that the board does not swing",
)
_HEIGHT = Metric("noise.height", "mm", section="limits")
_FLOOR = Metric("noise.floor", "degrees", section="limits")
#: Noise level → the largest usual level, the limit, its name, and what to check.
_NOISE = {
    _HEIGHT: (4.0, 30.0, "floor (height of the base)", "that the floor is flat and that the board does not move"),
    Metric("noise.joint", "degrees", section="limits"): (0.2, 0.4, *_PLAY),
    Metric("noise.sliding_joint", "mm", section="limits"): (0.35, 0.7, *_PLAY),
    Metric("noise.wheel", "rad per sqrt(rad)", section="limits"): (
        0.015, WHEEL_NOISE, "wheels", "the wheels for slip, and the head chain in the URDF",
    ),
    Metric("noise.wheel_share", "%", section="limits"): (
        1.0, 5.0, "wheels in proportion to their rotation", "the wheels for slip, the tires and the load",
    ),
    _FLOOR: (
        0.3, 1.5, "floor (roll and pitch of the base)", "that the floor is flat and that the base does not rock",
    ),
    Metric("noise.stamp", "ms", section="limits"): (
        2.0, 1e3 * STAMP_NOISE_S, "time stamps",
        "that images, joints and wheels are stamped when they are read, not when they arrive, or stop for each image",
    ),
    Metric("noise.pair", "ms", section="limits"): (
        2.0, 10.0, "time between the images of two cameras",
        "that the cameras are triggered together, or stop for each image",
    ),
    Metric("noise.shift", "px", section="limits"): (
        0.3, 2.0, "images as a whole", "that lenses and cameras are tight, and that no camera stabilizes its images",
    ),
}  # fmt: skip


def noise(case: Case, *levels: Metric) -> Iterator[Check]:
    """Noise of joints (in mm for a head that only slides), wheels, floor, and times of images where the robot moves.

    The estimate allows for it, so the limits are wide. A level of zero is a figure alone. A board that moved, or a base
    that leaned, makes the floor's noise large, and moves none of the nine parameters: then that is a warning.
    """
    uncertainty, chain = case.solution.uncertainty, case.extraction.rig.chain
    if uncertainty is None:
        return
    found, moving = uncertainty.noise, not all(o.at_rest for o in case.extraction.observations)
    slides = bool(chain.joints) and len(chain.prismatic) == len(chain.joints)
    measured = {
        "noise.height": ("floor_m", 1e3),
        "noise.joint": ("joint_rad", 0.0 if slides else math.degrees(1)),
        "noise.sliding_joint": ("joint_rad", 1e3 * chain.joint_units[0] if slides else 0.0),
        "noise.wheel": ("wheel_rad_per_sqrt_rad", 1.0),
        "noise.wheel_share": ("wheel_share", 100.0),
        "noise.floor": ("floor_rad", math.degrees(1)),
        "noise.stamp": ("stamp_s", 1e3 * moving),
        "noise.pair": ("pair_s", 1e3 * ("pair_s" in found.estimated)),
        "noise.shift": ("shift_px", 1.0 * ("shift_px" in found.estimated)),
    }
    moved = {part for jump in case.solution.jumps for part in (jump.part, jump.also) if part}
    beside = bool(moved) and moved <= {"board", jumps.LEAN}
    stepped = [visible(note) for note in case.extraction.notes if CLOCK_STEPS in note]
    stated = ", and the priors in rig.yaml" if case.extraction.rig.prior_sigmas else ""
    if case.extraction.measured:
        stated = ", and that the covariances of the poses state rotations and translations equally well"
        stated += ", and motions and rotations are between the same times" * bool(case.extraction.motions)
    for metric in levels:
        (usual, bad, name, cause), (field, unit) = _NOISE[metric], measured[metric.name]
        level = unit * getattr(found, field)
        if metric.name == "noise.stamp" and stepped:
            cause = f"that no clock is adjusted during the recording ({stepped[0]})"
        cure, known = f"Check {cause}{stated}. Then record again.", ""
        if field in case.extraction.rig.noise:
            known = " stated as"
            cure = f"Correct noise: {field} in rig.yaml, or leave it out: it is estimated."
        yield metric.check(
            level, bad, f"noise of the {name}" if level else "", cure,
            measured=f"{level:.2g} {metric.unit}",
            why=f"The noise of the {name} is{known} {level:.2g} {metric.unit} "
            f"(below {usual:g} {metric.unit} is usual).",
            beyond="warning" if beside and metric in (_HEIGHT, _FLOOR) else "fail",
        )  # fmt: skip


@criterion(Metric("head_chain"), gated=False)
def head_chain(case: Case, metric: Metric) -> Iterator[Check]:
    """A joint that moves the camera beside the head chain: the likeliest cause of noise beyond its limit.

    One that its name alone shows may move something else, and counts only where there is such noise.
    """
    noisy = any(check.outcome == "fail" for check in noise(case, *_NOISE))
    for note in case.extraction.notes:
        if CHAIN_ENDS in note or (noisy and CHAIN_LACKS in note):
            why, _, cure = visible(note).partition(". ")
            yield metric.check(
                None, None, "head chain", cure,
                measured="ends before a joint that moves the camera",
                at_limit="all joints that move the camera",
                why=f"{why}.",
                beyond="fail" if noisy else "warning",
            )  # fmt: skip


criterion(_HEIGHT, of_change=True)(noise)


@criterion(Metric("outliers", "%", section="stations"), of_change=True)
def outliers(case: Case, metric: Metric) -> Iterator[Check]:
    """Outliers; the limit is the share that a robust estimate tolerates."""
    if case.solution.uncertainty is None:
        return
    bad, count, gross = _MOST_OUTLIERS, len(case.extraction.observations), case.solution.gross_outliers
    share = 100 * len(gross) / max(1, count)
    further = f" Further outliers: {len(gross) - 1}." if len(gross) > 1 else ""
    unknown = "" if gross and all("Check " in outlier.text for outlier in gross) else "Find the cause. "
    yield metric.check(
        share, bad, "outliers", f"{unknown}The result uses the remaining measurements.",
        measured=f"{len(gross)} in {count} stations and the legs between them",
        why=f"{gross[0].text}{further}" if gross else "",
        passes=not gross,
        beyond="fail" if share > bad else "warning",
    )  # fmt: skip


@criterion(
    Metric("leg_outlier.point", "mm", section="stations"),
    Metric("leg_outlier.reprojection", "px", section="stations"),
)
def leg_outlier(case: Case, *metrics: Metric) -> Iterator[Check]:
    """The leg with the largest error against the median leg, of five legs or more.

    Errors of consistent legs are distributed like |x| of a normal x: the largest of 11 is about 3 times the median, the
    largest of 1000 about 5 times. Short legs have small errors, so an outlier must also be large in absolute terms: as
    a share of the distance, in mm or in the image, beside three standard deviations of the leg's own depth noise. With
    coarse encoders, that is more than an error of one step on both wheels, with a margin for the joints. The error of
    wheels grows with the root of the way: a leg that takes longer than the median leg may have so much more. Where the
    noise levels are estimated, the error is also more than three times what they make of this leg: a turn in front of a
    far board. Such an estimate has its own test of outliers, and this one only warns.
    """
    least_legs, times, bad, encoder_steps, sigmas = 5, 5.0, 0.01, 1.5, 3.0
    residuals, names = case.solution.residuals, station_names(case.extraction)
    if len(residuals.legs) < least_legs:
        return
    wheels = case.solution.parameters.wheels
    right_rad, left_rad = encoder_steps_rad(case.extraction.wheels).tolist()
    step_rad = (wheels.radius_right_m * right_rad + wheels.radius_left_m * left_rad) / wheels.separation_m
    bad = max(bad, encoder_steps * step_rad)
    distance_mm, focal_px = case.extraction.board_distance_m * 1e3, float(case.solution.cameras.first.K[0, 0])
    depth_noise = sigmas * residuals.leg_corner_noise_m * 1e3 / distance_mm
    stamps = np.array([o.time_ns for o in case.extraction.observations], dtype=np.int64)
    took = np.diff(stamps[residuals.legs], axis=1)[:, 0]
    longer = np.sqrt(np.maximum(took / max(float(np.median(took)), 1.0), 1.0))
    known = case.solution.leg_noise
    expected_px, expected_m = np.zeros((2, len(took))) if known is None else known
    for metric, kind, errors, expected, scale in (
        (metrics[0], "point", residuals.leg_point_rms_m * 1e3, expected_m * 1e3, distance_mm),
        (metrics[1], "reprojection", residuals.leg_reprojection_px, expected_px, focal_px),
    ):
        worst, median = int(np.argmax(errors)), float(np.median(errors))
        first, second = (names[end] for end in residuals.legs[worst])
        error = float(errors[worst])
        limit = max(math.hypot(bad, depth_noise[worst]) * scale, sigmas * float(expected[worst]))
        yield metric.check(
            error, limit, f"largest {kind} error of a leg",
            "Check for wheel slip and for a moved board between these stations, and record again.",
            measured=f"{error:.1f} {metric.unit} (median {median:.1f} {metric.unit})",
            at_limit=f"at most {times * longer[worst]:.2g} times the median, or at most {limit:.1f} {metric.unit}",
            why=f"The {kind} error between stations {first} and {second} is {error:.1f} {metric.unit} "
            f"(median {median:.1f} {metric.unit}).",
            passes=error <= times * longer[worst] * median or error <= limit,
            beyond="fail" if case.solution.uncertainty is None else "warning",
        )  # fmt: skip


_NO_NOISE = 3.0  # times its limit: a larger reprojection error is no noise


def unexplained(solution: Solution, extraction: Extraction) -> ErrorPart:
    """Reprojection error and point error beyond what the noise levels and the cameras' lenses explain.

    Noise of corners, joints, floor, wheels and stamps has limits of its own. What lenses do beside their models, and
    turns that differ, are estimated. None of it is an error of the calibration. Each is counted with its largest mean
    square.
    Depth is proportional to 1 / disparity: with a relative noise r, to first order, its mean square is r^2 (1 + 9 r^2).
    That of a leg is the sum of two stations.

    Args:
        solution: with legs.
        extraction: its recording.
    """
    legs = len(solution.residuals.legs)
    parts = solution.error_parts or {"corners": ErrorPart(0.0, solution.residuals.corner_noise_m)}
    left = np.square([solution.reprojection_rms_px, solution.point_rms_m])
    for name, part in parts.items():
        count = legs * extraction.board.corners if name == "corners" else legs
        left -= np.square(part) * largest_mean_square(count)
        if name == "corners":
            left[1] -= 9 / 2 * (part.m**2 / extraction.board_distance_m) ** 2
    return ErrorPart(*np.sqrt(np.maximum(left, 0.0)).tolist())


@criterion(
    Metric("point_error", "%", section="stations"),
    Metric("reprojection_error", "px", section="stations"),
    of_change=True,
)
def errors(case: Case, of_points: Metric, of_pixels: Metric) -> Iterator[Check]:
    """Point error and reprojection error, without what is no error of the calibration: see `unexplained`.

    Point error: encoders with 300 steps per turn (as in the paper) give about 0.5 % of the distance. 1.5 % is 0.9
    degrees of heading, more than a wheel without slip loses on one leg.
    """
    solution, distance = case.solution, case.extraction.board_distance_m
    if not len(solution.residuals.legs):
        return
    error, error_px = solution.point_rms_m, solution.reprojection_rms_px
    beyond = unexplained(solution, case.extraction)
    parts, without = solution.error_parts, "without corner noise, lenses and uneven floor"
    cause = max(parts, key=lambda name: parts[name].px, default="")
    limit = ERROR_BAD * float(solution.cameras.first.K[0, 0])
    gross = cause != "" and error_px > _NO_NOISE * limit
    _, cure = ERROR_PARTS.get(cause, ("", "Calibrate with --method ml (the default), which names the cause."))
    if gross:
        cure = "Check that the head chain has all joints that move the camera."
    noise = "noise of the poses" if case.extraction.measured else "depth noise"
    depth = f"({noise} alone: {solution.residuals.corner_noise_m * 1e3:.1f} mm)"
    yield of_points.check(
        100 * beyond.m / distance, 100 * ERROR_BAD, "point error", cure,
        measured=f"{1e3 * error:.1f} mm, {100 * error / distance:.2f} % of the distance {depth}",
        at_limit=f"at most {100 * ERROR_BAD:g} % {without}",
        why=f"The point error is {1e3 * error:.1f} mm at {distance:.1f} m {depth}.",
    )  # fmt: skip
    of_px = f" Of this, {std_text(parts[cause].px)} px come from the {cause}." if cause and not gross else ""
    yield of_pixels.check(
        beyond.px, limit, "reprojection error", cure,
        measured=f"{error_px:.2f} px",
        at_limit=f"at most {limit:.1f} px {without}",
        why=f"The reprojection error is {error_px:.1f} px (limit {limit:.1f} px {without}).{of_px}",
    )  # fmt: skip


#: Of a clock: a joint or wheel turns by some degrees meanwhile.
_LATE_S = 0.05


@criterion(Metric("methods"))
def methods(case: Case, metric: Metric) -> Iterator[Check]:
    """Difference between the linear and the refined solution; in shares of its limits, the largest.

    The linear method alone has errors up to 2 degrees, 60 mm and 5 % of the wheels. It knows no fixed values, and
    unobservable ones only roughly. It uses outliers, too, and readings as they are stamped: where there are any, or a
    clock is late, a large difference says nothing.
    """
    limits = (6.0, 200.0, 15.0)
    linear, refined = case.solution.linear.parameters, case.solution.parameters
    if case.solution.refinement is None:
        return
    step = refined.minus(linear)
    apart = [
        float(np.degrees(np.linalg.norm(step[:3]))),
        1e3 * float(np.linalg.norm(step[3:6])),
        100 * float(np.abs(linear.wheels.vector / refined.wheels.vector - 1).max()),
    ]
    if case.solution.uncertainty is not None:
        known = [bool(part.all()) for part in case.solution.uncertainty.observable.reshape(3, 3)]
        apart = [value if ok else 0.0 for value, ok in zip(apart, known, strict=True)]
    largest = max(value / limit for value, limit in zip(apart, limits, strict=True))
    clocks = (each.value for each in case.solution.constants.values() if each.kind == "clock")
    late = any(abs(offset_s) > _LATE_S for offset_s in clocks)
    if largest > 1 and (case.solution.gross_outliers or late):
        return
    text = "{:.1f} degrees, {:.0f} mm and {:.1f} % of the wheels".format(*apart)
    yield metric.check(
        largest, 1.0, "linear against refined solution",
        "Check the head joints for play. Then record again with more stops, head motion and turns.",
        measured=f"differ by {text}",
        at_limit="at most {:g} degrees, {:g} mm and {:g} %".format(*limits),
        why=f"The linear and the refined solution differ by {text}.",
        beyond="fail" if case.solution.uncertainty is None else "warning",
    )  # fmt: skip


@criterion(Metric("outliers_as_noise", section="stations"), gated=False)
def outliers_as_noise(case: Case, metric: Metric) -> Iterator[Check]:
    """Kinds of measurements with so many outliers that they are noise."""
    kinds = case.solution.noisy
    names = {"views": "stations' images", "legs": "legs' wheel rotations", "readings": "joint readings"}
    if case.solution.uncertainty is not None and kinds:
        yield metric.check(
            len(kinds), 0, "outliers that are noise", "See the noise levels in the report.",
            measured=", ".join(kinds),
            at_limit="none",
            why=f"More than a third of the {' and of the '.join(names[kind] for kind in kinds)} differ from the rest: "
            "their noise is larger than usual. All of them are used, with the noise level that fits them.",
            beyond="warning",
        )  # fmt: skip


criterion(*(metric for metric in _NOISE if metric is not _HEIGHT), of_change=True)(noise)


@criterion(*(Metric(figure.name, figure.unit, section="limits") for figure in FIGURES), of_change=True)
def expected_errors(case: Case, *metrics: Metric) -> Iterator[Check]:
    """Whether each expected error in use is within its limit; the least certain first."""
    uncertainty = case.solution.uncertainty
    if uncertainty is None:
        return
    limited = {use.figure: use for use in uses(case.solution, case.gates)}
    of = dict(zip(FIGURES, metrics, strict=True))
    for figure, metric in of.items():
        if figure not in limited:
            yield metric.check(figure.of(uncertainty.at_work))
    for use in sorted(limited.values(), key=lambda use: -use.share):
        figure, value = use.figure, f"{std_text(use.value)} {use.figure.unit}"
        by_head = figure.of_camera and not uncertainty.fixed[:6].all()
        by_base = figure.field not in ("camera_m", "camera_rad") and not uncertainty.fixed[6:].all()
        yield of[figure].check(
            use.value, use.limit, f"expected error: {figure.meaning}",
            motion_cure(case.solution.motion, NINE[:6] * by_head + NINE[6:] * by_base)
            or next_step_of(use, case.solution, case.extraction),
            measured=value if use.value else "fixed by the user",
            why=f"The expected error (1 sigma) of the {figure.meaning} is {value} "
            f"(limit {use.limit:.3g} {figure.unit}). {use.limiting}",
            beyond="not_enough",
        )  # fmt: skip


@criterion(Metric("rejected", "%", section="stations"))
def rejected(case: Case, metric: Metric) -> Iterator[Check]:
    """Share of rejected stations."""
    detected, used = stations_looked_at(case.extraction), len(case.extraction.observations)
    counts, lost = rejection_counts(case.extraction), f"{detected - used} of {detected}"
    cure = nearer(case.extraction) or "open the stations in the report, remove the cause, and record again"
    often = f" (most often: {visible(next(iter(counts))[1])})" if counts else ""
    yield metric.check(
        100 * (1 - used / detected), 50.0, "rejected stations",
        f"{capitalized(cure)}.",
        measured=f"{lost}{often}",
        beyond="warning",
    )  # fmt: skip


@criterion(Metric("change", "%", at_least=True, section="limits"))
def change(case: Case, metric: Metric) -> Iterator[Check]:
    """Whether the robot is unchanged since the last calibration.

    The limit is how often an unchanged robot shows a change this large.
    """
    difference, unlikely = case.change, 1e-4
    if difference is None or difference.p_value is None:
        return
    worst = int(np.argmax(np.abs(np.nan_to_num(difference.sigmas))))
    moved = f"{NINE[worst]} by {float(difference.sigmas[worst]):+.1f} sigma"
    yield metric.check(
        100 * difference.p_value, 100 * unlikely, "change since the last calibration",
        "Check that both calibrations are of this robot, and look for a loose camera and worn tires. If you find no "
        "cause, record and calibrate again.",
        measured=f"probability by chance {percent_text(difference.p_value)}; largest {moved}",
        at_limit=f"at least {100 * unlikely:g} %",
        why=f"The robot has changed since {visible(difference.against)}: {moved}.",
        beyond="warning",
    )  # fmt: skip
