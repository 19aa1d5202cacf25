"""Sub-pixel refinement of corners by image gradients: the start of the corner model's fit."""

from __future__ import annotations

import cv2
import numpy as np

from mobilecal_cli.model import FloatArray, GrayImage

# Half windows in units of the shortest edge. Printed boards often have narrow outer squares, and a window
# that extends beyond them biases the corner by pixels.
_NARROW = 0.28
_WIDE = 0.45
_MIN_HALF, _MAX_HALF = 2, 11  # of a window, px: enough gradients, and what a corner's surroundings may cost
# Iterations, and the last step, px. A tracked board is near its corners, and the fit of the model goes on from there.
_FINE, _COARSE = (60, 1e-4), (10, 0.05)


def refine(
    image: GrayImage, pixels: FloatArray, edge_px: float, wide: bool = False, tracked: bool = False
) -> FloatArray:
    """Refine corners by the gradients in a window (Foerstner and Guelch 1987, as iterated by OpenCV).

    Args:
        image: (height, width) gray.
        pixels: (..., 2) in the image, px.
        edge_px: shortest distance between corners, px.
        wide: the window may reach nearly to the middle of the squares next to a corner: all are whole.
        tracked: the corners were predicted well; saves time.

    Returns:
        (..., 2) px.
    """
    half = min(max(round((_WIDE if wide else _NARROW) * edge_px - 0.5), _MIN_HALF), _MAX_HALF)
    until = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, *(_COARSE if tracked else _FINE))
    start = np.ascontiguousarray(pixels, dtype=np.float32).reshape(-1, 1, 2)
    refined = cv2.cornerSubPix(image, start, (half, half), (-1, -1), until)
    return np.asarray(refined.reshape(pixels.shape), dtype=np.float64)


def refine_widely(image: GrayImage, grid: FloatArray, edge_px: float, outer_whole: bool) -> FloatArray:
    """Refine the corners (rows, columns, 2) of a whole board again with a wide window, where it fits the squares."""
    refined = grid.copy()
    part = refined if outer_whole else refined[1:-1, 1:-1]
    if part.size:
        part[:] = refine(image, part, edge_px, wide=True)
    return refined
