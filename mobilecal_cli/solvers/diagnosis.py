"""Diagnosis of a recording that does not fit its robot: which single mistake in the description would explain it."""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.errors import SolveError
from mobilecal_cli.kinematics import FEWEST_LEGS, MotionSeen, motion_seen
from mobilecal_cli.likelihood.dataset import Dataset, MotionPairs, dataset_of
from mobilecal_cli.model import Diagnosis, Extraction, FloatArray, Observation, Parameters, WheelGeometry
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
_OTHER_WHEELS = 3.0  # times the nominal radius; no tire differs by so much
_SAME_UNIT = 0.05  # m
_ROUNDS = 12  # of the linear method
_MOST_LEGS = 80  # that a fit of the linear method uses, spread over the recording
_SAME_VIEW = 0.01  # rad, and share of the distance: motion that moves the image by a few pixels
_FEWEST_IN_PART = 5  # stations before or after a change
_CHANGED_SCALE = (
    0.05  # of a wheel's readings: less is within the noise of the linear method on a few stations
)
_TURNED_RAD = 0.5  # wheel rotation: with less, noise and unequal wheels look like a turn


@dataclass(frozen=True, slots=True)
class _Score:
    """Fit of the linear method.

    Attributes:
        error: point error over the distance to the board.
        turned_rad: rotation of the camera from its nominal one.
        wheels: the estimate.
    """

    error: float
    turned_rad: float
    wheels: WheelGeometry


def _score(extraction: Extraction, starts: list[FloatArray]) -> _Score | None:
    """Fit of the best of some starts, wheel ratios (2,); None where none gives positive wheels."""
    data = dataset_of(extraction)
    seen, prior = _motion(data), InitialPrior(None, extraction.rig.nominal.wheels)
    pairs = _thinned(data)
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
    return _Score(rms / distance_m, turned, best.wheels)


def _thinned(data: Dataset) -> MotionPairs:
    """All legs, or some of many: mistakes show in a few, and the search takes some hundred fits."""
    legs = len(data.legs)
    if legs <= _MOST_LEGS:
        return data.pairs
    return data.pairs.select(np.linspace(0, legs - 1, _MOST_LEGS).round().astype(np.int64))


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
    pairs = _thinned(dataset_of(extraction))
    if len(pairs.legs) >= 3:
        try:
            as_is = linear_estimate(pairs, nominal).parameters
        except (SolveError, np.linalg.LinAlgError):
            return starts
        starts.append(np.abs(ratios_of(as_is.wheels)) * [1.0, -1.0])
    return starts


def misfit(extraction: Extraction) -> float | None:
    """Point error of the linear method over the distance to the board; None if it fits, or has no solution."""
    found = _score(extraction, _starts(extraction))
    return None if found is None or found.error < _FITS else found.error


def diagnose(extraction: Extraction, *, whole: bool = True) -> Diagnosis | None:
    """The mistake in the description that explains a recording which does not fit; None if none of the known does.

    Signs of every joint and wheel, exchanged joints and wheels, units, and readings that stop, are late, change their
    sign or belong to another station are tried one at a time with the linear method. A joint or a wheel without any
    motion is named where nothing else explains the recording, and then a change in the middle of it.

    Args:
        extraction: a recording that could not be solved, or only badly.
        whole: also look for a change in the middle.
    """
    if _sees_no_motion(extraction):
        return Diagnosis(
            "all stations show the board at the same place, but the base or the head moves",
            "check that the images are not frozen, and that the board does not move with the robot",
            None,
            None,
        )
    starts = _starts(extraction)
    as_is = _score(extraction, starts)
    base = math.inf if as_is is None else as_is.error
    other = _other_wheels(as_is, extraction.rig.nominal.wheels)
    if other is not None:
        return other
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
        return _of_one_log(extraction) or (_changed(extraction, starts, base) if whole else None)
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
        one = extraction.of_log(log)
        if len(one.observations) <= FEWEST_LEGS:
            continue
        found = diagnose(one)
        if found is not None:
            return replace(found, cause=f"recording {log + 1} of {logs}: {found.cause}")
    return None


def _changed(extraction: Extraction, starts: list[FloatArray], base: float) -> Diagnosis | None:
    """A change between two stations: the parts before and after fit on their own, but not together."""
    seen = extraction.observations
    if len(extraction.wheels) > 1:
        return None
    limit = min(_CLEARLY_BETTER * base, _FITS)

    def fit(part: tuple[Observation, ...]) -> _Score | None:
        of_part = replace(extraction, observations=part)
        return _score(of_part, starts) if _has_full_motion(of_part) else None

    @cache
    def parts(cut: int) -> tuple[_Score | None, _Score | None]:
        return fit(seen[:cut]), fit(seen[cut:])

    # A part with stations of the other one fits worse, so the change is where the two fit alike.
    low, high = _FEWEST_IN_PART, len(seen) - _FEWEST_IN_PART
    while low < high:
        middle = (low + high) // 2
        before, after = parts(middle)
        later = before is None or (after is not None and before.error < after.error)
        low, high = (middle + 1, high) if later else (low, middle)
    near = range(max(low - 1, _FEWEST_IN_PART), min(low + 2, len(seen) - _FEWEST_IN_PART + 1))
    found = [(max(x.error, y.error), cut, x, y) for cut in near for x, y in [parts(cut)] if x and y]
    error, cut, before, after = min(found, key=lambda item: item[0], default=(math.inf, 0, None, None))
    if before is None or after is None or error >= limit:
        return _wrong_after(extraction, _last_fit(fit, seen, limit))
    (track,) = extraction.wheels
    begin, end = ((o.time_ns - int(track.time_ns[0])) / 1e9 for o in seen[cut - 1 : cut + 1])
    scale = before.wheels.vector[:2] / after.wheels.vector[:2]  # larger readings look like smaller wheels
    changed = [
        f"the {side} wheel's readings become {factor:.2g} times as large"
        for side, factor in zip(("right", "left"), scale.tolist(), strict=True)
        if abs(factor - 1) > _CHANGED_SCALE
    ]
    what = " and ".join(changed) or "a joint, a camera or the board changes"
    return Diagnosis(
        f"{what} between {begin:.1f} and {end:.1f} s: the recording fits before and after, but not as a whole",
        "check the wheels, the head, the cameras and the board at this time, and record again without the change",
        None if not math.isfinite(base) else base,
        error,
    )


def _last_fit(
    fit: Callable[[tuple[Observation, ...]], _Score | None], seen: tuple[Observation, ...], limit: float
) -> int:
    """The number of first stations, about, that fit on their own; 0 if none do."""
    sizes = range(_FEWEST_IN_PART, len(seen) - _FEWEST_IN_PART + 1)

    def too_many(size: int) -> bool:
        found = fit(seen[:size])
        return found is not None and found.error >= limit

    size = bisect_left(sizes, True, key=too_many)
    return sizes[size - 1] if size and fit(seen[: sizes[size - 1]]) else 0


def _wrong_after(extraction: Extraction, cut: int) -> Diagnosis | None:
    """The mistake of the stations from one on, before which the recording fits; none for the first station."""
    if not cut:
        return None
    seen, (track,) = extraction.observations, extraction.wheels
    found = diagnose(replace(extraction, observations=seen[cut:]), whole=False)
    if found is None:
        return None
    begin_s = (seen[cut].time_ns - int(track.time_ns[0])) / 1e9
    return replace(found, cause=f"from {begin_s:.1f} s on, {found.cause}")


def _sees_no_motion(extraction: Extraction) -> bool:
    """Whether all stations show the board at the same place while joints or wheels move."""
    seen = extraction.observations
    away = se3.inverse(seen[0].T_c_k) @ np.stack([o.T_c_k for o in seen])
    distance_m = float(np.linalg.norm(seen[0].T_c_k[:3, 3]))
    still = np.linalg.norm(se3.log_so3(away[:, :3, :3]), axis=-1).max() < _SAME_VIEW
    still &= np.linalg.norm(away[:, :3, 3], axis=-1).max() < _SAME_VIEW * distance_m
    if not still:
        return False
    moves = [np.ptp(np.stack([o.joints for o in seen]), axis=0)]
    for log, track in enumerate(extraction.wheels):
        times = np.array([o.time_ns for o in seen if o.log == log], dtype=np.int64)
        moves += [np.array([np.ptp(side.at(times))]) for side in (track.right, track.left) if len(times)]
    return bool(np.concatenate(moves).max() > MOVED)


def _other_wheels(found: _Score | None, nominal: WheelGeometry | None) -> Diagnosis | None:
    """Wheel radii that fit the recording but are several times the nominal ones: readings in another unit."""
    if nominal is None or found is None or found.error >= _FITS:
        return None
    radii_m = found.wheels.vector[:2]
    factor = float(np.mean(radii_m / nominal.vector[:2]))
    if 1 / _OTHER_WHEELS < factor < _OTHER_WHEELS:
        return None
    right, left = (f"{1e3 * radius_m:.4g}" for radius_m in radii_m)
    meters = " (1 m: the readings are in meters)" if abs(radii_m - 1).max() < _SAME_UNIT else ""
    return Diagnosis(
        f"the wheel radii that fit are {right} and {left} mm, {factor:.2g} times the nominal ones{meters}",
        "check the unit and the ticks_per_revolution of the wheel readings (radians are expected), and a gear ratio",
        None,
        None,
    )


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
