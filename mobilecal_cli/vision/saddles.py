"""Saddle points of an image: a fast test for a checkerboard before a search.

A checkerboard corner is a saddle point of brightness: the determinant of the second derivatives is negative. All
corners of a board have a similar response, and few images without a board have as many strong saddle points.
"""

from __future__ import annotations

import cv2
import numpy as np

from mobilecal_cli.model import GrayImage
from mobilecal_cli.vision.grid import reduced
from mobilecal_cli.vision.values import LARGE_PX, Single

_BLUR = (5, 5), 1.0  # px; removes noise but keeps the corners of 7 px squares
_NEIGHBORS = np.ones((3, 3), np.uint8)
_WORTH = 0.02  # share of the strongest response; usually 1 % of the peaks exceed it, the others are noise
_FAINTEST = 0.1  # response of a corner in the same light, as a share of the board's weakest


def may_show_board(image: GrayImage, corners: int, least: float) -> bool:
    """Whether there are as many saddle points with at least this response as the board has corners."""
    return least == 0 or len(_peaks(_responses(image), least)) >= corners


def least_response(image: GrayImage, corners: int) -> float:
    """Response that the corners of a board have in the light of an image that shows one; 0 for any."""
    responses = _responses(image)
    peaks = _peaks(responses, _WORTH * float(responses.max()))
    if len(peaks) < corners:
        return 0.0
    return _FAINTEST * float(np.partition(peaks, len(peaks) - corners)[len(peaks) - corners])


def _responses(image: GrayImage) -> Single:
    """Negative determinant of the second derivatives of an image at reduced size, in arbitrary units."""
    scale = 0.25 if image.shape[1] >= LARGE_PX else 0.5
    small = cv2.GaussianBlur(reduced(image, scale), *_BLUR)
    saddle, by_xx, by_yy = (
        np.asarray(cv2.Sobel(small, cv2.CV_32F, *by, ksize=3), np.float32) for by in ((1, 1), (2, 0), (0, 2))
    )
    saddle *= saddle
    by_xx *= by_yy
    saddle -= by_xx
    return saddle


def _peaks(responses: Single, least: float) -> Single:
    """Local maxima above a limit."""
    peaks: Single = responses[(responses > least) & (responses == cv2.dilate(responses, _NEIGHBORS))]
    return peaks
