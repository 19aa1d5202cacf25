"""A maximum of the likelihood: what the solver ends with, and what follows from it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mobilecal_cli.likelihood.budget import Influence, influences, shares
from mobilecal_cli.likelihood.dataset import Dataset
from mobilecal_cli.likelihood.noise import Inliers
from mobilecal_cli.likelihood.posterior import Posterior
from mobilecal_cli.likelihood.residual_tests import ResidualTests
from mobilecal_cli.model import BetweenLogs, BoolArray, FloatArray, Noise
from mobilecal_cli.solvers.noise import Component, guess_worth

_GUESS_FREEDOM = 4.0  # a guessed level's variance is uncertain like that of so many residuals and two
#: Levels whose effects differ little, each with the other.
_PAIRS = (("floor_rad", "sway_rad"), ("floor_m", "sway_m"), ("wheel_rad_per_sqrt_rad", "wheel_share"))
_ALIKE = dict(_PAIRS) | {b: a for a, b in _PAIRS}


@dataclass(frozen=True, eq=False)
class Fit:
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
    def influences(self) -> tuple[Influence, ...]:
        """How each kind of measurement moves the shared parameters."""
        return tuple(influences(self.lin))

    @property
    def budget(self) -> Mapping[str, FloatArray]:
        """Source → its share (P, P) of the posterior's covariance: kinds of measurements, and groups of priors.

        "recordings" is by how much the spread between recordings makes it larger.
        """
        budget = dict(shares(self.lin, self.influences))
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
        for influence in self.influences:
            for level, share in influence.covariances.items():
                component = self.components.get(level)
                if component is not None and level not in self.given:
                    alike = self.components.get(_ALIKE.get(level, ""))
                    redundancy = component.redundancy + (alike.redundancy if alike else 0.0)
                    rests_on = redundancy + guess_worth(redundancy)
                    covariance += share * 2 / max(rests_on - 2, _GUESS_FREEDOM)
        return covariance
