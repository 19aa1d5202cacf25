"""Global parameters, common to all stations: the nine parameters and the optional additional ones."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mobilecal_cli.model import NINE, FloatArray

# Accuracy of nominal values from a drawing or a ruler. A direction is observable if the recording is more accurate.
NINE_SCALES = np.array([0.2, 0.2, 0.2, 0.1, 0.1, 0.1])  # rad, m; wheels: share `WHEEL_SCALE` of the value
WHEEL_SCALE = 0.2


@dataclass(frozen=True, slots=True)
class Extra:
    """An additional parameter that may be estimated with the nine; zero otherwise.

    Attributes:
        name: for `--estimate`.
        group: name of its group, also for `--estimate`.
        unit: "s", "rad", "m", "px" or "1".
        scale: a large value, in that unit.
        meaning: description for the report.
    """

    name: str
    group: str
    unit: str
    scale: float
    meaning: str


EXTRAS = (
    Extra(
        "time_joints",
        "time_offsets",
        "s",
        0.2,
        "time offset added to camera stamps to match the joint clock",
    ),
    Extra(
        "time_wheels",
        "time_offsets",
        "s",
        0.2,
        "time offset added to camera stamps to match the wheel clock",
    ),
    Extra("pan_zero", "pan_zero", "rad", 0.2, "pan joint angle at a reading of zero"),
    Extra("mount_x", "mount", "m", 0.1, "forward correction of the head mount"),
    Extra("mount_y", "mount", "m", 0.1, "leftward correction of the head mount"),
    Extra("backlash_pan", "backlash", "rad", 0.05, "backlash of the pan joint"),
    Extra("backlash_tilt", "backlash", "rad", 0.05, "backlash of the tilt joint"),
    Extra(
        "stereo_r_x", "stereo", "rad", 0.05, "rotation correction of the right camera about the left x axis"
    ),
    Extra(
        "stereo_r_y", "stereo", "rad", 0.05, "rotation correction of the right camera about the left y axis"
    ),
    Extra(
        "stereo_r_z", "stereo", "rad", 0.05, "rotation correction of the right camera about the left z axis"
    ),
    Extra("baseline_scale", "stereo", "1", 0.1, "relative correction of the stereo baseline"),
    Extra("focal_left", "focal_length", "px", 50.0, "correction of the left focal length"),
    Extra("focal_right", "focal_length", "px", 50.0, "correction of the right focal length"),
    Extra("principal_left_x", "principal_point", "px", 50.0, "correction of the left principal point, x"),
    Extra("principal_left_y", "principal_point", "px", 50.0, "correction of the left principal point, y"),
    Extra("principal_right_x", "principal_point", "px", 50.0, "correction of the right principal point, x"),
    Extra("principal_right_y", "principal_point", "px", 50.0, "correction of the right principal point, y"),
    Extra("square_scale", "square_scale", "1", 0.1, "relative correction of the square size"),
)
EXTRA_NAMES = tuple(extra.name for extra in EXTRAS)
INDEX = {name: i for i, name in enumerate(EXTRA_NAMES)}
POSE_EXTRAS = frozenset(
    EXTRA_NAMES[:7]
)  # change the camera's pose; the others change the cameras or the board


@dataclass(frozen=True, slots=True)
class Layout:
    """Columns of the global parameters: the nine, the additional parameters, the boards.

    Attributes:
        extras: names of the estimated additional parameters, in the order of `EXTRAS`.
        boards: number of board poses, six columns each.
    """

    extras: tuple[str, ...]
    boards: int

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the columns before the boards'."""
        return (*NINE, *self.extras)

    @property
    def named(self) -> int:
        """Number of columns before the boards'."""
        return len(NINE) + len(self.extras)

    @property
    def size(self) -> int:
        """Number of all columns."""
        return self.named + 6 * self.boards

    def scales(self, wheels_m: FloatArray) -> FloatArray:
        """Accuracy of each named parameter without a recording, (named,); wheels_m: (3,)."""
        extras = [EXTRAS[INDEX[name]].scale for name in self.extras]
        return np.concatenate([NINE_SCALES, WHEEL_SCALE * np.abs(wheels_m), extras])


def extras_of(names: tuple[str, ...]) -> tuple[str, ...]:
    """Additional parameters selected by names or group names, in the order of `EXTRAS`.

    Raises:
        KeyError: unknown name.
    """
    known = {extra.name for extra in EXTRAS} | {extra.group for extra in EXTRAS}
    for name in names:
        if name not in known:
            raise KeyError(name)
    return tuple(extra.name for extra in EXTRAS if extra.name in names or extra.group in names)
