"""A calibration tried on stations that it was not made from, and calibrations side by side."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mobilecal_cli.model.arrays import FloatArray, IntArray, freeze


@dataclass(frozen=True, slots=True)
class Drift:
    """How far dead reckoning leaves the way that the cameras see, over all pairs of stations of a log.

    Attributes:
        m_per_m: rms error of the place over the rms length of the way; None where the base hardly drove.
        rad_per_rad: rms error of the heading over the rms rotation; None where the base hardly turned.
    """

    m_per_m: float | None
    rad_per_rad: float | None


@dataclass(frozen=True, slots=True, eq=False)
class Evaluation:
    """A calibration tried on a recording.

    Each leg's camera motion is predicted by the parameters alone (eq. 18) and compared with what the board shows.

    Attributes:
        stations: with the board in both cameras.
        legs: (L, 3) log, first and second station of each leg.
        reprojection_px: (L,) rms distance of carried to detected corners, both cameras.
        rotation_rad: (L,) angle between predicted and seen rotation of the camera.
        translation_m: (L,) distance between predicted and seen place of the camera.
        driven_m, turned_rad: sums over the legs of the way and of the rotation, by the calibrated wheels.
        before: drift with the wheels as they were known before, None where they were not.
        after: drift with the calibrated wheels.
    """

    stations: int
    legs: IntArray
    reprojection_px: FloatArray
    rotation_rad: FloatArray
    translation_m: FloatArray
    driven_m: float
    turned_rad: float
    before: Drift | None
    after: Drift

    def __post_init__(self) -> None:
        legs = freeze(self, np.int64, legs=("L", 3))["L"]
        freeze(self, reprojection_px=(legs,), rotation_rad=(legs,), translation_m=(legs,))
