"""Directions of the shared parameters that the measurements show (method.md, last table)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mobilecal_cli.likelihood.nuisance import WHEEL_SIGMA
from mobilecal_cli.model import FloatArray

if TYPE_CHECKING:
    from mobilecal_cli.likelihood.linearization import Linearization


@dataclass(frozen=True, slots=True, eq=False)
class Directions:
    """Singular values and directions of the whitened, column-scaled Jacobian of the named parameters.

    Attributes:
        names: (named,) the columns.
        scales: (named,) units: prior sigmas of nominal values.
        singular_values: (named,) falling: scale over standard deviation along each direction.
        directions: (named, named) rows, orthonormal, in units of `scales`.
        least: a direction with a smaller singular value is unobservable: the measurements show less than a drawing, or
            no more than their noise alone would.
    """

    names: tuple[str, ...]
    scales: FloatArray
    singular_values: FloatArray
    directions: FloatArray
    least: float

    @property
    def unobservable(self) -> FloatArray:
        """(K, named) directions that the measurements do not show."""
        return self.directions[self.singular_values < self.least]


def directions(lin: Linearization, user_weight: FloatArray) -> Directions:
    """Singular directions of the information about the named parameters, the boards eliminated.

    Noisy readings look like a little motion: a leg without a turn seems to turn by as much as its noise, and so seems
    to show the separation to 100 %. Over n such legs that makes a singular value of ``WHEEL_SIGMA sqrt(n)``. A
    direction is observable from three times that on.

    Args:
        lin: where.
        user_weight: (named,) inverse variances of priors that count as measurements.

    Raises:
        LinAlgError: the boards' poses are not determined.
    """
    layout, scales, fixed = lin.data.layout, lin.priors.scales, lin.priors.fixed
    S, n = lin.normal.S, lin.data.layout.named
    S_ab, S_bb = S[:n, n:], S[n:, n:]
    reduced = S[:n, :n] - S_ab @ np.linalg.solve(S_bb, S_ab.T) + np.diag(user_weight)
    free = np.eye(n)[:, ~fixed]
    values, vectors = np.linalg.eigh(free.T @ (reduced * np.outer(scales, scales)) @ free)
    order = np.argsort(-values)
    singular = np.sqrt(np.maximum(values[order], 0.0))
    least = max(1.0, 3 * WHEEL_SIGMA * float(np.sqrt(len(lin.data.legs))))
    return Directions(layout.names, scales, singular, (free @ vectors[:, order]).T, least)
