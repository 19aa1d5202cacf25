"""The nine parameters as a value that adds and subtracts, and the contents of params.yaml."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.model.arrays import BoolArray, FloatArray, ReadOnly
from mobilecal_cli.model.observations import LogSource
from mobilecal_cli.model.rig import AssumedOdometry, Board, HeadChain, Side, WheelGeometry

NINE = ("r_x", "r_y", "r_z", "t_x", "t_y", "t_z", "radius_right", "radius_left", "separation")
WHEEL_WORDS = ("right wheel radius", "left wheel radius", "wheel separation")


@dataclass(frozen=True, slots=True, eq=False)
class Parameters(ReadOnly):
    """The nine parameters.

    Their differences are vectors of nine numbers in the order of `NINE`, the one tangent convention of the code: a
    rotation vector about the head's axes that is applied from the left, R -> exp(rho) R (rad), then differences of
    the translation (m, in the head's frame), the two radii and the separation (m).

    Attributes:
        T_h_c: (4, 4) head-eye transform: first camera coordinates to head coordinates, m.
        wheels: radii and separation.
    """

    T_h_c: Annotated[FloatArray, 4, 4]
    wheels: WheelGeometry

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


@dataclass(frozen=True, slots=True, eq=False)
class Knowledge(ReadOnly):
    """Uncertainty of the nine parameters of a params.yaml.

    Attributes:
        covariance: (9, 9) in the order of `NINE`: small rotation vector in the parent frame, rad; m.
        observable: (9,) false for parameters fixed at nominal values; `covariance` does not apply to them.
        noise: noise level → standard deviation, as far as the file states them; see `NoiseLevels`.
    """

    covariance: Annotated[FloatArray, 9, 9]
    observable: Annotated[BoolArray, 9]
    noise: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class CalibratedRobot(ReadOnly):
    """A calibration as stored in params.yaml.

    Attributes:
        parent_frame: head frame.
        child_frame: optical frame of the reference camera.
        T_parent_child: (4, 4) child coordinates to parent coordinates, m.
        wheels: radii and separation; with `odometry`, its assumed wheels times the factors.
        knowledge: None for methods that give no uncertainty.
        created: time, ISO 8601; "" if the file does not contain it.
        logs: recordings used for the calibration.
        wheel_joints: names of the wheel joints of robots with two wheels, if these were read from joint states.
        side_joints: the same for several wheels a side.
        odometry: the odometry that stands for wheels, if the recording had no wheels.
        nominal_wheels: nominal wheels, if any.
        head_joints: names of the head's joints that were read from joint states.
        rectified: whether it was made from rectified images, so that the child is the rectified optical frame.
        constants: estimated constants of the robot description → their difference from the stated value, in rad, m, s
            or as a share; none of methods that do not estimate them.
        constants_std: their standard deviations, in the same units.
        chain: the head chain as it was stated, without mimic joints' factors; None if the file does not contain it.
        cameras_sha256: `CameraRig.digest` of the cameras as they were stated; "" if the file does not contain it.
        verdict: "PASS", "FAIL", "NOT ENOUGH" or "GATE FAILED"; "" if the file does not state it.
        reasons: why the verdict is not PASS, whole sentences.
        board: the board of its recordings, if one camera took the scale from it.
    """

    parent_frame: str
    child_frame: str
    T_parent_child: Annotated[FloatArray, 4, 4]
    wheels: WheelGeometry
    knowledge: Knowledge | None = None
    created: str = ""
    logs: tuple[LogSource, ...] = ()
    wheel_joints: Mapping[Side, str] = field(default_factory=dict)
    side_joints: Mapping[Side, tuple[str, ...]] = field(default_factory=dict)
    odometry: AssumedOdometry | None = None
    nominal_wheels: WheelGeometry | None = None
    head_joints: tuple[str, ...] = ()
    rectified: bool = False
    constants: Mapping[str, float] = field(default_factory=dict)
    constants_std: Mapping[str, float] = field(default_factory=dict)
    chain: HeadChain | None = None
    cameras_sha256: str = ""
    verdict: str = ""
    reasons: tuple[str, ...] = ()
    board: Board | None = None

    @property
    def unobservable(self) -> BoolArray:
        """(9,) parameters that the recording does not determine and the user did not fix: they keep nominal values."""
        if self.knowledge is None:
            return np.zeros(9, dtype=np.bool_)
        return np.asarray(~self.knowledge.observable & (np.diag(self.knowledge.covariance) > 0))

    @property
    def factors(self) -> dict[str, float]:
        """Name → factor of the odometry; empty for a robot with wheels."""
        return {} if self.odometry is None else self.odometry.factors(self.wheels)

    @property
    def factors_std(self) -> dict[str, float]:
        """Standard deviations of `factors`; empty where there are none."""
        if self.odometry is None or self.knowledge is None:
            return {}
        return self.odometry.factors_std(self.wheels, self.knowledge.covariance[6:, 6:])

    def with_assumed(self, wheels: WheelGeometry) -> CalibratedRobot:
        """The same calibration of odometry for other assumed wheels.

        Distance and rotation stay; the difference of the two radii is in proportion to the separation.
        """
        if self.odometry is None or self.odometry.wheels == wheels:
            return self
        old, new = self.odometry.wheels.vector, wheels.vector
        wider = new[2] / old[2]
        same, other = (1 + wider) / 2, (1 - wider) / 2
        J = np.diag(new) @ np.array([[same, other, 0], [other, same, 0], [0, 0, 1]]) @ np.diag(1 / old)
        knowledge = self.knowledge
        if knowledge is not None:
            whole = np.eye(9)
            whole[6:, 6:] = J
            knowledge = replace(knowledge, covariance=whole @ knowledge.covariance @ whole.T)
        odometry = replace(self.odometry, wheels=wheels)
        return replace(
            self, wheels=WheelGeometry.of(J @ self.wheels.vector), knowledge=knowledge, odometry=odometry
        )
