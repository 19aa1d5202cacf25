"""A maximum of the likelihood: what the solver ends with, its uncertainty, and what limits it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.kinematics import unseen_height
from mobilecal_cli.likelihood.budget import covariances, shares, spread
from mobilecal_cli.likelihood.constants import camera_change
from mobilecal_cli.likelihood.dataset import Dataset, Inliers
from mobilecal_cli.likelihood.effects import CameraEffect
from mobilecal_cli.likelihood.posterior import Posterior
from mobilecal_cli.likelihood.predict import STEP, camera_covariance, expected, in_base, weights_of
from mobilecal_cli.likelihood.residual_tests import ResidualTests
from mobilecal_cli.model.arrays import BoolArray, FloatArray
from mobilecal_cli.model.findings import BetweenLogs, Budget
from mobilecal_cli.model.solution import Noise, NoiseLevels, Uncertainty
from mobilecal_cli.solvers.noise import Component, guess_worth

_GUESS_FREEDOM = 4.0  # a guessed level's variance is uncertain like that of so many residuals and two
#: Levels whose effects differ little, each with the other.
_PAIRS = (("floor_rad", "sway_rad"), ("floor_m", "sway_m"), ("wheel_rad_per_sqrt_rad", "wheel_share"))
_ALIKE = dict(_PAIRS) | {b: a for a, b in _PAIRS}
# How many times the standard deviations the jackknife's are beyond 1, at most, over the square root of the number of
# legs: contains 19 of 20 simulated recordings of 12 and of 40 stations.
_JACKKNIFE_SCATTER = 3.6
_FADES = 0.25  # share above its usual scatter up to which the jackknife counts the more, the larger it is
#: A parameter is observable if its standard deviation is below this share of the prior sigma of a nominal value.
OBSERVABLE_SHARE = 1 / 3


@dataclass(frozen=True, eq=False)
class LikelihoodFit:
    """A maximum of the likelihood.

    Attributes:
        lin: the likelihood there.
        costs: (n,) sums of squares of the optimization, from its start on.
        components: what each noise level rests on.
        singular_values: (9,) what the data show, see `directions`.
        given: names of the noise levels that are not estimated.
        noisy: kinds of measurements whose many outliers were taken as noise.
        between: the recordings one by one, where there are several.
        pooled_covariance: (P, P) covariance that allows for the spread between recordings.
    """

    lin: Posterior
    costs: FloatArray
    components: Mapping[str, Component]
    singular_values: FloatArray
    given: frozenset[str]
    noisy: tuple[str, ...] = ()
    between: BetweenLogs | None = None
    pooled_covariance: FloatArray | None = None

    @property
    def data(self) -> Dataset:
        """The measurements."""
        return self.lin.data

    @property
    def inliers(self) -> Inliers:
        """The measurements that are used."""
        return self.lin.inliers

    @property
    def noise(self) -> Noise:
        """The noise levels."""
        return self.lin.noise

    @property
    def sure_legs(self) -> BoolArray:
        """(L,) legs whose wheels are used, and the images and joint readings at both ends."""
        stations = self.inliers.views & self.inliers.readings.all(axis=1)
        return np.asarray(self.inliers.legs & stations[self.data.legs].all(axis=1))

    @cached_property
    def tests(self) -> ResidualTests:
        """Test statistics of all measurements."""
        return ResidualTests(self.lin)

    @cached_property
    def by_level(self) -> Mapping[str, FloatArray]:
        """Noise level → (P, P) covariance of the shared parameters due to it."""
        return covariances(self.lin)

    @property
    def budget(self) -> Mapping[str, FloatArray]:
        """Source → its share (P, P) of the posterior's covariance: see `shares`.

        "recordings" is by how much the spread between recordings makes it larger.
        """
        budget = dict(shares(self.lin, self.by_level))
        if self.between is not None and self.pooled_covariance is not None and self.between.between_std.any():
            considered = self.lin.considered
            budget["recordings"] = self.pooled_covariance + considered @ considered.T - self.lin.covariance
        return budget

    @cached_property
    def covariance(self) -> FloatArray:
        """(P, P) of the shared parameters, wider than the bound where the noise levels rest on few residuals.

        A variance that r residuals show is itself uncertain: its mean is r / (r - 2) times what they show. So much
        wider is the share of each kind of noise; at most 3 / 2, as a guess is right within a factor of about 1.6. The
        residuals of two levels that act alike show their sum.
        """
        considered, pooled = self.lin.considered, self.pooled_covariance
        covariance = self.lin.covariance.copy() if pooled is None else pooled + considered @ considered.T
        for level, share in self.by_level.items():
            component = self.components.get(level)
            if component is not None and level not in self.given:
                alike = self.components.get(_ALIKE.get(level, ""))
                redundancy = component.redundancy + (alike.redundancy if alike else 0.0)
                rests_on = redundancy + guess_worth(redundancy)
                covariance += share * 2 / max(rests_on - 2, _GUESS_FREEDOM)
        return covariance


def uncertainty_of(fit: LikelihoodFit) -> Uncertainty:
    """Uncertainty of the nine parameters of a fit."""
    jackknife, J = _jackknife_covariance(fit), _reference_jacobian(fit)
    J[fit.lin.priors.fixed[:9]] = 0.0  # exact, whatever the stereo pair is
    widened = _widening(fit, np.sqrt(np.diag(jackknife)[:9]))
    factor = np.ones(len(fit.covariance))
    factor[:9] = widened
    shared = fit.covariance * np.outer(factor, factor)
    covariance = shared[:9, :9]
    scales, fixed = fit.lin.priors.scales[:9], fit.lin.priors.fixed[:9]
    observable = (np.sqrt(np.diag(covariance)) < OBSERVABLE_SHARE * scales) & ~fixed
    shows, vertical = np.eye(fit.data.layout.size), unseen_height(fit.data.chain)
    if vertical is not None:  # errors in use are those without the height of a camera that never tilts
        shows[3:6, 3:6] -= np.outer(vertical, vertical)
    at_work = shows @ shared @ shows
    of_figures = weights_of(fit.lin.state.parameters, in_base(fit.lin))
    weights = {name: shows @ W @ shows for name, W in of_figures.items()}
    but_height = np.sqrt(np.diag(at_work)[:9])
    camera, camera_constants = camera_covariance(fit.lin, at_work)
    levels = [name for name in fit.components if name not in fit.given]
    return Uncertainty(
        covariance=covariance,
        reference_covariance=J @ shared @ J.T,
        observable=observable,
        unobservable=fit.lin.priors.unobservable,
        scales=scales,
        singular_values=fit.singular_values,
        noise=NoiseLevels(
            **fit.noise.levels,
            wider=fit.noise.wider,
            estimated=tuple(levels),
            redundancy={name: fit.components[name].redundancy for name in levels},
        ),
        fixed=fixed,
        jackknife_std=np.sqrt(np.diag(J @ jackknife @ J.T)),
        described=~observable & ~fixed & (but_height < OBSERVABLE_SHARE * scales),
        widened=widened,
        at_work=expected(weights, shared),
        camera=camera,
        camera_constants=camera_constants,
        budget=_budget_of(fit, weights),
    )


def _budget_of(fit: LikelihoodFit, weights: Mapping[str, FloatArray]) -> Budget:
    """What limits the accuracy: shares of noise levels, kinds of constants and priors in each variance.

    Args:
        fit: the estimate.
        weights: figure → (P, P) of the errors in use, see `weights_of`.
    """
    sources = {
        source: np.concatenate([np.diag(share)[:9], [np.sum(W * share) for W in weights.values()]])
        for source, share in fit.budget.items()
    }
    values = np.array(list(sources.values()))
    total = values.sum(axis=0)
    nine, at_work = np.split(values / np.where(total > 0, total, 1.0), [9], axis=1)
    return Budget(tuple(sources), nine, dict(zip(weights, at_work.T, strict=True)))


def _jackknife_covariance(fit: LikelihoodFit) -> FloatArray:
    """Jackknife covariance of the nine parameters and the constants, (P, P).

    The units left out in turn are each station's images, its joint readings and each leg's wheels. Each unit's shift
    is weighted by the square root of its redundancy (the weighted jackknife of Wu, Annals of Statistics 14, 1986), so
    that with true noise levels the expected value is the covariance itself. The priors' shares are added: residuals do
    not show them.
    """
    C, weight, considered = fit.lin.conditional_covariance, fit.lin.priors.weight, fit.lin.considered
    return np.asarray(spread(fit.lin) + (C * weight) @ C.T + considered @ considered.T)


def _reference_jacobian(fit: LikelihoodFit) -> FloatArray:
    """(9, K) derivative of the nine parameters of the reference camera by those of the first one and the constants."""
    data, state = fit.data, fit.lin.state
    J = np.eye(9, data.layout.size)
    if data.cameras.reference == data.cameras.names[0]:
        return J
    R_h_c, T_c_reference = state.parameters.T_h_c[:3, :3], state.cameras.T_c_reference
    J[3:6, :3] = -se3.skew(R_h_c @ T_c_reference[:3, 3])
    for k, name, _ in data.layout.of(CameraEffect):
        moved = {**state.constants, name: state.value(name) + STEP}
        T = camera_change(data.cameras, data.layout.constants, moved).apply(data.cameras).T_c_reference
        turn = se3.log_so3(T[:3, :3] @ T_c_reference[:3, :3].T)
        J[:3, k] = R_h_c @ turn / STEP
        J[3:6, k] = R_h_c @ (T[:3, 3] - T_c_reference[:3, 3]) / STEP
    return J


def _widening(fit: LikelihoodFit, jackknife: FloatArray) -> FloatArray:
    """Factor on the standard deviation of each of the nine parameters, (9,).

    The jackknife's, where it is larger than its own scatter explains: the residuals then vary more than their noise
    levels say, or are not independent.
    """
    std = np.sqrt(np.diag(fit.covariance)[:9])
    ratio = jackknife / np.where(std > 0, std, np.inf)
    usual = 1 + _JACKKNIFE_SCATTER / math.sqrt(max(int(fit.inliers.legs.sum()), 1))
    return np.asarray(1 + (ratio - 1) * np.clip((ratio / usual - 1) / _FADES, 0.0, 1.0))
