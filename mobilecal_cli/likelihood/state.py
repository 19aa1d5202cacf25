"""A value of every unknown, and the geometry that follows from it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Literal, TypeVar

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.kinematics import JointFrames, head_pose
from mobilecal_cli.likelihood.dataset import Dataset
from mobilecal_cli.likelihood.effects import (
    BoardEffect,
    ChainChange,
    ChainEffect,
    Clock,
    Effect,
    FloorEffect,
    JointReading,
)
from mobilecal_cli.likelihood.measurements import BASE, FLOOR, JOINTS, STAMP, SWAY, planar_pose
from mobilecal_cli.likelihood.nuisance import PATTERNS, Layout, camera_change
from mobilecal_cli.model import CameraRig, FloatArray, Parameters

_E = TypeVar("_E", bound=Effect)


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """A step of every unknown.

    Attributes:
        shared: (P,) of the nine parameters (see `Parameters.plus`) and the constants.
        boards: (logs, 6) of the board poses, body twists.
        base: (N, B) of base poses as body twists (x, y, heading), and of the errors of the base block.
        own: (N, J + 3) of the stations' own errors.
    """

    shared: FloatArray
    boards: FloatArray
    base: FloatArray
    own: FloatArray

    @classmethod
    def of_shared(cls, data: Dataset, shared: FloatArray) -> Step:
        """A step of the shared parameters alone."""
        sizes = (data.logs, 6), (data.stations, data.base_width), (data.stations, data.own_width)
        return cls(shared, *(np.zeros(size) for size in sizes))


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """A value of every unknown.

    Attributes:
        parameters: the nine parameters.
        constants: name → value of the constants; those that are not there are zero.
        T_w_k: (logs, 4, 4) board pose in each recording; w is the base at its first station.
        base: (N, B) base poses x, y (m), heading (rad, not wrapped) in w; errors to be added to the right and left
            wheel's reading, rad; roll and pitch (rad) and height (m) of the floor under the base against the plane of x
            and y; relative errors of the right and left wheel's size; and in a data set with motion errors to be added
            to the images' stamps, s. See `BASE` and `ERRORS`.
        own: (N, J + 3) errors to be added to the joint readings, rad or m, and roll, pitch (rad) and height (m) of the
            base beside the floor's. See `JOINTS` and `SWAY`.
    """

    parameters: Parameters
    constants: Mapping[str, float]
    T_w_k: FloatArray
    base: FloatArray
    own: FloatArray

    @classmethod
    def without_errors(
        cls, data: Dataset, parameters: Parameters, T_w_k: FloatArray, poses: FloatArray
    ) -> State:
        """A state in which all readings are exact, the floor is flat, and all constants are as stated.

        Args:
            data, parameters, T_w_k: see `State`.
            poses: (N, 3) of the base.
        """
        base, own = (np.zeros((data.stations, width)) for width in (data.base_width, data.own_width))
        base[:, BASE] = poses
        return cls(parameters, {}, T_w_k, base, own)

    def value(self, name: str) -> float:
        """Value of a constant."""
        return self.constants.get(name, 0.0)

    def present(self, layout: Layout, kind: type[_E]) -> Iterator[tuple[float, _E]]:
        """Value and effect of the constants with one kind of effect, but for those that are zero."""
        return ((self.value(name), effect) for _, name, effect in layout.of(kind) if self.value(name))

    def plus(self, data: Dataset, step: Step) -> State:
        """The state after a step."""
        values = zip(data.layout.constants, step.shared[9:].tolist(), strict=True)
        base = self.base + step.base
        base[:, :2] = self.base[:, :2] + planar(self.base[:, 2], step.base[:, :2])
        return State(
            parameters=self.parameters.plus(step.shared[:9]),
            constants={**self.constants, **{row.name: self.value(row.name) + value for row, value in values}},
            T_w_k=self.T_w_k @ se3.exp(step.boards),
            base=base,
            own=self.own + step.own,
        )


def planar(heading: FloatArray, xy: FloatArray) -> FloatArray:
    """Vectors (N, 2) of a frame whose heading is (N,) rad, in the frame that headings count from."""
    cos, sin = np.cos(heading), np.sin(heading)
    x, y = xy.T
    return np.stack([cos * x - sin * y, sin * x + cos * y], axis=1)


def joints_at(data: Dataset, state: State) -> FloatArray:
    """(N, J) joint positions: readings, their errors, and the constants that shift joints."""
    offset_s = clock_s(data, state, "joints")
    joints = data.joints + state.own[:, JOINTS]
    for value, effect in state.present(data.layout, JointReading):
        joints = joints + value * effect.rate(data)
    if np.any(offset_s):
        joints = joints + data.joint_shift(offset_s)
    if np.any(state.base[:, STAMP:]):
        joints = joints + data.joint_rates(offset_s) * state.base[:, STAMP:]
    return joints


def clock_s(data: Dataset, state: State, of: Literal["joints", "wheels"]) -> FloatArray:
    """(N,) offset of the clock of joints or wheels at each station, s."""
    offset = np.zeros(data.stations)
    for value, clock in state.present(data.layout, Clock):
        if clock.of == of:
            offset += value * clock.stations(data)
    return offset


def chain_change(data: Dataset, state: State) -> ChainChange:
    """What the constants change in the head's chain."""
    change = ChainChange()
    for value, effect in state.present(data.layout, ChainEffect):
        effect.add(change, value)
    return change


def head_at(data: Dataset, state: State) -> FloatArray:
    """(N, 4, 4) T_v_h of every station."""
    return head_pose(chain_change(data, state).apply(data.chain), joints_at(data, state))


def cameras_at(data: Dataset, state: State) -> CameraRig:
    """The cameras with the constants that change them, but for patterns, which mean nothing elsewhere."""
    rows = [row for row in data.layout.constants if row.kind not in PATTERNS]
    return camera_change(data.cameras, rows, state.constants).apply(data.cameras)


def points_at(data: Dataset, state: State) -> FloatArray:
    """(M, 3) corners on the board with the constants that change it, m."""
    points = data.points_k
    for value, effect in state.present(data.layout, BoardEffect):
        points = points + value * effect.displacement(data.points_k)
    return points


def stance_at(data: Dataset, state: State) -> FloatArray:
    """(N, 3) roll and pitch (rad) and height (m) of the base against the plane of x and y: floor, sway and lean."""
    return np.asarray(state.base[:, FLOOR] + state.own[:, SWAY] + constant_stance(data, state))


def constant_stance(data: Dataset, state: State) -> FloatArray:
    """(N, 3) the part of `stance_at` that constants make: the shape of the floor, and lean."""
    stance = np.zeros((data.stations, 3))
    for value, effect in state.present(data.layout, FloorEffect):
        stance += value * effect.stance(data, state.base)
    return stance


def standing(stance: FloatArray) -> FloatArray:
    """(N, 4, 4) base in a frame that stands level where the base is, from its stance (N, 3)."""
    return se3.transform(se3.exp_so3(stance * [1.0, 1.0, 0.0]), stance * [0.0, 0.0, 1.0])


def base_at(data: Dataset, state: State) -> FloatArray:
    """(N, 4, 4) T_w_v of every station."""
    return planar_pose(state.base[:, BASE]) @ standing(stance_at(data, state))


def board_in_camera(data: Dataset, state: State) -> FloatArray:
    """(N, 4, 4) T_c_k = X^-1 T_v_h^-1 T_w_v^-1 T_w_k."""
    T_w_c = base_at(data, state) @ head_at(data, state) @ state.parameters.T_h_c
    return se3.inverse(T_w_c) @ state.T_w_k[data.log]


def view_rates(data: Dataset, state: State) -> FloatArray:
    """(C, N, 6) rates of delta: how the board moves in the first camera, rad/s and m/s; 0 at rest.

    For each camera at the middle of its delay: the way in between is then right to second order.
    """
    T_h_c, wheels = state.parameters.T_h_c, state.parameters.wheels
    rates = np.zeros((len(data.cameras.each), data.stations, 6))
    if not data.moving.any() or not data.joint_tracks:
        return rates
    frames = JointFrames.at(chain_change(data, state).apply(data.chain), joints_at(data, state))
    into_camera = -se3.adjoint(se3.inverse(frames.T_v_h @ T_h_c)) * data.moving[:, None, None]
    delays_s = camera_change(data.cameras, data.layout.constants, state.constants).delay_s[:, 0]
    clocks_s = clock_s(data, state, "wheels"), clock_s(data, state, "joints")
    for twist, delay_s in zip(rates, delays_s, strict=True):
        of_wheels, of_joints = (clock + delay_s / 2 for clock in clocks_s)
        rolled = data.wheel_rates(of_wheels) * wheels.vector[:2]
        twist[:, 2] = (rolled[:, 0] - rolled[:, 1]) / wheels.separation_m
        twist[:, 3] = rolled.mean(axis=1)
        twist += (frames.by_joints() @ data.joint_rates(of_joints)[..., None])[..., 0]
        twist[:] = (into_camera @ twist[..., None])[..., 0]
    return rates
