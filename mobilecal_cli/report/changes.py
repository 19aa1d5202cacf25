"""Change of the nine parameters from the last calibration or from the nominal values."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np

from mobilecal_cli.comparison import difference, nine_apart
from mobilecal_cli.model import NINE, CalibratedRobot, FloatArray, Nominal
from mobilecal_cli.report.check import Check

#: The check warns if an unchanged robot shows a change this large less often than this.
_UNLIKELY = 1e-4


def _unknown() -> FloatArray:
    return np.full(len(NINE), np.nan)


@dataclass(frozen=True, slots=True, eq=False)
class Change:
    """The nine parameters minus those of before.

    Attributes:
        against: what they are compared with.
        value: (9,) rad and m, NaN where there is nothing to compare with.
        sigmas: (9,) divided by the standard deviation of the difference, NaN where none is known.
        chance: probability of a change this large if the robot did not change; None where it is not known.
        percent: (9,) change of the wheel parameters in percent of the nominal values, NaN for the others.
    """

    against: str
    value: FloatArray
    sigmas: FloatArray
    chance: float | None
    percent: FloatArray = field(default_factory=_unknown)


def change_since(robot: CalibratedRobot, last: CalibratedRobot, name: str) -> Change:
    """Change from an earlier calibration, also in standard deviations of the difference.

    Raises:
        ConfigError: the earlier calibration is of other frames.
    """
    found = difference(last, robot)
    return Change(name, found.change, found.sigmas, None if found.shared else found.chance)


def change_from_nominal(robot: CalibratedRobot, nominal: Nominal) -> Change | None:
    """Change from the nominal values, which have no standard deviations; None where there are no nominal values."""
    if nominal.T_h_reference is None and nominal.wheels is None:
        return None
    T = robot.T_parent_child if nominal.T_h_reference is None else nominal.T_h_reference
    before = CalibratedRobot(robot.parent_frame, robot.child_frame, T, nominal.wheels or robot.wheels)
    value, percent = nine_apart(before, robot), _unknown()
    if nominal.T_h_reference is None:
        value[:6] = np.nan
    if nominal.wheels is None:
        value[6:] = np.nan
    else:
        wheels = nominal.wheels
        percent[6:] = 100 * value[6:] / [wheels.radius_right_m, wheels.radius_left_m, wheels.separation_m]
    return Change("the nominal values", value, _unknown(), None, percent)


def change_checks(change: Change | None) -> Iterator[Check]:
    """Whether the robot is unchanged since the last calibration."""
    if change is None or change.chance is None:
        return
    worst = int(np.argmax(np.abs(np.nan_to_num(change.sigmas))))
    facts = {
        "parameter": NINE[worst],
        "sigmas": float(change.sigmas[worst]),
        "against": change.against,
    }
    yield Check(
        "change",
        100 * change.chance,
        100 * _UNLIKELY,
        "warning" if change.chance < _UNLIKELY else "pass",
        facts,
    )
