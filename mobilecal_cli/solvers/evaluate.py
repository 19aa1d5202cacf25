"""A calibration tried on a recording: what it predicts from station to station, against what the board shows."""

from __future__ import annotations

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.model import Drift, Evaluation, Extraction, FloatArray, IntArray, Parameters, WheelGeometry
from mobilecal_cli.solvers.carry import camera_motion
from mobilecal_cli.solvers.loops import Loops, closed_loops
from mobilecal_cli.solvers.residuals import dead_reckoned, residuals_of

#: With less of a way or a rotation between stations, their error over it says nothing of the wheels.
_LEAST_M, _LEAST_RAD = 0.2, 0.35
#: Pairs of stations grow with the square of their number: of long logs so many stations make them.
_MOST_STATIONS = 400


def evaluate(extraction: Extraction, parameters: Parameters, before: WheelGeometry | None) -> Evaluation:
    """Predict the camera's motion over each leg by eq. 18, and the base's over every pair of stations.

    Args:
        extraction: the recording, at least two observations of one log.
        parameters: the calibration, which the extraction does not change.
        before: wheels that dead reckoning is compared with.
    """
    loops = closed_loops(extraction)
    i, j = loops.legs.T
    o = extraction.observations
    seen = loops.T_c_k[i] @ se3.inverse(loops.T_c_k[j])
    apart = se3.inverse(seen) @ camera_motion(loops, parameters)
    way, turned = _way(loops, parameters.wheels)
    return Evaluation(
        stations=len(o),
        legs=np.array([(o[a].log, o[a].station, o[b].station) for a, b in loops.legs.tolist()]),
        reprojection_px=residuals_of(extraction, loops, parameters).leg_reprojection_px,
        rotation_rad=np.linalg.norm(se3.log_so3(apart[:, :3, :3]), axis=-1),
        translation_m=np.linalg.norm(apart[:, :3, 3], axis=-1),
        driven_m=float(way.sum()),
        turned_rad=float(turned.sum()),
        before=_drift(loops, parameters, before) if before is not None else None,
        after=_drift(loops, parameters, parameters.wheels),
    )


def _way(loops: Loops, wheels: WheelGeometry) -> tuple[FloatArray, FloatArray]:
    """(L,) length of the way and (L,) rotation, both without sign, m and rad, along each leg."""
    steps = loops.steps
    path_m = (wheels.radius_right_m * steps.right_rad + wheels.radius_left_m * steps.left_rad) / 2
    turn_rad = (
        wheels.radius_right_m * steps.right_rad - wheels.radius_left_m * steps.left_rad
    ) / wheels.separation_m
    return steps.total(np.abs(path_m)), steps.total(np.abs(turn_rad))


def _drift(loops: Loops, parameters: Parameters, wheels: WheelGeometry) -> Drift:
    """Dead reckoning by some wheels against the base's places that the board shows.

    Way and rotation are those of the calibrated wheels, so that two drifts can be compared.
    """
    reckoned = dead_reckoned(loops, Parameters(parameters.T_h_c, wheels))
    T_k_v = se3.inverse(loops.T_v_h @ parameters.T_h_c @ loops.T_c_k)
    way, turned = _way(loops, parameters.wheels)
    place_m, heading_rad, way_m, turned_rad = [], [], [], []
    for legs in _logs(loops):
        stations = np.concatenate([loops.legs[legs, 0], loops.legs[legs[-1:], 1]])
        covered = [np.concatenate([[0.0], np.cumsum(values[legs])]) for values in (way, turned)]
        kept = np.unique(np.linspace(0, len(stations) - 1, min(len(stations), _MOST_STATIONS)).astype(int))
        first, second = (kept[index] for index in np.triu_indices(len(kept), 1))
        a, b = stations[first], stations[second]
        T_seen, T_reckoned = se3.inverse(T_k_v[a]) @ T_k_v[b], se3.inverse(reckoned[a]) @ reckoned[b]
        place_m.append(np.linalg.norm((T_reckoned - T_seen)[:, :2, 3], axis=-1))
        heading_rad.append(np.abs(_heading(se3.inverse(T_seen) @ T_reckoned)))
        way_m.append(covered[0][second] - covered[0][first])
        turned_rad.append(covered[1][second] - covered[1][first])
    return Drift(
        _over(np.concatenate(place_m), np.concatenate(way_m), _LEAST_M),
        _over(np.concatenate(heading_rad), np.concatenate(turned_rad), _LEAST_RAD),
    )


def _logs(loops: Loops) -> list[IntArray]:
    """The legs of each log."""
    return [np.flatnonzero(loops.chain == first) for first in np.unique(loops.chain)]


def _heading(T: FloatArray) -> FloatArray:
    """Rotation about z of (n, 4, 4), rad."""
    return np.asarray(np.arctan2(T[:, 1, 0], T[:, 0, 0]))


def _over(error: FloatArray, covered: FloatArray, least: float) -> float | None:
    if not len(covered) or covered.max() < least:
        return None
    return float(np.sqrt(np.mean(error**2) / np.mean(covered**2)))
