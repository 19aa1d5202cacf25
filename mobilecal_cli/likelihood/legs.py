"""Residuals of each leg between two base poses, and their covariance: odometry, and a planar sensor's own motion."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.kinematics import Arcs, Increments, integrate
from mobilecal_cli.likelihood.dataset import Dataset
from mobilecal_cli.likelihood.effects import Clock, FloorDrift, Rolling
from mobilecal_cli.likelihood.measurements import (
    BASE,
    ENCODERS,
    ERRORS,
    FLOOR,
    SCALES,
    STAMP,
    heading_of,
    planar_pose,
)
from mobilecal_cli.likelihood.processes import Processes, bridge_variance, mean_variance, path_m, rolled_m
from mobilecal_cli.likelihood.state import State, Step, planar
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.rig import WheelGeometry
from mobilecal_cli.model.solution import Noise

SLIP_M_PER_SQRT_M = 1e-4  # sideways and along, of a wheel that rolls on a firm floor
_STANDSTILL_M, _STANDSTILL_RAD = 2e-5, 2e-5  # no leg is known better than this, not even one without motion
_STOP_M, _STOP_RAD = 2e-4, 2e-4  # that a base gives way at two stops: play of gears, tires
# Share of the change of a step's rates: a change at once, in the middle of the step, is 1 / 4, a steady one 1 / 16.
_UNSTEADY = 1 / 8
#: Share of the legs' covariance that is no level: what is supposed of every leg.
SUPPOSED = "slip"


@dataclass(frozen=True, slots=True, eq=False)
class Legs:
    """Residuals of all legs at a state, not whitened.

    K is 3: (x, y, heading) of odometry minus those of the base poses. Where a sensor measured its own planar motion it
    is 6: those of the sensor's motion minus those that the base poses say follow.

    Attributes:
        residual: (L, K) m, m, rad.
        by_start, by_end: (L, K, B) by the station's base block.
        by_shared: (L, K, P) by the parameters that all recordings share.
    """

    residual: FloatArray
    by_start: FloatArray
    by_end: FloatArray
    by_shared: FloatArray

    def moved(self, data: Dataset, step: Step) -> Legs:
        """The same after a step of all unknowns, to first order."""
        i, j = data.legs.T
        by_ends = self.by_start @ step.base[i, :, None] + self.by_end @ step.base[j, :, None]
        change: FloatArray = by_ends[..., 0] + self.by_shared @ step.shared
        return replace(self, residual=self.residual + change)


def _steps(state: State, scale: FloatArray) -> tuple[Increments, Increments]:
    """Steps of the legs between the errors of readings at their ends: as read, and as the wheels drove.

    The scale is (L, 2): what the right and left wheel turned over what is read.
    """
    data, (i, j) = state.data, state.data.legs.T
    errors = state.base[:, ENCODERS]
    if np.any(state.base[:, STAMP:]):
        errors = errors + state.rates[:, -2:] * state.base[:, STAMP:]
    read = data.steps(state.clock_s("wheels")).with_ends(-errors[i], errors[j])
    even, (right, left) = state.evened(read), scale[read.leg].T
    return read, replace(even, right_rad=right * even.right_rad, left_rad=left * even.left_rad)


def base_legs(state: State) -> FloatArray:
    """(L, 3) x, y (m) and heading (rad) of each leg's second base pose in its first."""
    i, j = state.data.legs.T
    apart = state.base[j, BASE] - state.base[i, BASE]
    apart[:, :2] = planar(-state.base[i, 2], apart[:, :2])
    return apart


def linearize_legs(state: State, processes: Processes) -> Legs:
    """Residuals of all legs and their derivatives."""
    data, (i, j) = state.data, state.data.legs.T
    # Over a leg, the mean scale error of a wheel is the one that is expected from those at both ends.
    scale = 1 + processes.mean_share * (state.base[i, SCALES] + state.base[j, SCALES])
    read, steps = _steps(state, scale)
    arcs = integrate(steps, state.parameters.wheels)
    by_wheels = arcs.by_wheels()
    between = base_legs(state)
    count = len(between)
    first = np.searchsorted(steps.leg, np.arange(count))
    last = np.searchsorted(steps.leg, np.arange(count), side="right") - 1
    by_start, by_end = np.zeros((2, count, 3, data.base_width))
    # Seen from a start that is shifted or turned, the end is shifted or turned the other way.
    by_start[:, :, BASE] = np.eye(3)
    by_start[:, 0, 2], by_start[:, 1, 2] = -between[:, 1], between[:, 0]
    by_end[:, :, BASE] = -se3.rotation_z(between[:, 2])
    rolled, heading = processes.distance_m[j, FLOOR.start - ERRORS.start], state.base[i, 2]
    drifts = [(value, effect.carried(data, heading, rolled)) for value, effect in state.present(FloorDrift)]
    carried = sum((value * each for value, each in drifts), np.zeros((count, 2)))
    by_start[:, 0, 2] += carried[:, 1]
    by_start[:, 1, 2] -= carried[:, 0]
    by_start[data.first[i], :, BASE] = 0.0
    by_start[:, :, ENCODERS] = -arcs.sensitivity(first) * scale[:, None]
    by_end[:, :, ENCODERS] = arcs.sensitivity(last) * scale[:, None]
    radii, share = state.parameters.wheels.vector[:2], (processes.mean_share / scale)[:, None]
    by_start[:, :, SCALES] = by_end[:, :, SCALES] = by_wheels[:, :, :2] * radii * share
    by_clock = np.zeros((count, 3))
    if data.base_width > STAMP:
        rates = state.rates[:, -2:]
        by_start[:, :, STAMP] = np.einsum("lab,lb->la", by_start[:, :, ENCODERS], rates[i])
        by_end[:, :, STAMP] = np.einsum("lab,lb->la", by_end[:, :, ENCODERS], rates[j])
        by_clock = by_start[:, :, STAMP] + by_end[:, :, STAMP]
    residual = _wrapped(np.column_stack([arcs.t_m + carried, arcs.psi_rad]) - between)
    by_shared = np.zeros((count, 3, data.layout.size))
    by_shared[:, :, 6:9] = by_wheels
    for column, _, clock in data.layout.of(Clock):
        if clock.of == "wheels":
            by_shared[:, :, column] = by_clock * clock.stations(data)[i, None]
    for column, name, rolling in data.layout.of(Rolling):
        further = rolling.by_value(read, state.value(name)) * scale[read.leg].T
        by_shared[:, :, column] = arcs.by_rotations(*further)
    for column, _, drift in data.layout.of(FloorDrift):
        by_shared[:, :2, column] = drift.carried(data, heading, rolled)
    odometry = residual, by_start, by_end, by_shared
    if not data.motions:
        return Legs(*odometry)
    both = zip(odometry, _of_sensor(state), strict=True)
    return Legs(*(np.concatenate(each, axis=1) for each in both))


def residuals_moved(state: State, step: FloatArray, processes: Processes) -> FloatArray:
    """(L, K) change of all residuals by a step of the shared parameters."""
    before, after = (linearize_legs(at, processes).residual for at in (state, state.plus_shared(step)))
    change = after - before
    return np.concatenate([_wrapped(change[:, :3]), change[:, 3:]], axis=1)


def _wrapped(residual: FloatArray) -> FloatArray:
    """(L, 3) the same with headings from -pi to pi."""
    residual[:, 2] = np.remainder(residual[:, 2] + np.pi, 2 * np.pi) - np.pi
    return residual


def _of_sensor(state: State) -> tuple[FloatArray, ...]:
    """Measured minus predicted motion of a planar sensor on the head, which does not move meanwhile."""
    data, X, i = state.data, state.parameters.T_h_c, state.data.legs[:, 0]
    T_b = planar_pose(base_legs(state))
    T_v_c = state.frames.T_v_h[i] @ X
    T = se3.inverse(T_v_c) @ T_b @ T_v_c
    # Rows of a left twist of T that move x, y and heading.
    rows = np.zeros((len(T), 3, 6))
    rows[:, 0, 3] = rows[:, 1, 4] = rows[:, 2, 2] = 1.0
    rows[:, 0, 2], rows[:, 1, 2] = -T[:, 1, 3], T[:, 0, 3]
    into = se3.adjoint(se3.inverse(T_v_c))
    by_start, by_end = np.zeros((2, len(T), 3, data.base_width))
    by_start[:, :, BASE] = (rows @ into)[:, :, [3, 4, 2]]
    by_end[:, :, BASE] = -(rows @ into @ se3.adjoint(T_b))[:, :, [3, 4, 2]]
    by_start[data.first[i], :, BASE] = 0.0
    by_shared = np.zeros((len(T), 3, data.layout.size))
    by_pose = rows @ (np.eye(6) - se3.adjoint(T))
    by_shared[:, :, :6] = by_pose @ np.kron(np.eye(2), X[:3, :3].T)
    measured = np.array([each.motion for each in data.motions])
    residual = _wrapped(measured - np.column_stack([T[:, :2, 3], heading_of(T)]))
    return residual, by_start, by_end, by_shared


def wheels_minus_sensor(state: State, legs: Legs) -> FloatArray:
    """(L, 3) motion of the base by its wheels minus that by a planar sensor: x, y (m) and heading (rad)."""
    T_v_c = state.frames.T_v_h[state.data.legs[:, 0]] @ state.parameters.T_h_c
    measured = np.array([each.motion for each in state.data.motions])
    by_sensor = T_v_c @ planar_pose(measured) @ se3.inverse(T_v_c)
    by_wheels = base_legs(state) + legs.residual[:, :3]
    return _wrapped(by_wheels - np.column_stack([by_sensor[:, :2, 3], heading_of(by_sensor)]))


def all_covariances(state: State, noise: Noise) -> Mapping[str, FloatArray]:
    """Noise level → its share of the covariance of the legs' residuals, (L, K, K), for known ends; see `Legs`."""
    data = state.data
    of_wheels = leg_covariances(data.steps(), state.parameters.wheels, noise, ends_known=True)
    stops = ~data.moving[data.legs].any(axis=1)
    of_wheels[SUPPOSED][stops] += np.diag([_STOP_M**2, _STOP_M**2, _STOP_RAD**2])
    if not data.motions:
        return of_wheels
    wide = {name: np.zeros((len(data.legs), 6, 6)) for name in (*of_wheels, "pose_scale")}
    for name, share in of_wheels.items():
        wide[name][:, :3, :3] = share
    of_motions = np.array([each.covariance for each in data.motions])
    wide["pose_scale"][:, 3:, 3:] = noise.pose_scale**2 * of_motions
    return wide


def _between_readings(arcs: Arcs) -> FloatArray:
    """(L, 2, 2) covariance of x and y by what the wheels do between two readings, m^2.

    A step is an arc if both wheels turn evenly in it. Their rates in the steps before and after tell how much they
    change: heading and way differ from those of the arc by a share of the differences between these steps.
    """
    steps, none = arcs.steps, np.zeros(1)
    same = np.diff(steps.leg) == 0  # before and after a leg, the wheels are at rest
    of_way, of_turn = (
        np.abs(np.append(each[1:] * same, none) - np.append(none, each[:-1] * same))
        for each in (arcs.ds, arcs.turn)
    )
    across = _UNSTEADY * (np.abs(arcs.ds) * of_turn + np.abs(arcs.turn) * of_way)
    cos, sin = arcs.direction
    xx, xy, yy = (steps.total(across**2 * part) for part in (sin**2, -sin * cos, cos**2))
    return np.stack([xx, xy, xy, yy], axis=1).reshape(-1, 2, 2)


def leg_covariances(
    steps: Increments, wheels: WheelGeometry, noise: Noise, ends_known: bool = False
) -> Mapping[str, FloatArray]:
    """Covariance of odometry's (x, y, heading) by cause, (L, 3, 3) each: m^2, m rad, rad^2.

    Noise that grows with the square root of the rotation is propagated along the arcs. A wheel's mean scale error over
    a leg acts like a change of its radius.

    Args:
        steps, wheels, noise: of the legs.
        ends_known: for known scale errors at both ends of each leg, see `processes`.

    Returns:
        Noise level → its share; "slip" for what is supposed of every leg.
    """
    arcs = integrate(steps, wheels)
    sensitivity = arcs.sensitivity()
    right, left = noise.wheel_rad_per_sqrt_rad**2 * np.abs([steps.right_rad, steps.left_rad])
    root = np.empty((steps.legs, 3, 3))
    for a, b in ((0, 0), (0, 1), (0, 2), (1, 1), (1, 2), (2, 2)):
        of_a, of_b = sensitivity[:, a], sensitivity[:, b]
        per_step = right * of_a[:, 0] * of_b[:, 0] + left * of_a[:, 1] * of_b[:, 1]
        root[:, a, b] = root[:, b, a] = steps.total(per_step)
    variance = bridge_variance if ends_known else mean_variance
    share = noise.wheel_share * np.sqrt(variance(rolled_m(steps, wheels) / noise.wheel_length_m))
    by_radii = arcs.by_wheels()[:, :, :2] * wheels.vector[:2] * share[:, None]
    slip = np.zeros_like(root)
    slip[:, 0, 0] = slip[:, 1, 1] = _STANDSTILL_M**2 + SLIP_M_PER_SQRT_M**2 * path_m(steps, wheels)
    slip[:, 2, 2] = _STANDSTILL_RAD**2
    slip[:, :2, :2] += _between_readings(arcs)
    return {
        "wheel_rad_per_sqrt_rad": root,
        "wheel_share": by_radii @ by_radii.mT,
        SUPPOSED: slip,
    }
