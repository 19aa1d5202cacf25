"""Fit of a board's corners, and the rule that accepts them: the same for boards found and boards tracked."""

from __future__ import annotations

import numpy as np

from mobilecal_cli.model import BoolArray, FloatArray, GrayImage
from mobilecal_cli.vision.corner_model import FittedCorners, fit_corners, upper_median
from mobilecal_cli.vision.grid import smallest_edge_px
from mobilecal_cli.vision.grid_map import GridMap, fit_grid
from mobilecal_cli.vision.values import Appearance, Miss

MIN_EDGE_PX = 7.0  # detectors are unreliable below, and the refinement window becomes too small
# A corner may be off the grid of the others by a share of a square, but not by many times the usual distance.
_LEAST_OFF_PX, _MOST_OFF, _MOST_OFF_TIMES = 0.6, 0.12, 12.0
_MOST_BAD = 0.2  # share of the corners that the others can predict


def check_size(grid: FloatArray) -> Miss | None:
    """A Miss if the squares of (rows, columns, 2) corners are too small, None otherwise."""
    edge_px = smallest_edge_px(grid)
    if edge_px >= MIN_EDGE_PX:
        return None
    return Miss("squares too small", f"smallest square {edge_px:.1f} px, minimum {MIN_EDGE_PX:.0f} px")


def limit_px(off_px: FloatArray, edge_px: float) -> float:
    """Largest distance of a corner from the smooth map through the others, px.

    Args:
        off_px: (rows, columns) see `GridMap.off_px`.
        edge_px: shortest distance between corners, px.
    """
    return max(_LEAST_OFF_PX, min(_MOST_OFF * edge_px, _MOST_OFF_TIMES * upper_median(off_px.ravel())))


def off_grid(grid_map: GridMap, edge_px: float) -> BoolArray:
    """(rows, columns) whether a corner is off the grid of the others."""
    off_px = grid_map.off_px
    return np.asarray(off_px > limit_px(off_px, edge_px))


def fit_board(
    image: GrayImage, grid: FloatArray, outer_whole: bool, appearance: Appearance | None = None
) -> tuple[FittedCorners, GridMap]:
    """Fit all corners of a board; bad ones twice, from where the others predict them.

    Args:
        image, grid, outer_whole, appearance: see `fit_corners`.

    Returns:
        The corners, and the smooth map through them.
    """
    fit = fit_corners(image, grid, outer_whole, appearance)
    corners = fit.pixels.reshape(grid.shape)
    # Where most corners are not corners, no lens would make them a board.
    is_board = np.mean(fit.fitted) >= 1 - _MOST_BAD
    grid_map = fit_grid(corners, image.shape if is_board else None)
    bad = off_grid(grid_map, smallest_edge_px(corners)) | ~fit.fitted.reshape(grid.shape[:2])
    if not 0 < np.mean(bad) <= _MOST_BAD:
        return fit, grid_map
    again = fit_corners(image, grid_map.predicted(corners, bad), outer_whole, appearance)
    return again, fit_grid(again.pixels.reshape(grid.shape), image.shape)


def check_grid(fit: FittedCorners, grid_map: GridMap) -> Miss | None:
    """A Miss if a corner is not fitted or off the grid of the others, None otherwise."""
    edge_px = smallest_edge_px(fit.pixels.reshape(grid_map.residual.shape))
    off_px = grid_map.off_px
    worst_px, most_px = float(off_px.max()), limit_px(off_px, edge_px)
    if worst_px > most_px:
        return Miss(
            "corners not on a regular grid", f"worst corner {worst_px:.2f} px, limit {most_px:.2f} px"
        )
    if not fit.fitted.all():
        return Miss(
            "corners not on a regular grid",
            f"{int(np.sum(~fit.fitted))} of {fit.fitted.size} corners do not look like corners of squares",
        )
    return None
