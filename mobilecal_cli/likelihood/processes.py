"""Errors that stay along the way: the floor's roll, pitch and height under the base, and the scale of each wheel.

Each is a stationary Gauss-Markov process in the driven distance (Uhlenbeck and Ornstein, 1930):
``cov(f(s), f(s + d)) = sigma^2 exp(-d / l)``. So ``f_j = rho f_i + w`` from a station to the next, with
``rho = exp(-d / l)`` and w of variance ``sigma^2 (1 - rho^2)``, independent of all others. Stations that follow one
another closely share one floor: their number adds nothing to what the distance shows.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mobilecal_cli.kinematics import Increments
from mobilecal_cli.likelihood.dataset import Dataset
from mobilecal_cli.likelihood.noise import Inliers
from mobilecal_cli.model import EXACT, FloatArray, Noise, WheelGeometry

#: Noise level of each process, and of its correlation length: roll, pitch, height, right wheel, left wheel.
LEVELS = ("floor_rad", "floor_rad", "floor_m", "wheel_share", "wheel_share")
LENGTHS = ("floor_length_m", "floor_length_m", "floor_length_m", "wheel_length_m", "wheel_length_m")
COUNT = len(LEVELS)
_SMALL = 1e-2  # d / l below which series are exact to rounding: their next terms are below 1e-8


@dataclass(frozen=True, slots=True, eq=False)
class Processes:
    """Prior of the processes at N stations: one innovation w for each, in units rad, rad, m, 1, 1.

    Attributes:
        distance_m: (N, 5) driven since the station before.
        rho: (N, 5) correlation with it, 0 for the first of a recording.
        variance: (N, 5) of the innovations.
        mean_share: (L, 2) c of each leg and wheel: the mean scale error over a leg is expected at c (s_i + s_j).
    """

    distance_m: FloatArray
    rho: FloatArray
    variance: FloatArray
    mean_share: FloatArray

    def innovations(self, values: FloatArray) -> FloatArray:
        """(N, 5) w = f_j - rho f_i of the processes' values, (N, 5)."""
        out: FloatArray = values - self.rho * np.roll(values, 1, axis=0)
        return out


def rolled_m(steps: Increments, wheels: WheelGeometry) -> FloatArray:
    """(L, 2) distance that the right and left wheel roll over each leg, forward and backward."""
    rolled = ((wheels.radius_right_m, steps.right_rad), (wheels.radius_left_m, steps.left_rad))
    return np.stack([steps.total(np.abs(radius * rad)) for radius, rad in rolled], axis=1)


def processes_of(data: Dataset, wheels: WheelGeometry, noise: Noise, inliers: Inliers) -> Processes:
    """The processes along the legs. A leg that is no inlier joins nothing: the floor behind it is another one."""
    j = data.legs[:, 1]
    rolled = rolled_m(data.steps(), wheels)
    distance = np.zeros((data.stations, COUNT))
    distance[j, :3], distance[j, 3:] = rolled.mean(axis=1, keepdims=True), rolled
    joined = np.zeros(data.stations, dtype=np.bool_)
    joined[j] = inliers.legs
    lengths = np.array([getattr(noise, name) for name in LENGTHS])
    sigma = np.array([getattr(noise, name) for name in LEVELS])
    x = distance / lengths
    rho = np.where(joined[:, None], np.exp(-x), 0.0)
    variance = np.maximum(np.where(joined[:, None], -np.expm1(-2 * x), 1.0) * sigma**2, EXACT**2)
    return Processes(distance, rho, variance, _half_tanh(x[j, 3:]))


def _half_tanh(x: FloatArray) -> FloatArray:
    """tanh(x / 2) / x."""
    safe = np.maximum(x, _SMALL)
    return np.where(x < _SMALL, 0.5 - x**2 / 24, np.tanh(safe / 2) / safe)


def mean_variance(x: FloatArray) -> FloatArray:
    """Variance of the mean of a process of unit variance over a distance of x correlation lengths."""
    safe = np.maximum(x, _SMALL)
    return np.where(x < _SMALL, 1 - x / 3 + x**2 / 12, 2 * (safe + np.expm1(-safe)) / safe**2)


def bridge_variance(x: FloatArray) -> FloatArray:
    """The same for known values at both ends, whose share of the mean is tanh(x / 2) / x each."""
    safe = np.maximum(x, _SMALL)
    return np.where(x < _SMALL, x / 6 - x**3 / 60, 2 * (safe - 2 * np.tanh(safe / 2)) / safe**2)
