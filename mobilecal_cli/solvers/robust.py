"""Outlier statistics of corners, stations, legs and joint readings.

Inliers are tested by deletion, excluded measurements against the prediction from the inliers. `decisions` uses both.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.special import fdtri

from mobilecal_cli import se3
from mobilecal_cli.likelihood.marginals import Marginals
from mobilecal_cli.likelihood.noise import FREE_JOINT, Noise, Selection
from mobilecal_cli.likelihood.problem import Problem, State
from mobilecal_cli.likelihood.system import joint_sigmas
from mobilecal_cli.likelihood.views import blocks_of, corner_residuals, linearize_views, whitened
from mobilecal_cli.model import BoolArray, FloatArray
from mobilecal_cli.solvers.descent import Optimum

_FALSE_ALARM = 1e-4  # chance that a consistent measurement is excluded, in a recording of 50 stations
_CORNER_SIGMAS = 5.5
_BAD_PICTURE = 0.4  # share of gross corners above which the whole board is excluded
_BAD_BOARD = 6.0  # limit of a station's corner noise over the median
_LOCAL_STEPS = 12
_NO_REDUNDANCY = 0.02


def limit(count: int, dof: float, redundancy: float) -> float:
    """Largest statistic of a consistent measurement: an F quantile, since the noise level is itself estimated."""
    chance = _FALSE_ALARM / max(1, count // 50)
    return float(dof * fdtri(dof, max(redundancy, 4.0), 1 - chance))


@dataclass(frozen=True, slots=True, eq=False)
class Statistics:
    """Decrease of the sum of squares if a measurement is excluded (chi-squared for consistent measurements).

    Attributes:
        views: (N,) for a station's images together, six degrees of freedom.
        legs: (L,) for a leg's wheels, three.
        readings: (N, J) for a joint reading, one.
    """

    views: FloatArray
    legs: FloatArray
    readings: FloatArray


def _deleted(whitened: FloatArray, taken: FloatArray) -> FloatArray:
    """v^T (I - h)^-1 v over the redundant directions, (n, k) and (n, k, k) → (n,)."""
    values, vectors = np.linalg.eigh(np.eye(whitened.shape[1]) - taken)
    along = np.einsum("nki,nk->ni", vectors, whitened)
    usable = values > _NO_REDUNDANCY
    safe = np.where(usable, values, 1.0)
    return np.asarray(np.sum(np.where(usable, along**2 / safe, 0.0), axis=1))


def believed_statistics(
    problem: Problem, optimum: Optimum, marginal: Marginals, selection: Selection, noise: Noise
) -> Statistics:
    """Deletion statistics of all inliers; 0 for excluded measurements."""
    system = optimum.system
    views, legs = system.views, system.legs
    G, g = views.information[:, :6, :6], views.gradient[:, :6]
    pictured = np.zeros(problem.stations)
    on = selection.views
    root = np.linalg.cholesky(G[on])  # G = root root^T
    v = np.linalg.solve(root, g[on][..., None])[..., 0]
    pictured[on] = _deleted(v, np.swapaxes(root, 1, 2) @ marginal.views[on][:, :6, :6] @ root)

    driven = np.zeros(len(problem.legs))
    on = selection.legs
    root = np.linalg.cholesky(system.leg_weight[on])
    v = np.einsum("lab,la->lb", root, legs.residual[on])
    driven[on] = _deleted(v, np.swapaxes(root, 1, 2) @ marginal.legs[on] @ root)

    sigma = joint_sigmas(problem, selection, noise)
    left = 1 - np.diagonal(marginal.joints, axis1=1, axis2=2) / sigma**2
    usable = selection.readings & (left > _NO_REDUNDANCY)
    ratio = (optimum.state.joint_errors / sigma) ** 2 / np.where(usable, left, 1.0)
    return Statistics(pictured, driven, np.where(usable, ratio, 0.0))


def doubted_views(
    problem: Problem, optimum: Optimum, marginal: Marginals, selection: Selection, noise: Noise
) -> tuple[FloatArray, FloatArray]:
    """Statistics of each station's images against the prediction from the other stations.

    Returns:
        (N,) with the joints as read, six degrees of freedom, and (N, J) with one reading unknown, five.
    """
    whole = replace(selection, views=np.ones(problem.stations, dtype=np.bool_))
    views = linearize_views(problem, optimum.state, whole, noise)
    G, g = views.information[:, :6, :6], views.gradient[:, :6]
    inverse = np.linalg.inv(G)
    off = -np.einsum("nab,nb->na", inverse, g)
    spread = inverse + marginal.views[:, :6, :6]
    as_read = np.einsum("na,na->n", off, np.linalg.solve(spread, off[..., None])[..., 0])
    freed = np.empty(problem.joints.shape)
    for j in range(problem.joints.shape[1]):
        k = views.by_joints[:, :6, j : j + 1]
        wide = spread + FREE_JOINT**2 * (k @ np.swapaxes(k, 1, 2))
        freed[:, j] = np.einsum("na,na->n", off, np.linalg.solve(wide, off[..., None])[..., 0])
    return np.asarray(as_read), freed


def doubted_legs(optimum: Optimum, marginal: Marginals) -> FloatArray:
    """Statistic of each leg's wheels against the prediction from the rest, (L,), three degrees of freedom."""
    e = optimum.system.legs.residual
    spread = optimum.leg_covariance + marginal.legs
    return np.asarray(np.einsum("la,la->l", e, np.linalg.solve(spread, e[..., None])[..., 0]))


def doubted_readings(optimum: Optimum, marginal: Marginals, noise: Noise) -> FloatArray:
    """Statistic of each excluded joint reading against the prediction, (N, J), one degree of freedom."""
    spread = noise.joint_rad**2 + np.diagonal(marginal.joints, axis1=1, axis2=2)
    return np.asarray(optimum.state.joint_errors**2 / spread)


def _median(size: FloatArray, seen: BoolArray) -> FloatArray:
    """Median over the detected corners (N, 2, M), (N,)."""
    return np.asarray(np.nanmedian(np.where(seen, size, np.nan), axis=(1, 2)))


def _own_misfit(problem: Problem, state: State, T: FloatArray, stations: slice) -> FloatArray:
    """Corner residuals after a robust fit of each station's own board pose, (n, 2, M), from initial T (n, 4, 4)."""
    seen = problem.seen[stations]
    for _ in range(_LOCAL_STEPS):
        residual, J = corner_residuals(problem, state, T, stations)
        W = problem.whitening[stations]
        residual, J = whitened(W, residual), whitened(W, J)
        size = np.linalg.norm(residual, axis=-1)
        scale = np.maximum(_median(size, seen), 1e-9)
        # Cauchy weight, which limits the influence of outliers.
        root = (seen / np.sqrt(1 + (size / (2 * scale[:, None, None])) ** 2))[..., None]
        A = (J[..., :6] * root[..., None]).reshape(len(T), -1, 6)
        r = (residual * root).reshape(len(T), -1)
        At = np.swapaxes(A, 1, 2)
        step = np.linalg.solve(At @ A, -(At @ r[..., None]))[..., 0]
        T = se3.exp(step) @ T
        if np.abs(step).max() < 1e-10:
            break
    residual, _ = corner_residuals(problem, state, T, stations)
    return np.asarray(np.linalg.norm(whitened(problem.whitening[stations], residual), axis=-1))


def gross_corners(
    problem: Problem, state: State, T_c_k: FloatArray
) -> tuple[BoolArray, BoolArray, FloatArray]:
    """Corners and boards that fit the board's shape, tested per station.

    Args:
        problem: the corners.
        state: gives the cameras.
        T_c_k: (N, 4, 4) initial board poses.

    Returns:
        (N, 2, M) inlier corners, (N,) inlier boards, and (N,) corner noise of each station, px.
    """
    size = np.concatenate(
        [_own_misfit(problem, state, T_c_k[block], block) for block in blocks_of(problem.stations)]
    )
    # The median length of a two-dimensional normal vector is 1.1774 sigma.
    own = _median(size, problem.seen) / 1.1774
    common = max(float(np.median(own)), 1e-9)
    near = size <= _CORNER_SIGMAS * np.maximum(common, np.minimum(own, _BAD_BOARD * common))[:, None, None]
    sound = near & problem.seen
    enough = np.all(sound.sum(axis=2) >= (1 - _BAD_PICTURE) * problem.seen.sum(axis=2), axis=1)
    return sound, enough & (own < _BAD_BOARD * common), own
