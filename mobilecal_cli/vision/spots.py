"""How much in a picture looks like corners of a checkerboard: the cheap question before a search."""

from __future__ import annotations

import cv2
import numpy as np

from mobilecal_cli.model import GrayImage

_LARGE = 1280  # px of width from which a quarter of the size is enough
_BLUR_PX = 1.0  # takes noise out, and leaves squares of 7 px their corners
_NEIGHBOURS = np.ones((3, 3), np.uint8)


def spot_strength(image: GrayImage, count: int) -> float:
    """Strength of the count-th strongest saddle of brightness, 0 where there are fewer.

    A corner of a checkerboard is a saddle: the determinant of the second derivatives is negative there. On a
    board all are about equally strong, so that many strong ones hardly occur without one.

    Args:
        image: (height, width) grey.
        count: corners of the board that is looked for.

    Returns:
        Minus the determinant there, at reduced size, in units of its own: to be compared with other pictures' only.
    """
    scale = 0.25 if image.shape[1] >= _LARGE else 0.5
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    small = cv2.GaussianBlur(small, (0, 0), _BLUR_PX)
    xx = cv2.Sobel(small, cv2.CV_32F, 2, 0, ksize=3)
    yy = cv2.Sobel(small, cv2.CV_32F, 0, 2, ksize=3)
    xy = cv2.Sobel(small, cv2.CV_32F, 1, 1, ksize=3)
    saddle = cv2.subtract(cv2.multiply(xy, xy), cv2.multiply(xx, yy))
    peaks = saddle[(saddle == cv2.dilate(saddle, _NEIGHBOURS)) & (saddle > 0)]
    if len(peaks) < count:
        return 0.0
    return float(np.partition(peaks, len(peaks) - count)[len(peaks) - count])
