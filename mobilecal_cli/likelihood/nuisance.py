"""Constants of the robot that may be estimated beside the nine parameters: one row each in `CONSTANTS`.

A row names what its constant changes, an effect (see `effects`). A constant that acts like another one needs a row and
no code.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from mobilecal_cli.likelihood.effects import (
    BaselineScale,
    BoardEffect,
    CameraChange,
    CameraEffect,
    Effect,
    FocalLength,
    JointClock,
    JointPlay,
    JointZero,
    MountShift,
    PrincipalPoint,
    RightTurn,
    SquareScale,
    WheelClock,
)
from mobilecal_cli.model import NINE, FloatArray, StereoRig, WheelGeometry

# Prior sigmas of the nine: what a drawing or a ruler gives without any recording.
NINE_SIGMAS = np.array([0.2, 0.2, 0.2, 0.1, 0.1, 0.1])  # rad, m; wheels: a share of their size
WHEEL_SIGMA = 0.2


@dataclass(frozen=True, slots=True)
class Constant:
    """A constant that may be estimated beside the nine parameters; zero where it is not.

    Attributes:
        name: as `--estimate` takes it.
        group: a name for several at once.
        unit: "s", "rad", "m", "px" or "1".
        sigma: prior standard deviation, in that unit; the expected value is zero.
        meaning: in words.
        effect: what it changes.
    """

    name: str
    group: str
    unit: str
    sigma: float
    meaning: str
    effect: Effect


# fmt: off
CONSTANTS: tuple[Constant, ...] = (
    Constant("time_joints", "time_offsets", "s", 0.2, "joint clock minus camera clock", JointClock()),
    Constant("time_wheels", "time_offsets", "s", 0.2, "wheel clock minus camera clock", WheelClock()),
    Constant("pan_zero", "pan_zero", "rad", 0.2, "position of the pan joint where it reads zero", JointZero("pan")),
    Constant("mount_x", "mount", "m", 0.1, "shift of the head mount, forward", MountShift(0)),
    Constant("mount_y", "mount", "m", 0.1, "shift of the head mount, to the left", MountShift(1)),
    Constant("backlash_pan", "backlash", "rad", 0.05, "backlash of the pan joint", JointPlay("pan")),
    Constant("backlash_tilt", "backlash", "rad", 0.05, "backlash of the tilt joint", JointPlay("tilt")),
    Constant("stereo_r_x", "stereo", "rad", 0.05, "right camera's rotation about the left one's x", RightTurn(0)),
    Constant("stereo_r_y", "stereo", "rad", 0.05, "right camera's rotation about the left one's y", RightTurn(1)),
    Constant("stereo_r_z", "stereo", "rad", 0.05, "right camera's rotation about the left one's z", RightTurn(2)),
    Constant("baseline_scale", "stereo", "1", 0.1, "relative change of the stereo baseline", BaselineScale()),
    Constant("focal_left", "focal_length", "px", 50.0, "change of the left focal length", FocalLength("left")),
    Constant("focal_right", "focal_length", "px", 50.0, "change of the right focal length", FocalLength("right")),
    Constant("principal_left_x", "principal_point", "px", 50.0, "left principal point x", PrincipalPoint("left", 0)),
    Constant("principal_left_y", "principal_point", "px", 50.0, "left principal point y", PrincipalPoint("left", 1)),
    Constant("principal_right_x", "principal_point", "px", 50.0, "right principal point x", PrincipalPoint("right", 0)),
    Constant("principal_right_y", "principal_point", "px", 50.0, "right principal point y", PrincipalPoint("right", 1)),
    Constant("square_scale", "square_scale", "1", 0.1, "relative change of the board's squares", SquareScale()),
)
# fmt: on


def constant(name: str) -> Constant:
    """The row of a constant.

    Raises:
        KeyError: there is none of this name.
    """
    for row in CONSTANTS:
        if row.name == name:
            return row
    raise KeyError(name)


def rows(names: Collection[str]) -> tuple[Constant, ...]:
    """The rows that some names or group names stand for, in the order of the table.

    Raises:
        KeyError: an unknown name.
    """
    for name in names:
        if not any(name in (row.name, row.group) for row in CONSTANTS):
            raise KeyError(name)
    return tuple(row for row in CONSTANTS if row.name in names or row.group in names)


def _camera_change(constants: Iterable[Constant], values: Mapping[str, float]) -> CameraChange | None:
    change, changed = CameraChange(), False
    for row in constants:
        if isinstance(row.effect, CameraEffect) and values.get(row.name):
            row.effect.add(change, values[row.name])
            changed = True
    return change if changed else None


def cameras_with(rig: StereoRig, constants: Iterable[Constant], values: Mapping[str, float]) -> StereoRig:
    """A stereo pair with estimated constants applied; the same object where none of them changes it.

    Args:
        rig: as stated.
        constants: the rows to apply; those that do not change the cameras are ignored.
        values: name of a constant → its value; those that are not there are zero.
    """
    change = _camera_change(constants, values)
    return rig if change is None else change.apply(rig)


def stereo_turn(constants: Iterable[Constant], values: Mapping[str, float]) -> FloatArray:
    """(3,) rotation vector by which the right camera is turned against its stated rotation, rad."""
    change = _camera_change(constants, values)
    return np.zeros(3) if change is None else change.turn


@dataclass(frozen=True, slots=True)
class Layout:
    """Columns of the parameters that all stations share: the nine, the estimated constants, the boards.

    Attributes:
        constants: rows of the estimated constants, in the order of the table.
        boards: number of board poses, six columns each.
    """

    constants: tuple[Constant, ...]
    boards: int

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns before the boards'."""
        return (*NINE, *(row.name for row in self.constants))

    @property
    def named(self) -> int:
        """Number of columns before the boards'."""
        return len(NINE) + len(self.constants)

    @property
    def size(self) -> int:
        """Number of all columns."""
        return self.named + 6 * self.boards

    @property
    def direct(self) -> tuple[tuple[int, Constant], ...]:
        """(column, row) of the constants that change the cameras or the board, not the camera's pose."""
        return tuple(
            (k, row)
            for k, row in enumerate(self.constants, len(NINE))
            if isinstance(row.effect, CameraEffect | BoardEffect)
        )

    def prior_sigmas(self, wheels: WheelGeometry) -> FloatArray:
        """(named,) prior sigmas of the nine around nominal values, and of the constants around zero."""
        constants = [row.sigma for row in self.constants]
        return np.concatenate([NINE_SIGMAS, WHEEL_SIGMA * np.abs(wheels.vector), constants])
