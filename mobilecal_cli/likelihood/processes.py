"""Errors of the base blocks: encoder readings, the floor under the base, the scale of each wheel, and stamps.

Each is a stationary Gauss-Markov process in the driven distance (Uhlenbeck and Ornstein, 1930):
``cov(f(s), f(s + d)) = sigma^2 exp(-d / l)``. So ``f_j = rho f_i + w`` from a station to the next, with
``rho = exp(-d / l)`` and w of variance ``sigma^2 (1 - rho^2)``, independent of all others. Stations that follow one
another closely share one floor: their number adds nothing to what the distance shows. Errors of readings are new at
each station: rho is 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mobilecal_cli.kinematics import Increments
from mobilecal_cli.likelihood.dataset import Inliers
from mobilecal_cli.likelihood.measurements import ENCODERS, ERRORS, FLOOR, SCALES
from mobilecal_cli.likelihood.state import State
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.rig import WheelGeometry
from mobilecal_cli.model.solution import EXACT, Noise

#: Noise level of each error, in the order of `ERRORS`.
LEVELS = (*["encoder_rad"] * 2, *["floor_rad"] * 2, "floor_m", *["wheel_share"] * 2, "stamp_s")
#: Noise level → correlation length, of the errors that stay along the way.
LENGTHS = {"floor_rad": "floor_length_m", "floor_m": "floor_length_m", "wheel_share": "wheel_length_m"}
_LEAST_READING = 1e-6  # rad: of an encoder without steps
_SMALL = 1e-2  # d / l below which series are exact to rounding: their next terms are below 1e-8


@dataclass(frozen=True, slots=True, eq=False)
class Processes:
    """Prior of the K errors at N stations: one innovation w for each, in the errors' units.

    Attributes:
        levels: (K,) noise level of each.
        distance_m: (N, K) driven since the station before; infinite for what is new at each station.
        rho: (N, K) correlation with it, 0 for the first of a recording.
        variance: (N, K) of the innovations.
        share: (N, K) of the noise level in this variance; the rest is of readings that are interpolated.
        mean_share: (L, 2) c of each leg and wheel: the mean scale error over a leg is expected at c (s_i + s_j).
    """

    levels: tuple[str, ...]
    distance_m: FloatArray
    rho: FloatArray
    variance: FloatArray
    share: FloatArray
    mean_share: FloatArray

    def innovations(self, errors: FloatArray) -> FloatArray:
        """(N, K, ...) w = f_j - rho f_i of the errors, (N, K, ...), or of their derivatives."""
        rho = self.rho.reshape(*self.rho.shape, *[1] * (errors.ndim - 2))
        return np.asarray(errors - rho * np.roll(errors, 1, axis=0))

    def whitened(self, base: FloatArray) -> FloatArray:
        """(N, K) innovations of the errors in base blocks (N, B), in standard deviations."""
        return np.asarray(self.innovations(base[:, ERRORS]) / np.sqrt(self.variance))


def rolled_m(steps: Increments, wheels: WheelGeometry) -> FloatArray:
    """(L, 2) distance that the right and left wheel roll over each leg, forward and backward."""
    rolled = ((wheels.radius_right_m, steps.right_rad), (wheels.radius_left_m, steps.left_rad))
    return np.stack([steps.total(np.abs(radius * rad)) for radius, rad in rolled], axis=1)


def path_m(steps: Increments, wheels: WheelGeometry) -> FloatArray:
    """(L,) distance that the middle of the axle drives over each leg, forward and backward."""
    twice_m = wheels.radius_right_m * steps.right_rad + wheels.radius_left_m * steps.left_rad
    return steps.total(np.abs(twice_m) / 2)


def processes_of(state: State, noise: Noise, inliers: Inliers) -> Processes:
    """The processes along the legs. A leg that is no inlier joins nothing: the floor behind it is another one."""
    data, j, width = state.data, state.data.legs[:, 1], state.data.base_width
    levels = LEVELS[: width - ERRORS.start]
    rolled = rolled_m(data.steps(), state.parameters.wheels)
    distance, between = np.zeros((2, data.stations, width))
    distance[j, FLOOR], distance[j, SCALES] = rolled.mean(axis=1, keepdims=True), rolled
    unit = np.ones(width)
    unit[ENCODERS], between[:, ENCODERS] = data.encoder_shares, data.wheels_between
    sigma = unit[ERRORS] * [getattr(noise, level) for level in levels]
    least = [_LEAST_READING if level == "encoder_rad" else EXACT for level in levels]
    lengths = [getattr(noise, LENGTHS[level]) if level in LENGTHS else 1.0 for level in levels]
    joined = np.zeros(data.stations, dtype=np.bool_)
    joined[j] = inliers.legs
    distance = np.where([level in LENGTHS for level in levels], distance[:, ERRORS], np.inf)
    x = distance / lengths
    rho = np.where(joined[:, None], np.exp(-x), 0.0)
    own = np.maximum(np.where(joined[:, None], -np.expm1(-2 * x), 1.0) * sigma**2, np.square(least))
    variance = own + between[:, ERRORS] ** 2
    mean_share = _half_tanh(rolled / noise.wheel_length_m)
    return Processes(levels, distance, rho, variance, own / variance, mean_share)


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
