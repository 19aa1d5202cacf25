"""A value of every unknown, and the geometry that follows from it."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, TypeVar

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.kinematics import Increments, JointFrames
from mobilecal_cli.likelihood.constants import PATTERNS, camera_change
from mobilecal_cli.likelihood.dataset import Dataset
from mobilecal_cli.likelihood.effects import (
    BoardEffect,
    CameraChange,
    ChainChange,
    ChainEffect,
    Clock,
    Effect,
    FloorEffect,
    JointReading,
    Rolling,
)
from mobilecal_cli.likelihood.measurements import BASE, FLOOR, JOINTS, STAMP, SWAY, planar_pose
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.calibration import Parameters
from mobilecal_cli.model.rig import CameraRig, HeadChain

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


@dataclass(frozen=True, eq=False)
class State:
    """A value of every unknown.

    Attributes:
        data: the measurements and the constants.
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

    data: Dataset
    parameters: Parameters
    constants: Mapping[str, float]
    T_w_k: FloatArray
    base: FloatArray
    own: FloatArray

    @classmethod
    def without_errors(
        cls, data: Dataset, parameters: Parameters, T_w_k: FloatArray, poses: FloatArray
    ) -> State:
        """A state at base poses (N, 3): all readings are exact, the floor is flat, the constants are as stated."""
        base, own = (np.zeros((data.stations, width)) for width in (data.base_width, data.own_width))
        base[:, BASE] = poses
        return cls(data, parameters, {}, T_w_k, base, own)

    def value(self, name: str) -> float:
        """Value of a constant."""
        return self.constants.get(name, 0.0)

    def present(self, kind: type[_E]) -> Iterator[tuple[float, _E]]:
        """Value and effect of the constants with one kind of effect, but for those that are zero."""
        rows = self.data.layout.of(kind)
        return ((self.value(name), effect) for _, name, effect in rows if self.value(name))

    def plus(self, step: Step) -> State:
        """The state after a step."""
        values = zip(self.data.layout.constants, step.shared[9:].tolist(), strict=True)
        base = self.base + step.base
        base[:, :2] = self.base[:, :2] + planar(self.base[:, 2], step.base[:, :2])
        return State(
            data=self.data,
            parameters=self.parameters.plus(step.shared[:9]),
            constants={**self.constants, **{row.name: self.value(row.name) + value for row, value in values}},
            T_w_k=self.T_w_k @ se3.exp(step.boards),
            base=base,
            own=self.own + step.own,
        )

    def plus_shared(self, shared: FloatArray) -> State:
        """The state after a step (P,) of the shared parameters alone."""
        return self.plus(
            Step(shared, np.zeros((self.data.logs, 6)), np.zeros_like(self.base), np.zeros_like(self.own))
        )

    # -- joints and head ----------------------------------------------------------------------------

    def clock_s(self, of: Literal["joints", "wheels"]) -> FloatArray:
        """(N,) offset of the clock of joints or wheels at each station, s."""
        offset = np.zeros(self.data.stations)
        for value, clock in self.present(Clock):
            if clock.of == of:
                offset += value * clock.stations(self.data)
        return offset

    @cached_property
    def joints(self) -> FloatArray:
        """(N, J) joint positions: readings, their errors, and the constants that shift joints."""
        data, offset_s = self.data, self.clock_s("joints")
        joints = data.joints + self.own[:, JOINTS]
        for value, effect in self.present(JointReading):
            joints = joints + value * effect.rate(data)
        if np.any(offset_s):
            joints = joints + data.joint_shift(offset_s)
        if np.any(self.base[:, STAMP:]):
            joints = joints + self.rates[:, :-2] * self.base[:, STAMP:]
        return joints

    @cached_property
    def rates(self) -> FloatArray:
        """(N, J + 2) rates of the joints, and of the right and left wheel, at the stations, rad/s or m/s."""
        return self.data.rates(self.clock_s("joints"), self.clock_s("wheels"))

    @cached_property
    def chain_change(self) -> ChainChange:
        """What the constants change in the head's chain."""
        change = ChainChange()
        for value, effect in self.present(ChainEffect):
            effect.add(change, value)
        return change

    @cached_property
    def chain(self) -> HeadChain:
        """The head's chain with the constants that change it."""
        return self.chain_change.apply(self.data.chain)

    @cached_property
    def frames(self) -> JointFrames:
        """The head's joints at every station."""
        return JointFrames.at(self.chain, self.joints)

    # -- cameras and board --------------------------------------------------------------------------

    @cached_property
    def camera_change(self) -> CameraChange:
        """What the constants change in the cameras."""
        return camera_change(self.data.cameras, self.data.layout.constants, self.constants)

    @cached_property
    def cameras(self) -> CameraRig:
        """The cameras with the constants that change them, but for patterns, which mean nothing elsewhere."""
        rows = [row for row in self.data.layout.constants if row.kind not in PATTERNS]
        return camera_change(self.data.cameras, rows, self.constants).apply(self.data.cameras)

    @cached_property
    def points_k(self) -> FloatArray:
        """(M, 3) corners on the board with the constants that change it, m."""
        points = self.data.points_k
        for value, effect in self.present(BoardEffect):
            points = points + value * effect.displacement(self.data.points_k)
        return points

    # -- wheels -------------------------------------------------------------------------------------

    def evened(self, steps: Increments) -> Increments:
        """The rotations of wheels at the mean separation that are read at one time, of those that are read."""
        further = (effect.further(steps, value) for value, effect in self.present(Rolling))
        right, left = sum(further, np.zeros((2, len(steps.leg))))
        return replace(steps, right_rad=steps.right_rad + right, left_rad=steps.left_rad + left)

    # -- base ---------------------------------------------------------------------------------------

    @cached_property
    def constant_stance(self) -> FloatArray:
        """(N, 3) the part of `stance` that constants make: the shape of the floor, and lean."""
        stance = np.zeros((self.data.stations, 3))
        for value, effect in self.present(FloorEffect):
            stance += value * effect.stance(self.data, self.base)
        return stance

    @cached_property
    def stance(self) -> FloatArray:
        """(N, 3) roll, pitch (rad), height (m) of the base against the plane of x and y: floor, sway and lean."""
        return np.asarray(self.base[:, FLOOR] + self.own[:, SWAY] + self.constant_stance)

    @cached_property
    def T_w_v(self) -> FloatArray:
        """(N, 4, 4) of every station."""
        return planar_pose(self.base[:, BASE]) @ standing(self.stance)

    @cached_property
    def T_c_k(self) -> FloatArray:
        """(N, 4, 4) board in the camera, X^-1 T_v_h^-1 T_w_v^-1 T_w_k."""
        T_w_c = self.T_w_v @ self.frames.T_v_h @ self.parameters.T_h_c
        return se3.inverse(T_w_c) @ self.T_w_k[self.data.log]

    @cached_property
    def view_rates(self) -> FloatArray:
        """(C, N, 6) rates of delta: how the board moves in the first camera, rad/s and m/s; 0 at rest.

        For each camera at the middle of its delay: the way in between is then right to second order.
        """
        data, wheels = self.data, self.parameters.wheels
        rates = np.zeros((len(data.cameras.each), data.stations, 6))
        if not data.moving.any() or not data.joint_tracks:
            return rates
        T_v_c = self.frames.T_v_h @ self.parameters.T_h_c
        into_camera = -se3.adjoint(se3.inverse(T_v_c)) * data.moving[:, None, None]
        clocks_s = self.clock_s("joints"), self.clock_s("wheels")
        for twist, delay_s in zip(rates, self.camera_change.delay_s[:, 0], strict=True):
            joints_s, wheels_s = (clock + delay_s / 2 for clock in clocks_s)
            in_images = data.rates(joints_s, wheels_s, in_images=True)
            joints, rolled = in_images[:, :-2], in_images[:, -2:] * wheels.vector[:2]
            twist[:, 2] = (rolled[:, 0] - rolled[:, 1]) / wheels.separation_m
            twist[:, 3] = rolled.mean(axis=1)
            twist += (self.frames.by_joints() @ joints[..., None])[..., 0]
            twist[:] = (into_camera @ twist[..., None])[..., 0]
        return rates


def planar(heading: FloatArray, xy: FloatArray) -> FloatArray:
    """Vectors (N, 2) of a frame whose heading is (N,) rad, in the frame that headings count from."""
    cos, sin = np.cos(heading), np.sin(heading)
    x, y = xy.T
    return np.stack([cos * x - sin * y, sin * x + cos * y], axis=1)


def standing(stance: FloatArray) -> FloatArray:
    """(N, 4, 4) base in a frame that stands level where the base is, from its stance (N, 3)."""
    return se3.transform(se3.exp_so3(stance * [1.0, 1.0, 0.0]), stance * [0.0, 0.0, 1.0])
