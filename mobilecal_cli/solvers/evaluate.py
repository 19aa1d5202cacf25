"""A calibration evaluated on a recording: predicted motion from station to station, and dead reckoning."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.likelihood.measurements import MotionPairs, heading_of
from mobilecal_cli.likelihood.processes import path_m
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.calibration import Parameters
from mobilecal_cli.model.observations import Extraction
from mobilecal_cli.model.rig import WheelGeometry
from mobilecal_cli.model.solution import MOST_ERROR_PX, Drift, Evaluation, Solution
from mobilecal_cli.solvers.residuals import at_constants, residuals_of
from mobilecal_cli.solvers.transfer import camera_motion, dead_reckoned

#: Below this path length or rotation, the relative error of dead reckoning is mostly noise.
_LEAST_M, _LEAST_RAD = 0.2, 0.35
#: The number of station pairs grows quadratically: longer recordings use this many stations, evenly spaced.
_MOST_STATIONS = 400


def clock_offsets(solution: Solution) -> dict[str, float]:
    """Estimated clock offsets, s: "joints" and "wheels" against the images, "joints_2" of a recording against these."""
    return {
        name.removeprefix("time_"): constant.value
        for name, constant in solution.constants.items()
        if constant.kind == "clock"
    }


def evaluate(
    extraction: Extraction,
    parameters: Parameters,
    before: WheelGeometry | None,
    *,
    offsets_s: Mapping[str, float] | None = None,
    reference: WheelGeometry | None = None,
    constants: Mapping[str, float] | None = None,
) -> Evaluation:
    """Errors of the camera motion predicted over each leg (eq. 18), and of dead reckoning over all station pairs.

    Args:
        extraction: the recording, with at least two observations of one log.
        parameters: the calibration under test.
        before: wheels to compare dead reckoning with.
        offsets_s: clock offsets of the recording, see `clock_offsets`.
        reference: wheels that give path length and rotation, which drift is divided by: an estimate independent of
            the calibration under test. Without them, the cameras give both, from station to station.
        constants: of the robot description, as the calibration has them, by name; as stated without them.
    """
    offsets = dict(offsets_s or {})
    clocks = {f"time_{name}": offset_s for name, offset_s in offsets.items()}
    every = (constants or {}).items()  # clocks belong to a recording
    own = {name: value for name, value in every if not name.startswith(("time_joints", "time_wheels"))}
    shown = at_constants(extraction, parameters, own | clocks)
    pairs, (i, j) = shown.pairs, shown.pairs.legs.T
    o = extraction.observations
    T_ci_cj = pairs.T_c_k[i] @ se3.inverse(pairs.T_c_k[j])
    motion = camera_motion(pairs, parameters)
    apart = se3.inverse(T_ci_cj) @ motion
    behind = np.any(se3.act(motion, pairs.points_c[j])[..., 2] <= 0, axis=-1) & shown.seen[i].any(axis=(1, 2))
    px = np.where(behind, MOST_ERROR_PX, residuals_of(shown, parameters).leg_reprojection_px)
    T_k_v = se3.inverse(pairs.T_v_h @ parameters.T_h_c @ pairs.T_c_k)
    covered = _seen(pairs, T_k_v) if reference is None else _covered(pairs, reference)
    return Evaluation(
        stations=len(o),
        legs=np.array([(o[a].log, o[a].station, o[b].station) for a, b in pairs.legs.tolist()]),
        reprojection_px=np.minimum(px, MOST_ERROR_PX),
        rotation_rad=np.linalg.norm(se3.log_so3(apart[:, :3, :3]), axis=-1),
        translation_m=np.linalg.norm(apart[:, :3, 3], axis=-1),
        driven_m=float(covered[0].sum()),
        turned_rad=float(covered[1].sum()),
        before=_drift(pairs, T_k_v, before, covered) if before is not None else None,
        after=_drift(pairs, T_k_v, parameters.wheels, covered),
        clock_offsets_s=offsets,
    )


def _covered(pairs: MotionPairs, wheels: WheelGeometry) -> tuple[FloatArray, FloatArray]:
    """(L,) path length, m, and (L,) absolute rotation, rad, of each leg."""
    steps = pairs.steps
    right_m, left_m = wheels.radius_right_m * steps.right_rad, wheels.radius_left_m * steps.left_rad
    return path_m(steps, wheels), steps.total(np.abs(right_m - left_m) / wheels.separation_m)


def _seen(pairs: MotionPairs, T_k_v: FloatArray) -> tuple[FloatArray, FloatArray]:
    """(L,) distance, m, and (L,) rotation below a half turn, rad, of the base over each leg, as the board shows."""
    i, j = pairs.legs.T
    moved = se3.inverse(T_k_v[i]) @ T_k_v[j]
    return np.linalg.norm(moved[:, :2, 3], axis=-1), np.abs(heading_of(moved))


def _drift(
    pairs: MotionPairs,
    T_k_v: FloatArray,
    wheels: WheelGeometry,
    covered: tuple[FloatArray, FloatArray],
) -> Drift:
    """Error of dead reckoning with some wheels against the base poses (N, 4, 4) that the board gives.

    It is divided by path and rotation (`covered`), which do not depend on these wheels, so that drifts can be compared.
    """
    reckoned = dead_reckoned(pairs, wheels)
    path, turned = covered
    place_m, heading_rad, covered_m, turned_rad = [], [], [], []
    for legs in (np.flatnonzero(pairs.first_leg == first) for first in np.unique(pairs.first_leg)):
        stations = np.concatenate([pairs.legs[legs, 0], pairs.legs[legs[-1:], 1]])
        so_far = [np.concatenate([[0.0], np.cumsum(values[legs])]) for values in (path, turned)]
        kept = np.unique(np.linspace(0, len(stations) - 1, min(len(stations), _MOST_STATIONS)).astype(int))
        first, second = (kept[index] for index in np.triu_indices(len(kept), 1))
        a, b = stations[first], stations[second]
        T_seen, T_reckoned = se3.inverse(T_k_v[a]) @ T_k_v[b], se3.inverse(reckoned[a]) @ reckoned[b]
        place_m.append(np.linalg.norm((T_reckoned - T_seen)[:, :2, 3], axis=-1))
        heading_rad.append(np.abs(heading_of(se3.inverse(T_seen) @ T_reckoned)))
        covered_m.append(so_far[0][second] - so_far[0][first])
        turned_rad.append(so_far[1][second] - so_far[1][first])
    return Drift(
        _over(np.concatenate(place_m), np.concatenate(covered_m), _LEAST_M, 1e3),
        _over(np.concatenate(heading_rad), np.concatenate(turned_rad), _LEAST_RAD, 360),
    )


def _over(error: FloatArray, covered: FloatArray, least: float, unit: float) -> float | None:
    """Error over what was covered, in some unit; None if less than the least was covered."""
    if not len(covered) or covered.max() < least:
        return None
    return float(np.sqrt(np.mean(error**2) / np.mean(covered**2))) * unit
