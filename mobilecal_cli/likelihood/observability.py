"""Directions of the shared parameters that the measurements show (method.md, last table)."""

from __future__ import annotations

import numpy as np

from mobilecal_cli.likelihood.linearization import solvable
from mobilecal_cli.likelihood.nuisance import WHEEL_SIGMA
from mobilecal_cli.likelihood.posterior import Posterior
from mobilecal_cli.model import NINE, FloatArray

_SCATTERS = 5.0


@solvable()
def directions(lin: Posterior, user_weight: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Singular directions of the information about the nine, the constants (with their priors) eliminated.

    Noisy readings look like a little motion: a leg without a turn seems to turn by as much as its noise, and so seems
    to show the separation to 100 %. Over n such legs that makes a squared singular value of ``WHEEL_SIGMA^2 n`` of the
    wheels' share of a direction, with a scatter of ``WHEEL_SIGMA^2 sqrt(2 n)``. A direction is observable if it shows
    more than this, and five times the scatter, and a drawing.

    Args:
        lin: where.
        user_weight: (P,) inverse variances of priors that count as measurements: the user's, and the constants'.

    Returns:
        (9,) falling singular values: prior sigma of a nominal value over standard deviation along each direction of
        the free parameters; and the unobservable directions, (K, 9) rows, orthonormal in units of these sigmas: of
        which the measurements show less than a drawing, or no more than their noise alone would.

    Raises:
        SolveError: the constants are not determined.
    """
    nine = len(NINE)
    scales, fixed = lin.priors.scales[:nine], lin.priors.fixed
    S = lin.normal.S + np.diag(user_weight)
    others = nine + np.flatnonzero(~fixed[nine:])
    own = np.diag(S)[others]
    unit = 1 / np.sqrt(np.where(own > 0, own, 1.0))  # far from the optimum, rounding may exceed what is known
    across = S[:nine, others] * unit
    inner = S[np.ix_(others, others)] * np.outer(unit, unit)
    reduced = S[:nine, :nine] - across @ np.linalg.solve(inner, across.T)
    kept = np.eye(nine)[:, ~fixed[:nine]]
    values, vectors = np.linalg.eigh(kept.T @ (reduced * np.outer(scales, scales)) @ kept)
    order = np.argsort(-values)
    singular = np.sqrt(np.maximum(values[order], 0.0))
    along = (kept @ vectors[:, order]).T
    legs = len(lin.data.legs)
    by_noise = WHEEL_SIGMA**2 * (legs + _SCATTERS * np.sqrt(2 * legs))
    least = np.sqrt(1 + by_noise * np.sum(along[:, 6:] ** 2, axis=1))
    return singular, along[singular < least]
