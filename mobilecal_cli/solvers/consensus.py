"""Robust initial estimate: the subset of legs with which most other legs are consistent."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.errors import SolveError
from mobilecal_cli.kinematics import head_jacobian, integrate
from mobilecal_cli.likelihood.legs import leg_covariance
from mobilecal_cli.likelihood.noise import Noise, Selection
from mobilecal_cli.likelihood.problem import Problem
from mobilecal_cli.likelihood.system import joint_sigmas
from mobilecal_cli.model import BoolArray, FloatArray, IntArray, Parameters
from mobilecal_cli.solvers.carry import base_motion, camera_motion
from mobilecal_cli.solvers.loops import Loops

_DRAWN_LEGS = 4
_DRAWS = 300
_AGREEING = 0.45  # share of consistent legs: a fifth of bad stations and a slip affect up to half of the legs
_USUAL = 5.3  # median of chi-squared with six degrees of freedom
_BAD_LEG = 30.0  # chi-squared with six degrees of freedom exceeds it once in 25,000
_POLISH = 3
_FEW_DRAWS, _GOOD_ENOUGH = 20, 2.0  # stop after this many draws if the variance ratio is below this limit


@dataclass(frozen=True, slots=True, eq=False)
class Consensus:
    """Parameters with which most legs are consistent.

    Attributes:
        parameters: fitted to the consistent legs.
        bad: (L,) inconsistent legs.
        noise_factor: noise of the consistent legs over the assumed noise.
    """

    parameters: Parameters
    bad: BoolArray
    noise_factor: float


def leg_spread(
    problem: Problem, loops: Loops, parameters: Parameters, noise: Noise, pose_cov: FloatArray
) -> FloatArray:
    """Covariance of each leg's difference between wheels and cameras, (L, 6, 6), left twists in the first camera.

    Args:
        problem, loops: the legs.
        parameters: initial estimate.
        noise: of wheels and joints.
        pose_cov: (N, 6, 6) of T_c_k.
    """
    i, j = loops.legs.T
    T_ci_cj = camera_motion(loops, parameters)
    X = parameters.T_h_c
    J = se3.adjoint(se3.inverse(X)) @ head_jacobian(problem.chain, problem.joints)
    sigma = joint_sigmas(problem, Selection.everything(problem), noise)
    of_joints = (J * sigma[:, None, :] ** 2) @ np.swapaxes(J, 1, 2)
    of_station = of_joints + pose_cov
    Ad = se3.adjoint(T_ci_cj)
    T_vi_vj = base_motion(integrate(loops.steps, parameters.wheels))
    to_camera = se3.adjoint(se3.inverse(loops.T_v_h[i] @ X) @ T_vi_vj)
    by_leg = np.zeros((len(i), 6, 3))
    by_leg[:, 2, 2] = 1.0
    by_leg[:, 3:5, :2] = np.swapaxes(T_vi_vj[:, :2, :2], 1, 2)
    by_leg = to_camera @ by_leg
    of_wheels = by_leg @ leg_covariance(problem, parameters.wheels, noise) @ np.swapaxes(by_leg, 1, 2)
    spread: FloatArray = of_station[i] + Ad @ of_station[j] @ np.swapaxes(Ad, 1, 2) + of_wheels
    return spread


def disagreement(loops: Loops, parameters: Parameters, weight: FloatArray) -> FloatArray:
    """Squared Mahalanobis distance between wheels and cameras over each leg, (L,)."""
    i, j = loops.legs.T
    seen = loops.T_c_k[i] @ se3.inverse(loops.T_c_k[j])
    delta = se3.log(camera_motion(loops, parameters) @ se3.inverse(seen))
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


def agreed(
    problem: Problem,
    loops: Loops,
    rough: Parameters,
    noise: Noise,
    pose_cov: FloatArray,
    fit: Callable[[Loops], Parameters],
) -> Consensus:
    """Consensus of the legs by least quantile of squares over random subsets.

    Args:
        problem, loops: all legs.
        rough: parameters at which the covariances are evaluated; outliers may bias them.
        noise: assumed noise levels.
        pose_cov: (N, 6, 6) of T_c_k.
        fit: estimates parameters from a subset of the legs.

    Raises:
        SolveError: no subset gives a solution.
    """
    spread = leg_spread(problem, loops, rough, noise, pose_cov)
    weight = np.asarray(np.linalg.inv(spread), dtype=np.float64)
    rank = max(_DRAWN_LEGS + 1, int(np.ceil(_AGREEING * len(loops.legs)))) - 1
    rank = min(rank, len(loops.legs) - 1)
    best: tuple[float, Parameters] | None = None

    def tried(legs: IntArray) -> tuple[float, Parameters] | None:
        try:
            parameters = fit(loops.select(legs))
        except (SolveError, np.linalg.LinAlgError):
            return None
        return float(np.partition(disagreement(loops, parameters, weight), rank)[rank]), parameters

    for number, legs in enumerate(_draws(len(loops.legs), np.random.default_rng(0))):
        found = tried(legs)
        if found is not None and (best is None or found[0] < best[0]):
            best = found
        if number >= _FEW_DRAWS and best is not None and best[0] < _GOOD_ENOUGH * _USUAL:
            break
    if best is None:
        raise SolveError(
            "no subset of four legs between stations gives a solution",
            "check the residuals of --method linear",
        )
    for _ in range(_POLISH):
        distance = disagreement(loops, best[1], weight)
        factor = max(best[0] / _USUAL, 1e-6)
        inside = np.flatnonzero(distance < _BAD_LEG * factor)
        found = tried(inside) if len(inside) >= _DRAWN_LEGS else None
        if found is None or found[0] > best[0]:
            break
        best = found
    factor = max(best[0] / _USUAL, 1e-6)
    return Consensus(
        best[1], disagreement(loops, best[1], weight) > _BAD_LEG * factor, float(np.sqrt(factor))
    )
