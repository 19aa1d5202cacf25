"""What the likelihood says of the parameters at one point: normal equations, covariances, steps."""

from __future__ import annotations

from functools import cached_property
from typing import Self

import numpy as np

from mobilecal_cli.likelihood.linearization import Linearization, solvable
from mobilecal_cli.likelihood.marginals import Marginals, marginals
from mobilecal_cli.likelihood.normal import NormalEquations, eliminated
from mobilecal_cli.likelihood.state import Step
from mobilecal_cli.model import FloatArray


class Posterior(Linearization):
    """The likelihood at one point with its normal equations solved.

    What follows from it are functions: `budget`, `evidence`, `jumps`, `observability`, `residual_tests`, `suggest`.
    """

    def eliminated(self, damping: float = 0.0) -> NormalEquations:
        """Normal equations of the measurements, stations and boards eliminated; see `normal.eliminated`.

        Raises:
            SolveError: a singular matrix.
        """
        with solvable():
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
        with solvable():
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

    @cached_property
    def marginals(self) -> Marginals:
        """Covariances of the predicted measurements."""
        with solvable():
            return marginals(self, self.normal, self.conditional_covariance)

    def predicted(self, step: Step) -> Self:
        """The likelihood after an undamped step, all to first order: residuals follow, derivatives stay."""
        known = {
            "views": self.views.moved(step),
            "legs": self.legs.moved(self.data, step),
            "normal": self.normal.after(step.shared),
            "conditional_covariance": self.conditional_covariance,
        }
        return self.changed(known=known, state=self.state.plus(self.data, step))


def _positive(values: FloatArray) -> FloatArray:
    """The values.

    Raises:
        LinAlgError: one is not positive.
    """
    if not np.all(values > 0):
        raise np.linalg.LinAlgError("not positive definite")
    return values
