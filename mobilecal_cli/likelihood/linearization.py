"""The likelihood at one point: residuals, normal equations, and everything that follows from them."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from mobilecal_cli.errors import SolveError
from mobilecal_cli.likelihood.budget import Influence, influences, shares
from mobilecal_cli.likelihood.dataset import Dataset
from mobilecal_cli.likelihood.evidence import evidence
from mobilecal_cli.likelihood.legs import Legs, all_covariances, linearize_legs
from mobilecal_cli.likelihood.marginals import Marginals, marginals
from mobilecal_cli.likelihood.noise import Inliers, encoder_sigmas, own_sigmas
from mobilecal_cli.likelihood.normal import NormalEquations, eliminated
from mobilecal_cli.likelihood.observability import Directions, directions
from mobilecal_cli.likelihood.priors import Priors
from mobilecal_cli.likelihood.processes import Processes, processes_of
from mobilecal_cli.likelihood.residual_tests import ResidualTests
from mobilecal_cli.likelihood.state import State, Step
from mobilecal_cli.likelihood.views import Views, linearize_views, view_rates, with_stations
from mobilecal_cli.model import Evidence, FloatArray, Noise


@contextmanager
def _solvable() -> Iterator[None]:
    """Turn a singular matrix into an error that a user understands: the only place that meets one."""
    try:
        yield
    except np.linalg.LinAlgError as error:
        raise SolveError(
            "the inlier measurements do not determine all parameters",
            "record more stations, with the whole board in the images",
        ) from error


@dataclass(frozen=True, eq=False)
class Linearization:
    """A data set at a state, with everything that the likelihood depends on.

    The legs' covariance, the driven distances and the views' rates depend on the state, but stay constant during an
    optimization: `at` computes them, `after` keeps them.

    Attributes:
        data: the measurements.
        state: a value of every unknown.
        inliers: the measurements that are used.
        noise: standard deviations of the measurements.
        priors: what is known of the shared parameters.
        leg_covariances: noise level → its share of the covariance of the legs' residuals, (L, K, K), m and rad,
            for known scale errors of the wheels at the stations.
        processes: prior of the floor and of the wheels' scale errors along the way.
        rates: (N, 6) see `view_rates`.
        leg_offset: (L, K) to be added to the legs' residuals, or 0.
    """

    data: Dataset
    state: State
    inliers: Inliers
    noise: Noise
    priors: Priors
    leg_covariances: Mapping[str, FloatArray]
    processes: Processes
    rates: FloatArray
    leg_offset: FloatArray | float = 0.0

    @classmethod
    def at(cls, data: Dataset, state: State, inliers: Inliers, noise: Noise, priors: Priors) -> Linearization:
        """The likelihood at a state, with the legs' covariance and the distances for the wheels of this state."""
        wheels = state.parameters.wheels
        covariances = all_covariances(data, wheels, noise)
        along = processes_of(data, wheels, noise, inliers)
        wide = priors.widened(noise.wider)
        return cls(data, state, inliers, noise, wide, covariances, along, view_rates(data, state))

    def changed(
        self,
        keep: Collection[str] = (),
        known: Mapping[str, object] | None = None,
        **fields: Any,  # noqa: ANN401
    ) -> Linearization:
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

    def after(self, step: Step) -> Linearization:
        """The likelihood after a step of all unknowns."""
        return self.changed(state=self.state.plus(self.data, step))

    def predicted(self, step: Step) -> Linearization:
        """The likelihood after an undamped step, all to first order: residuals follow, derivatives stay."""
        known = {
            "views": self.views.moved(step),
            "legs": self.legs.moved(self.data, step),
            "normal": self.normal.after(step.shared),
            "conditional_covariance": self.conditional_covariance,
        }
        return self.changed(known=known, state=self.state.plus(self.data, step))

    def under(self, priors: Priors) -> Linearization:
        """The same point with other priors."""
        same = ("views", "legs", "leg_covariance", "leg_weight", "own_sigmas", "normal")
        return self.changed(same, priors=priors.widened(self.noise.wider))

    def with_noise(self, noise: Noise) -> Linearization:
        """The same point with other noise levels, and the legs' covariance for the wheels of this state.

        The views' rates stay, as the views do; see `renewed`.
        """
        wheels, known = self.state.parameters.wheels, {}
        if "views" in self.__dict__:
            levels = (("pixel_px", ~self.data.posed), ("pose_scale", self.data.posed))
            factor = sum(getattr(noise, level) / getattr(self.noise, level) * of for level, of in levels)
            known["views"] = self.views.scaled(np.asarray(factor))
        same_legs = (noise.encoder_rad > 0) == (self.noise.encoder_rad > 0)
        same_legs &= noise.wheel_length_m == self.noise.wheel_length_m
        return self.changed(
            ("legs",) if same_legs else (),
            known,
            noise=noise,
            priors=self.priors.widened(noise.wider),
            leg_covariances=all_covariances(self.data, wheels, noise),
            processes=processes_of(self.data, wheels, noise, self.inliers),
        )

    def renewed(self) -> Linearization:
        """The same point with the views' rates of its state: the same itself where nothing moves."""
        if not self.data.moving.any():
            return self
        return Linearization.at(self.data, self.state, self.inliers, self.noise, self.priors)

    def with_inliers(self, inliers: Inliers) -> Linearization:
        """The same point with other inliers."""
        along, known = processes_of(self.data, self.state.parameters.wheels, self.noise, inliers), {}
        if "views" in self.__dict__:
            differ = (inliers.used_corners != self.inliers.used_corners).any(axis=(1, 2))
            differ |= inliers.views != self.inliers.views
            known["views"] = with_stations(
                self.views, self.data, self.state, inliers, self.noise, self.rates, np.flatnonzero(differ)
            )
        return self.changed(("legs", "leg_covariance"), known, inliers=inliers, processes=along)

    def of_log(self, log: int) -> Linearization:
        """The part that belongs to one recording."""
        data = self.data
        legs = np.flatnonzero(data.log[data.legs[:, 0]] == log)
        return replace(
            self,
            data=data.of_log(log),
            state=self.state.of_log(data, log),
            inliers=self.inliers.of_log(data, log),
            leg_covariances={name: share[legs] for name, share in self.leg_covariances.items()},
            processes=self.processes.select(np.flatnonzero(data.log == log), legs),
            rates=self.rates[data.log == log],
        )

    # -- residuals --------------------------------------------------------------------------------

    @cached_property
    def views(self) -> Views:
        """Residuals of the images."""
        return linearize_views(self.data, self.state, self.inliers, self.noise, self.rates)

    @cached_property
    def legs(self) -> Legs:
        """Residuals of the wheels."""
        legs = linearize_legs(self.data, self.state, self.processes, self.noise.encoder_rad > 0)
        return replace(legs, residual=legs.residual + self.leg_offset)

    @cached_property
    def leg_covariance(self) -> FloatArray:
        """(L, K, K) covariance of the legs' residuals, m and rad."""
        return np.asarray(sum(self.leg_covariances.values()))

    @cached_property
    def leg_weight(self) -> FloatArray:
        """(L, K, K) inverse covariance of each leg, 0 for outliers."""
        with _solvable():
            inverse = np.linalg.inv(self.leg_covariance)
        return np.asarray(inverse * self.inliers.legs[:, None, None], dtype=np.float64)

    @cached_property
    def own_sigmas(self) -> FloatArray:
        """(N, J + 3) sigma of each joint reading (rad or m), and of the sway's roll, pitch (rad) and height (m)."""
        return own_sigmas(self.data, self.inliers, self.noise)

    @property
    def own_errors(self) -> FloatArray:
        """(N, J + 3) joint errors and sway, see `own_sigmas`."""
        return np.concatenate([self.state.joint_errors, self.state.sway], axis=1)

    @cached_property
    def encoder_sigmas(self) -> FloatArray:
        """(2,) sigma of the right and left wheel's encoder reading, rad; 0 where the encoders have no steps."""
        return encoder_sigmas(self.data, self.noise)

    @cached_property
    def cost(self) -> float:
        """Sum of squares of all whitened residuals and of the priors."""
        e, state = self.legs.residual, self.state
        cost = float(self.views.cost.sum()) + float(np.einsum("la,lab,lb->", e, self.leg_weight, e))
        cost += float(np.sum((self.own_errors / self.own_sigmas) ** 2))
        cost += float(np.sum(self.processes.innovations(state.processes) ** 2 / self.processes.variance))
        cost += float(np.sum((state.stamp_errors / self.noise.stamp_s) ** 2))
        if self.noise.encoder_rad:
            cost += float(np.sum((state.encoder_errors / self.encoder_sigmas) ** 2))
        return cost + self.priors.cost(state)

    # -- normal equations -------------------------------------------------------------------------

    def eliminated(self, damping: float = 0.0) -> NormalEquations:
        """Normal equations of the measurements, stations and boards eliminated; see `normal.eliminated`.

        Raises:
            SolveError: a singular matrix.
        """
        with _solvable():
            return eliminated(self, damping)

    @cached_property
    def normal(self) -> NormalEquations:
        """The normal equations without damping."""
        return self.eliminated()

    @cached_property
    def information(self) -> FloatArray:
        """(P, P) information of the shared parameters, priors included."""
        return np.asarray(self.normal.S + np.diag(self.priors.weight))

    @cached_property
    def conditional_covariance(self) -> FloatArray:
        """(P, P) covariance of the shared parameters for correct values along all directions that keep their mean."""
        basis = self.priors.basis
        reduced = basis.T @ self.information @ basis
        with _solvable():
            scale = 1 / np.sqrt(_positive(np.diag(reduced)))
            inverse = np.linalg.inv(reduced * np.outer(scale, scale)) * np.outer(scale, scale)
        C: FloatArray = basis @ inverse @ basis.T
        return C

    @cached_property
    def considered(self) -> FloatArray:
        """(P, K) errors of the shared parameters by one prior sigma along each unobservable direction."""
        return self.priors.considered(self.information, self.conditional_covariance)

    @cached_property
    def covariance(self) -> FloatArray:
        """(P, P) of the shared parameters. Unobservable directions keep their prior variance."""
        return self.conditional_covariance + self.considered @ self.considered.T

    def observable_directions(self, user_weight: FloatArray) -> Directions:
        """Directions of the shared parameters that the measurements show.

        Args:
            user_weight: (P,) inverse variances of priors that count as measurements.
        """
        with _solvable():
            return directions(self, user_weight)

    # -- what follows -----------------------------------------------------------------------------

    @cached_property
    def marginals(self) -> Marginals:
        """Covariances of the predicted measurements."""
        with _solvable():
            return marginals(self)

    @cached_property
    def influences(self) -> tuple[Influence, ...]:
        """How each kind of measurement moves the shared parameters."""
        return tuple(influences(self))

    @cached_property
    def tests(self) -> ResidualTests:
        """Test statistics of all measurements."""
        return ResidualTests(self)

    def evidence(self, parts: bool = True) -> tuple[Evidence, ...]:
        """How far the data contradict the stated values of each kind of constants, of each part or of all."""
        with _solvable():
            return tuple(evidence(self, parts))

    def budget(self) -> Mapping[str, FloatArray]:
        """Source → its share (P, P) of `covariance`: kinds of measurements, and groups of priors. They add up to it."""
        return shares(self)


def _positive(values: FloatArray) -> FloatArray:
    """The values.

    Raises:
        LinAlgError: one is not positive.
    """
    if not np.all(values > 0):
        raise np.linalg.LinAlgError("not positive definite")
    return values
