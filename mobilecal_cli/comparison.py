"""Calibrations of one robot side by side: differences in units, in standard deviations, and in what a user feels."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.likelihood.predict import AHEAD_M
from mobilecal_cli.model import BoolArray, CalibratedRobot, FloatArray
from mobilecal_cli.model.arrays import freeze


@dataclass(frozen=True, slots=True, eq=False)
class Difference:
    """One calibration less another.

    Attributes:
        change: (9,) in the order of `NINE`: rotation vector of R_b R_a^T in the head's frame, rad; m.
        std: (9,) of it, for independent recordings; 0 where one of the two does not know the number.
        known: (9,) numbers that both know.
        chi2: change in units of its covariance, squared, over the known numbers; None where there are none.
        chance: that chance alone makes it as large; None where there are none.
        shared: the two were made from a common recording, so that the standard deviations say too much.
        ray_m: shift of a point two metres ahead of the camera.
        along_m_per_m: more distance dead reckoned per metre straight on.
        heading_rad_per_m: heading gained where the first goes straight on.
        heading_rad_per_turn: heading gained in a full turn on the spot.
    """

    change: FloatArray
    std: FloatArray
    known: BoolArray
    chi2: float | None
    chance: float | None
    shared: bool
    ray_m: float
    along_m_per_m: float
    heading_rad_per_m: float
    heading_rad_per_turn: float

    def __post_init__(self) -> None:
        freeze(self, change=(9,), std=(9,))
        freeze(self, np.bool_, known=(9,))

    @property
    def sigmas(self) -> FloatArray:
        """(9,) change over its standard deviation, NaN where that is not known."""
        return np.where(self.known, self.change / np.where(self.known, self.std, 1.0), np.nan)


def difference(first: CalibratedRobot, second: CalibratedRobot) -> Difference:
    """What has changed from one calibration to another.

    Raises:
        ConfigError: they speak of other frames.
    """
    for one, other, what in (
        (first.parent_frame, second.parent_frame, "head"),
        (first.child_frame, second.child_frame, "camera"),
    ):
        if one != other:
            raise ConfigError(
                f"the calibrations speak of different frames: the {what} is {one!r} in one and {other!r} in the other",
                "compare calibrations of one robot, made with the same head.head_frame and cameras.reference",
            )
    change = nine_apart(first, second)
    known, covariance = _known(first, second)
    std = np.where(known, np.sqrt(np.diag(covariance)), 0.0)
    known &= std > 0
    chi2 = chance = None
    if known.any():
        x = change[known]
        chi2 = float(x @ np.linalg.lstsq(covariance[np.ix_(known, known)], x, rcond=None)[0])
        chance = _chance(chi2, int(known.sum()))
    a, b = first.wheels, second.wheels
    right, left = b.radius_right_m / a.radius_right_m, b.radius_left_m / a.radius_left_m
    # A full turn on the spot by the first: each wheel rolls b_a / 2 times 2 pi, one of them backwards.
    turned = 2 * math.pi * (right + left) / 2 * a.separation_m / b.separation_m
    ahead = np.array([0.0, 0.0, AHEAD_M])
    shift = se3.act(second.T_parent_child, ahead[None]) - se3.act(first.T_parent_child, ahead[None])
    return Difference(
        change=change,
        std=std,
        known=known,
        chi2=chi2,
        chance=chance,
        shared=bool({log.sha256 for log in first.logs} & {log.sha256 for log in second.logs}),
        ray_m=float(np.linalg.norm(shift)),
        along_m_per_m=(right + left) / 2 - 1,
        heading_rad_per_m=(right - left) / b.separation_m,
        heading_rad_per_turn=turned - 2 * math.pi,
    )


def nine_apart(first: CalibratedRobot, second: CalibratedRobot) -> FloatArray:
    """(9,) in the order of `NINE`: rotation vector of R_b R_a^T, rad, and differences of the lengths, m."""
    a, b = first.wheels, second.wheels
    R_b_a = second.T_parent_child[:3, :3] @ first.T_parent_child[:3, :3].T
    return np.array(
        [
            *se3.log_so3(R_b_a),
            *(second.T_parent_child[:3, 3] - first.T_parent_child[:3, 3]),
            b.radius_right_m - a.radius_right_m,
            b.radius_left_m - a.radius_left_m,
            b.separation_m - a.separation_m,
        ]
    )


def _known(first: CalibratedRobot, second: CalibratedRobot) -> tuple[BoolArray, FloatArray]:
    """(9,) numbers that both know, and (9, 9) covariance of the difference of independent calibrations."""
    a, b = first.knowledge, second.knowledge
    if a is None or b is None:
        return np.zeros(9, dtype=np.bool_), np.zeros((9, 9))
    return a.observable & b.observable, a.covariance + b.covariance


def _chance(chi2: float, freedom: int) -> float:
    """That chance alone makes a sum of squares as large (Pearson's chi-squared test)."""
    from scipy.special import chdtrc  # heavy, and whoever draws a report needs none of it

    return float(chdtrc(freedom, chi2))


@dataclass(frozen=True, slots=True, eq=False)
class History:
    """One number over several calibrations.

    Attributes:
        change: (n, 9) against the first calibration.
        std: (n, 9) of each calibration by itself, 0 where it does not know the number.
        chance: (9,) that calibrations of a robot that did not change are so far apart; NaN where fewer than two
            know the number.
    """

    change: FloatArray
    std: FloatArray
    chance: FloatArray


def history(robots: Sequence[CalibratedRobot]) -> History:
    """All calibrations against the first, and whether each number stays.

    Raises:
        ConfigError: they speak of other frames.
    """
    change = np.stack([difference(robots[0], robot).change for robot in robots])
    std = np.zeros_like(change)
    for row, robot in zip(std, robots, strict=True):
        if robot.knowledge is not None:
            row[:] = np.where(robot.knowledge.observable, np.sqrt(np.diag(robot.knowledge.covariance)), 0.0)
    chance = np.full(9, np.nan)
    for k in range(9):
        known = std[:, k] > 0
        if known.sum() >= 2:
            weight = 1 / std[known, k] ** 2
            mean = np.average(change[known, k], weights=weight)
            chance[k] = _chance(float(weight @ (change[known, k] - mean) ** 2), int(known.sum()) - 1)
    return History(change, std, chance)
