"""Motion between stations, from joints and wheels alone: what a recording can show."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mobilecal_cli.model.arrays import FloatArray

TILTED_RAD = math.radians(3.0)  # in a smaller range, the rotation axes are practically parallel for Tsai-Lenz
TURNED_RAD = 0.1  # wheel rotation: about 2.5 degrees of heading with typical wheels
DRIVEN_RAD = 0.1  # wheel rotation: about 2 cm with typical wheels
_UNEQUAL = 0.02  # share of their size by which the wheels of a robot may differ
FEWEST_LEGS = 3  # nine equations in translation and nine in rotation for nine unknowns
_WHEEL_RAD_PER_SQRT_RAD = 0.004  # noise of wheels that roll on a firm floor
_CLEAR = 3.0  # rotations over their noise
_BLOCK = 500  # stations compared with all others at once


@dataclass(frozen=True, slots=True)
class MotionSeen:
    """Kinds of motion of the legs, and how much of each.

    Attributes:
        tilted_rad: largest angle between the base's verticals in the head's frame.
        turned_rad: largest difference of the two wheels' rotations over a leg.
        driven_rad: largest mean rotation of the two wheels over a leg.
        together_rad: smallest singular value of the rotations of all legs; 0 if noise alone explains it.
    """

    tilted_rad: float
    turned_rad: float
    driven_rad: float
    together_rad: float

    @property
    def tilts(self) -> bool:
        """Whether the head's tilt changes."""
        return self.tilted_rad >= TILTED_RAD

    @property
    def turns(self) -> bool:
        """Whether the base turns over a leg: more than wheels that differ in size do, driving straight."""
        return self.turned_rad >= max(TURNED_RAD, _UNEQUAL * self.driven_rad)

    @property
    def drives(self) -> bool:
        """Whether the base drives over a leg."""
        return self.driven_rad >= DRIVEN_RAD

    @property
    def shows_wheels(self) -> bool:
        """Whether the base turns and drives: over a leg, or over many short legs together."""
        return (self.turns and self.drives) or self.together_rad >= max(TURNED_RAD, DRIVEN_RAD)


def motion_seen(T_v_h: FloatArray, totals_rad: FloatArray, encoder_step_rad: FloatArray) -> MotionSeen:
    """Motion of joints and wheels.

    Args:
        T_v_h: (N, 4, 4) head in the base at the stations.
        totals_rad: (L, 2) rotation of the right and left wheel over each leg.
        encoder_step_rad: (2,) resolution of the encoders; 0 for none.
    """
    vertical_h = T_v_h[:, 2, :3]
    blocks = (vertical_h[i : i + _BLOCK] for i in range(0, len(vertical_h), _BLOCK))
    least_cosine = min(float((block @ vertical_h.T).min()) for block in blocks)
    right, left = totals_rad.T
    # Legs that only drive straight, or only turn in place, are all along one direction: the other one is noise.
    together = float(np.linalg.norm(totals_rad, ord=-2)) if len(totals_rad) else 0.0
    variance = _WHEEL_RAD_PER_SQRT_RAD**2 * np.abs(totals_rad) + encoder_step_rad**2 / 6  # of two readings
    noise = math.sqrt(float(variance.mean(axis=1).sum()))
    return MotionSeen(
        float(np.arccos(np.clip(least_cosine, -1, 1))),
        float(np.abs(right - left).max(initial=0)),
        float(np.abs(right + left).max(initial=0)) / 2,
        together if together >= _CLEAR * noise else 0.0,
    )
