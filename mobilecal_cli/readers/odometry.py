"""Wheel rotations from a driver's odometry, which was computed with known (nominal) wheels."""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any

import numpy as np

from mobilecal_cli.model import FloatArray, Side, Track, WheelGeometry
from mobilecal_cli.readers.series import Series

_SMALL = 1e-6
#: No wheeled robot moves or turns this far from one message to the next: the driver was reset.
_JUMP_M, _JUMP_RAD = 0.5, 1.5


class Odometry:
    """Poses of nav_msgs/Odometry on one topic.

    Args:
        topic: the topic.
        baked_in: the wheels that the driver computed its poses with.
    """

    def __init__(self, topic: str, baked_in: WheelGeometry) -> None:
        self.baked_in = baked_in
        self._topic = topic
        self._x, self._y, self._heading = (Series(f"{what} on {topic}") for what in ("x", "y", "heading"))

    def take(self, message: Any, time_ns: int) -> None:  # noqa: ANN401 - the type is the recording's
        """Read one message."""
        position, turned = message.pose.pose.position, message.pose.pose.orientation
        heading = 2 * math.atan2(turned.z, turned.w)
        if all(math.isfinite(value) for value in (position.x, position.y, heading)):
            self._x.add(time_ns, position.x)
            self._y.add(time_ns, position.y)
        self._heading.add(time_ns, heading if math.isfinite(position.x + position.y) else math.nan)

    def track(self, side: Side, notes: list[str]) -> Track:
        """Rotation of a wheel, rad, starting at zero.

        Raises:
            RecordingError: no finite pose.
        """
        tracks, found = self._taken_apart
        notes += found
        return tracks[side]

    @cached_property
    def _taken_apart(self) -> tuple[dict[Side, Track], list[str]]:
        notes: list[str] = []
        time_ns, heading = self._heading.ordered(notes)
        quiet: list[str] = []  # notes on the same stamps
        xy = np.stack([self._x.ordered(quiet)[1], self._y.ordered(quiet)[1]], axis=1)
        right, left, jumps = rotations(xy, heading, self.baked_in)
        wheels = self.baked_in
        notes.append(
            f"{self._topic}: wheel rotations are derived from odometry, assuming wheel radii of "
            f"{wheels.radius_left_m * 1e3:g} mm (left) and {wheels.radius_right_m * 1e3:g} mm (right) "
            f"and a separation of {wheels.separation_m * 1e3:g} mm; if the driver uses other values, the result has "
            "the same relative error"
        )
        if jumps:
            notes.append(
                f"{self._topic}: the pose jumps {jumps} times; the wheels are assumed to stand still there"
            )
        return {"right": Track(time_ns, right), "left": Track(time_ns, left)}, notes


def rotations(
    xy_m: FloatArray, heading_rad: FloatArray, wheels: WheelGeometry
) -> tuple[FloatArray, FloatArray, int]:
    """Wheel rotations that move a differential drive along poses (inverse of the paper's eqs. 8-10).

    Between two poses the base moves along an arc of length chord * h / sin(h), where h is half the turn.

    Args:
        xy_m: (n, 2) positions.
        heading_rad: (n,) headings, wrapped or not.
        wheels: their sizes.

    Returns:
        (n,) right and left rotation starting at zero, rad, and the number of jumps.
    """
    turn = np.remainder(np.diff(heading_rad) + math.pi, 2 * math.pi) - math.pi
    step = np.diff(xy_m, axis=0)
    half = turn / 2
    middle = heading_rad[:-1] + half
    forward = step[:, 0] * np.cos(middle) + step[:, 1] * np.sin(middle)
    small = np.abs(half) < _SMALL
    way = forward * np.where(small, 1.0, half / np.where(small, 1.0, np.sin(half)))
    jumps = (np.hypot(*step.T) > _JUMP_M) | (np.abs(turn) > _JUMP_RAD)
    way, turn = np.where(jumps, 0.0, way), np.where(jumps, 0.0, turn)
    ahead = turn * wheels.separation_m / 2
    right, left = (way + ahead) / wheels.radius_right_m, (way - ahead) / wheels.radius_left_m
    return (
        np.concatenate([[0.0], np.cumsum(right)]),
        np.concatenate([[0.0], np.cumsum(left)]),
        int(jumps.sum()),
    )
