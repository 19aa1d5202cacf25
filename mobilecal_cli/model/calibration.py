"""The nine parameters as a value that adds and subtracts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.model.arrays import FloatArray, freeze
from mobilecal_cli.model.rig import WheelGeometry

NINE = ("r_x", "r_y", "r_z", "t_x", "t_y", "t_z", "radius_right", "radius_left", "separation")


@dataclass(frozen=True, slots=True, eq=False)
class Parameters:
    """The nine parameters.

    Their differences are vectors of nine numbers in the order of `NINE`, the one tangent convention of the code: a
    rotation vector about the head's axes that is applied from the left, R -> exp(rho) R (rad), then differences of
    the translation (m, in the head's frame), the two radii and the separation (m).

    Attributes:
        T_h_c: (4, 4) head-eye transform: left camera coordinates to head coordinates, m.
        wheels: radii and separation.
    """

    T_h_c: FloatArray
    wheels: WheelGeometry

    def __post_init__(self) -> None:
        freeze(self, T_h_c=(4, 4))

    @property
    def vector(self) -> FloatArray:
        """(9,) rotation vector of R_h_c (rad), translation, radii and separation (m)."""
        return np.concatenate([se3.log_so3(self.T_h_c[:3, :3]), self.T_h_c[:3, 3], self.wheels.vector])

    def plus(self, delta: FloatArray) -> Parameters:
        """The parameters after a step, (9,)."""
        R = se3.exp_so3(delta[:3]) @ self.T_h_c[:3, :3]
        T_h_c = se3.transform(R, self.T_h_c[:3, 3] + delta[3:6])
        return Parameters(T_h_c, WheelGeometry.of(self.wheels.vector + delta[6:]))

    def seen_from(self, T_c_other: FloatArray) -> Parameters:
        """The parameters of another camera, which has the pose (4, 4) in the coordinates of this one."""
        return Parameters(self.T_h_c @ T_c_other, self.wheels)

    def minus(self, other: Parameters) -> FloatArray:
        """(9,) step from other parameters to these: other.plus(self.minus(other)) is self."""
        turn = se3.log_so3(self.T_h_c[:3, :3] @ other.T_h_c[:3, :3].T)
        shift = self.T_h_c[:3, 3] - other.T_h_c[:3, 3]
        return np.concatenate([turn, shift, self.wheels.vector - other.wheels.vector])
