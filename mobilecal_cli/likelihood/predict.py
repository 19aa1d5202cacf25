"""Expected errors of the camera's pose and of dead reckoning, from the covariance."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from mobilecal_cli.model import FloatArray, Parameters

#: Distance of the point ahead of the camera whose position error is predicted, m.
AHEAD_M = 2.0


@dataclass(frozen=True, slots=True)
class Predicted:
    """Expected standard deviations.

    Attributes:
        camera_m, camera_rad: position and rotation of the left camera on the head, over all directions.
        point_m: position of a point two meters ahead of the camera.
        along_m_per_m, heading_rad_per_m: distance and heading by dead reckoning in straight driving.
        sideways_m_per_m: sideways position after one meter of straight driving.
        heading_rad_per_turn: heading per full turn in place.
    """

    camera_m: float
    camera_rad: float
    point_m: float
    along_m_per_m: float
    heading_rad_per_m: float
    sideways_m_per_m: float
    heading_rad_per_turn: float


def predicted(parameters: Parameters, covariance: FloatArray) -> Predicted:
    """Expected errors from the covariance of the nine parameters, (9, 9) in the order of `NINE`, to first order.

    Straight driving over s meters: both wheels turn by s / r, so a radius error moves its wheel by s dr / r. Turn in
    place by psi: psi = (rR phiR - rL phiL) / b with rR phiR = -rL phiL = psi b / 2 (paper, eq. 10).
    """
    wheels = parameters.wheels
    rR, rL, b = wheels.radius_right_m, wheels.radius_left_m, wheels.separation_m
    ahead = parameters.T_h_c[:3, :3] @ np.array([0.0, 0.0, AHEAD_M])
    by_head_eye = np.zeros((3, 9))
    by_head_eye[:, :3] = -np.cross(np.eye(3), ahead)
    by_head_eye[:, 3:6] = np.eye(3)

    def sigma(*gradient: float) -> float:
        g = np.array(gradient)
        return math.sqrt(max(0.0, float(g @ covariance[6:, 6:] @ g)))

    heading = sigma(1 / (rR * b), -1 / (rL * b), 0.0)
    return Predicted(
        camera_m=math.sqrt(float(np.trace(covariance[3:6, 3:6]))),
        camera_rad=math.sqrt(float(np.trace(covariance[:3, :3]))),
        point_m=math.sqrt(float(np.trace(by_head_eye @ covariance @ by_head_eye.T))),
        along_m_per_m=sigma(0.5 / rR, 0.5 / rL, 0.0),
        heading_rad_per_m=heading,
        sideways_m_per_m=heading / 2,
        heading_rad_per_turn=2 * math.pi * sigma(0.5 / rR, 0.5 / rL, -1 / b),
    )
