"""What is known of the shared parameters beside the measurements: nominal values, user priors, fixed values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mobilecal_cli.likelihood.constants import Layout, family
from mobilecal_cli.likelihood.state import State
from mobilecal_cli.model.arrays import BoolArray, FloatArray
from mobilecal_cli.model.calibration import NINE, Parameters


@dataclass(frozen=True, eq=False)
class Priors:
    """Gaussian priors of the named parameters (the nine and the constants), and what keeps its prior.

    All speak of the displacement from an anchor: `Parameters.minus`, and the constants as they are.

    Attributes:
        layout: columns.
        anchor: the point that displacements count from.
        mean: (P,) expected displacement.
        stated_weight: (P,) inverse variance as stated, 0 for no prior.
        fixed: (P,) columns with an exactly known displacement, `mean`.

        unobservable: (K, 9) directions of the nine that the measurements do not show, orthonormal in units of
            `scales`. The displacement keeps its mean along them, and its prior variance.
        alike: (P,) constants whose priors are made wider with those of their kind, see `wider`.
        wider: kind of constants → how many times as wide as stated their priors are.
        bias: (P,) gradient that half the sum of squares is expected to have at the truth, see
            `budget.expected_gradient`.
    """

    layout: Layout
    anchor: Parameters
    mean: FloatArray
    stated_weight: FloatArray
    fixed: BoolArray
    unobservable: FloatArray
    alike: BoolArray
    wider: Mapping[str, float]
    bias: FloatArray | float = 0.0

    def widened(self, wider: Mapping[str, float]) -> Priors:
        """The same, so many times as wide as stated."""
        return replace(self, wider=wider)

    @cached_property
    def scales(self) -> FloatArray:
        """(P,) prior sigmas of nominal values: units in which directions are orthonormal."""
        return self.layout.prior_sigmas(self.anchor.wheels)

    @cached_property
    def factors(self) -> FloatArray:
        """(P,) prior sigma over the stated one."""
        of_kind = [self.wider.get(family(row.kind), 1.0) for row in self.layout.constants]
        return np.where(self.alike, np.concatenate([np.ones(len(NINE)), of_kind]), 1.0)

    @cached_property
    def weight(self) -> FloatArray:
        """(P,) inverse variance, 0 for no prior."""
        return self.stated_weight / self.factors**2

    def displacement(self, state: State) -> FloatArray:
        """(P,) rad, m, and the constants' units."""
        constants = [state.value(row.name) for row in self.layout.constants]
        return np.concatenate([state.parameters.minus(self.anchor), constants])

    @cached_property
    def nine_basis(self) -> FloatArray:
        """(9, F) free directions of the nine, orthonormal in units of `scales`."""
        kept = np.concatenate([np.eye(len(NINE))[self.fixed[: len(NINE)]], self.unobservable])
        if not len(kept):
            return np.eye(len(NINE))
        _, _, Vt = np.linalg.svd(kept, full_matrices=True)
        return np.asarray(Vt[len(kept) :].T)

    def onto_free(self, gradient: FloatArray) -> FloatArray:
        """(P, ...) by the parameters → (F, ...) by the free directions: those of the nine, then free constants."""
        nine = len(NINE)
        scaled = (gradient.T * self.scales).T
        return np.concatenate([self.nine_basis.T @ scaled[:nine], scaled[nine:][~self.fixed[nine:]]])

    def from_free(self, along: FloatArray) -> FloatArray:
        """(F, ...) step along the free directions → (P, ...) step of the parameters: the transpose of `onto_free`."""
        own, step = self.nine_basis.shape[1], np.zeros((self.layout.size, *along.shape[1:]))
        step[: len(NINE)] = self.nine_basis @ along[:own]
        step[len(NINE) :][~self.fixed[len(NINE) :]] = along[own:]
        return np.asarray((step.T * self.scales).T)

    def reduced(self, information: FloatArray) -> FloatArray:
        """(P, P) → (F, F) of the free directions."""
        return self.onto_free(self.onto_free(information).T)

    def spread(self, covariance: FloatArray) -> FloatArray:
        """(F, F) of the free directions → (P, P)."""
        return self.from_free(self.from_free(covariance).T)

    def step_to_mean(self, state: State) -> FloatArray:
        """(P,) shortest step after which the state has its mean along all directions that keep it."""
        size, others = self.layout.size, self.layout.size - len(NINE)
        kept = np.concatenate([np.eye(size)[self.fixed], np.pad(self.unobservable, ((0, 0), (0, others)))])
        off = kept @ ((self.mean - self.displacement(state)) / self.scales)
        return np.asarray(self.scales * (kept.T @ off))

    def gradient(self, state: State) -> FloatArray:
        """(P,) gradient of half the priors' sum of squares, less the bias of the measurements'."""
        return self.weight * (self.displacement(state) - self.mean) - self.bias

    def cost(self, state: State) -> float:
        """Sum of squares of the whitened deviations from the priors, less what the measurements' bias makes it."""
        off = self.displacement(state) - self.mean
        return float(np.sum(self.weight * off**2 - 2 * self.bias * off))

    def considered(self, information: FloatArray, covariance: FloatArray) -> FloatArray:
        """(P, K) how the estimate is wrong if the unobservable directions are wrong by their prior sigmas.

        The other parameters follow a wrong value u as the normal equations make them, so the error is
        u - C H u (the consider covariance of Schmidt, 1966).

        Args:
            information: (P, P) H, priors included.
            covariance: (P, P) C for correct values along the unobservable directions.
        """
        along = np.zeros((self.layout.size, len(self.unobservable)))
        U, nine = self.unobservable, len(NINE)
        weight, scales = self.weight[:nine], self.scales[:nine]
        prior = np.sqrt(np.maximum(np.einsum("kn,n,kn->k", U, weight * scales**2, U), 1e-300))
        along[:nine] = (U * scales).T / prior
        return along - covariance @ (information @ along)
