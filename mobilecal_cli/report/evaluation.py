"""A calibration evaluated on a recording: PASS, FAIL or NOT ENOUGH, and the errors as numbers, text and JSON.

The recording is also solved by itself. The calibration fails where it differs from that estimate by more than a
limit and by more than the uncertainty of both explains, so noise alone does not fail it.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.errors import MobilecalError
from mobilecal_cli.likelihood.predict import camera_in_base
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.calibration import NINE, CalibratedRobot
from mobilecal_cli.model.observations import Extraction
from mobilecal_cli.model.rig import HeadChain
from mobilecal_cli.model.solution import MOST_ERROR_PX, Drift, Evaluation, Solution
from mobilecal_cli.model.text import capitalized, wrapped
from mobilecal_cli.report.checks import ERROR_BAD, MIN_STATIONS, rms, unexplained
from mobilecal_cli.report.criteria import Check, Metric, Outcome, check_lines
from mobilecal_cli.report.formats import ByName, JsonValue, Table, by, json_text, like
from mobilecal_cli.report.motion import motion_cure
from mobilecal_cli.report.numbers import DEG, std_text, value_text
from mobilecal_cli.report.verdict import GATE, Verdict, decided_by

#: Largest differences that pass. Two recordings of an unchanged robot differ by a tenth of this.
_QUANTITIES = (
    ("camera_rotation", "camera rotation", slice(0, 3), 0.75, "deg"),
    ("camera_position", "camera position", slice(3, 6), 20.0, "mm"),
    ("radius_right", "right wheel radius", slice(6, 7), 1.0, "%"),
    ("radius_left", "left wheel radius", slice(7, 8), 1.0, "%"),
    ("separation", "wheel separation", slice(8, 9), 2.0, "%"),
)
#: A difference counts from so many standard deviations on.
_SIGMAS = 3.0
#: The standard deviation may be this share of the limit: a difference of twice the limit is then 4 sigma.
_SIGMA_SHARE = 0.5
#: Corner errors above the limit fail the calibration if they are so many times those of the recording's own estimate.
_TIMES_OWN = 1.5


@dataclass(frozen=True, slots=True, eq=False)
class Evaluated:
    """Result of an evaluation.

    Attributes:
        evaluation: the figures.
        extraction: the recording's measurements.
        verdict: PASS, FAIL or NOT ENOUGH, with every check.
        used: names of the recordings that the calibration was made from.
        remarks: notes on the board that is taken, and on corrections of the calibration that do not apply to the
            recording; whole sentences.
    """

    evaluation: Evaluation
    extraction: Extraction
    verdict: Verdict
    used: tuple[str, ...]
    remarks: tuple[str, ...] = ()

    @property
    def notes(self) -> tuple[str, ...]:
        """Notes if the calibration was made from some of the recordings, or does not apply in part; sentences."""
        if not self.used:
            return self.remarks
        which = f"{', '.join(self.used)} {'was' if len(self.used) == 1 else 'were'}"
        if len(self.extraction.logs) == 1:
            which = "This recording was"
        return (f"{which} used for this calibration: the errors below are not independent.", *self.remarks)


def judge_evaluation(
    evaluation: Evaluation,
    extraction: Extraction,
    robot: CalibratedRobot,
    own: Solution | MobilecalError,
    cure: str,
    used: Sequence[str],
    gates: Iterable[Check],
) -> Verdict:
    """Verdict on a calibration. A failed check comes before one that lacks data.

    Args:
        evaluation: errors of the calibration on the recording.
        extraction: the recording's measurements.
        robot: the calibration under test.
        own: the recording solved by itself, or the error that prevented it.
        cure: the motion that the recording lacks to determine all parameters; "" if it lacks none.
        used: names of the recordings that the calibration was made from.
        gates: the user's limits, see `gate_checks`.
    """
    enough_stations = Metric("evaluated_stations", at_least=True).check(
        evaluation.stations,
        MIN_STATIONS,
        f"stations with the board in {extraction.rig.cameras.images_words}",
        "Record at least ten stations.",
    )
    agreement = _agreement(robot, own, extraction.rig.chain, cure)
    checks = (enough_stations, _corner_error(evaluation, extraction, own), *agreement, *gates)
    for outcome in ("fail", "not_enough"):
        decisive = next((check for check in checks if check.outcome == outcome), None)
        if decisive is not None:
            return decided_by(decisive, checks)
    agreed = ", ".join(f"{c.name} {c.measured_text}" for c in checks if c.id.startswith("agreement."))
    next_step = "Use params.yaml on the robot."
    if robot.verdict not in ("PASS", ""):
        next_step = " ".join((f"Calibrate again: this calibration is {robot.verdict}.", *robot.reasons[:1]))
    elif used:
        next_step = "Evaluate a recording that was not used for this calibration."
    return Verdict("PASS", f"The calibration agrees with this recording: {agreed}.", next_step, checks)


def _corner_error(evaluation: Evaluation, extraction: Extraction, own: Solution | MobilecalError) -> Check:
    """A gross error of the calibration, or of a recording that no calibration explains."""
    limit_px = ERROR_BAD * float(extraction.rig.cameras.first.K[0, 0])
    px = float(np.median(evaluation.reprojection_px))
    best_px, unexplained_px, best = limit_px, 0.0, ""
    cure = "Check that params.yaml is of this robot, in meters. If tires, load or a mount changed, calibrate again."
    if isinstance(own, MobilecalError):
        cure = f"{capitalized(own.hint)}. Then evaluate again. {cure}" if own.hint else cure
    else:
        best_px = float(np.median(own.residuals.leg_reprojection_px))
        unexplained_px = unexplained(own, extraction).px
        best = f"; the recording's own estimate leaves {best_px:.1f} px"
    metric, name = Metric("corner_error", "px"), "median station-to-station corner error"
    limit = max(limit_px, _TIMES_OWN * best_px)
    if min(best_px, unexplained_px) > limit_px:
        return metric.check(
            px, limit, name, "Check for wheel slip, a moved board and wrong encoder settings, and record again.",
            why=f"No parameters explain this recording: the best leave {best_px:.1f} px (limit {limit_px:.1f} px).",
            passes=False,
            beyond="not_enough",
        )  # fmt: skip
    return metric.check(
        px, limit, name, cure,
        measured=f"{_shown(px, 2, MOST_ERROR_PX)} px{best}",
        at_limit=f"at most {limit:.1f} px",
    )  # fmt: skip


def _apart(robot: CalibratedRobot, own: Solution, chain: HeadChain) -> tuple[FloatArray, FloatArray]:
    """(9,) a calibration less a recording's own estimate, and its covariance (9, 9): rad, m.

    The camera's pose is that in the base, where the corrections of the head chain count, as a right twist: rotation,
    then translation. Of a camera that nothing tilts, without its height.
    """
    uncertainty = own.uncertainty
    assert uncertainty is not None  # the default method always has one
    found = {constant.name: constant.value for constant in own.constants.values()}
    T_own = camera_in_base(chain, found, own.T_h_reference)
    T_c_robot = se3.inverse(T_own) @ camera_in_base(chain, robot.constants, robot.T_parent_child)
    wheels = robot.wheels.vector - own.parameters.wheels.vector
    apart = np.concatenate([se3.log_so3(T_c_robot[:3, :3]), T_c_robot[:3, 3], wheels])
    by_first, by_head, seen = np.zeros((9, 6)), np.eye(9), np.eye(9)
    by_first[:6] = se3.adjoint(se3.inverse(own.cameras.T_c_reference))
    by_head[:3, :3] = by_head[3:6, 3:6] = robot.T_parent_child[:3, :3].T
    covariance = by_first @ uncertainty.camera[:6, :6] @ by_first.T
    covariance[6:, 6:] = uncertainty.covariance[6:, 6:]
    if robot.knowledge is not None:
        mine = by_head @ np.diag(robot.knowledge.observable.astype(np.float64))
        covariance += mine @ robot.knowledge.covariance @ mine.T
    if uncertainty.described.any():
        upward = T_own[2, :3]
        seen[3:6, 3:6] -= np.outer(upward, upward)
    return seen @ apart, seen @ covariance @ seen


def _agreement(
    robot: CalibratedRobot, own: Solution | MobilecalError, chain: HeadChain, missing: str
) -> Iterator[Check]:
    """Whether each quantity is that of the recording's own estimate, if it has one; without those that no motion
    shows.
    """
    if isinstance(own, MobilecalError):
        yield Metric("own_estimate").check(
            None, None, "estimate from this recording",
            f"{capitalized(own.hint)}." if own.hint else "Record again.",
            measured="none",
            at_limit="all nine parameters",
            why=f"This recording cannot be solved by itself: {own.message}.",
            beyond="not_enough",
        )  # fmt: skip
        return
    uncertainty = own.uncertainty
    assert uncertainty is not None  # the default method always has one
    change, covariance = _apart(robot, own, chain)
    scales = np.array([*[180 / np.pi] * 3, *[1e3] * 3, *(100 / own.parameters.wheels.vector)])
    change, covariance = change * scales, covariance * np.outer(scales, scales)
    hidden = ~(uncertainty.observable | uncertainty.described)
    # What no motion shows comes first: that is why the others are uncertain.
    for key, name, whole, limit, unit in sorted(_QUANTITIES, key=lambda each: not hidden[each[2]].any()):
        if robot.odometry is not None and not key.startswith("camera"):
            name = f"{name} multiplier"  # nobody measured the wheels
        if uncertainty.described[whole].any():
            name = f"{name} without its height"  # which no motion shows
        x, C = change[whole], covariance[whole, whole]
        size = float(np.linalg.norm(x))
        along = x / size if size > 0 else np.eye(len(x))[0]
        sigma, largest = float(np.sqrt(along @ C @ along)), float(np.sqrt(np.linalg.eigvalsh(C)[-1]))
        needed = _SIGMA_SHARE * limit
        measured = f"{value_text(size, largest, 2)} ± {std_text(largest)} {unit}"
        value: float | None = size
        outcome: Outcome = "not_enough"
        why = cure = ""
        if hidden[whole].any():
            value, measured = None, "unobservable"
            why = f"The {name} is unobservable in this recording."
            cure = f"{capitalized(missing or 'record more motion of base and head')}."
        elif size > max(limit, _SIGMAS * sigma):
            outcome = "fail"
            why = f"The {name} differs from this recording by {measured} (limit {limit:g} {unit})."
            cure = "Calibrate again, and check what has changed on the robot: camera mount, tires, load."
        elif largest > needed:
            why = f"This recording gives the {name} to {std_text(largest)} {unit} (1 sigma, limit {needed:.2g} {unit})."
            cure = motion_cure(own.motion, NINE[whole])
            cure = cure or "Record more stations; mobilecal suggest lists the most useful ones."
        yield Metric("agreement", unit).check(
            value, limit, name, cure,
            part=key,
            measured=measured,
            at_limit=f"at most {limit:g} {unit}, or {_SIGMAS:g} sigma",
            why=why,
            passes=not why,
            beyond=outcome,
        )  # fmt: skip


class SpreadData(JsonValue):
    """Root mean square, median and largest error of a leg."""

    rms: float
    median: float
    worst: float


class LegErrorData(JsonValue):
    """Errors on one leg of a recording."""

    log: int
    from_station: int
    to_station: int
    reprojection_px: float
    rotation_deg: float
    translation_mm: float


def _legs(e: Evaluation) -> tuple[LegErrorData, ...]:
    columns = e.legs, e.reprojection_px, e.rotation_rad * DEG, e.translation_m * 1e3
    return tuple(
        LegErrorData(
            log=log, from_station=i, to_station=j, reprojection_px=px, rotation_deg=deg, translation_mm=mm
        )
        for (log, i, j), px, deg, mm in zip(*(column.tolist() for column in columns), strict=True)
    )


def _spread(errors: FloatArray) -> SpreadData:
    return SpreadData(rms=rms(errors), median=float(np.median(errors)), worst=float(errors.max()))


class EvaluationData(JsonValue):
    """Errors of a calibration on stations that it was not made from."""

    stations: int
    legs: int = by(lambda evaluation: len(evaluation.legs))
    driven_m: float
    turned_deg: float
    reprojection_px: SpreadData = by(lambda e: _spread(e.reprojection_px))
    rotation_deg: SpreadData = by(lambda e: _spread(e.rotation_rad * DEG))
    translation_mm: SpreadData = by(lambda e: _spread(e.translation_m * 1e3))
    drift_before: Drift | None = by(lambda e: e.before)
    drift_after: Drift = by(lambda e: e.after)
    per_leg: tuple[LegErrorData, ...] = by(_legs)
    clock_offsets_s: ByName


def evaluation_json(result: Evaluated) -> str:
    """An evaluation with its verdict and gates for programs."""
    numbers = like(EvaluationData, result.evaluation)
    return json_text(
        {
            "schema_version": 2,
            "logs": result.extraction.logs,
            "used_for_calibration": result.used,
            "notes": [*result.notes, *result.extraction.notes],
            **vars(numbers),
            "verdict": result.verdict,
            "gates": [check for check in result.verdict.checks if check.id.startswith(GATE)],
        }
    )


def _shown(value: float, digits: int, most: float) -> str:
    """An error, or that it is beyond the largest one that is counted."""
    return f"{value:.{digits}f}" if value < most else f"> {most:g}"


def evaluation_tables(evaluation: EvaluationData) -> tuple[Table, Table]:
    """The errors on the legs, and the drift of dead reckoning."""
    errors = (
        ("station-to-station corner error", evaluation.reprojection_px, 2, MOST_ERROR_PX, "px"),
        ("camera rotation error", evaluation.rotation_deg, 3, math.inf, "deg"),
        ("camera position error", evaluation.translation_mm, 2, math.inf, "mm"),
    )
    rows = [
        (name, *(_shown(value, digits, most) for value in (spread.rms, spread.median, spread.worst)), unit)
        for name, spread, digits, most, unit in errors
    ]
    before, after = evaluation.drift_before, evaluation.drift_after
    drifts = (
        ("position", "mm per m", before and before.mm_per_m, after.mm_per_m),
        ("heading", "deg per turn", before and before.deg_per_turn, after.deg_per_turn),
    )
    drift = [
        (name, *("-" if value is None else f"{value:.2f}" for value in values), unit)
        for name, unit, *values in drifts
    ]
    heads = ("prediction error on a leg", "number:rms", "number:median", "number:worst", "unit")
    of_drift = ("drift of dead reckoning", "number:wheels before", "number:calibrated wheels", "unit")
    return Table.of(heads, rows, "limits", "Held-out stations"), Table.of(of_drift, drift, "limits")


def evaluation_text(result: Evaluated) -> str:
    """An evaluation and the checks of its verdict for the terminal."""
    data = like(EvaluationData, result.evaluation)
    lines = [line for note in result.notes for line in wrapped(note, "Note: ")]
    motion = f"driven {data.driven_m:.2f} m, turned {data.turned_deg:.0f} deg"
    lines.append(f"{data.stations} stations, {data.legs} legs; {motion}")
    if data.clock_offsets_s:
        offsets = ", ".join(f"{name} {s * 1e3:+.1f} ms" for name, s in data.clock_offsets_s.items())
        lines += wrapped(f"Clock offsets: {offsets}", "", "  ")
    for table in evaluation_tables(data):
        lines += ["", *table.lines()]
    return (
        "\n".join([*lines, "", "Calibration against this recording", *check_lines(result.verdict.checks)])
        + "\n"
    )
