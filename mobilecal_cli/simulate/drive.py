"""Motion of the simulated base in segments of constant speed, integrated as exact arcs.

This code is independent of the solver's dead reckoning.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mobilecal_cli.model import FloatArray, WheelGeometry

_STRAIGHT_RADPS = 1e-12


@dataclass(frozen=True, slots=True)
class Stretch:
    """A time segment with constant speeds.

    Attributes:
        duration_s: duration, s.
        v_mps: forward speed of the base's origin, m/s.
        w_radps: turning rate, rad/s, positive to the left.
    """

    duration_s: float
    v_mps: float = 0.0
    w_radps: float = 0.0


Pose = tuple[float, float, float]


def moved(pose: Pose, stretch: Stretch, time_s: float) -> Pose:
    """Base pose (x m, y m, heading rad) after a given time in a segment."""
    x, y, heading = pose
    if abs(stretch.w_radps) < _STRAIGHT_RADPS:
        run = stretch.v_mps * time_s
        return x + run * math.cos(heading), y + run * math.sin(heading), heading
    radius = stretch.v_mps / stretch.w_radps
    centre_x, centre_y = x - radius * math.sin(heading), y + radius * math.cos(heading)
    heading += stretch.w_radps * time_s
    return centre_x + radius * math.sin(heading), centre_y - radius * math.cos(heading), heading


def wheel_speeds(stretch: Stretch, wheels: WheelGeometry) -> tuple[float, float]:
    """Right and left wheel speeds, rad/s, for rolling without slip."""
    half = wheels.separation_m / 2
    right = (stretch.v_mps + stretch.w_radps * half) / wheels.radius_right_m
    left = (stretch.v_mps - stretch.w_radps * half) / wheels.radius_left_m
    return right, left


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """A complete drive.

    Attributes:
        stretches: consecutive segments.
        start: initial pose.
    """

    stretches: tuple[Stretch, ...]
    start: Pose = (0.0, 0.0, 0.0)

    @property
    def breaks_s(self) -> FloatArray:
        """(B + 1,) boundaries between the segments, s, from 0."""
        return np.concatenate([[0.0], np.cumsum([s.duration_s for s in self.stretches])])

    def poses(self, times_s: FloatArray) -> FloatArray:
        """(n, 3) base poses at given times."""
        at_breaks = [self.start]
        for stretch in self.stretches:
            at_breaks.append(moved(at_breaks[-1], stretch, stretch.duration_s))
        breaks = self.breaks_s
        index = np.clip(np.searchsorted(breaks, times_s, side="right") - 1, 0, len(self.stretches) - 1)
        return np.array(
            [
                moved(at_breaks[i], self.stretches[i], t - breaks[i])
                for i, t in zip(index, times_s, strict=True)
            ]
        )

    def wheel_angles(self, times_s: FloatArray, wheels: WheelGeometry) -> FloatArray:
        """(n, 2) rotations of the right and left wheel since the start, rad; linear inside a segment."""
        rolled = [[0.0, 0.0]]
        for stretch in self.stretches:
            right, left = wheel_speeds(stretch, wheels)
            before = rolled[-1]
            rolled.append([before[0] + right * stretch.duration_s, before[1] + left * stretch.duration_s])
        breaks, angles = self.breaks_s, np.array(rolled)
        return np.stack([np.interp(times_s, breaks, angles[:, k]) for k in (0, 1)], axis=1)


def base_in_world(poses: FloatArray) -> FloatArray:
    """T_w_v of base poses: (n, 3) → (n, 4, 4)."""
    T = np.zeros((len(poses), 4, 4))
    cos, sin = np.cos(poses[:, 2]), np.sin(poses[:, 2])
    T[:, 0, 0], T[:, 0, 1], T[:, 1, 0], T[:, 1, 1] = cos, -sin, sin, cos
    T[:, 2, 2] = T[:, 3, 3] = 1
    T[:, 0, 3], T[:, 1, 3] = poses[:, 0], poses[:, 1]
    return T
