"""Covariances of the predicted measurements, for redundancies and for outlier tests."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mobilecal_cli.model import FloatArray

if TYPE_CHECKING:
    from mobilecal_cli.likelihood.linearization import Linearization


@dataclass(frozen=True, slots=True, eq=False)
class Marginals:
    """Posterior covariances at an optimum.

    Attributes:
        views: (N, Q, Q) of each station's board pose in the camera (delta) and of the direct constants.
        own: (N, J + 3, J + 3) of the joint errors and of the floor.
        legs: (L, 3, 3) of the legs' residuals.
        encoders: (N, 2) variances of the encoder errors.
        stamps: (N,) variances of the stamp errors; 0 where the robot never moves.
        bases: (N, 3, 3) of the base poses, as body twists (x, y, heading).
    """

    views: FloatArray
    own: FloatArray
    legs: FloatArray
    encoders: FloatArray
    stamps: FloatArray
    bases: FloatArray


def _sandwich(A: FloatArray, C: FloatArray) -> FloatArray:
    out: FloatArray = A @ C @ np.swapaxes(A, -1, -2)
    return out


def marginals(lin: Linearization) -> Marginals:
    """Marginal covariances of every station and leg, given correct values along unobservable directions.

    Args:
        lin: an optimum.

    Raises:
        LinAlgError: a singular matrix.
    """
    C, normal = lin.conditional_covariance, lin.normal
    own, cross = normal.base_covariance()
    follow = normal.base_by_shared
    E_inverse, by_base, by_shared = normal.own_conditional()
    views, legs = lin.views, lin.legs

    A = views.by_base + views.by_own @ by_base
    F = A @ follow + views.by_shared + views.by_own @ by_shared
    seen = _sandwich(A, own) + _sandwich(F, C) + _sandwich(views.by_own, E_inverse)
    F_own = by_base @ follow + by_shared
    errors = E_inverse + _sandwich(by_base, own) + _sandwich(F_own, C)
    bases = own + _sandwich(follow, C)

    i, j = lin.data.legs.T
    F_legs = legs.by_start @ follow[i] + legs.by_end @ follow[j] + legs.by_shared(lin.data.layout)
    mixed = legs.by_start @ cross[i] @ np.swapaxes(legs.by_end, 1, 2)
    both = _sandwich(legs.by_start, own[i]) + _sandwich(legs.by_end, own[j])
    return Marginals(
        views=seen,
        own=errors,
        legs=both + mixed + np.swapaxes(mixed, 1, 2) + _sandwich(F_legs, C),
        encoders=np.diagonal(bases, axis1=1, axis2=2)[:, 3:5].copy(),
        stamps=bases[:, 5, 5].copy() if lin.data.base_width > 5 else np.zeros(len(bases)),
        bases=bases[:, :3, :3],
    )
