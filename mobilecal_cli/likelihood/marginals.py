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
        joints: (N, J, J) of the joint errors.
        legs: (L, 3, 3) of the legs' residuals.
        encoders: (N, 2) variances of the encoder errors.
        bases: (N, 3, 3) of the base poses, as body twists (x, y, heading).
    """

    views: FloatArray
    joints: FloatArray
    legs: FloatArray
    encoders: FloatArray
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
    E_inverse, by_base, by_shared = normal.joint_conditional()
    views, legs = lin.views, lin.legs

    A = views.by_base + views.by_joints @ by_base
    F = A @ follow + views.by_shared + views.by_joints @ by_shared
    seen = _sandwich(A, own) + _sandwich(F, C) + _sandwich(views.by_joints, E_inverse)
    F_joints = by_base @ follow + by_shared
    joints = E_inverse + _sandwich(by_base, own) + _sandwich(F_joints, C)
    bases = own + _sandwich(follow, C)

    i, j = lin.data.legs.T
    F_legs = legs.by_start @ follow[i] + legs.by_end @ follow[j] + legs.by_shared(lin.data.layout)
    mixed = legs.by_start @ cross[i] @ np.swapaxes(legs.by_end, 1, 2)
    both = _sandwich(legs.by_start, own[i]) + _sandwich(legs.by_end, own[j])
    return Marginals(
        views=seen,
        joints=joints,
        legs=both + mixed + np.swapaxes(mixed, 1, 2) + _sandwich(F_legs, C),
        encoders=np.diagonal(bases, axis1=1, axis2=2)[:, 3:].copy(),
        bases=bases[:, :3, :3],
    )
