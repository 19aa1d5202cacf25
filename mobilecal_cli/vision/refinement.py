"""Sub-pixel refinement of corners by image gradients."""

from __future__ import annotations

import cv2
import numpy as np

from mobilecal_cli.model import FloatArray, GrayImage

# Half windows in units of the shortest edge. Printed boards often have narrow outer squares, and a window
# that extends beyond them biases the corner by pixels.
_NARROW = 0.28
_WIDE = 0.45
_MIN_HALF, _MAX_HALF = 2, 11
# Smoothing removes the pixel grid from the gradients. It halves the error on images without noise (0.024 to
# 0.015 px rms) and reduces it by a tenth on noisy ones. Small squares allow less smoothing.
_SMOOTHING = 0.075  # of the shortest edge
_FINE = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 60, 1e-4)
_COARSE = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 10, 0.05)
_MIN_SMOOTHING_PX, _MAX_SMOOTHING_PX = 0.6, 0.9


def refine_widely(image: GrayImage, grid: FloatArray, edge_px: float, outer_whole: bool) -> FloatArray:
    """Refine again with a larger window where it fits inside the squares.

    Args:
        image: (height, width) gray.
        grid: (rows, columns, 2) refined corners of a whole board, px.
        edge_px: shortest distance between corners, px.
        outer_whole: the outer squares are about as wide as the others, so that outer corners also allow it.

    Returns:
        (rows, columns, 2) px.
    """
    refined = grid.copy()
    part = refined if outer_whole else refined[1:-1, 1:-1]
    if part.size:
        part[:] = refine(image, part.reshape(-1, 2), edge_px, _WIDE).reshape(part.shape)
    return refined


def refine_once(image: GrayImage, pixels: FloatArray, edge_px: float, outer_whole: bool) -> FloatArray:
    """Refine corners before a model fit: without smoothing, in a single call.

    Args:
        image: (height, width) gray.
        pixels: (M, 2) in the image, px.
        edge_px: shortest distance between corners, px.
        outer_whole: the outer squares are about as wide as the others.

    Returns:
        (M, 2) px.
    """
    half = _half_window(edge_px, _WIDE if outer_whole else _NARROW)
    return _where_gradients_meet(image, pixels, half, _COARSE)


def refine(image: GrayImage, pixels: FloatArray, edge_px: float, window: float = _NARROW) -> FloatArray:
    """Refine corners by the gradients in a window (Foerstner and Guelch 1987, as iterated by OpenCV).
    The window stays inside the squares next to a corner.

    Args:
        image: (height, width) gray.
        pixels: (M, 2) in the image, px.
        edge_px: shortest distance between corners, px.
        window: half width in units of that distance.

    Returns:
        (M, 2) px.
    """
    half = _half_window(edge_px, window)
    smoothing_px = float(np.clip(_SMOOTHING * edge_px, _MIN_SMOOTHING_PX, _MAX_SMOOTHING_PX))
    margin = 2 * half + 4
    height, width = image.shape
    corner = np.maximum(np.floor(pixels.min(axis=0)).astype(int) - margin, 0)
    x0, y0 = corner
    x1, y1 = np.minimum(np.ceil(pixels.max(axis=0)).astype(int) + margin + 1, [width, height])
    part = np.asarray(cv2.GaussianBlur(image[y0:y1, x0:x1], (0, 0), smoothing_px), dtype=np.uint8)
    return np.asarray(_where_gradients_meet(part, pixels - corner, half, _FINE) + corner)


def _half_window(edge_px: float, window: float) -> int:
    return min(max(round(window * edge_px - 0.5), _MIN_HALF), _MAX_HALF)


def _where_gradients_meet(
    image: GrayImage, pixels: FloatArray, half: int, until: tuple[int, int, float]
) -> FloatArray:
    start = np.ascontiguousarray(pixels, dtype=np.float32).reshape(-1, 1, 2)
    refined = cv2.cornerSubPix(image, start, (half, half), (-1, -1), until)
    return np.asarray(refined.reshape(-1, 2), dtype=np.float64)
