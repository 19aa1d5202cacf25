"""How much in a picture looks like corners of a checkerboard: the cheap question before a search.

A corner of a checkerboard is a saddle: the determinant of the second derivatives is negative there. On a board all
are about equally strong, so that many strong ones hardly occur without one.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import ArrayLike

from mobilecal_cli.model import GrayImage
from mobilecal_cli.vision.values import Single

_LARGE = 1280  # px of width from which a quarter of the size is enough
_BLUR = (5, 5), 1.0  # px; takes noise out, and leaves squares of 7 px their corners
_WORTH = 0.02  # of the strongest; mostly a hundredth of all peaks are above it, the others are noise
_NEIGHBOURS = np.ones((3, 3), np.uint8)


def spot_strength(image: GrayImage, count: int) -> float:
    """Strength of the count-th strongest saddle of brightness, 0 where there are fewer.

    Args:
        image: (height, width) grey.
        count: corners of the board that is looked for.

    Returns:
        Minus the determinant there, at reduced size, in units of its own: to be compared with other pictures' only.
    """
    saddle = _saddle(image)
    peaks = _peaks(saddle, _WORTH * float(saddle.max()))
    if len(peaks) < count:
        peaks = _peaks(saddle, 0.0)
    if len(peaks) < count:
        return 0.0
    return float(np.partition(peaks, len(peaks) - count)[len(peaks) - count])


def has_spots(image: GrayImage, count: int, least: float) -> bool:
    """Whether `spot_strength` is above some strength, in less time."""
    saddle = _saddle(image)
    return bool(np.count_nonzero(saddle > least) >= count) and len(_peaks(saddle, least)) >= count


def _saddle(image: GrayImage) -> Single:
    """Minus the determinant of the second derivatives of a picture at reduced size."""
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
    """Those values above some strength that no neighbour surpasses."""
    neighbours: Single = np.asarray(cv2.dilate(saddle, _NEIGHBOURS), dtype=np.float32)
    return np.asarray(saddle[(saddle > least) & (saddle == neighbours)])
