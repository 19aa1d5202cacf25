"""Marginal covariances of the fitted measurements, for redundancies and outlier tests."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mobilecal_cli.likelihood.problem import Problem
from mobilecal_cli.likelihood.system import System
from mobilecal_cli.model import FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class Marginals:
    """Posterior covariances at the optimum.

    Attributes:
        views: (N, Q, Q) of (delta, direct extras): board pose in the camera, and camera parameters.
        joints: (N, J, J) of the joint errors.
        legs: (L, 3, 3) of the fitted leg residuals.
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


def marginals(problem: Problem, system: System, shared_covariance: FloatArray) -> Marginals:
    """Marginal covariances of every station and leg.

    Args:
        problem, system: at the optimum, without damping.
        shared_covariance: (P, P) of the global parameters.
    """
    own, cross = system.base_covariance()
    follow = system.base_by_shared
    E_inverse, by_base, by_shared = system.joint_conditional()
    views, legs = system.views, system.legs

    A = views.by_base + views.by_joints @ by_base
    F = A @ follow + views.by_shared + views.by_joints @ by_shared
    seen = _sandwich(A, own) + _sandwich(F, shared_covariance) + _sandwich(views.by_joints, E_inverse)
    F_joints = by_base @ follow + by_shared
    joints = E_inverse + _sandwich(by_base, own) + _sandwich(F_joints, shared_covariance)
    bases = own + _sandwich(follow, shared_covariance)

    i, j = problem.legs.T
    F_legs = legs.by_start @ follow[i] + legs.by_end @ follow[j] + legs.by_all_shared(problem.layout)
    mixed = legs.by_start @ cross[i] @ np.swapaxes(legs.by_end, 1, 2)
    both = _sandwich(legs.by_start, own[i]) + _sandwich(legs.by_end, own[j])
    return Marginals(
        views=seen,
        joints=joints,
        legs=both + mixed + np.swapaxes(mixed, 1, 2) + _sandwich(F_legs, shared_covariance),
        encoders=np.diagonal(bases, axis1=1, axis2=2)[:, 3:].copy(),
        bases=bases[:, :3, :3],
    )
