"""A calibration as params.yaml holds it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from mobilecal_cli.model.arrays import BoolArray, FloatArray, freeze
from mobilecal_cli.model.observations import LogSource
from mobilecal_cli.model.rig import Side, WheelGeometry


@dataclass(frozen=True, slots=True, eq=False)
class Knowledge:
    """How well the nine numbers of a params.yaml are known.

    Attributes:
        covariance: (9, 9) in the order of `NINE`: small rotation vector in the parent's frame, rad; m.
        observable: (9,) false for numbers that are held at nominal values; `covariance` does not speak of them.
    """

    covariance: FloatArray
    observable: BoolArray

    def __post_init__(self) -> None:
        freeze(self, covariance=(9, 9))
        freeze(self, np.bool_, observable=(9,))


@dataclass(frozen=True, slots=True, eq=False)
class CalibratedRobot:
    """The calibration as params.yaml holds it.

    Attributes:
        parent_frame: the head's frame.
        child_frame: the reference camera's optical frame.
        T_parent_child: (4, 4) child coordinates to parent coordinates, m.
        wheels: radii and separation.
        knowledge: None where the method knew none.
        created: when, ISO 8601, "" where the file does not say.
        logs: the recordings that it was made from.
        wheel_joints: names of the wheels' joints, where they were read from joint states.
        nominal_wheels: the wheels as they were known before, if they were.
    """

    parent_frame: str
    child_frame: str
    T_parent_child: FloatArray
    wheels: WheelGeometry
    knowledge: Knowledge | None = None
    created: str = ""
    logs: tuple[LogSource, ...] = ()
    wheel_joints: Mapping[Side, str] = field(default_factory=dict)
    nominal_wheels: WheelGeometry | None = None

    def __post_init__(self) -> None:
        freeze(self, T_parent_child=(4, 4))
