"""Evaluation of a calibration on stations that were not used for it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mobilecal_cli.model.arrays import FloatArray, IntArray, freeze


@dataclass(frozen=True, slots=True)
class Drift:
    """Error of dead reckoning relative to the motion that the cameras measure, over all pairs of stations.

    Attributes:
        m_per_m: rms position error over rms distance; None if the base hardly drove.
        rad_per_rad: rms heading error over rms rotation; None if the base hardly turned.
    """

    m_per_m: float | None
    rad_per_rad: float | None


@dataclass(frozen=True, slots=True, eq=False)
class Evaluation:
    """Evaluation of a calibration on a recording.

    The parameters predict the camera motion of each leg (eq. 18); the board measures it.

    Attributes:
        stations: number of stations with the board in both cameras.
        legs: (L, 3) log, first and second station of each leg.
        reprojection_px: (L,) rms distance between predicted and detected corners, both cameras.
        rotation_rad: (L,) angle between predicted and measured rotation of the camera.
        translation_m: (L,) distance between predicted and measured position of the camera.
        driven_m, turned_rad: total distance and rotation of the base, with the calibrated wheels.
        before: drift with the nominal wheels, None without nominal wheels.
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
