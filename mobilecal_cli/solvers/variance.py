"""Estimation of the noise levels from residuals (variance components, restricted maximum likelihood)."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import astuple, dataclass, replace

import numpy as np

from mobilecal_cli.likelihood.marginals import Marginals
from mobilecal_cli.likelihood.noise import Noise, Selection
from mobilecal_cli.likelihood.problem import Problem
from mobilecal_cli.likelihood.system import joint_sigmas
from mobilecal_cli.solvers.descent import Optimum

# Default levels: a good corner fit, wheels without slip on a firm floor, a servo's encoder.
GUESS = Noise(pixel_px=0.1, wheel_rad_per_sqrt_rad=0.004, encoder_rad=0.0, joint_rad=float(np.radians(0.03)))
LEAST = Noise(pixel_px=1e-3, wheel_rad_per_sqrt_rad=1e-5, encoder_rad=0.0, joint_rad=1e-6)
_WORTH, _FADES_AT = 2.0, 4.0
UNIFORM = 1 / math.sqrt(12)  # sigma of an encoder reading, in steps


def guess_worth(redundancy: float) -> float:
    """Weight of the default level as a number of residuals; it decreases with the redundancy."""
    return _WORTH / (1 + (max(redundancy, 0.0) / _FADES_AT) ** 2)


@dataclass(frozen=True, slots=True)
class Component:
    """Residual statistics of one kind of noise.

    Attributes:
        squares: sum of squares of the whitened residuals.
        redundancy: degrees of freedom, the residuals less the unknowns that they determine.
    """

    squares: float
    redundancy: float

    def factor(self, guess: float) -> float:
        """Factor on the variance; guess: the default variance over the present one."""
        worth = guess_worth(self.redundancy)
        return (self.squares + worth * guess) / (max(self.redundancy, 0.0) + worth)


def components(
    problem: Problem, optimum: Optimum, marginal: Marginals, selection: Selection, noise: Noise
) -> dict[str, Component]:
    """Sum of squares and redundancy of each kind of noise at an optimum (Foerstner's estimate)."""
    system = optimum.system
    views = system.views
    believed = selection.corners & selection.views[:, None, None]
    taken = np.einsum("nqr,nrq->", views.information, marginal.views)
    result = {"pixel_px": Component(float(views.cost.sum()), 2 * int(believed.sum()) - float(taken))}

    weight, e = system.leg_weight, system.legs.residual
    squares = float(np.einsum("la,lab,lb->", e, weight, e))
    free = 3 * int(selection.legs.sum()) - float(np.einsum("lab,lba->", weight, marginal.legs))
    result["wheel_rad_per_sqrt_rad"] = Component(squares, free)

    sigma = joint_sigmas(problem, selection, noise)
    read = selection.readings & selection.views[:, None]
    variance = np.diagonal(marginal.joints, axis1=1, axis2=2)
    ratio = np.where(read, (optimum.state.joint_errors / sigma) ** 2, 0.0)
    left = np.where(read, 1 - variance / sigma**2, 0.0)
    result["joint_rad"] = Component(float(ratio.sum()), float(left.sum()))

    if noise.encoder_rad:
        ratio = (optimum.state.encoder_errors / noise.encoder_rad) ** 2
        left = 1 - marginal.encoders / noise.encoder_rad**2
        result["encoder_rad"] = Component(float(ratio.sum()), float(left.sum()))
    return result


def estimated(noise: Noise, found: Mapping[str, Component], given: frozenset[str], guess: Noise) -> Noise:
    """Noise levels after one fixed-point iteration; given levels do not change."""
    changes: dict[str, float] = {}
    for name, component in found.items():
        if name in given:
            continue
        before, supposed = getattr(noise, name), getattr(guess, name)
        factor = np.clip(component.factor((supposed / before) ** 2), 1e-4, 1e4)
        changes[name] = max(before * float(np.sqrt(factor)), getattr(LEAST, name))
    return replace(noise, **changes)


def settled(before: Noise, after: Noise, tolerance: float) -> bool:
    """Whether all levels changed by at most the relative tolerance."""
    a, b = np.array(astuple(before)), np.array(astuple(after))
    return bool(np.all(np.abs(b - a) <= tolerance * a))
