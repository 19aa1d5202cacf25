"""PASS, FAIL or NOT ENOUGH for a calibration that is evaluated on a recording.

The recording is also solved by itself. The calibration fails where it differs from that estimate by more than a
limit and by more than the uncertainty of both explains, so noise alone does not fail it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from mobilecal_cli.comparison import nine_apart
from mobilecal_cli.errors import MobilecalError
from mobilecal_cli.model import BoolArray, CalibratedRobot, Evaluation, FloatArray, StereoRig
from mobilecal_cli.report.check import Check, Checks, enough
from mobilecal_cli.report.checks.faults import PIXEL_ERROR_BAD
from mobilecal_cli.report.checks.recording import MIN_STATIONS
from mobilecal_cli.report.values import Outcome
from mobilecal_cli.report.verdict import LEVELS, Verdict, decided_by
from mobilecal_cli.report.wording.evaluation import agreement

#: Largest differences that pass. Two recordings of an unchanged robot differ by a tenth of this.
CAMERA_DEG, CAMERA_MM, RADIUS_PERCENT, SEPARATION_PERCENT = 0.75, 20.0, 1.0, 2.0
#: A difference counts from so many standard deviations on.
SIGMAS = 3.0
#: The standard deviation may be this share of the limit: a difference of twice the limit is then 4 sigma.
SIGMA_SHARE = 0.5
#: Corner errors above the limit fail the calibration if they are so many times those of the recording's own estimate.
_TIMES_OWN = 1.5
_QUANTITIES = (
    ("camera_rotation", slice(0, 3), CAMERA_DEG),
    ("camera_position", slice(3, 6), CAMERA_MM),
    ("radius_right", slice(6, 7), RADIUS_PERCENT),
    ("radius_left", slice(7, 8), RADIUS_PERCENT),
    ("separation", slice(8, 9), SEPARATION_PERCENT),
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
    checks = Checks((*_checks(found, cameras, robot, own), *gates))
    order = ("pass", "warning", "not_enough", "fail")
    worst = max(checks, key=lambda check: order.index(check.outcome))
    if worst.outcome in LEVELS:
        return decided_by(worst, checks)
    return Verdict("PASS", *agreement(checks, independent=not used), checks)


def _checks(
    found: Evaluation, cameras: StereoRig, robot: CalibratedRobot, own: OwnEstimate | MobilecalError
) -> Iterator[Check]:
    outcome = enough(found.stations, MIN_STATIONS)
    yield Check("evaluated_stations", found.stations, MIN_STATIONS, outcome)
    yield _corners(found, cameras, own)
    if isinstance(own, MobilecalError):
        facts = {"message": own.message, "hint": own.hint}
        yield Check("own_estimate", None, None, "not_enough", facts)
        return
    yield from _differences(robot, own)


def _corners(found: Evaluation, cameras: StereoRig, own: OwnEstimate | MobilecalError) -> Check:
    """A gross error of the calibration, or of a recording that no calibration explains."""
    limit_px = PIXEL_ERROR_BAD * float(cameras.left.K[0, 0])
    px = float(np.median(found.reprojection_px))
    best_px = limit_px if isinstance(own, MobilecalError) else float(np.median(own.reprojection_px))
    unexplained = best_px > limit_px
    outcome: Outcome = (
        "not_enough" if unexplained else "fail" if px > _TIMES_OWN * best_px and px > limit_px else "pass"
    )
    facts = {"limit_px": limit_px, "best_px": None if isinstance(own, MobilecalError) else best_px}
    return Check("corner_error", px, max(limit_px, _TIMES_OWN * best_px), outcome, facts)


def _differences(robot: CalibratedRobot, own: OwnEstimate) -> Iterator[Check]:
    change, covariance, known = _compared(robot, own.robot)
    for name, part, limit in _QUANTITIES:
        facts: dict[str, Any] = {"sigmas": SIGMAS, "cure": own.cure}
        if not known[part].all():
            yield Check(f"agreement.{name}", None, limit, "not_enough", facts)
            continue
        x, C = change[part], covariance[part, part]
        size = float(np.linalg.norm(x))
        along = x / size if size > 0 else np.eye(len(x))[0]
        sigma, largest = float(np.sqrt(along @ C @ along)), float(np.sqrt(np.linalg.eigvalsh(C)[-1]))
        needed = SIGMA_SHARE * limit
        outcome: Outcome = "pass"
        if size > max(limit, SIGMAS * sigma):
            outcome = "fail"
        elif largest > needed:
            outcome = "not_enough"
        facts |= {"sigma": sigma, "largest": largest, "needed": needed}
        yield Check(f"agreement.{name}", size, limit, outcome, facts)


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
