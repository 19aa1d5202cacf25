"""PASS, FAIL or NOT ENOUGH for a calibration that is evaluated on a recording.

The recording is also solved by itself. The calibration fails where it differs from that estimate by more than a
limit and by more than the uncertainty of both explains, so noise alone does not fail it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from mobilecal_cli.comparison import nine_apart
from mobilecal_cli.errors import MobilecalError
from mobilecal_cli.model import BoolArray, CalibratedRobot, Evaluation, FloatArray, StereoRig
from mobilecal_cli.report.check import Check, Outcome
from mobilecal_cli.report.verdict import MIN_STATIONS, PIXEL_ERROR_BAD, Verdict

#: Largest differences that pass. Two recordings of an unchanged robot differ by a tenth of this.
CAMERA_DEG, CAMERA_MM, RADIUS_PERCENT, SEPARATION_PERCENT = 0.75, 20.0, 1.0, 2.0
#: A difference counts from so many standard deviations on.
SIGMAS = 3.0
#: The standard deviation may be this share of the limit: a difference of twice the limit is then 4 sigma.
SIGMA_SHARE = 0.5
#: Corner errors above the limit fail the calibration if they are so many times those of the recording's own estimate.
_TIMES_OWN = 1.5
_QUANTITIES = (
    ("camera rotation", slice(0, 3), "deg", CAMERA_DEG),
    ("camera position", slice(3, 6), "mm", CAMERA_MM),
    ("right wheel radius", slice(6, 7), "%", RADIUS_PERCENT),
    ("left wheel radius", slice(7, 8), "%", RADIUS_PERCENT),
    ("wheel separation", slice(8, 9), "%", SEPARATION_PERCENT),
)


@dataclass(frozen=True, slots=True, eq=False)
class OwnEstimate:
    """What a recording gives when it is solved by itself.

    Attributes:
        robot: the nine parameters with their covariance.
        reprojection_px: (L,) station-to-station corner error of each inlier leg.
        cure: the motion that makes the unobservable parameters observable; empty if all are.
    """

    robot: CalibratedRobot
    reprojection_px: FloatArray
    cure: str = ""


def judge_evaluation(
    found: Evaluation,
    cameras: StereoRig,
    robot: CalibratedRobot,
    own: OwnEstimate | MobilecalError,
    used: Sequence[str] = (),
    gates: Sequence[Check] = (),
) -> Verdict:
    """Verdict on a calibration. A failed check comes before one that lacks data.

    Args:
        found: errors of the calibration on the recording.
        cameras: the recording's stereo pair.
        robot: the calibration under test.
        own: the recording's own estimate, or the error that prevented it.
        used: names of the recordings that the calibration was made from.
        gates: the user's limits, see `gate_checks`.
    """
    checks = (*_checks(found, cameras, robot, own), *gates)
    for outcome, level in (("bad", "FAIL"), ("short", "NOT ENOUGH")):
        for check in checks:
            if check.outcome == outcome:
                return Verdict(level, check.why, check.next_step, checks)  # type: ignore[arg-type]
    agreement = ", ".join(f"{check.name} {check.measured}" for check in checks[2:7])
    next_step = "Use params.yaml on the robot."
    if used:
        next_step = "Evaluate a recording that was not used for this calibration."
    return Verdict("PASS", f"The calibration agrees with this recording: {agreement}.", next_step, checks)


def _checks(
    found: Evaluation, cameras: StereoRig, robot: CalibratedRobot, own: OwnEstimate | MobilecalError
) -> Iterator[Check]:
    yield Check(
        "stations",
        str(found.stations),
        f"at least {MIN_STATIONS}",
        "good" if found.stations >= MIN_STATIONS else "short",
        f"Both cameras see the board at {found.stations} stations; at least {MIN_STATIONS} are needed.",
        "Record at least ten stations.",
    )
    yield _corners(found, cameras, own)
    if isinstance(own, MobilecalError):
        yield Check(
            "estimate from this recording",
            "none",
            "all nine parameters",
            "short",
            f"This recording cannot be solved by itself: {own.message}.",
            f"{own.hint[:1].upper()}{own.hint[1:]}." if own.hint else "Record again.",
        )
        return
    yield from _differences(robot, own)


def _corners(found: Evaluation, cameras: StereoRig, own: OwnEstimate | MobilecalError) -> Check:
    """A gross error of the calibration, or of a recording that no calibration explains."""
    limit_px = PIXEL_ERROR_BAD * float(cameras.left.K[0, 0])
    px = float(np.median(found.reprojection_px))
    best_px = limit_px if isinstance(own, MobilecalError) else float(np.median(own.reprojection_px))
    unexplained = best_px > limit_px
    outcome: Outcome = (
        "short" if unexplained else "bad" if px > _TIMES_OWN * best_px and px > limit_px else "good"
    )
    return Check(
        "median station-to-station corner error",
        f"{px:.2f} px",
        f"at most {max(limit_px, _TIMES_OWN * best_px):.1f} px",
        outcome,
        f"No parameters explain this recording: the best leave {best_px:.1f} px (limit {limit_px:.1f} px)."
        if unexplained
        else f"The median station-to-station corner error is {px:.1f} px (limit {limit_px:.1f} px)"
        + (
            "."
            if isinstance(own, MobilecalError)
            else f"; the recording's own estimate leaves {best_px:.1f} px."
        ),
        "Check for wheel slip, a moved board and wrong encoder settings, and record again."
        if unexplained
        else "Check that params.yaml belongs to this robot and is in meters; otherwise calibrate again.",
    )


def _differences(robot: CalibratedRobot, own: OwnEstimate) -> Iterator[Check]:
    change, covariance, known = _compared(robot, own.robot)
    for name, part, unit, limit in _QUANTITIES:
        limits = f"at most {limit:g} {unit}, or {SIGMAS:g} sigma"
        if not known[part].all():
            yield Check(
                name,
                "unobservable",
                limits,
                "short",
                f"The {name} is unobservable in this recording.",
                f"{own.cure[:1].upper()}{own.cure[1:]}."
                if own.cure
                else "Record more motion of base and head.",
            )
            continue
        x, C = change[part], covariance[part, part]
        size = float(np.linalg.norm(x))
        along = x / size if size > 0 else np.eye(len(x))[0]
        sigma, largest = float(np.sqrt(along @ C @ along)), float(np.sqrt(np.linalg.eigvalsh(C)[-1]))
        needed = SIGMA_SHARE * limit
        outcome: Outcome = "good"
        if size > max(limit, SIGMAS * sigma):
            outcome = "bad"
        elif largest > needed:
            outcome = "short"
        yield Check(
            name,
            f"{size:.2g} ± {sigma:.1g} {unit}",
            limits,
            outcome,
            f"The {name} differs from this recording by {size:.2g} ± {sigma:.1g} {unit} (limit {limit:g} {unit})."
            if outcome == "bad"
            else f"This recording gives the {name} to {largest:.2g} {unit} (1 sigma); {needed:.2g} {unit} are needed.",
            "Calibrate again, and check what has changed on the robot: camera mount, tires, load."
            if outcome == "bad"
            else "Record more stations; mobilecal suggest lists the most useful ones.",
        )


def _compared(robot: CalibratedRobot, own: CalibratedRobot) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Difference in deg, mm and percent, (9,); its covariance, (9, 9); and which of it is known, (9,)."""
    wheels = own.wheels
    scales = np.array(
        [*[180 / np.pi] * 3, *[1e3] * 3]
        + [100 / size for size in (wheels.radius_right_m, wheels.radius_left_m, wheels.separation_m)]
    )
    covariance: FloatArray = np.zeros((9, 9))
    known: BoolArray = np.zeros(9, dtype=np.bool_)
    if own.knowledge is not None:
        covariance, known = own.knowledge.covariance.copy(), own.knowledge.observable
    if robot.knowledge is not None:
        mine = np.diag(robot.knowledge.observable.astype(np.float64))
        covariance += mine @ robot.knowledge.covariance @ mine
    return nine_apart(own, robot) * scales, covariance * np.outer(scales, scales), known
