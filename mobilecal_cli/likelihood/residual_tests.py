"""Test statistics: an inlier against its own deletion, an outlier against what all others predict."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np
from scipy.special import fdtri

from mobilecal_cli import se3
from mobilecal_cli.likelihood.noise import FREE_JOINT
from mobilecal_cli.likelihood.posterior import Posterior
from mobilecal_cli.likelihood.state import board_in_camera
from mobilecal_cli.likelihood.views import Views
from mobilecal_cli.model import BoolArray, FloatArray

#: Smaller discrepancies never make an outlier, however small the noise is: they do not matter at work.
SMALL_M, SMALL_RAD = 3e-4, float(np.radians(0.005))
_FALSE_ALARM = 1e-4  # chance to reject one good measurement in a recording of 50 stations
_NO_REDUNDANCY = 0.02


def limit(stations: int, dof: float, redundancy: float) -> float:
    """Largest statistic of a good measurement: Fisher's distribution, as the noise level is itself estimated."""
    chance = _FALSE_ALARM / max(1, stations // 50)
    return float(dof * fdtri(dof, max(redundancy, 4.0), 1 - chance))


class ResidualTests:
    """Chi-squared statistics of single measurements at an optimum.

    Those of inliers are the decrease of the sum of squares if the measurement were deleted; those of outliers compare
    the measurement with what all others predict.
    """

    def __init__(self, lin: Posterior) -> None:
        self._lin = lin

    # -- inliers ----------------------------------------------------------------------------------

    @cached_property
    def views(self) -> FloatArray:
        """(N,) of each station's images as a whole, six degrees of freedom; 0 for outliers."""
        lin, on = self._lin, self._lin.inliers.views
        G, g = lin.views.information[on, :6, :6], lin.views.gradient[on, :6]
        return _scattered(on, _deleted(G, g, lin.marginals.views[on]))

    @cached_property
    def legs(self) -> FloatArray:
        """(L,) of each leg's wheels, three degrees of freedom; 0 for outliers."""
        lin, on = self._lin, self._lin.inliers.legs
        W = lin.leg_weight[on]
        g = np.einsum("lab,lb->la", W, lin.legs.residual[on])
        return _scattered(on, _deleted(W, g, lin.marginals.legs[on]))

    @cached_property
    def readings(self) -> FloatArray:
        """(N, J) of each joint reading, one degree of freedom; 0 for outliers."""
        lin, joints = self._lin, self._lin.data.joints.shape[1]
        sigma = lin.own_sigmas[:, :joints]
        left = 1 - np.diagonal(lin.marginals.own, axis1=1, axis2=2)[:, :joints] / sigma**2
        usable = lin.inliers.readings & (left > _NO_REDUNDANCY)
        ratio = (lin.state.joint_errors / sigma) ** 2 / np.where(usable, left, 1.0)
        return np.where(usable, ratio, 0.0)

    # -- outliers ---------------------------------------------------------------------------------

    @cached_property
    def predicted_views(self) -> tuple[FloatArray, FloatArray]:
        """Distance of each station's images from what all others predict.

        Returns:
            (N,) statistics with the joint readings as they are, six degrees of freedom, and (N, J) with one reading
            unknown, five.
        """
        lin = self._lin
        views, off, inverse = self._apart
        spread = inverse + lin.marginals.views
        freed = np.empty_like(lin.data.joints)
        for j in range(lin.data.joints.shape[1]):
            k = views.by_own[..., j : j + 1]
            freed[:, j] = _mahalanobis(off, spread + FREE_JOINT**2 * (k @ np.swapaxes(k, 1, 2)))
        return _mahalanobis(off, spread), freed

    @cached_property
    def _apart(self) -> tuple[Views, FloatArray, FloatArray]:
        """All images, used or not: their residuals, the boards' poses by them alone against the predicted ones as left
        twists (N, 6), and the covariance of these (N, 6, 6).
        """
        lin = self._lin
        whole = replace(lin.inliers, views=np.ones(lin.data.stations, dtype=np.bool_))
        views = lin.with_inliers(whole).views
        inverse: FloatArray = np.asarray(
            np.linalg.pinv(views.information[:, :6, :6], hermitian=True), np.float64
        )
        return views, -np.einsum("nab,nb->na", inverse, views.gradient[:, :6]), inverse

    # -- what does not matter ---------------------------------------------------------------------

    @cached_property
    def small_views(self) -> BoolArray:
        """(N,) stations whose images show the board where it is predicted, to `SMALL_RAD` and `SMALL_M`."""
        lin = self._lin
        _, off, _ = self._apart
        middle = se3.act(board_in_camera(lin.data, lin.state), lin.data.points_k.mean(axis=0)[None])[:, 0]
        shift = off[:, 3:] + np.cross(off[:, :3], middle)
        return _small(np.linalg.norm(off[:, :3], axis=1), np.linalg.norm(shift, axis=1))

    @cached_property
    def small_legs(self) -> BoolArray:
        """(L,) legs whose wheels agree with the base poses to `SMALL_RAD` and `SMALL_M`."""
        x, y, heading = self._lin.legs.residual[:, :3].T
        return _small(np.abs(heading), np.hypot(x, y))

    @cached_property
    def small_readings(self) -> BoolArray:
        """(N, J) joint readings that are right to `SMALL_RAD`."""
        return np.asarray(np.abs(self._lin.state.joint_errors) < SMALL_RAD * self._lin.data.joint_units)

    @cached_property
    def predicted_legs(self) -> FloatArray:
        """(L,) distance of each leg's wheels from what all others predict, three degrees of freedom."""
        lin = self._lin
        return _mahalanobis(lin.legs.residual, lin.leg_covariance + lin.marginals.legs)

    @cached_property
    def predicted_readings(self) -> FloatArray:
        """(N, J) distance of each rejected joint reading from what all others predict, one degree of freedom."""
        lin = self._lin
        used = (lin.noise.joint_rad * lin.data.joint_units) ** 2
        spread = used + np.diagonal(lin.marginals.own, axis1=1, axis2=2)[:, : lin.data.joints.shape[1]]
        return np.asarray(lin.state.joint_errors**2 / spread)


def _small(turn_rad: FloatArray, shift_m: FloatArray) -> BoolArray:
    return np.asarray((turn_rad < SMALL_RAD) & (shift_m < SMALL_M))


def _mahalanobis(off: FloatArray, covariance: FloatArray) -> FloatArray:
    """Squared distances: (n, k) and (n, k, k) → (n,)."""
    return np.asarray(np.einsum("na,na->n", off, np.linalg.solve(covariance, off[..., None])[..., 0]))


def _deleted(G: FloatArray, g: FloatArray, marginal: FloatArray) -> FloatArray:
    """v^T (I - h)^-1 v over redundant directions, with G = R R^T, v = R^-1 g, h = R^T marginal R: (n, k, k) → (n,)."""
    values, vectors = np.linalg.eigh(G)
    size = np.sqrt(np.maximum(values, 0.0))
    positive = size > 1e-9 * size.max(axis=1, initial=1e-300, keepdims=True)
    root = vectors * size[:, None, :]
    v = np.einsum("nab,na->nb", vectors, g) * np.where(positive, 1 / np.where(positive, size, 1.0), 0.0)
    leverage = np.swapaxes(root, 1, 2) @ marginal @ root
    values, vectors = np.linalg.eigh(np.eye(G.shape[1]) - leverage)
    along = np.einsum("nki,nk->ni", vectors, v)
    usable = values > _NO_REDUNDANCY
    return np.asarray(np.sum(np.where(usable, along**2 / np.where(usable, values, 1.0), 0.0), axis=1))


def _scattered(on: np.ndarray[tuple[int, ...], np.dtype[np.bool_]], values: FloatArray) -> FloatArray:
    out = np.zeros(on.shape)
    out[on] = values
    return out
