"""The residual test: each measurement against what all others predict."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np
from scipy.special import fdtri

from mobilecal_cli import se3
from mobilecal_cli.likelihood.linearization import FREE_JOINT
from mobilecal_cli.likelihood.measurements import JOINTS
from mobilecal_cli.likelihood.posterior import Posterior, over_redundancy
from mobilecal_cli.likelihood.views import Views, roots
from mobilecal_cli.model.arrays import BoolArray, FloatArray

#: Smaller discrepancies never make an outlier, however small the noise is: they do not matter at work.
SMALL_M, SMALL_RAD = 3e-4, float(np.radians(0.005))
_FALSE_ALARM = 1e-4  # chance to reject one good measurement in a recording of 50 stations
_NO_REDUNDANCY = 0.02


def limit(stations: int, dof: float, redundancy: float) -> float:
    """Largest statistic of a good measurement: Fisher's distribution, as the noise level is itself estimated."""
    chance = _FALSE_ALARM / max(1.0, stations / 50)
    return float(dof * fdtri(dof, max(redundancy, 4.0), 1 - chance))


class ResidualTests:
    """Chi-squared statistics of single measurements at an optimum: the leave-out distance of each.

    It is ``e^T (S + M)^-1 e``: e is the measured minus the predicted value, S the covariance of the measurement, and M
    that of a prediction from all others. An outlier has no part in the prediction. For an inlier of residual r and
    marginal covariance h, the same is ``r^T (S - h)^-1 r``: the decrease of the sum of squares without it.
    """

    def __init__(self, lin: Posterior) -> None:
        self._lin = lin

    @cached_property
    def _all_views(self) -> Views:
        """All images, used or not."""
        lin = self._lin
        return lin.with_inliers(replace(lin.inliers, views=np.ones_like(lin.inliers.views))).views

    @cached_property
    def views(self) -> FloatArray:
        """(N,) of each station's images as a whole, six degrees of freedom."""
        lin, views = self._lin, self._all_views
        G, g = views.rows[:, :6, :6], views.pull[:, :6]
        return _left_out(G, g, lin.spread_in_images(views.rows[:, :6]), lin.inliers.views)

    @cached_property
    def legs(self) -> FloatArray:
        """(L,) of each leg's wheels, three degrees of freedom."""
        lin = self._lin
        W = np.asarray(np.linalg.inv(lin.leg_covariance), dtype=np.float64)
        g = np.einsum("lab,lb->la", W, lin.legs.residual)
        return _left_out(W, g, W @ lin.marginals.legs @ W, lin.inliers.legs)

    @cached_property
    def readings(self) -> FloatArray:
        """(N, J) of each joint reading, one degree of freedom."""
        lin = self._lin
        sigma = lin.data.joint_sigmas(lin.noise)
        share = np.diagonal(lin.marginals.own, axis1=1, axis2=2)[:, JOINTS] / sigma**2
        left = np.where(lin.inliers.readings, 1 - share, 1 + share)
        usable = left > _NO_REDUNDANCY
        return np.where(usable, (lin.state.own[:, JOINTS] / sigma) ** 2 / np.where(usable, left, 1.0), 0.0)

    @cached_property
    def views_freed(self) -> FloatArray:
        """(N, J) of each outlier station's images with one joint reading unknown, five degrees of freedom."""
        lin, views = self._lin, self._all_views
        G, g = views.rows[:, :6, :6], views.pull[:, :6]
        predicted, freed = lin.spread_in_images(views.rows[:, :6]), np.empty_like(lin.data.joints)
        for j in range(freed.shape[1]):
            by_reading = FREE_JOINT * G @ views.by_own[..., j : j + 1]
            spread = predicted + by_reading @ by_reading.mT
            freed[:, j] = _left_out(G, g, spread, np.zeros_like(lin.inliers.views))
        return freed

    # -- what does not matter ---------------------------------------------------------------------

    @cached_property
    def small_views(self) -> BoolArray:
        """(N,) stations whose images show the board where it is predicted, to `SMALL_RAD` and `SMALL_M`."""
        lin, views = self._lin, self._all_views
        inverse = np.linalg.pinv(views.rows[:, :6, :6], hermitian=True)
        off = np.einsum("nab,nb->na", inverse, views.pull[:, :6])
        middle = se3.act(lin.state.T_c_k, lin.data.points_k.mean(axis=0)[None])[:, 0]
        shift = off[:, 3:] + np.cross(off[:, :3], middle)
        return _small(np.linalg.norm(off[:, :3], axis=1), np.linalg.norm(shift, axis=1))

    @cached_property
    def small_legs(self) -> BoolArray:
        """(L,) legs whose wheels agree with the base poses to `SMALL_RAD` and `SMALL_M`."""
        x, y, heading = self._lin.legs.residual[:, :3].T
        return _small(np.abs(heading), np.hypot(x, y))

    @cached_property
    def small_readings(self) -> BoolArray:
        """(N, J) joint readings that are right to `SMALL_RAD`, or `SMALL_M` of a prismatic joint."""
        chain = self._lin.data.chain
        small = [SMALL_M if name in chain.prismatic else SMALL_RAD for name in chain.joints]
        return np.asarray(np.abs(self._lin.state.own[:, JOINTS]) < small)


def _small(turn_rad: FloatArray, shift_m: FloatArray) -> BoolArray:
    return np.asarray((turn_rad < SMALL_RAD) & (shift_m < SMALL_M))


def _left_out(G: FloatArray, g: FloatArray, predicted: FloatArray, used: BoolArray) -> FloatArray:
    """Leave-out distance over redundant directions: ``g^T (G -+ H)^-1 g``, - for those used, + for the others.

    Args:
        G: (n, k, k) information of each measurement.
        g: (n, k) its gradient.
        predicted: (n, k, k) H, covariance that the unknowns give the gradient.
        used: (n,) which are part of the fit.
    """
    whiten = roots(G)[1].mT
    sign = np.where(used, -1.0, 1.0)[:, None, None]
    left = np.eye(G.shape[1]) + sign * (whiten.mT @ predicted @ whiten)
    return np.asarray(
        np.sum(over_redundancy((whiten.mT @ g[..., None])[..., 0], left, _NO_REDUNDANCY) ** 2, axis=1)
    )
