"""Noise level of each kind of measurement, and the selection of inlier measurements."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mobilecal_cli.likelihood.problem import Problem
from mobilecal_cli.model import BoolArray

SLIP_M_PER_SQRT_M = 1e-4  # sideways and along, for a wheel without slip on a firm floor
STANDSTILL_M, STANDSTILL_RAD = 2e-5, 2e-5  # sigma of a leg without motion
FREE_JOINT = 1.0  # rad or m: sigma of an excluded reading
LOST_BASE = 1e2  # m, rad: sigma of a base pose that may have no other constraint


@dataclass(frozen=True, slots=True)
class Noise:
    """Standard deviation of each kind of measurement.

    Attributes:
        pixel_px: of one corner coordinate (root mean square over the stations).
        wheel_rad_per_sqrt_rad: of a wheel's rotation over one radian; the variance is proportional to the rotation.
        encoder_rad: of one encoder reading; 0 for encoders without steps.
        joint_rad: of one joint reading (prismatic joint: per 0.1 m).
    """

    pixel_px: float
    wheel_rad_per_sqrt_rad: float
    encoder_rad: float
    joint_rad: float


@dataclass(frozen=True, slots=True, eq=False)
class Selection:
    """Inlier measurements.

    Attributes:
        corners: (N, 2, M) corners of each camera, a subset of the detected ones.
        views: (N,) stations whose images are used.
        legs: (L,) legs whose wheels are used.
        readings: (N, J) joint readings that are used.
    """

    corners: BoolArray
    views: BoolArray
    legs: BoolArray
    readings: BoolArray

    @classmethod
    def everything(cls, problem: Problem) -> Selection:
        """Selection of all measurements."""
        return cls(
            problem.seen,
            np.ones(problem.stations, dtype=np.bool_),
            np.ones(len(problem.legs), dtype=np.bool_),
            np.ones(problem.joints.shape, dtype=np.bool_),
        )

    def same(self, other: Selection) -> bool:
        """Whether both selections are equal."""
        return all(
            np.array_equal(getattr(self, name), getattr(other, name))
            for name in ("corners", "views", "legs", "readings")
        )
