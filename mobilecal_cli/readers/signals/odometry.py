"""Wheel rotations from a driver's odometry, which was computed with known (nominal) wheels."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from mobilecal_cli.model import FloatArray, Side, Track, WheelGeometry
from mobilecal_cli.readers.signals.series import Samples, Series

_SMALL = 1e-6
#: No wheeled robot moves or turns this far from one message to the next: the driver was reset.
_JUMP_M, _JUMP_RAD = 0.5, 1.5


class Odometry:
    """Poses of nav_msgs/Odometry on one topic.

    Args:
        topic: the topic.
        baked_in: the wheels that the driver computed its poses with.

    Attributes:
        series: x, y and heading of each pose.
    """

    def __init__(self, topic: str, baked_in: WheelGeometry) -> None:
        self.baked_in = baked_in
        self.series = Series(topic, f"pose on {topic}", width=3)

    def take(self, message: Any, time_ns: int, log_ns: int) -> None:  # noqa: ANN401 - the type is the recording's
        """Read one message."""
        position, turned = message.pose.pose.position, message.pose.pose.orientation
        self.series.add(time_ns, log_ns, position.x, position.y, 2 * math.atan2(turned.z, turned.w))

    def track(self, side: Side, samples: Samples, notes: list[str]) -> Track:
        """Rotation of a wheel, rad, starting at zero."""
        time_ns, pose = samples.ordered(notes)
        right, left, jumps = rotations(pose[:, :2], pose[:, 2], self.baked_in)
        wheels = self.baked_in
        notes.append(
            f"{samples.topic}: wheel rotations are derived from odometry, assuming wheel radii of "
            f"{wheels.radius_left_m * 1e3:g} mm (left) and {wheels.radius_right_m * 1e3:g} mm (right) "
            f"and a separation of {wheels.separation_m * 1e3:g} mm; if the driver uses other values, the result has "
            "the same relative error"
        )
        if jumps:
            notes.append(
                f"{samples.topic}: the pose jumps {jumps} times; the wheels are assumed to stand still there"
            )
        return Track(time_ns, right if side == "right" else left)


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
