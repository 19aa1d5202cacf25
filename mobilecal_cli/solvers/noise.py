"""Noise levels from the residuals: variance components by restricted maximum likelihood."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import astuple, dataclass, replace

import numpy as np

from mobilecal_cli.likelihood.linearization import Linearization
from mobilecal_cli.likelihood.noise import Noise

# Where nothing else is known: a good corner fit, wheels that roll on a firm floor, a servo's encoder.
GUESS = Noise(pixel_px=0.1, wheel_rad_per_sqrt_rad=0.004, encoder_rad=0.0, joint_rad=float(np.radians(0.03)))
LEAST = Noise(pixel_px=1e-3, wheel_rad_per_sqrt_rad=1e-5, encoder_rad=0.0, joint_rad=1e-6)
# Beyond these a level says that the model is wrong, not how noisy a measurement is.
MOST = Noise(pixel_px=1e3, wheel_rad_per_sqrt_rad=1.0, encoder_rad=1.0, joint_rad=1.0)
_WORTH, _FADES_AT = 2.0, 4.0
UNIFORM = 1 / math.sqrt(12)  # sigma of an encoder's reading, in steps


def guess_worth(redundancy: float) -> float:
    """How many residuals the guess counts for: a few where few others are, hardly any where many are."""
    return _WORTH / (1 + (max(redundancy, 0.0) / _FADES_AT) ** 2)


@dataclass(frozen=True, slots=True)
class Component:
    """One kind of noise, as the residuals show it.

    Attributes:
        squares: sum of squares of the whitened residuals.
        redundancy: number of residuals minus what the unknowns take up.
    """

    squares: float
    redundancy: float

    def factor(self, guess: float) -> float:
        """Estimated variance over the present one; guess: the guessed variance over the present one."""
        worth = guess_worth(self.redundancy)
        return (self.squares + worth * guess) / (max(self.redundancy, 0.0) + worth)


def components(lin: Linearization) -> dict[str, Component]:
    """Sums of squares and redundancies of each kind of noise at an optimum (Foerstner's estimate)."""
    views, marginal, state = lin.views, lin.marginals, lin.state
    taken = np.einsum("nqr,nrq->", views.information, marginal.views)
    corners = 2 * int(lin.inliers.used_corners.sum())
    result = {"pixel_px": Component(float(views.cost.sum()), corners - float(taken))}

    weight, e = lin.leg_weight, lin.legs.residual
    squares = float(np.einsum("la,lab,lb->", e, weight, e))
    free = 3 * int(lin.inliers.legs.sum()) - float(np.einsum("lab,lba->", weight, marginal.legs))
    result["wheel_rad_per_sqrt_rad"] = Component(squares, free)

    sigma = lin.joint_sigmas
    read = lin.inliers.readings & lin.inliers.views[:, None]
    variance = np.diagonal(marginal.joints, axis1=1, axis2=2)
    ratio = np.where(read, (state.joint_errors / sigma) ** 2, 0.0)
    left = np.where(read, 1 - variance / sigma**2, 0.0)
    result["joint_rad"] = Component(float(ratio.sum()), float(left.sum()))

    if lin.noise.encoder_rad:
        ratio = (state.encoder_errors / lin.encoder_sigmas) ** 2
        left = 1 - marginal.encoders / lin.encoder_sigmas**2
        result["encoder_rad"] = Component(float(ratio.sum()), float(left.sum()))
    return result


def estimated(noise: Noise, found: Mapping[str, Component], given: frozenset[str], guess: Noise) -> Noise:
    """The noise after one step of the fixed point; levels that are given stay."""
    changes: dict[str, float] = {}
    for name, component in found.items():
        if name in given:
            continue
        before, supposed = getattr(noise, name), getattr(guess, name)
        factor = np.clip(component.factor((supposed / before) ** 2), 1e-4, 1e4)
        level = before * float(np.sqrt(factor))
        changes[name] = min(max(level, getattr(LEAST, name)), getattr(MOST, name))
    return replace(noise, **changes)


def converged(before: Noise, after: Noise, tolerance: float) -> bool:
    """Whether no level moved by more than a share of itself."""
    a, b = np.array(astuple(before)), np.array(astuple(after))
    return bool(np.all(np.abs(b - a) <= tolerance * a))
