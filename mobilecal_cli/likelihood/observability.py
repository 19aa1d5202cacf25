"""Which directions of the shared numbers the measurements show (method.md, last table)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mobilecal_cli.likelihood.shared import WHEEL_SCALE, Layout
from mobilecal_cli.model import BoolArray, FloatArray

_HELD_ERROR = 0.1  # what is held may be wrong by this share of its scale: 10 mm, 1.1 degrees, 2 % of a wheel


@dataclass(frozen=True, slots=True, eq=False)
class Directions:
    """Singular values and directions of the whitened, column-scaled Jacobian of the named shared numbers.

    Attributes:
        names: (named,) the columns.
        scales: (named,) units: what a number would be known to without the log.
        singular_values: (named,) falling: scale over standard deviation along each direction.
        directions: (named, named) rows, orthonormal, in units of `scales`.
        least: a singular value under this is none: the log tells less than a drawing, or no more than noise alone
            would feign.
    """

    names: tuple[str, ...]
    scales: FloatArray
    singular_values: FloatArray
    directions: FloatArray
    least: float

    @property
    def hidden(self) -> FloatArray:
        """(K, named) directions that the log does not show."""
        return self.directions[self.singular_values < self.least]


def directions(
    information: FloatArray, layout: Layout, wheels_m: FloatArray, free: FloatArray, legs: int
) -> Directions:
    """Singular directions of the information about the named numbers, the boards eliminated.

    Noisy readings look like a little motion: a leg that does not turn still seems to turn by as much as its own
    noise, and so seems to show the separation to 100 %. Over n such legs that makes a singular value of
    ``WHEEL_SCALE sqrt(n)``; what is not three times as large is not believed.

    Args:
        information: (P, P) of the shared numbers.
        layout: names its columns.
        wheels_m: (3,) scales of the wheels.
        legs: how many legs there are.
        free: (named, F) basis of what is not fixed by the user, in units of the scales; others are left out.
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
    """Which numbers a plausible error of the held directions would shift by more than their own sigma.

    Args:
        held: (K, named) directions in units of `scales`.
        scales: (named,) units.
        std: (named,) standard deviations with the directions held.
    """
    if not len(held):
        return np.zeros(len(scales), dtype=np.bool_)
    share = np.linalg.norm(held, axis=0)
    return np.asarray((share > 1e-6) & (share * scales * _HELD_ERROR > std))
