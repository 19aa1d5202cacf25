"""A value of every unknown, and the geometry that follows from it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.kinematics import head_pose
from mobilecal_cli.likelihood.dataset import Dataset
from mobilecal_cli.likelihood.effects import BoardEffect, HeadEffect, JointEffect
from mobilecal_cli.likelihood.nuisance import cameras_with
from mobilecal_cli.model import FloatArray, Parameters, StereoRig


@dataclass(frozen=True, slots=True, eq=False)
class Step:
    """A step of every unknown.

    Attributes:
        shared: (layout.size,) of the nine parameters (see `Parameters.plus`), the constants and the boards (body
            twists).
        base: (N, 5) of base poses as body twists (x, y, heading) and of encoder errors, right and left.
        joints: (N, J) of joint errors.
    """

    shared: FloatArray
    base: FloatArray
    joints: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """A value of every unknown.

    Attributes:
        parameters: the nine parameters.
        constants: name → value of the constants; those that are not there are zero.
        T_w_k: (B, 4, 4) board poses; w is the base at the first station of the board's recording.
        base: (N, 3) base poses x, y (m), heading (rad, not wrapped) in w.
        joint_errors: (N, J) to be added to the readings.
        encoder_errors: (N, 2) to be added to the right and left wheel's reading, rad.
    """

    parameters: Parameters
    constants: Mapping[str, float]
    T_w_k: FloatArray
    base: FloatArray
    joint_errors: FloatArray
    encoder_errors: FloatArray

    def value(self, name: str) -> float:
        """Value of a constant."""
        return self.constants.get(name, 0.0)

    @property
    def T_w_v(self) -> FloatArray:
        """(N, 4, 4) base in the world."""
        flat = np.concatenate([self.base[:, :2], np.zeros((len(self.base), 1))], axis=1)
        return se3.transform(se3.rotation_z(self.base[:, 2]), flat)

    def plus(self, data: Dataset, step: Step) -> State:
        """The state after a step."""
        layout, shared = data.layout, step.shared
        values = zip(layout.constants, shared[9 : layout.named].tolist(), strict=True)
        cos, sin = np.cos(self.base[:, 2]), np.sin(self.base[:, 2])
        x, y, turn = step.base[:, 0], step.base[:, 1], step.base[:, 2]
        return State(
            parameters=self.parameters.plus(shared[:9]),
            constants={**self.constants, **{row.name: self.value(row.name) + value for row, value in values}},
            T_w_k=self.T_w_k @ se3.exp(shared[layout.named :].reshape(-1, 6)),
            base=self.base + np.stack([cos * x - sin * y, sin * x + cos * y, turn], axis=1),
            joint_errors=self.joint_errors + step.joints,
            encoder_errors=self.encoder_errors + step.base[:, 3:],
        )

    def of_log(self, data: Dataset, log: int) -> State:
        """The part that belongs to one recording of a data set."""
        mine = data.log == log
        return replace(
            self,
            T_w_k=self.T_w_k[np.unique(data.board[mine])],
            base=self.base[mine],
            joint_errors=self.joint_errors[mine],
            encoder_errors=self.encoder_errors[mine],
        )


def joints_at(data: Dataset, state: State) -> FloatArray:
    """(N, J) joint positions: readings, their errors, and the constants that shift joints."""
    joints = data.joints + state.joint_errors
    for row in data.layout.constants:
        if isinstance(row.effect, JointEffect) and state.value(row.name):
            joints = joints + row.effect.shift(data, state.value(row.name))
    return joints


def head_at(data: Dataset, state: State) -> FloatArray:
    """(N, 4, 4) T_v_h of every station."""
    T_v_h = head_pose(data.chain, joints_at(data, state))
    for row in data.layout.constants:
        if isinstance(row.effect, HeadEffect) and state.value(row.name):
            T_v_h = row.effect.apply(T_v_h, state.value(row.name))
    return T_v_h


def cameras_at(data: Dataset, state: State) -> StereoRig:
    """The stereo pair with the constants that change it."""
    return cameras_with(data.cameras, data.layout.constants, state.constants)


def points_at(data: Dataset, state: State) -> FloatArray:
    """(M, 3) corners on the board with the constants that change it, m."""
    points = data.points_k
    for row in data.layout.constants:
        if isinstance(row.effect, BoardEffect) and state.value(row.name):
            points = points + state.value(row.name) * row.effect.displacement(data.points_k)
    return points


def board_in_camera(data: Dataset, state: State) -> FloatArray:
    """(N, 4, 4) T_c_k = X^-1 T_v_h^-1 T_w_v^-1 T_w_k."""
    T_w_c = state.T_w_v @ head_at(data, state) @ state.parameters.T_h_c
    T: FloatArray = se3.inverse(T_w_c) @ state.T_w_k[data.board]
    return T
