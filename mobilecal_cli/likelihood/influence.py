"""Influence of each kind of measurement on the global parameters, and the jackknife covariance from it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mobilecal_cli.likelihood.marginals import Marginals
from mobilecal_cli.likelihood.noise import Noise, Selection
from mobilecal_cli.likelihood.problem import Problem, State
from mobilecal_cli.likelihood.system import System, joint_sigmas
from mobilecal_cli.model import FloatArray

_NO_REDUNDANCY = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Influence:
    """Influence of one kind of measurement, in units with independent noise: stations or legs.

    Attributes:
        level: the name of its noise level, see `noise.Noise`.
        by_unit: (n, P, m) derivative of the global parameters by each unit's m whitened residuals.
        residual: (n, m) those residuals.
        taken: (n, m, m) each unit's block of the hat matrix.
    """

    level: str
    by_unit: FloatArray
    residual: FloatArray
    taken: FloatArray

    @property
    def covariance(self) -> FloatArray:
        """Covariance contribution of this kind of noise, (P, P), for an exactly known noise level."""
        return np.asarray(np.einsum("npm,nqm->pq", self.by_unit, self.by_unit))

    @property
    def spread(self) -> FloatArray:
        """Covariance contribution from the residuals, (P, P): sum over units of (K (I - h)^-1/2 r)(...)^T."""
        values, vectors = np.linalg.eigh(np.eye(self.residual.shape[1]) - self.taken)
        usable = values > _NO_REDUNDANCY
        root = np.where(usable, 1 / np.sqrt(np.where(usable, values, 1.0)), 0.0)
        along = np.einsum("nkm,nk->nm", vectors, self.residual) * root
        shift = np.einsum("npk,nkm,nm->np", self.by_unit, vectors, along)
        return np.asarray(shift.T @ shift)


def _roots(information: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Square roots R of R R^T = information, and their pseudo-inverses, (n, Q, Q) each."""
    values, vectors = np.linalg.eigh(information)
    size = np.sqrt(np.maximum(values, 0.0))
    sound = size > 1e-9 * size.max(axis=1, keepdims=True).clip(1e-300)
    inverse = np.where(sound, 1 / np.where(sound, size, 1.0), 0.0)
    return vectors * size[:, None, :], np.swapaxes(vectors * inverse[:, None, :], 1, 2)


def influences(
    problem: Problem,
    state: State,
    selection: Selection,
    noise: Noise,
    system: System,
    marginal: Marginals,
    covariance: FloatArray,
) -> Iterator[Influence]:
    """Influences of images, joint readings, wheels and encoder readings at an optimum.

    Args:
        problem, state, selection, noise, system, marginal: the optimum.
        covariance: (P, P) of the global parameters, for exactly known noise levels.
    """
    views, legs = system.views, system.legs
    root, inverse = _roots(views.information)
    yield Influence(
        "pixel_px",
        covariance
        @ system.onto_shared(
            np.arange(problem.stations),
            np.swapaxes(views.by_base, 1, 2) @ root,
            np.swapaxes(views.by_joints, 1, 2) @ root,
            np.swapaxes(views.by_shared, 1, 2) @ root,
        ),
        (inverse @ views.gradient[..., None])[..., 0],
        np.swapaxes(root, 1, 2) @ marginal.views @ root,
    )

    sigma = joint_sigmas(problem, selection, noise)
    read = selection.readings & selection.views[:, None]
    count, J = sigma.shape
    one = np.where(read, 1 / sigma, 0.0)[:, :, None] * np.eye(J)
    none, P = np.zeros((count, 5, J)), covariance.shape[0]
    yield Influence(
        "joint_rad",
        covariance @ system.onto_shared(np.arange(count), none, one, np.zeros((count, P, J))),
        np.where(read, state.joint_errors / sigma, 0.0),
        one @ marginal.joints @ one,
    )

    if len(problem.legs):
        i, j = problem.legs.T
        root, _ = _roots(system.leg_weight)
        shared = np.swapaxes(legs.by_all_shared(problem.layout), 1, 2) @ root
        empty = np.zeros((len(i), J, 3))
        onto = system.onto_shared(i, np.swapaxes(legs.by_start, 1, 2) @ root, empty, shared)
        onto += system.onto_shared(j, np.swapaxes(legs.by_end, 1, 2) @ root, empty, np.zeros_like(shared))
        yield Influence(
            "wheel_rad_per_sqrt_rad",
            covariance @ onto,
            (np.swapaxes(root, 1, 2) @ legs.residual[..., None])[..., 0],
            np.swapaxes(root, 1, 2) @ marginal.legs @ root,
        )
    if noise.encoder_rad:
        one = np.broadcast_to(np.eye(2) / noise.encoder_rad, (count, 2, 2))
        base = np.concatenate([np.zeros((count, 3, 2)), one], axis=1)
        onto = system.onto_shared(np.arange(count), base, np.zeros((count, J, 2)), np.zeros((count, P, 2)))
        taken = marginal.encoders[:, :, None] * np.eye(2) / noise.encoder_rad**2
        yield Influence("encoder_rad", covariance @ onto, state.encoder_errors / noise.encoder_rad, taken)
