"""R and P of the camera_info of a stereo pair."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import cv2
import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.model import FloatArray, Side, StereoRig


@dataclass(frozen=True, slots=True, eq=False)
class RectifiedPair:
    """Rectification of a stereo pair.

    Attributes:
        R: side → (3, 3) raw to rectified coordinates.
        P: side → (3, 4) projection of rectified coordinates, px.
    """

    R: Mapping[Side, FloatArray]
    P: Mapping[Side, FloatArray]


def rectified_pair(cameras: StereoRig) -> RectifiedPair:
    """Rectification of raw cameras by Bouguet's method (OpenCV, alpha 0: only valid pixels)."""
    T_r_c = se3.inverse(cameras.T_c_r)
    R, t = np.ascontiguousarray(T_r_c[:3, :3]), np.ascontiguousarray(T_r_c[:3, 3:])
    left, right = cameras.left, cameras.right
    size = (left.width, left.height)
    if left.distortion == "equidistant":
        R1, R2, P1, P2, _ = cv2.fisheye.stereoRectify(
            left.K, left.D, right.K, right.D, size, R, t, cv2.CALIB_ZERO_DISPARITY
        )
    else:
        R1, R2, P1, P2, *_ = cv2.stereoRectify(left.K, left.D, right.K, right.D, size, R, t, alpha=0)
    as_float = [np.asarray(matrix, dtype=np.float64) for matrix in (R1, R2, P1, P2)]
    return RectifiedPair(
        {"left": as_float[0], "right": as_float[1]}, {"left": as_float[2], "right": as_float[3]}
    )
