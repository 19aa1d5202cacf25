"""Which measurements are inliers, and their standard deviations."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mobilecal_cli.likelihood.dataset import Dataset
from mobilecal_cli.model import BoolArray, FloatArray, Noise

SLIP_M_PER_SQRT_M = 1e-4  # sideways and along, of a wheel that rolls on a firm floor
STANDSTILL_M, STANDSTILL_RAD = 2e-5, 2e-5  # no leg is known better than this, not even one without motion
FREE_JOINT = 1.0  # rad or m: sigma of a rejected joint reading
FREE_BASE = 1e2  # m, rad: sigma of a base pose that no measurement may hold
FREE_BOARD = 100.0  # m, rad: sigma of a board that no used image shows, which nothing else depends on
FEWEST_CORNERS = 4  # of one station, in both images together: fewer do not hold a board pose

#: Kind of measurement that is used or not as a whole → its degrees of freedom: a station's images, a leg's wheels,
#: and a joint reading.
DEGREES = {"views": 6, "legs": 3, "readings": 1}


@dataclass(frozen=True, slots=True, eq=False)
class Inliers:
    """The measurements that are used.

    Attributes:
        corners: (N, C, M) corners of each image, among those that were detected.
        views: (N,) stations whose images are used.
        legs: (L,) legs whose wheels are used.
        readings: (N, J) joint readings that are used.
    """

    corners: BoolArray
    views: BoolArray
    legs: BoolArray
    readings: BoolArray

    @classmethod
    def all_of(cls, data: Dataset) -> Inliers:
        """Every measurement."""
        return cls(
            data.seen,
            np.ones(data.stations, dtype=np.bool_),
            np.ones(len(data.legs), dtype=np.bool_),
            np.ones(data.joints.shape, dtype=np.bool_),
        )

    def same(self, other: Inliers) -> bool:
        """Whether both are the same measurements."""
        kinds = ("corners", *DEGREES)
        return all(np.array_equal(getattr(self, kind), getattr(other, kind)) for kind in kinds)

    @property
    def used_corners(self) -> BoolArray:
        """(N, C, M) corners of the stations whose images are used."""
        return self.corners & self.views[:, None, None]


def joint_sigmas(data: Dataset, inliers: Inliers, noise: Noise) -> FloatArray:
    """(N, J) sigma of each reading, rad or m."""
    sigma = np.hypot(noise.joint_rad * data.joint_units, data.joints_between)
    return np.where(inliers.readings, sigma, FREE_JOINT)
