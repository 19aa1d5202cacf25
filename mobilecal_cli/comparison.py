"""Comparison of calibrations of one robot: change in units, in standard deviations, and its effect on the robot."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.arguments import require
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.kinematics import unlike_joints
from mobilecal_cli.likelihood.constants import joint_constants
from mobilecal_cli.likelihood.predict import AHEAD_M, camera_in_base
from mobilecal_cli.model.arrays import BoolArray, FloatArray, ReadOnly
from mobilecal_cli.model.calibration import NINE, CalibratedRobot, Parameters
from mobilecal_cli.model.rig import WheelGeometry

#: Significance level.
UNLIKELY = 0.01
#: Change of an unobservable parameter, in standard deviations of its nominal value, that no nominal value explains.
MOST_NOMINAL_SIGMAS = 5.0


@dataclass(frozen=True, slots=True, eq=False)
class Difference(ReadOnly):
    """Change from one calibration a to another b.

    Attributes:
        change: (9,) in the order of `NINE`: rotation vector of R_b R_a^T in the head's frame, rad; m.
        std: (9,) standard deviation of `change` for independent recordings; 0 where `known` is false.
        known: (9,) whether the parameter can be compared: both determine it, with a standard deviation.
        unobservable: (9,) whether the parameter is unobservable in one of them.
        both_nominal: (9,) whether it is in both, and keeps the same nominal value.
        nominal_sigmas: (9,) change of the unobservable parameters in standard deviations, which are then those of
            nominal values; 0 for the others.
        chi2: squared Mahalanobis distance of the known parameters; None if there are none.
        chance: probability of a chi-squared this large if the robot did not change; None if there is none.
        shared: both use a common recording, so they are not independent and the test is weak.
        ray_m: shift of a point 2 m ahead of the camera.
        along_m_per_m: change of the distance by dead reckoning per meter of straight driving.
        heading_rad_per_m: change of heading per meter where a drives straight.
        heading_rad_per_turn: change of heading in a full turn in place.
        joints: constant of the head chain → its change and standard deviation, in units for people, and the unit; where
            both correct the same chain.
        assumed: wheels that the radii and the separation are factors of, where both calibrate odometry.
    """

    change: Annotated[FloatArray, 9]
    std: Annotated[FloatArray, 9]
    known: Annotated[BoolArray, 9]
    unobservable: Annotated[BoolArray, 9]
    both_nominal: Annotated[BoolArray, 9]
    nominal_sigmas: Annotated[FloatArray, 9]
    chi2: float | None
    chance: float | None
    shared: bool
    ray_m: float
    along_m_per_m: float
    heading_rad_per_m: float
    heading_rad_per_turn: float
    joints: Mapping[str, tuple[float, float, str]] = field(default_factory=dict)
    assumed: WheelGeometry | None = None

    @property
    def sigmas(self) -> FloatArray:
        """Change in standard deviations, (9,); NaN where unknown."""
        return np.where(self.known, self.change / np.where(self.known, self.std, 1.0), np.nan)

    @property
    def moved_joints(self) -> dict[str, float]:
        """Change in standard deviations of the constants of the head chain that have changed (level `UNLIKELY`)."""
        sigmas = {name: change / std for name, (change, std, _) in self.joints.items() if std > 0}
        return {
            name: value for name, value in sigmas.items() if _chance(value**2, 1) * len(sigmas) < UNLIKELY
        }


def difference(first: CalibratedRobot, second: CalibratedRobot) -> Difference:
    """Change from the first calibration to the second.

    Raises:
        ConfigError: the frames differ, or these are no calibrations.
    """
    for name, robot in (("first", first), ("second", second)):
        require(name, robot, CalibratedRobot, "load(path), or the robot of a report")
    for attribute, what in (("parent_frame", "head"), ("child_frame", "camera")):
        frame, other = getattr(first, attribute), getattr(second, attribute)
        if frame != other:
            raise ConfigError(
                f"the {what} frames of the calibrations differ: {frame!r} in one and {other!r} in the other",
                "compare calibrations of one robot with the same head.head_frame and cameras.reference",
            )
    if (first.odometry is None) != (second.odometry is None):
        raise ConfigError(
            "one calibration has the factors of odometry, the other wheel radii and a wheel separation",
            "compare calibrations from recordings with the same topics",
        )
    if first.odometry is not None:
        second = second.with_assumed(first.odometry.wheels)
    change = nine_apart(first, second)
    unobservable = np.zeros(9, dtype=np.bool_)
    for robot in (first, second):
        if robot.knowledge is not None:
            unobservable |= ~robot.knowledge.observable
    # Both must have a standard deviation and determine the parameter: a nominal value is no measurement.
    known, covariance = np.zeros(9, dtype=np.bool_), np.zeros((9, 9))
    if first.knowledge is not None and second.knowledge is not None:
        covariances = first.knowledge.covariance, second.knowledge.covariance
        covariance = covariances[0] + covariances[1]
        known = (np.diag(covariances[0]) > 0) & (np.diag(covariances[1]) > 0) & ~unobservable
    every_std = np.sqrt(np.diag(covariance))
    std = np.where(known, every_std, 0.0)
    fixed = unobservable & (every_std > 0)
    chi2 = chance = None
    if known.any():
        x = change[known]
        chi2 = float(x @ np.linalg.lstsq(covariance[np.ix_(known, known)], x, rcond=None)[0])
        chance = _chance(chi2, int(known.sum()))
    a, b = first.wheels, second.wheels
    right, left = b.radius_right_m / a.radius_right_m, b.radius_left_m / a.radius_left_m
    # A full turn in place by a: each wheel rolls b_a / 2 times 2 pi, one of them backwards.
    turned = 2 * math.pi * (right + left) / 2 * a.separation_m / b.separation_m
    ahead = np.array([0.0, 0.0, AHEAD_M])
    T_first, T_second = _in_base(first, second)
    shift = se3.act(T_second, ahead[None]) - se3.act(T_first, ahead[None])
    return Difference(
        change=change,
        std=std,
        known=known,
        unobservable=unobservable,
        both_nominal=first.unobservable & second.unobservable & (change == 0),
        nominal_sigmas=np.where(fixed, np.abs(change) / np.where(fixed, every_std, 1.0), 0.0),
        chi2=chi2,
        chance=chance,
        shared=bool({log.sha256 for log in first.logs} & {log.sha256 for log in second.logs}),
        ray_m=float(np.linalg.norm(shift)),
        along_m_per_m=(right + left) / 2 - 1,
        heading_rad_per_m=(right - left) / b.separation_m,
        heading_rad_per_turn=turned - 2 * math.pi,
        joints=_joints_apart(first, second),
        assumed=None if first.odometry is None else first.odometry.wheels,
    )


def _in_base(*robots: CalibratedRobot) -> list[FloatArray]:
    """(4, 4) pose of the camera in the base with the corrections of the head chain; in the head without a chain."""
    in_base = [
        camera_in_base(robot.chain, robot.constants, robot.T_parent_child)
        for robot in robots
        if robot.chain is not None
    ]
    return in_base if len(in_base) == len(robots) else [robot.T_parent_child for robot in robots]


def _joints_apart(first: CalibratedRobot, second: CalibratedRobot) -> dict[str, tuple[float, float, str]]:
    """Change of the constants of the head chain, see `Difference.joints`."""
    if first.chain is None or second.chain is None or unlike_joints(first.chain, second.chain):
        return {}
    apart = {}
    for row in joint_constants(first.chain):
        if row.name in first.constants_std and row.name in second.constants_std:
            values = [robot.constants[row.name] for robot in (first, second)]
            std = math.hypot(*(robot.constants_std[row.name] for robot in (first, second)))
            kind = row.of_kind
            apart[row.name] = kind.shown * (values[1] - values[0]), kind.shown * std, kind.shown_unit
    return apart


def nine_apart(first: CalibratedRobot, second: CalibratedRobot) -> FloatArray:
    """Change from a to b, (9,), in the order of `NINE`: rotation vector of R_b R_a^T, rad; lengths, m."""
    a, b = (Parameters(robot.T_parent_child, robot.wheels) for robot in (first, second))
    return b.minus(a)


def _chance(chi2: float, freedom: int) -> float:
    """Probability of a sum of squares this large (Pearson's chi-squared test)."""
    from scipy.special import chdtrc  # slow to import, and reports do not need it

    return float(chdtrc(freedom, chi2))


def broken_limits(
    change: Difference,
    max_sigma: float | None = None,
    max_ray_mm: float | None = None,
    max_heading_deg: float | None = None,
) -> list[str]:
    """The limits that a difference exceeds, as text; the one of unobservable parameters always applies.

    Args:
        max_sigma: limit of any parameter, in standard deviations; None for none.
        max_ray_mm: limit of the shift of a point 2 m ahead of the camera, mm.
        max_heading_deg: limit of the change of heading per full turn, deg.
    """
    broken = [
        f"{NINE[k]}, unobservable or fixed in one calibration, by {change.nominal_sigmas[k]:.1f} sigma "
        f"(limit {MOST_NOMINAL_SIGMAS:g})"
        for k in np.flatnonzero(change.nominal_sigmas > MOST_NOMINAL_SIGMAS)
    ]
    if max_sigma is not None:
        if not change.known.any():
            broken.append("no standard deviations for the limit in sigma")
        blind = np.flatnonzero(change.unobservable & ~change.both_nominal)
        broken += [f"no conclusion about {NINE[k]}: unobservable or fixed" for k in blind]
        sigmas = np.nan_to_num(np.abs(change.sigmas))
        worst = int(np.argmax(sigmas))
        if sigmas[worst] > max_sigma:
            broken.append(f"{NINE[worst]} by {sigmas[worst]:.1f} sigma (limit {max_sigma:g})")
        broken += [
            f"{name} by {abs(moved):.1f} sigma (limit {max_sigma:g})"
            for name, moved in change.moved_joints.items()
            if abs(moved) > max_sigma
        ]
    if max_ray_mm is not None and change.ray_m * 1e3 > max_ray_mm:
        broken.append(f"point 2 m ahead by {change.ray_m * 1e3:.2f} mm (limit {max_ray_mm:g})")
    turn_deg = abs(math.degrees(change.heading_rad_per_turn))
    if max_heading_deg is not None and turn_deg > max_heading_deg:
        broken.append(f"heading per full turn by {turn_deg:.3f} deg (limit {max_heading_deg:g})")
    return broken


@dataclass(frozen=True, slots=True, eq=False)
class History:
    """The nine parameters over several calibrations.

    Attributes:
        change: (n, 9) change from the first calibration.
        std: (n, 9) standard deviations of each calibration, 0 where there is none.
        chance: (9,) probability of a spread this large if the robot did not change; NaN where fewer than two
            calibrations observe the parameter.
    """

    change: FloatArray
    std: FloatArray
    chance: FloatArray


def history(robots: Sequence[CalibratedRobot]) -> History:
    """Change of all calibrations from the first, with a test of each parameter.

    Raises:
        ConfigError: the frames differ.
    """
    change = np.stack([difference(robots[0], robot).change for robot in robots])
    std, observed = np.zeros_like(change), np.zeros(change.shape, dtype=np.bool_)
    for row, robot in enumerate(robots):
        if robot.knowledge is not None:
            std[row] = np.sqrt(np.diag(robot.knowledge.covariance))
            observed[row] = robot.knowledge.observable & (std[row] > 0)
    chance = np.full(9, np.nan)
    for k in range(9):
        known = observed[:, k]
        if known.sum() >= 2:
            weight = 1 / std[known, k] ** 2
            mean = np.average(change[known, k], weights=weight)
            chance[k] = _chance(float(weight @ (change[known, k] - mean) ** 2), int(known.sum()) - 1)
    return History(change, std, chance)
