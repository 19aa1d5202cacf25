"""Errors of a calibration on a recording."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from mobilecal_cli.model.arrays import FloatArray, IntArray, freeze


@dataclass(frozen=True, slots=True)
class Drift:
    """Relative error of dead reckoning against the cameras, over all pairs of stations of a log.

    Attributes:
        m_per_m: rms position error over the rms path length; None if the base hardly drove.
        rad_per_rad: rms heading error over the rms rotation; None if the base hardly turned.
    """

    m_per_m: float | None
    rad_per_rad: float | None


@dataclass(frozen=True, slots=True, eq=False)
class Evaluation:
    """Errors of a calibration on a recording.

    The parameters predict the camera motion over each leg (eq. 18); the board gives the measured motion.

    Attributes:
        stations: number of stations with the board in both cameras.
        legs: (L, 3) log, first and second station of each leg.
        reprojection_px: (L,) rms distance of transferred to detected corners, both cameras.
        rotation_rad: (L,) angle between predicted and measured camera rotation.
        translation_m: (L,) distance between predicted and measured camera position.
        driven_m, turned_rad: path length and absolute rotation, summed over the legs.
        before: drift with the wheels to compare with, None if there are none.
        after: drift with the calibrated wheels.
        clock_offsets_s: estimated clock offset of "joints" and "wheels", s; empty if not estimated.
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
    clock_offsets_s: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        legs = freeze(self, np.int64, legs=("L", 3))["L"]
        freeze(self, reprojection_px=(legs,), rotation_rad=(legs,), translation_m=(legs,))
