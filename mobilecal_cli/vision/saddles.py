"""Saddle response of an image: a fast test for a checkerboard before the search.

A checkerboard corner is a saddle point of brightness: the determinant of the second derivatives is negative.
All corners of a board have a similar response, and few images without a board have as many strong saddle
points.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import ArrayLike

from mobilecal_cli.model import GrayImage
from mobilecal_cli.vision.values import Single

_LARGE = 1280  # image width from which a quarter of the size is enough, px
_BLUR = (5, 5), 1.0  # px; removes noise but keeps the corners of 7 px squares
_WORTH = 0.02  # share of the strongest response; usually 1 % of the peaks exceed it, the others are noise
_NEIGHBOURS = np.ones((3, 3), np.uint8)


def saddle_response(image: GrayImage, count: int) -> float:
    """Response of the count-th strongest saddle point, 0 if there are fewer.

    Args:
        image: (height, width) gray.
        count: number of corners of the board.

    Returns:
        Negative determinant of the second derivatives at reduced size, in arbitrary units: only for
        comparison with other images.
    """
    saddle = _saddle(image)
    peaks = _peaks(saddle, _WORTH * float(saddle.max()))
    if len(peaks) < count:
        peaks = _peaks(saddle, 0.0)
    if len(peaks) < count:
        return 0.0
    return float(np.partition(peaks, len(peaks) - count)[len(peaks) - count])


def has_saddle_points(image: GrayImage, count: int, least: float) -> bool:
    """Whether `saddle_response` exceeds a limit; faster than computing it."""
    saddle = _saddle(image)
    return bool(np.count_nonzero(saddle > least) >= count) and len(_peaks(saddle, least)) >= count


def _saddle(image: GrayImage) -> Single:
    """Negative determinant of the second derivatives of an image at reduced size."""
    scale = 0.25 if image.shape[1] >= _LARGE else 0.5
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    small = cv2.GaussianBlur(small, *_BLUR)
    saddle = _derivative(small, 1, 1)
    saddle *= saddle
    straight = _derivative(small, 2, 0)
    straight *= _derivative(small, 0, 2)
    saddle -= straight
    return saddle


def _derivative(image: ArrayLike, by_x: int, by_y: int) -> Single:
    return np.asarray(cv2.Sobel(np.asarray(image), cv2.CV_32F, by_x, by_y, ksize=3), dtype=np.float32)


def _peaks(saddle: Single, least: float) -> Single:
    """Local maxima above a limit."""
    neighbours: Single = np.asarray(cv2.dilate(saddle, _NEIGHBOURS), dtype=np.float32)
    return np.asarray(saddle[(saddle > least) & (saddle == neighbours)])
