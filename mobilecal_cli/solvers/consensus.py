"""Initial parameters from the few legs that most others agree with: bad stations and slips have no influence."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.errors import SolveError
from mobilecal_cli.kinematics import head_jacobian, integrate
from mobilecal_cli.likelihood.dataset import Dataset
from mobilecal_cli.likelihood.legs import leg_covariances
from mobilecal_cli.likelihood.measurements import MotionPairs
from mobilecal_cli.likelihood.noise import Inliers, own_sigmas
from mobilecal_cli.model import BoolArray, FloatArray, IntArray, Noise, Parameters
from mobilecal_cli.solvers.transfer import base_motion, camera_motion

_DRAWN_LEGS = 4
_DRAWS = 300
_AGREEING = 0.45  # a fifth of bad stations and a slip affect up to half of the legs
_USUAL = 5.3  # the median of chi-squared with six degrees of freedom; 0.45 of all is more of the good ones
_BAD_LEG = 30.0  # chi-squared with six degrees of freedom exceeds it once in 25,000
_POLISH = 3
_FEW_DRAWS, _GOOD_ENOUGH = 20, 2.0  # parameters this good (in variance) after so many draws end the search


@dataclass(frozen=True, slots=True, eq=False)
class Consensus:
    """Parameters on which most legs agree.

    Attributes:
        parameters: fitted to the agreeing legs.
        bad: (L,) legs that do not agree.
        noise_factor: noise of the agreeing legs over the supposed one.
    """

    parameters: Parameters
    bad: BoolArray
    noise_factor: float


def leg_spread(data: Dataset, parameters: Parameters, noise: Noise) -> FloatArray:
    """Covariance of each leg's disagreement between wheels and cameras: (L, 6, 6), left twists in the first camera.

    Args:
        data: the legs.
        parameters: approximate.
        noise: of wheels, joints and floor.
    """
    pairs = data.pairs
    i, j = pairs.legs.T
    T_ci_cj = camera_motion(pairs, parameters)
    X = parameters.T_h_c
    J = np.concatenate(
        [
            se3.adjoint(se3.inverse(X)) @ head_jacobian(data.chain, data.joints),
            se3.adjoint(se3.inverse(pairs.T_v_h @ X))[:, :, [0, 1, 5]],  # roll, pitch and height of the base
        ],
        axis=2,
    )
    sigma = own_sigmas(data, Inliers.all_of(data), noise)
    sigma[:, -3:] = np.hypot(sigma[:, -3:], [noise.floor_rad, noise.floor_rad, noise.floor_m])
    of_joints = (J * sigma[:, None, :] ** 2) @ np.swapaxes(J, 1, 2)
    of_station = of_joints + data.T_c_k_cov
    Ad = se3.adjoint(T_ci_cj)
    T_vi_vj = base_motion(integrate(pairs.steps, parameters.wheels))
    to_camera = se3.adjoint(se3.inverse(pairs.T_v_h[i] @ X) @ T_vi_vj)
    by_leg = np.zeros((len(i), 6, 3))
    by_leg[:, 2, 2] = 1.0
    by_leg[:, 3:5, :2] = np.swapaxes(T_vi_vj[:, :2, :2], 1, 2)
    by_leg = to_camera @ by_leg
    covariance = np.asarray(sum(leg_covariances(data.steps(), parameters.wheels, noise).values()))
    of_wheels = by_leg @ covariance @ np.swapaxes(by_leg, 1, 2)
    spread: FloatArray = of_station[i] + Ad @ of_station[j] @ np.swapaxes(Ad, 1, 2) + of_wheels
    return spread


def disagreement(pairs: MotionPairs, parameters: Parameters, weight: FloatArray) -> FloatArray:
    """(L,) squared distance between wheels and cameras over each leg, in units of the spread."""
    i, j = pairs.legs.T
    T_ci_cj = pairs.T_c_k[i] @ se3.inverse(pairs.T_c_k[j])
    delta = se3.log(camera_motion(pairs, parameters) @ se3.inverse(T_ci_cj))
    return np.asarray(np.einsum("la,lab,lb->l", delta, weight, delta))


def _draws(legs: int, random: np.random.Generator) -> Iterator[IntArray]:
    size = min(_DRAWN_LEGS, legs)
    if legs <= 12:
        everything = list(itertools.combinations(range(legs), size))
        order = random.permutation(len(everything))[:_DRAWS]
        yield from (np.array(everything[k]) for k in order)
        return
    for _ in range(_DRAWS):
        yield np.sort(random.choice(legs, size, replace=False))


def consensus(
    data: Dataset, initial: Parameters, noise: Noise, fit: Callable[[MotionPairs], Parameters]
) -> Consensus:
    """The parameters on which the largest share of legs agree best (least quantile of squares).

    Args:
        data: all legs.
        initial: parameters at which the spread is computed; outliers may have pulled them.
        noise: supposed.
        fit: parameters from a few legs.

    Raises:
        SolveError: no few legs give any parameters.
    """
    pairs = data.pairs
    weight = np.asarray(np.linalg.inv(leg_spread(data, initial, noise)), dtype=np.float64)
    rank = max(_DRAWN_LEGS + 1, int(np.ceil(_AGREEING * len(pairs.legs)))) - 1
    rank = min(rank, len(pairs.legs) - 1)
    best: tuple[float, Parameters] | None = None

    def tried(legs: IntArray) -> tuple[float, Parameters] | None:
        try:
            parameters = fit(pairs.select(legs))
        except (SolveError, np.linalg.LinAlgError):
            return None
        return float(np.partition(disagreement(pairs, parameters, weight), rank)[rank]), parameters

    for number, legs in enumerate(_draws(len(pairs.legs), np.random.default_rng(0))):
        candidate = tried(legs)
        if candidate is not None and (best is None or candidate[0] < best[0]):
            best = candidate
        if number >= _FEW_DRAWS and best is not None and best[0] < _GOOD_ENOUGH * _USUAL:
            break
    if best is None:
        raise SolveError(
            "no four legs between stations determine the parameters",
            "check that the base turns and drives between stations, and the signs and units of joints and wheels in "
            "rig.yaml",
        )
    for _ in range(_POLISH):
        distance = disagreement(pairs, best[1], weight)
        factor = max(best[0] / _USUAL, 1e-6)
        inside = np.flatnonzero(distance < _BAD_LEG * factor)
        candidate = tried(inside) if len(inside) >= _DRAWN_LEGS else None
        if candidate is None or candidate[0] > best[0]:
            break
        best = candidate
    factor = max(best[0] / _USUAL, 1e-6)
    bad = disagreement(pairs, best[1], weight) > _BAD_LEG * factor
    return Consensus(best[1], bad, float(np.sqrt(factor)))
