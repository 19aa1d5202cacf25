"""What has changed against the last calibration, or against the drawing."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mobilecal_cli.comparison import difference, nine_apart
from mobilecal_cli.model import NINE, CalibratedRobot, FloatArray, Nominal
from mobilecal_cli.model.text import visible
from mobilecal_cli.report.check import Check
from mobilecal_cli.report.units import SHOWN

#: Chance does that once in ten thousand robots that did not change.
_UNLIKELY = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class Change:
    """The nine numbers less those of before.

    Attributes:
        against: what they are compared with, in words.
        value: (9,) rad and m, NaN where there is nothing to compare with.
        sigmas: (9,) in standard deviations, NaN where none is known.
        chance: that a robot that did not change gives as much; None against a drawing, which knows no sigma.
    """

    against: str
    value: FloatArray
    sigmas: FloatArray
    chance: float | None


def change_since(robot: CalibratedRobot, last: CalibratedRobot, name: str) -> Change:
    """Against an earlier calibration, in standard deviations of the difference.

    Raises:
        ConfigError: it is of other frames.
    """
    found = difference(last, robot)
    return Change(name, found.change, found.sigmas, None if found.shared else found.chance)


def change_from_nominal(robot: CalibratedRobot, nominal: Nominal) -> Change | None:
    """Against what was known before the recording, in standard deviations of the calibration; None for nothing."""
    if nominal.T_h_reference is None and nominal.wheels is None:
        return None
    T = robot.T_parent_child if nominal.T_h_reference is None else nominal.T_h_reference
    before = CalibratedRobot(robot.parent_frame, robot.child_frame, T, nominal.wheels or robot.wheels)
    value = nine_apart(before, robot)
    if nominal.T_h_reference is None:
        value[:6] = np.nan
    if nominal.wheels is None:
        value[6:] = np.nan
    sigmas = np.full(9, np.nan)
    if robot.knowledge is not None:
        std = np.sqrt(np.diag(robot.knowledge.covariance))
        known = robot.knowledge.observable & (std > 0)
        sigmas[known] = value[known] / std[known]
    return Change("the nominal values", value, sigmas, None)


def change_rows(change: Change | None) -> dict[str, tuple[str, str]]:
    """Number → its change in deg or mm, and in standard deviations, ready to be shown; "" where not known."""
    if change is None:
        return {}
    rows = {}
    for name, value, sigmas in zip(NINE, change.value, change.sigmas, strict=True):
        shown = f"{value * SHOWN[name][1]:+.3f}" if np.isfinite(value) else ""
        rows[name] = (shown, f"{sigmas:+.1f}" if np.isfinite(sigmas) else "")
    return rows


def change_checks(change: Change | None) -> Iterator[Check]:
    """Whether the robot is still the one that was calibrated last."""
    if change is None or change.chance is None:
        return
    worst = int(np.argmax(np.abs(np.nan_to_num(change.sigmas))))
    moved = f"{NINE[worst]} moved by {change.sigmas[worst]:+.1f} standard deviations"
    yield Check(
        "the robot is as it was calibrated last",
        moved,
        f"as large by chance in more than {100 * _UNLIKELY:g} % of cases",
        "look" if change.chance < _UNLIKELY else "good",
        f"The robot has changed since {visible(change.against)}: {moved}.",
        "Look for a loose camera or worn tyres; where nothing is found, record and calibrate once more.",
    )
