"""Observable and unobservable directions of the global parameters (method.md, last table)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mobilecal_cli.likelihood.shared import WHEEL_SCALE, Layout
from mobilecal_cli.model import BoolArray, FloatArray

_HELD_ERROR = (
    0.1  # assumed error of a fixed direction, as a share of its scale: 10 mm, 1.1 degrees, 2 % of a wheel
)


@dataclass(frozen=True, slots=True, eq=False)
class Directions:
    """Singular values and directions of the whitened, column-scaled Jacobian of the named global parameters.

    Attributes:
        names: (named,) the columns.
        scales: (named,) units: the accuracy of a parameter without any recording.
        singular_values: (named,) in decreasing order: scale over standard deviation along each direction.
        directions: (named, named) rows, orthonormal, in units of `scales`.
        least: directions with a smaller singular value are unobservable: nominal values are more accurate, or noise
            alone gives as much.
    """

    names: tuple[str, ...]
    scales: FloatArray
    singular_values: FloatArray
    directions: FloatArray
    least: float

    @property
    def hidden(self) -> FloatArray:
        """Unobservable directions, (K, named)."""
        return self.directions[self.singular_values < self.least]


def directions(
    information: FloatArray, layout: Layout, wheels_m: FloatArray, free: FloatArray, legs: int
) -> Directions:
    """Singular directions of the information about the named parameters, with the boards eliminated.

    Noisy readings resemble a small motion: a leg without a turn seems to turn by its own noise, and so to determine
    the wheel separation to 100 %. Over n such legs this gives a singular value of ``WHEEL_SCALE sqrt(n)``. The limit
    `least` is three times this value.

    Args:
        information: (P, P) of the global parameters.
        layout: names its columns.
        wheels_m: (3,) scales of the wheels.
        legs: number of legs.
        free: (named, F) basis of the directions not fixed by the user, in units of the scales.
    """
    n, scales = layout.named, layout.scales(wheels_m)
    S_ab, S_bb = information[:n, n:], information[n:, n:]
    reduced = information[:n, :n] - S_ab @ np.linalg.solve(S_bb, S_ab.T)
    values, vectors = np.linalg.eigh(free.T @ (reduced * np.outer(scales, scales)) @ free)
    order = np.argsort(-values)
    singular = np.sqrt(np.maximum(values[order], 0.0))
    least = max(1.0, 3 * WHEEL_SCALE * float(np.sqrt(legs)))
    return Directions(layout.names, scales, singular, (free @ vectors[:, order]).T, least)


def tainted(held: FloatArray, scales: FloatArray, std: FloatArray) -> BoolArray:
    """Parameters that a plausible error of the fixed directions shifts by more than their own sigma, (named,).

    Args:
        held: (K, named) fixed directions in units of `scales`.
        scales: (named,) units.
        std: (named,) standard deviations with these directions fixed.
    """
    if not len(held):
        return np.zeros(len(scales), dtype=np.bool_)
    share = np.linalg.norm(held, axis=0)
    return np.asarray((share > 1e-6) & (share * scales * _HELD_ERROR > std))
