"""The numbers that all stations share: the nine, and those that may be estimated beside them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mobilecal_cli.model import NINE, FloatArray

# What a drawing or a ruler tells without any log. A direction in which the log tells less is not observable.
NINE_SCALES = np.array([0.2, 0.2, 0.2, 0.1, 0.1, 0.1])  # rad, m; wheels: `WHEEL_SCALE` of themselves
WHEEL_SCALE = 0.2


@dataclass(frozen=True, slots=True)
class Extra:
    """A number that may be estimated beside the nine; zero where it is not.

    Attributes:
        name: as `--estimate` takes it.
        group: a name for several at once.
        unit: "s", "rad", "m", "px" or "1".
        scale: a value that would be large, in that unit.
        meaning: in words.
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
        "to be added to the cameras' stamps, to be on the joints' clock",
    ),
    Extra(
        "time_wheels",
        "time_offsets",
        "s",
        0.2,
        "to be added to the cameras' stamps, to be on the wheels' clock",
    ),
    Extra("pan_zero", "pan_zero", "rad", 0.2, "what the pan joint really stands at when it reads zero"),
    Extra("mount_x", "mount", "m", 0.1, "the head's mount further forward than the chain says"),
    Extra("mount_y", "mount", "m", 0.1, "the head's mount further to the left than the chain says"),
    Extra("backlash_pan", "backlash", "rad", 0.05, "play of the pan joint between its two directions"),
    Extra("backlash_tilt", "backlash", "rad", 0.05, "play of the tilt joint between its two directions"),
    Extra("stereo_r_x", "stereo", "rad", 0.05, "turn of the right camera about the left one's x"),
    Extra("stereo_r_y", "stereo", "rad", 0.05, "turn of the right camera about the left one's y"),
    Extra("stereo_r_z", "stereo", "rad", 0.05, "turn of the right camera about the left one's z"),
    Extra("baseline_scale", "stereo", "1", 0.1, "the stereo baseline longer than camera_info says"),
    Extra("focal_left", "focal_length", "px", 50.0, "the left focal length longer than camera_info says"),
    Extra("focal_right", "focal_length", "px", 50.0, "the right focal length longer than camera_info says"),
    Extra("principal_left_x", "principal_point", "px", 50.0, "the left principal point further right"),
    Extra("principal_left_y", "principal_point", "px", 50.0, "the left principal point further down"),
    Extra("principal_right_x", "principal_point", "px", 50.0, "the right principal point further right"),
    Extra("principal_right_y", "principal_point", "px", 50.0, "the right principal point further down"),
    Extra("square_scale", "square_scale", "1", 0.1, "the board's squares larger than stated"),
)
EXTRA_NAMES = tuple(extra.name for extra in EXTRAS)
INDEX = {name: i for i, name in enumerate(EXTRA_NAMES)}
POSE_EXTRAS = frozenset(EXTRA_NAMES[:7])  # they move the camera; the others change what it sees


@dataclass(frozen=True, slots=True)
class Layout:
    """Which shared numbers are unknown, and in which column each stands: the nine, the extras, the boards.

    Attributes:
        extras: names of the free extras, in the order of `EXTRAS`.
        boards: how many board poses there are, six columns each.
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
        """(named,) the size at which a number would be no better than a drawing's; wheels_m: (3,)."""
        extras = [EXTRAS[INDEX[name]].scale for name in self.extras]
        return np.concatenate([NINE_SCALES, WHEEL_SCALE * np.abs(wheels_m), extras])


def extras_of(names: tuple[str, ...]) -> tuple[str, ...]:
    """The extras that some names or group names stand for, in the order of `EXTRAS`.

    Raises:
        KeyError: an unknown name.
    """
    known = {extra.name for extra in EXTRAS} | {extra.group for extra in EXTRAS}
    for name in names:
        if name not in known:
            raise KeyError(name)
    return tuple(extra.name for extra in EXTRAS if extra.name in names or extra.group in names)
