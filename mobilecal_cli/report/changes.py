"""Change since the last calibration, or from the nominal values."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mobilecal_cli.comparison import difference, nine_apart
from mobilecal_cli.model import NINE, CalibratedRobot, FloatArray, Nominal
from mobilecal_cli.model.text import visible
from mobilecal_cli.report.check import Check
from mobilecal_cli.report.units import SHOWN

#: Probability of a false alarm for a robot that did not change.
_UNLIKELY = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class Change:
    """Change of the nine parameters.

    Attributes:
        against: label of the reference.
        value: (9,) rad and m, NaN where the reference has no value.
        sigmas: (9,) in standard deviations, NaN where none is known; all NaN against nominal values.
        chance: probability of a change this large if the robot did not change; None against nominal values.
    """

    against: str
    value: FloatArray
    sigmas: FloatArray
    chance: float | None


def change_since(robot: CalibratedRobot, last: CalibratedRobot, name: str) -> Change:
    """Change since an earlier calibration.

    Raises:
        ConfigError: the frames differ.
    """
    found = difference(last, robot)
    return Change(name, found.change, found.sigmas, None if found.shared else found.chance)


def change_from_nominal(robot: CalibratedRobot, nominal: Nominal) -> Change | None:
    """Difference from the nominal values, which have no standard deviation; None if none are stated."""
    if nominal.T_h_reference is None and nominal.wheels is None:
        return None
    T = robot.T_parent_child if nominal.T_h_reference is None else nominal.T_h_reference
    before = CalibratedRobot(robot.parent_frame, robot.child_frame, T, nominal.wheels or robot.wheels)
    value = nine_apart(before, robot)
    if nominal.T_h_reference is None:
        value[:6] = np.nan
    if nominal.wheels is None:
        value[6:] = np.nan
    return Change("the nominal values", value, np.full(9, np.nan), None)


def change_rows(change: Change | None) -> dict[str, tuple[str, str]]:
    """Parameter → its change in deg or mm and in sigmas, formatted; "" where unknown."""
    if change is None:
        return {}
    rows = {}
    for name, value, sigmas in zip(NINE, change.value, change.sigmas, strict=True):
        shown = f"{value * SHOWN[name][1]:+.3f}" if np.isfinite(value) else ""
        rows[name] = (shown, f"{sigmas:+.1f}" if np.isfinite(sigmas) else "")
    return rows


def change_checks(change: Change | None) -> Iterator[Check]:
    """Whether the robot has changed since the last calibration."""
    if change is None or change.chance is None:
        return
    worst = int(np.argmax(np.abs(np.nan_to_num(change.sigmas))))
    moved = f"{NINE[worst]} by {change.sigmas[worst]:+.1f} sigma"
    yield Check(
        "change since the last calibration",
        f"largest: {moved}",
        f"probability by chance at least {100 * _UNLIKELY:g} %",
        "look" if change.chance < _UNLIKELY else "good",
        f"The robot has changed since {visible(change.against)}: {moved}.",
        "Check for a loose camera and worn tires. If nothing is found, record and calibrate again.",
    )
