"""How each kind of measurement moves the shared parameters: error budget, and a jackknife from the residuals."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mobilecal_cli.model import NINE, FloatArray

if TYPE_CHECKING:
    from mobilecal_cli.likelihood.linearization import Linearization

_NO_REDUNDANCY = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class Influence:
    """One kind of measurement in units whose noise is independent: stations, or legs.

    Attributes:
        level: its noise level, see `noise.Noise`.
        by_unit: (n, P, m) derivative of the shared parameters by each unit's m whitened residuals.
        residual: (n, m) those residuals.
        leverage: (n, m, m) each unit's block of the hat matrix.
    """

    level: str
    by_unit: FloatArray
    residual: FloatArray
    leverage: FloatArray

    @property
    def covariance(self) -> FloatArray:
        """(P, P) covariance of the shared parameters due to this kind's noise, for a correct noise level."""
        return np.asarray(np.einsum("npm,nqm->pq", self.by_unit, self.by_unit))

    @property
    def spread(self) -> FloatArray:
        """(P, P) the same from the residuals' scatter: sum over units of (K (I - h)^-1/2 r)(...)^T."""
        values, vectors = np.linalg.eigh(np.eye(self.residual.shape[1]) - self.leverage)
        usable = values > _NO_REDUNDANCY
        root = np.where(usable, 1 / np.sqrt(np.where(usable, values, 1.0)), 0.0)
        along = np.einsum("nkm,nk->nm", vectors, self.residual) * root
        shift = np.einsum("npk,nkm,nm->np", self.by_unit, vectors, along)
        return np.asarray(shift.T @ shift)


def _roots(information: FloatArray) -> tuple[FloatArray, FloatArray]:
    """R with R R^T = information, and its pseudo-inverse, (n, Q, Q) each."""
    values, vectors = np.linalg.eigh(information)
    size = np.sqrt(np.maximum(values, 0.0))
    positive = size > 1e-9 * size.max(axis=1, keepdims=True).clip(1e-300)
    inverse = np.where(positive, 1 / np.where(positive, size, 1.0), 0.0)
    return vectors * size[:, None, :], np.swapaxes(vectors * inverse[:, None, :], 1, 2)


def influences(lin: Linearization) -> Iterator[Influence]:
    """Images, joint readings, wheels and encoder readings at an optimum."""
    data, state, normal, marginal = lin.data, lin.state, lin.normal, lin.marginals
    views, legs, C = lin.views, lin.legs, lin.conditional_covariance
    root, inverse = _roots(views.information)
    yield Influence(
        "pixel_px",
        C
        @ normal.onto_shared(
            np.arange(data.stations),
            np.swapaxes(views.by_base, 1, 2) @ root,
            np.swapaxes(views.by_joints, 1, 2) @ root,
            np.swapaxes(views.by_shared, 1, 2) @ root,
        ),
        (inverse @ views.gradient[..., None])[..., 0],
        np.swapaxes(root, 1, 2) @ marginal.views @ root,
    )

    sigma = lin.joint_sigmas
    read = lin.inliers.readings & lin.inliers.views[:, None]
    count, J = sigma.shape
    one = np.where(read, 1 / sigma, 0.0)[:, :, None] * np.eye(J)
    none, P = np.zeros((count, 5, J)), C.shape[0]
    yield Influence(
        "joint_rad",
        C @ normal.onto_shared(np.arange(count), none, one, np.zeros((count, P, J))),
        np.where(read, state.joint_errors / sigma, 0.0),
        one @ marginal.joints @ one,
    )

    if len(data.legs):
        i, j = data.legs.T
        root, _ = _roots(lin.leg_weight)
        shared = np.swapaxes(legs.by_shared(data.layout), 1, 2) @ root
        empty = np.zeros((len(i), J, 3))
        onto = normal.onto_shared(i, np.swapaxes(legs.by_start, 1, 2) @ root, empty, shared)
        onto += normal.onto_shared(j, np.swapaxes(legs.by_end, 1, 2) @ root, empty, np.zeros_like(shared))
        yield Influence(
            "wheel_rad_per_sqrt_rad",
            C @ onto,
            (np.swapaxes(root, 1, 2) @ legs.residual[..., None])[..., 0],
            np.swapaxes(root, 1, 2) @ marginal.legs @ root,
        )
    if lin.noise.encoder_rad:
        one = np.broadcast_to(np.diag(1 / lin.encoder_sigmas), (count, 2, 2))
        base = np.concatenate([np.zeros((count, 3, 2)), one], axis=1)
        onto = normal.onto_shared(np.arange(count), base, np.zeros((count, J, 2)), np.zeros((count, P, 2)))
        leverage = marginal.encoders[:, :, None] * np.diag(lin.encoder_sigmas**-2)
        yield Influence("encoder_rad", C @ onto, state.encoder_errors / lin.encoder_sigmas, leverage)


def shares(lin: Linearization) -> Mapping[str, FloatArray]:
    """Source → (P, P) share of the covariance of the shared parameters; the shares add up to it.

    With C = H^-1 and H the sum of J_s^T W_s J_s over the sources s, C is the sum of C J_s^T W_s J_s C. Joint readings
    that are outliers and bases that no measurement holds count as a source of their own ("free").

    Returns:
        Noise levels by name, "prior <name>" for the nine parameters and each constant with a prior, "unobservable" for
        the prior variance of unobservable directions, and "free".
    """
    C, layout = lin.conditional_covariance, lin.data.layout
    result: dict[str, FloatArray] = {i.level: i.covariance for i in lin.influences}
    for k, name in enumerate(layout.names):
        if lin.priors.weight[k]:
            result[f"prior {name}"] = lin.priors.weight[k] * np.outer(C[:, k], C[:, k])
    result["unobservable"] = lin.considered @ lin.considered.T
    result["free"] = lin.covariance - sum(result.values())
    return result


def nine_of(share: FloatArray) -> FloatArray:
    """(9,) variances of the nine parameters in a share of the budget."""
    return np.asarray(np.diag(share)[: len(NINE)])
