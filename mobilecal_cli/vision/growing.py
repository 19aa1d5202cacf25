"""Growth of a grid of any size from a few corners to the edge of the board."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from mobilecal_cli.model import FloatArray, GrayImage
from mobilecal_cli.vision.acceptance import colors, sample
from mobilecal_cli.vision.corner_model import refine
from mobilecal_cli.vision.grid import at_full_size, reduced, right_handed, smallest_edge_px
from mobilecal_cli.vision.grid_map import fit_grid
from mobilecal_cli.vision.values import LARGE_PX

_SEEDS = ((3, 3), (5, 4))  # corners that the seed must have: each finds boards that the other misses
_MIN_EDGE_PX = 4.0  # below, nothing is left of a square's color in its quadrants
_MIN_STRENGTH_GREY = 8.0  # least contrast between quadrants, a few times the noise
_LARGEST = 60  # largest number of corners along one side
_QUADRANT = 0.22  # distance of the samples from a corner along both sides, in squares
_LEAST = 0.3  # least strength of a corner, as a share of the median


@dataclass(frozen=True, slots=True)
class Grown:
    """A grid of corners grown as far as possible.

    Attributes:
        grid: (rows, columns, 2) px, right-handed.
        open_sides: number of sides where the next line of corners is partly visible or outside the image.
    """

    grid: FloatArray
    open_sides: int


def _alternating(grid: FloatArray, image: GrayImage) -> FloatArray:
    """Contrast of the four quadrants around every corner of (rows, columns, 2), gray levels, with the expected sign.

    The smallest difference between neighboring quadrants; 0 if the signs disagree.
    """
    dv, du = np.gradient(grid, axis=(0, 1))
    quadrant = [(-1, -1), (1, -1), (1, 1), (-1, 1)]
    q = [sample(image, grid + _QUADRANT * (a * du + b * dv)) for a, b in quadrant]
    values = np.stack([value for value, _ in q])
    inside = np.all([good for _, good in q], axis=0)
    differences = np.stack([s * (values[i] - values[(i + 1) % 4]) for i, s in enumerate((1, -1, 1, -1))])
    agree = np.all(differences > 0, axis=0) | np.all(differences < 0, axis=0)
    weakest = np.take_along_axis(differences, np.argmin(np.abs(differences), axis=0)[None], axis=0)[0]
    return colors(*grid.shape[:2]) * np.where(agree & inside, weakest, 0.0)


def _trim(grid: FloatArray, image: GrayImage) -> FloatArray | None:
    """Remove outer lines with false corners, worst first; None if too few lines are left."""
    while min(grid.shape[:2]) >= 3:
        strength = _alternating(grid, image)
        median = float(np.median(strength))
        if abs(median) < _MIN_STRENGTH_GREY or smallest_edge_px(grid) < _MIN_EDGE_PX:
            return None
        bad = strength * np.sign(median) < _LEAST * abs(median)
        if not bad.any():
            return grid
        lines = {0: bad[0].mean(), 1: bad[-1].mean(), 2: bad[:, 0].mean(), 3: bad[:, -1].mean()}
        worst = max(lines, key=lambda k: float(lines[k]))
        if lines[worst] == 0:
            return None  # false corners inside the grid
        grid = (grid[1:], grid[:-1], grid[:, 1:], grid[:, :-1])[worst]
    return None


def _next_line(grid: FloatArray, image: GrayImage) -> tuple[FloatArray | None, bool]:
    """The grid extended by one row, or None; and whether part of that row is visible."""
    rows, columns = grid.shape[:2]
    grid_map = fit_grid(grid, image.shape)
    uv = np.stack([np.arange(columns), np.full(columns, rows)], axis=-1).astype(np.float64)
    guess = grid_map(uv)
    height, width = image.shape
    inside = np.all((guess > 2) & (guess < [width - 3, height - 3]), axis=-1)
    edge = float(np.linalg.norm(guess - grid[-1], axis=-1).min())
    if not inside.any() or edge < 3:
        return None, not inside.all()
    line = guess.copy()
    moved = refine(image, guess[inside], min(edge, smallest_edge_px(grid)))
    near = np.linalg.norm(moved - guess[inside], axis=-1) < 0.35 * edge
    line[inside] = np.where(near[:, None], moved, guess[inside])
    longer = np.concatenate([grid, line[None]])
    strength = _alternating(longer, image)
    median = float(np.median(strength[:-1]))
    there = (strength[-1] * np.sign(median) >= _LEAST * abs(median)) & inside
    if there.all():
        return longer, True
    return None, bool(there.mean() >= 0.3 or not inside.all())


def grow(image: GrayImage, seed: FloatArray) -> Grown | None:
    """Remove false outer lines from a grid, then add lines on all four sides while they are fully visible.

    Args:
        image: (height, width) gray.
        seed: (rows, columns, 2) px, corners of any detector, possibly with false ones.
    """
    grid = _trim(right_handed(seed), image)
    if grid is None:
        return None
    grid = refine(image, grid, smallest_edge_px(grid))
    grid = _trim(grid, image)
    if grid is None:
        return None
    open_sides, closed = 0, 0
    while closed < 4 and max(grid.shape[:2]) < _LARGEST:
        longer, partly = _next_line(grid, image)
        if longer is not None:
            grid, open_sides, closed = longer, 0, 0
        else:
            closed += 1
            open_sides += partly
            grid = np.rot90(grid)  # four quarter turns cover all four sides
    return Grown(right_handed(grid), open_sides)


def _seed(image: GrayImage, smallest: tuple[int, int]) -> FloatArray | None:
    """A few corners of any checkerboard, (rows, columns, 2) px, by OpenCV's sector-based detector.

    Its board size and its sub-pixel positions are unreliable; `grow` corrects both.
    """
    picture = reduced(image, 0.5) if image.shape[1] >= LARGE_PX else image
    cv2.setRNGSeed(0)  # the detector draws random samples; a fixed seed makes it repeatable
    complete, corners, meta = cv2.findChessboardCornersSBWithMeta(picture, smallest, cv2.CALIB_CB_LARGER)
    if not complete:
        return None
    grid = np.asarray(corners, dtype=np.float64).reshape(*meta.shape[:2], 2)
    return at_full_size(grid, picture, image)


def grow_any(image: GrayImage, enough: int) -> Grown | None:
    """The largest grid that can be grown in an image; the search ends at `enough` corners."""
    best: Grown | None = None
    for smallest in _SEEDS:
        seed = _seed(image, smallest)
        grown = grow(image, seed) if seed is not None else None
        if grown is not None and (best is None or grown.grid.size > best.grid.size):
            best = grown
        if seed is None or (best is not None and best.grid.size >= 2 * enough):
            break
    return best
