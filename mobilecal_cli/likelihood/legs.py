"""Odometry residuals of each leg, their derivatives, and their covariance propagated along the arcs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mobilecal_cli.kinematics import Arcs, Increments, LegMotion
from mobilecal_cli.likelihood.noise import SLIP_M_PER_SQRT_M, STANDSTILL_M, STANDSTILL_RAD, Noise
from mobilecal_cli.likelihood.problem import Problem, State
from mobilecal_cli.likelihood.shared import Layout
from mobilecal_cli.model import FloatArray, WheelGeometry


@dataclass(frozen=True, slots=True, eq=False)
class Legs:
    """Residuals of all legs at a state, not whitened: (x, y, heading) from odometry minus from the base poses.

    Attributes:
        residual: (L, 3) m, m, rad.
        by_start, by_end: (L, 3, 5) by the first and second station's base twist (x, y, heading) and encoder errors.
        by_wheels: (L, 3, 3) by (rR, rL, b).
        by_time: (L, 3) by the time offset between cameras and wheels.
    """

    residual: FloatArray
    by_start: FloatArray
    by_end: FloatArray
    by_wheels: FloatArray
    by_time: FloatArray

    def by_all_shared(self, layout: Layout) -> FloatArray:
        """Derivatives by all global parameters, (L, 3, P)."""
        shared = np.zeros((len(self.residual), 3, layout.size))
        shared[:, :, 6:9] = self.by_wheels
        if "time_wheels" in layout.extras:
            shared[:, :, 9 + layout.extras.index("time_wheels")] = self.by_time
        return shared


def _steps(problem: Problem, state: State) -> Increments:
    i, j = problem.legs.T
    return problem.steps(state.extra("time_wheels")).with_ends(
        -state.encoder_errors[i], state.encoder_errors[j]
    )


def base_legs(problem: Problem, state: State) -> FloatArray:
    """Second base pose of each leg in the frame of its first, (L, 3): x, y (m) and heading (rad)."""
    i, j = problem.legs.T
    apart = state.base[j] - state.base[i]
    cos, sin = np.cos(state.base[i, 2]), np.sin(state.base[i, 2])
    x, y = cos * apart[:, 0] + sin * apart[:, 1], -sin * apart[:, 0] + cos * apart[:, 1]
    return np.stack([x, y, apart[:, 2]], axis=1)


def _as_rows(motion: LegMotion) -> FloatArray:
    return np.concatenate([motion.t_m, motion.psi_rad[:, None]], axis=1)


def linearize_legs(problem: Problem, state: State, encoders: bool) -> Legs:
    """Residuals of all legs and their derivatives; by encoder errors only if `encoders` is true."""
    i, j = problem.legs.T
    steps = _steps(problem, state)
    arcs = Arcs.along(steps, state.parameters.wheels)
    d_psi, d_t = arcs.by_wheels()
    between = base_legs(problem, state)
    count = len(between)
    first = np.searchsorted(steps.leg, np.arange(count))
    last = np.searchsorted(steps.leg, np.arange(count), side="right") - 1
    by_start, by_end = np.zeros((count, 3, 5)), np.zeros((count, 3, 5))
    # The residual subtracts the base motion, so moving the start forward or turning it increases the residual.
    by_start[:, 0, 0] = by_start[:, 1, 1] = by_start[:, 2, 2] = 1.0
    by_start[:, 0, 2], by_start[:, 1, 2] = -between[:, 1], between[:, 0]
    cos, sin = np.cos(between[:, 2]), np.sin(between[:, 2])
    by_end[:, 0, 0], by_end[:, 0, 1] = -cos, sin
    by_end[:, 1, 0], by_end[:, 1, 1] = -sin, -cos
    by_end[:, 2, 2] = -1.0
    by_start[problem.first[i], :, :3] = 0.0
    by_start[:, :, 3:] = -arcs.sensitivity(first)
    by_end[:, :, 3:] = arcs.sensitivity(last)
    by_time = np.zeros((count, 3))
    if "time_wheels" in problem.layout.extras:
        rates = problem.wheel_rates(state.extra("time_wheels"))
        by_time += np.einsum("lab,lb->la", by_end[:, :, 3:], rates[j])
        by_time += np.einsum("lab,lb->la", by_start[:, :, 3:], rates[i])
    if not encoders:
        by_start[:, :, 3:] = by_end[:, :, 3:] = 0.0
    by_wheels = np.concatenate([d_t, d_psi[:, None]], axis=1)
    return Legs(_as_rows(arcs.motion()) - between, by_start, by_end, by_wheels, by_time)


def leg_covariance(problem: Problem, wheels: WheelGeometry, noise: Noise) -> FloatArray:
    """Covariance of odometry (x, y, heading) of each leg, propagated along the arcs, (L, 3, 3): m^2, m rad, rad^2."""
    steps = problem.steps()
    sensitivity = Arcs.along(steps, wheels).sensitivity()
    right, left = noise.wheel_rad_per_sqrt_rad**2 * np.abs([steps.right_rad, steps.left_rad])
    covariance = np.empty((len(problem.legs), 3, 3))
    for a, b in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)):
        of_a, of_b = sensitivity[:, a], sensitivity[:, b]
        per_step = right * of_a[:, 0] * of_b[:, 0] + left * of_a[:, 1] * of_b[:, 1]
        covariance[:, a, b] = covariance[:, b, a] = steps.total(per_step)
    path_m = steps.total(
        np.abs(wheels.radius_right_m * steps.right_rad + wheels.radius_left_m * steps.left_rad) / 2
    )
    slip = STANDSTILL_M**2 + SLIP_M_PER_SQRT_M**2 * path_m
    covariance[:, 0, 0] += slip
    covariance[:, 1, 1] += slip
    covariance[:, 2, 2] += STANDSTILL_RAD**2
    return covariance
