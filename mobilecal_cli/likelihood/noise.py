"""How noisy each kind of measurement is, and which measurements are used at all."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mobilecal_cli.likelihood.problem import Problem
from mobilecal_cli.model import BoolArray

SLIP_M_PER_SQRT_M = 1e-4  # sideways and along, of a sound wheel on a firm floor
STANDSTILL_M, STANDSTILL_RAD = 2e-5, 2e-5  # a leg that does not move still ends where it began only so well
FREE_JOINT = 1.0  # rad or m: sigma of a reading that is not believed
LOST_BASE = 1e2  # m, rad: sigma of a base pose that may hang on nothing


@dataclass(frozen=True, slots=True)
class Noise:
    """Standard deviations.

    Attributes:
        pixel_px: of one corner coordinate (root mean square over the stations, whose pictures differ).
        wheel_rad_per_sqrt_rad: of a wheel's rotation over one radian; the variance grows with the rotation.
        encoder_rad: of one encoder reading; 0 where the encoders have no steps.
        joint_rad: of one joint reading (a sliding joint: of 0.1 m).
    """

    pixel_px: float
    wheel_rad_per_sqrt_rad: float
    encoder_rad: float
    joint_rad: float


@dataclass(frozen=True, slots=True, eq=False)
class Selection:
    """What is believed.

    Attributes:
        corners: (N, 2, M) corners of each camera, among those that it saw.
        views: (N,) stations whose pictures are used.
        legs: (L,) legs whose wheels are used.
        readings: (N, J) joint readings that are used.
    """

    corners: BoolArray
    views: BoolArray
    legs: BoolArray
    readings: BoolArray

    @classmethod
    def everything(cls, problem: Problem) -> Selection:
        """Believe all that was measured."""
        return cls(
            problem.seen,
            np.ones(problem.stations, dtype=np.bool_),
            np.ones(len(problem.legs), dtype=np.bool_),
            np.ones(problem.joints.shape, dtype=np.bool_),
        )

    def same(self, other: Selection) -> bool:
        """Whether both believe the same."""
        return all(
            np.array_equal(getattr(self, name), getattr(other, name))
            for name in ("corners", "views", "legs", "readings")
        )
