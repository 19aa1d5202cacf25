"""How each kind of measurement moves the shared parameters: error budget, and a jackknife from the residuals."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mobilecal_cli.likelihood.measurements import ENCODERS, PROCESSES, STAMP
from mobilecal_cli.likelihood.posterior import Posterior, roots
from mobilecal_cli.likelihood.processes import COUNT, LEVELS
from mobilecal_cli.model import FloatArray

_NO_REDUNDANCY = 1e-6
# Over the square root of the number of legs: contains 19 of 20 simulated recordings of 12 and of 40 stations.
_JACKKNIFE_SCATTER = 3.6


@dataclass(frozen=True, eq=False)
class Influence:
    """One kind of measurement in units whose noise is independent: stations, or legs.

    Attributes:
        by_unit: (n, P, m) derivative of the shared parameters by each unit's m whitened residuals.
        residual: (n, m) those residuals.
        leverage: (n, m, m) each unit's block of the hat matrix.
        parts: noise level (see `noise.Noise`) → (n or 1, m, m) its share of the residuals' covariance, the identity;
            None where it is all of it.
    """

    by_unit: FloatArray
    residual: FloatArray
    leverage: FloatArray
    parts: Mapping[str, FloatArray | None]

    @cached_property
    def covariances(self) -> Mapping[str, FloatArray]:
        """Noise level → (P, P) covariance of the shared parameters due to it, if it is correct."""
        shares = {
            level: self.by_unit if part is None else self.by_unit @ part for level, part in self.parts.items()
        }
        return {level: _summed(share, self.by_unit) for level, share in shares.items()}

    @property
    def spread(self) -> FloatArray:
        """(P, P) the same from the residuals' scatter: sum over units of (K (I - h)^-1/2 r)(...)^T."""
        values, vectors = np.linalg.eigh(np.eye(self.residual.shape[1]) - self.leverage)
        usable = values > _NO_REDUNDANCY
        root = np.where(usable, 1 / np.sqrt(np.where(usable, values, 1.0)), 0.0)
        along = np.einsum("nkm,nk->nm", vectors, self.residual) * root
        shift = (self.by_unit @ (vectors @ along[..., None]))[..., 0]
        return np.asarray(shift.T @ shift)


def _summed(A: FloatArray, B: FloatArray) -> FloatArray:
    """Sum over n and m of A B^T: (n, P, m) and (n, Q, m) → (P, Q), as one matrix product."""
    flat = (np.moveaxis(part, 1, 0).reshape(part.shape[1], -1) for part in (A, B))
    left, right = flat
    product: FloatArray = left @ right.T
    return product


def influences(lin: Posterior) -> Iterator[Influence]:
    """Images, joint readings, sway, floor and wheel scales, wheels, encoder readings and stamps at an optimum."""
    yield from _of_images(lin)
    data, marginal = lin.data, lin.marginals
    errors, sigma = lin.own_errors, lin.own_sigmas
    joints = data.joints.shape[1]
    per_sigma = np.where(lin.inliers.views[:, None], 1 / sigma, 0.0)
    per_sigma[:, :joints] *= lin.inliers.readings
    per_sigma[:, joints:] *= data.drives[:, None]
    for columns, parts in (
        (slice(0, joints), {"joint_rad": None}),
        (slice(joints, None), {"sway_rad": np.diag([1.0, 1.0, 0.0]), "sway_m": np.diag([0.0, 0.0, 1.0])}),
    ):
        at = np.zeros((*errors.shape, errors[:, columns].shape[1]))
        at[:, columns] = per_sigma[:, columns, None] * np.eye(at.shape[2])
        leverage = np.swapaxes(at, 1, 2) @ marginal.own @ at
        yield Influence(_onto(lin, own=at), (errors * per_sigma)[:, columns], leverage, parts)
    yield _of_processes(lin)
    if len(data.legs):
        yield _of_legs(lin)
    base = np.zeros((data.stations, data.base_width, 2))
    base[:, ENCODERS] = np.eye(2) / lin.encoder_sigmas[:, None]
    leverage = np.eye(2) * (marginal.encoders / lin.encoder_sigmas**2)[:, None]
    off = lin.state.encoder_errors / lin.encoder_sigmas
    yield Influence(_onto(lin, base=base), off, leverage, {"encoder_rad": None})
    if data.base_width > STAMP:
        base = np.zeros((data.stations, data.base_width, 1))
        base[:, STAMP] = 1 / lin.noise.stamp_s
        leverage = (marginal.stamps / lin.noise.stamp_s**2)[:, None, None]
        off = lin.state.stamp_errors[:, None] / lin.noise.stamp_s
        yield Influence(_onto(lin, base=base), off, leverage, {"stamp_s": None})


def _onto(lin: Posterior, base: FloatArray | None = None, own: FloatArray | None = None) -> FloatArray:
    """(N, P, m) influence of m measurements of each station's base block (N, B, m), or of its own errors (N, E, m)."""
    stations = np.arange(lin.data.stations)
    influence: FloatArray = lin.conditional_covariance @ lin.normal.onto_shared(stations, base, own)
    return influence


def _of_images(lin: Posterior) -> Iterator[Influence]:
    """Of corners, and of measured poses."""
    views, C = lin.views, lin.conditional_covariance
    leverage = lin.marginals.images()
    for level, of_kind in (("pixel_px", ~lin.data.posed), ("pose_scale", lin.data.posed)):
        stations = np.flatnonzero(of_kind)
        if not len(stations):
            continue
        root, inverse = roots(views.information[stations])
        transposed = np.swapaxes(root, 1, 2)
        base, own, board = (
            np.swapaxes(part[stations], 1, 2) @ root[:, :6]
            for part in (views.by_base, views.by_own, views.by_board)
        )
        shared = np.swapaxes(views.onto_shared(transposed, stations), 1, 2)
        yield Influence(
            C @ lin.normal.onto_shared(stations, base, own, board, shared),
            (inverse @ views.gradient[stations, :, None])[..., 0],
            transposed @ leverage[stations] @ root,
            {level: None},
        )


def _of_processes(lin: Posterior) -> Influence:
    data, processes, on = lin.data, lin.processes, np.arange(COUNT)
    root = 1 / np.sqrt(processes.variance)
    here = np.zeros((data.stations, data.base_width, COUNT))
    here[:, on + PROCESSES.start, on] = root
    by_unit = _onto(lin, base=here)
    i, j = data.legs.T
    there = np.zeros((len(j), data.base_width, COUNT))
    there[:, on + PROCESSES.start, on] = -processes.rho[j] * root[j]
    by_unit[j] += lin.conditional_covariance @ lin.normal.onto_shared(i, there)
    parts = {level: np.diag([float(level == other) for other in LEVELS]) for level in dict.fromkeys(LEVELS)}
    leverage = root[:, :, None] * lin.marginals.innovations(processes.rho) * root[:, None, :]
    return Influence(by_unit, processes.innovations(lin.state.processes) * root, leverage, parts)


def _of_legs(lin: Posterior) -> Influence:
    data, legs = lin.data, lin.legs
    i, j = data.legs.T
    root, _ = roots(lin.leg_weight)
    shared = np.swapaxes(legs.by_shared, 1, 2) @ root
    onto = lin.normal.onto_shared(i, np.swapaxes(legs.by_start, 1, 2) @ root, shared=shared)
    onto += lin.normal.onto_shared(j, np.swapaxes(legs.by_end, 1, 2) @ root)
    transposed = np.swapaxes(root, 1, 2)
    return Influence(
        lin.conditional_covariance @ onto,
        (transposed @ legs.residual[..., None])[..., 0],
        transposed @ lin.marginals.legs @ root,
        {level: transposed @ share @ root for level, share in lin.leg_covariances.items()},
    )


def shares(lin: Posterior, moved_by: Iterable[Influence]) -> Mapping[str, FloatArray]:
    """Source → (P, P) share of the covariance of the shared parameters; the shares add up to it.

    With C = H^-1 and H the sum of J_s^T W_s J_s over the sources s, C is the sum of C J_s^T W_s J_s C. Joint readings
    that are outliers and bases that no measurement holds count as a source of their own ("free").

    Args:
        lin: an optimum.
        moved_by: see `influences`.

    Returns:
        Noise levels by name, "prior <name>" for the nine parameters and each constant with a prior, "unobservable" for
        the prior variance of unobservable directions, and "free".
    """
    C, layout = lin.conditional_covariance, lin.data.layout
    result: dict[str, FloatArray] = {}
    for influence in moved_by:
        for level, covariance in influence.covariances.items():
            result[level] = result.get(level, 0.0) + covariance
    for k, name in enumerate(layout.names):
        if lin.priors.weight[k]:
            result[f"prior {name}"] = lin.priors.weight[k] * np.outer(C[:, k], C[:, k])
    result["unobservable"] = lin.considered @ lin.considered.T
    result["free"] = lin.covariance - sum(result.values())
    return result


def usual_jackknife_factor(legs: int) -> float:
    """How many times the standard deviations the jackknife's are, at most, if the model is right."""
    return 1 + _JACKKNIFE_SCATTER / math.sqrt(max(legs, 1))
