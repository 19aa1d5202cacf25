"""Diagnosis of a recording that does not fit its robot: which single mistake in the description would explain it."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.errors import SolveError
from mobilecal_cli.kinematics import FEWEST_LEGS, MotionSeen, motion_seen
from mobilecal_cli.likelihood.dataset import Dataset, dataset_of
from mobilecal_cli.model import Diagnosis, Extraction, FloatArray, Parameters
from mobilecal_cli.solvers.initial import initial_with_prior, linear_estimate
from mobilecal_cli.solvers.linear import InitialPrior, few_rounds, ratios_of
from mobilecal_cli.solvers.mistakes import (
    MOVED,
    STILL,
    Mistake,
    delays,
    exchanged_stations,
    interruptions,
    joint_mistakes,
    reversals,
    wheel_mistakes,
)
from mobilecal_cli.solvers.transfer import point_rms_m

_CLEARLY_BETTER = (
    0.4  # a mistake explains the recording if correcting it shrinks the point error to this share
)
_FITS = (
    0.06  # point error over the distance to the board of a recording that fits; usual cameras: up to 0.035
)
_EQUAL = 1.5  # mistakes whose point errors differ by less cannot be distinguished
_SAME_RAD = (
    0.5  # mistakes are distinguished by the camera's rotation from its nominal one, if it differs by more
)
_ROUNDS = 12  # of the linear method
_TURNED_RAD = 0.5  # wheel rotation: with less, noise and unequal wheels look like a turn


@dataclass(frozen=True, slots=True)
class _Score:
    """Fit of the linear method: point error over the distance to the board, and rotation from the nominal camera."""

    error: float
    turned_rad: float


def _score(extraction: Extraction, starts: list[FloatArray]) -> _Score | None:
    """Fit of the best of some starts, wheel ratios (2,); None where none gives positive wheels."""
    data = dataset_of(extraction)
    pairs, seen, prior = data.pairs, _motion(data), InitialPrior(None, extraction.rig.nominal.wheels)
    full = seen.tilts and seen.turns and seen.drives
    found: list[tuple[float, Parameters]] = []
    for ratios in starts if full else starts[:1]:
        try:
            # Without full motion, the linear method alone finds any wheels, those of a mistake or none at all.
            parameters = (
                few_rounds(pairs, ratios, _ROUNDS) if full else initial_with_prior(pairs, prior, seen)
            )
        except (SolveError, np.linalg.LinAlgError):
            continue
        if np.all(parameters.wheels.vector > 0):
            found.append((point_rms_m(pairs, parameters), parameters))
    if not found:
        return None
    rms, best = min(found, key=lambda item: item[0])
    distance_m = float(np.linalg.norm(pairs.points_c, axis=-1).mean())
    nominal, turned = extraction.rig.nominal.T_h_reference, 0.0
    if nominal is not None:
        R = nominal[:3, :3] @ extraction.rig.cameras.T_c_reference[:3, :3].T
        turned = float(np.linalg.norm(se3.log_so3(best.T_h_c[:3, :3] @ R.T)))
    return _Score(rms / distance_m, turned)


def _motion(data: Dataset) -> MotionSeen:
    return motion_seen(data.pairs.T_v_h, data.pairs.steps.totals_rad, data.encoder_step_rad)


def _has_full_motion(extraction: Extraction) -> bool:
    seen = _motion(dataset_of(extraction))
    return seen.tilts and seen.drives and seen.turned_rad > _TURNED_RAD


def _starts(extraction: Extraction) -> list[FloatArray]:
    """Wheel ratios to start from: nominal ones, and those of the recording as it stands, with the right signs."""
    nominal, starts = extraction.rig.nominal.wheels, []
    if nominal is not None:
        starts.append(ratios_of(nominal))
    pairs = dataset_of(extraction).pairs
    if len(pairs.legs) >= 3:
        try:
            as_is = linear_estimate(pairs, nominal).parameters
        except (SolveError, np.linalg.LinAlgError):
            return starts
        starts.append(np.abs(ratios_of(as_is.wheels)) * [1.0, -1.0])
    return starts


def diagnose(extraction: Extraction) -> Diagnosis | None:
    """The mistake in the description that explains a recording which does not fit; None if none of the known does.

    Signs of every joint and wheel, exchanged joints and wheels, units, and readings that stop, are late, change their
    sign or belong to another station are tried one at a time with the linear method. A joint or a wheel without any
    motion is named where nothing else explains the recording.

    Args:
        extraction: a recording that could not be solved, or only badly.
    """
    starts = _starts(extraction)
    as_is = _score(extraction, starts)
    base = math.inf if as_is is None else as_is.error
    full = _has_full_motion(extraction)

    def explaining(mistakes: Iterable[Mistake]) -> list[tuple[_Score, Mistake]]:
        found = []
        for mistake in mistakes:
            corrected = mistake.corrected(extraction)
            if not (full or _has_full_motion(corrected)):
                continue  # such motion does not tell mistakes apart
            score = _score(corrected, starts)
            if score is not None and score.error < min(_CLEARLY_BETTER * base, _FITS):
                found.append((score, mistake))
        return found

    found = explaining((*joint_mistakes(extraction.rig.chain), *wheel_mistakes(), *interruptions(extraction)))
    if not found:
        frozen = _frozen(extraction)
        if frozen is not None:
            return frozen
        found = explaining((*delays(extraction), *exchanged_stations(), *reversals(extraction)))
    if not found:
        return _of_one_log(extraction)
    least = min(score.error for score, _ in found)
    equal = [(score, mistake) for score, mistake in found if score.error < _EQUAL * least]
    nearest = min(score.turned_rad for score, _ in equal)
    named = [mistake for score, mistake in equal if score.turned_rad < nearest + _SAME_RAD]
    return Diagnosis(
        " or ".join(mistake.cause for mistake in named),
        ", or ".join(mistake.cure for mistake in named),
        None if not math.isfinite(base) else base,
        least,
    )


def _of_one_log(extraction: Extraction) -> Diagnosis | None:
    """The mistake of one of several recordings."""
    logs = len(extraction.wheels)
    for log in range(logs if logs > 1 else 0):
        alone = tuple(replace(o, log=0) for o in extraction.observations if o.log == log)
        if len(alone) <= FEWEST_LEGS:
            continue
        tracks = extraction.joint_tracks[log : log + 1]
        one = replace(extraction, observations=alone, wheels=(extraction.wheels[log],), joint_tracks=tracks)
        found = diagnose(one)
        if found is not None:
            return replace(found, cause=f"recording {log + 1} of {logs}: {found.cause}")
    return None


def _frozen(extraction: Extraction) -> Diagnosis | None:
    """Joints that have the same reading at all stations while others move, or wheels."""
    frozen = [
        name
        for name in ("right", "left")
        if all(np.ptp(getattr(track, name).value) < STILL for track in extraction.wheels)
    ]
    if len(frozen) == 1:
        return Diagnosis(
            f"the reading of the {frozen[0]} wheel never changes, and that of the other wheel does",
            "check the cable and the driver of this encoder, and record again",
            None,
            None,
        )
    if frozen:
        return Diagnosis(
            "the readings of both wheels never change, and the images do not fit a base at rest",
            "check that the wheel encoders are recorded while the base moves",
            None,
            None,
        )
    readings = np.stack([o.joints for o in extraction.observations])
    still = [
        name
        for name, extent in zip(extraction.rig.chain.joints, np.ptp(readings, axis=0), strict=True)
        if extent < STILL
    ]
    if not still or np.ptp(readings, axis=0).max() < MOVED:
        return None
    return Diagnosis(
        f"the reading of {', '.join(still)} never changes, and the images do not fit a joint at rest",
        "check that this joint's state is recorded while it moves",
        None,
        None,
    )
