"""The likelihood at one point: the residuals of all measurements, their weights, and the sum of their squares."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, Self

import numpy as np

from mobilecal_cli.errors import SolveError
from mobilecal_cli.likelihood.dataset import Dataset, Inliers
from mobilecal_cli.likelihood.legs import Legs, all_covariances, linearize_legs
from mobilecal_cli.likelihood.priors import Priors
from mobilecal_cli.likelihood.processes import Processes, processes_of
from mobilecal_cli.likelihood.state import State, Step
from mobilecal_cli.likelihood.views import Views, linearize_views
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.solution import EXACT, Noise

_LEGS = ("legs", "leg_covariance")  # what does not depend on the images, or on which measurements are used
FREE_JOINT = 1.0  # rad or m: sigma of a rejected joint reading


@contextmanager
def solvable() -> Iterator[None]:
    """Turn a singular matrix into an error that a user understands."""
    try:
        yield
    # scipy refuses what is not finite by a ValueError
    except (np.linalg.LinAlgError, ValueError, FloatingPointError) as error:
        raise SolveError(
            "the inlier measurements do not determine all parameters",
            "record more stations, with the whole board in the images",
        ) from error


@dataclass(frozen=True, eq=False)
class Linearization:
    """A state, with everything else that the likelihood depends on.

    The legs' covariance, the driven distances and the views' rates depend on the state, but stay constant during an
    optimization: `at` computes them, `after` keeps them.

    Attributes:
        state: a value of every unknown.
        inliers: the measurements that are used.
        noise: standard deviations of the measurements.
        priors: what is known of the shared parameters.
        leg_covariances: noise level → its share of the covariance of the legs' residuals, (L, K, K), m and rad,
            for known scale errors of the wheels at the stations.
        processes: prior of the base blocks' errors along the way.
        rates: (C, N, 6) see `State.view_rates`.
        leg_offset: (L, K) to be added to the legs' residuals, or 0.
        apart: whether the images' information is kept station by station, not in sums over each recording.
        traced: see `Views.traced`; further ones of (delta, direct constants).
    """

    state: State
    inliers: Inliers
    noise: Noise
    priors: Priors
    leg_covariances: Mapping[str, FloatArray]
    processes: Processes
    rates: FloatArray
    leg_offset: FloatArray | float = 0.0
    apart: bool = False
    traced: tuple[int, ...] = ()

    @classmethod
    def at(cls, state: State, inliers: Inliers, noise: Noise, priors: Priors) -> Self:
        """The likelihood at a state, with the legs' covariance and the distances for the wheels of this state."""
        covariances, along = all_covariances(state, noise), processes_of(state, noise, inliers)
        wide = priors.widened(noise.wider)
        return cls(state, inliers, noise, wide, covariances, along, state.view_rates)

    @property
    def data(self) -> Dataset:
        """The measurements."""
        return self.state.data

    def changed(
        self,
        keep: Collection[str] = (),
        known: Mapping[str, object] | None = None,
        **fields: Any,  # noqa: ANN401
    ) -> Self:
        """Another point, with some of what was derived here: the only place that moves it.

        Args:
            keep: names of properties that are the same there; they are derived again only if they were not yet here.
            known: properties → their values there.
            fields: attributes that differ.
        """
        other = replace(self, **fields)
        other.__dict__.update({name: self.__dict__[name] for name in keep if name in self.__dict__})
        other.__dict__.update(known or {})
        return other

    def after(self, step: Step) -> Self:
        """The likelihood after a step of all unknowns."""
        return self.changed(state=self.state.plus(step))

    def under(self, priors: Priors) -> Self:
        """The same point with other priors."""
        same = ("images", "views", "legs", "leg_covariance", "leg_weight", "own_sigmas", "normal")
        return self.changed(same, priors=priors.widened(self.noise.wider))

    def with_noise(self, noise: Noise) -> Self:
        """The same point with other noise levels, and the legs' covariance for the wheels of this state.

        The views' rates stay, as the views do; see `renewed`.
        """
        same_legs = noise.wheel_length_m == self.noise.wheel_length_m
        return self.changed(
            ("images", "legs") if same_legs else ("images",),
            noise=noise,
            priors=self.priors.widened(noise.wider),
            leg_covariances=all_covariances(self.state, noise),
            processes=processes_of(self.state, noise, self.inliers),
        )

    def renewed(self) -> Self:
        """The same point with the views' rates of its state: the same itself where nothing moves."""
        if not self.data.moving.any():
            return self
        return self.at(self.state, self.inliers, self.noise, self.priors)

    def with_inliers(self, inliers: Inliers) -> Self:
        """The same point with other inliers."""
        before, after = self.inliers, inliers
        same = np.array_equal(before.views, after.views) and np.array_equal(
            before.used_corners, after.used_corners
        )
        along = processes_of(self.state, self.noise, inliers)
        return self.changed((*_LEGS, "images", "views") if same else _LEGS, inliers=inliers, processes=along)

    def tracing(self, unknowns: tuple[int, ...]) -> Self:
        """The same point with the information of the images kept station by station for further unknowns."""
        if set(unknowns) <= set(self.traced):
            return self
        return self.changed((*_LEGS, "own_sigmas"), traced=unknowns)

    def of_log(self, log: int) -> Self:
        """The same point with the measurements of one recording alone."""
        mine = self.data.log == log
        legs = self.inliers.legs & mine[self.data.legs[:, 0]]
        inliers = replace(self.inliers, views=self.inliers.views & mine, legs=legs)
        images = self.images.scaled(np.where(mine, 1.0, np.inf))
        return self.changed((*_LEGS, "own_sigmas"), {"images": images}, inliers=inliers)

    # -- residuals --------------------------------------------------------------------------------

    @cached_property
    def images(self) -> Views:
        """Residuals of the images, for a noise level of one and constants that are alike from image to image."""
        group = np.arange(self.data.stations) if self.apart else self.data.log
        return linearize_views(self.state, self.inliers, self.rates, group, self.traced)

    @cached_property
    def views(self) -> Views:
        """Residuals of the images."""
        level = getattr(self.noise, self.data.images_level)
        return self.images.scaled(np.full(self.data.stations, level)).with_own(self.noise)

    @cached_property
    def legs(self) -> Legs:
        """Residuals of the wheels."""
        legs = linearize_legs(self.state, self.processes)
        return replace(legs, residual=legs.residual + self.leg_offset)

    @cached_property
    def leg_covariance(self) -> FloatArray:
        """(L, K, K) covariance of the legs' residuals, m and rad."""
        return np.asarray(sum(self.leg_covariances.values()))

    @cached_property
    def leg_weight(self) -> FloatArray:
        """(L, K, K) inverse covariance of each leg, 0 for outliers."""
        with solvable():
            inverse = np.linalg.inv(self.leg_covariance)
        return np.asarray(inverse * self.inliers.legs[:, None, None], dtype=np.float64)

    @cached_property
    def own_sigmas(self) -> FloatArray:
        """(N, J + 3) sigma of each joint reading (rad or m), and of the sway's roll, pitch (rad) and height (m).

        A base that never moves does not sway.
        """
        data, noise = self.data, self.noise
        sway = np.where(data.drives[:, None], [noise.sway_rad, noise.sway_rad, noise.sway_m], EXACT)
        readings = np.where(self.inliers.readings, data.joint_sigmas(noise), FREE_JOINT)
        return np.concatenate([readings, sway], axis=1)

    @cached_property
    def cost(self) -> float:
        """Sum of squares of all whitened residuals and of the priors."""
        e, state = self.legs.residual, self.state
        cost = float(self.views.cost.sum()) + float(np.einsum("la,lab,lb->", e, self.leg_weight, e))
        cost += float(np.sum((state.own / self.own_sigmas) ** 2))
        cost += float(np.sum(self.processes.whitened(state.base) ** 2))
        return cost + self.priors.cost(state)
