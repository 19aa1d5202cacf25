"""Whether corners are those of a whole board of the expected size, in focus.

Positions are judged by the fit of the corners; blur, colors and the extent of the pattern by the brightness of the
squares, which shares no assumption with the detectors.
"""

from __future__ import annotations

from functools import lru_cache
from math import erf, sqrt

import cv2
import numpy as np

from mobilecal_cli.model.arrays import BoolArray, FloatArray, GrayImage, IntArray
from mobilecal_cli.model.signals import Reason
from mobilecal_cli.vision.corner_model import FittedCorners, fit_corners, upper_median
from mobilecal_cli.vision.grid import smallest_edge_px
from mobilecal_cli.vision.grid_map import GridMap, fit_grid
from mobilecal_cli.vision.values import FLOOR_PX, Appearance, Detection, Miss

MIN_EDGE_PX = 7.0  # detectors are unreliable below, and the refinement window becomes too small
# A corner may be off the grid of the others by a share of a square, but not by many times the usual distance.
_LEAST_OFF_PX, _MOST_OFF, _MOST_OFF_TIMES = 0.6, 0.12, 12.0
_MOST_BAD = 0.2  # share of the corners that the others can predict
_MOST_EDGE_WIDTH = 0.6  # of a square, 10 to 90 %
_WIDTH_PER_SIGMA = 2.563  # distance from 10 to 90 % of a step with a Gaussian blur
# Distances from a border between squares, in squares; the ratio of the differences there for each blur, in squares.
_NEAR, _FAR = 0.15, 0.38
_SIGMAS = np.linspace(0.02, 1.0, 99)
_RATIOS = np.array([erf(_NEAR / (s * sqrt(2))) / erf(_FAR / (s * sqrt(2))) for s in _SIGMAS])
# Distance of the samples of an outer square from its corners, in squares: near, because printed boards often have
# narrow outer squares; and where those of a board with whole ones end.
_NEAR_OUTER, _WHOLE_OUTER = 0.24, 0.6
_SPREAD = 0.12  # distance of the nine samples in a square, in squares
_WEAKEST = 0.15  # least contrast of a pair of neighbors, as a share of the board's
_BEYOND = 0.35  # contrast from which a pair beyond the outer squares counts as part of a board
_MIN_CONTRAST_GREY, _NOISE_FACTOR = 4.0, 5.0  # least contrast, and the same in sigmas of a square's mean


def check_size(grid: FloatArray) -> Miss | None:
    """A Miss if the squares of (rows, columns, 2) corners are too small, None otherwise."""
    edge_px = smallest_edge_px(grid)
    if edge_px >= MIN_EDGE_PX:
        return None
    return Miss(Reason.TOO_SMALL, f"smallest square {edge_px:.1f} px, minimum {MIN_EDGE_PX:.0f} px")


def _limit_px(grid_map: GridMap) -> float:
    """Largest distance of a corner from the smooth map through the others, px; see `GridMap.off_px`."""
    usual_px = upper_median(grid_map.off_px.ravel())
    return max(_LEAST_OFF_PX, min(_MOST_OFF * smallest_edge_px(grid_map.corners), _MOST_OFF_TIMES * usual_px))


def fit_board(image: GrayImage, grid: FloatArray, appearance: Appearance) -> tuple[FittedCorners, GridMap]:
    """Fit all corners of a board; bad ones twice, from where the others predict them.

    Args:
        image, grid, appearance: see `fit_corners`.

    Returns:
        The corners, and the smooth map through them.
    """
    fit = fit_corners(image, grid, appearance)
    # Where most corners are not corners, no lens would make them a board.
    is_board = np.mean(fit.fitted) >= 1 - _MOST_BAD
    grid_map = fit_grid(fit.pixels.reshape(grid.shape), image.shape if is_board else None)
    bad = (grid_map.off_px > _limit_px(grid_map)) | ~fit.fitted.reshape(grid_map.shape)
    if not 0 < np.mean(bad) <= _MOST_BAD:
        return fit, grid_map
    again = fit_corners(image, grid_map.predicted(bad), appearance)
    return again, fit_grid(again.pixels.reshape(grid.shape), image.shape)


def accepted(
    fit: FittedCorners, grid_map: GridMap, expected: Appearance, order: IntArray | slice = slice(None)
) -> Detection | Miss:
    """The board in an image; a Miss if a corner is not fitted or off the grid of the others.

    Args:
        fit, grid_map: see `fit_board`.
        expected: with the sign of the contrast, and with the outer squares, of this image.
        order: of the corners.
    """
    worst_px, most_px = float(grid_map.off_px.max()), _limit_px(grid_map)
    if worst_px > most_px:
        return Miss(Reason.IRREGULAR, f"worst corner {worst_px:.2f} px, limit {most_px:.2f} px")
    if not fit.fitted.all():
        return Miss(
            Reason.IRREGULAR,
            f"{int(np.sum(~fit.fitted))} of {fit.fitted.size} corners do not look like corners of squares",
        )
    half_grey = float(np.copysign(upper_median(np.abs(fit.contrast_grey)), expected.contrast_grey))
    appearance = Appearance(fit.blur_px, fit.noise_grey, half_grey, expected.outer_whole)
    sigma_px = max(grid_map.sigma_px, FLOOR_PX)
    return Detection(fit.pixels[order], sigma_px, cov=fit.cov[order], appearance=appearance)


@lru_cache(maxsize=32)
def colors(rows: int, columns: int) -> FloatArray:
    """1 and -1 in a checkerboard pattern, (rows, columns)."""
    j, i = np.indices((rows, columns))
    return np.where((i + j) % 2 == 0, 1.0, -1.0)


def sample(image: GrayImage, pixels: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Interpolate brightness: (..., 2) px → (...) whole gray levels, and which points are in the image."""
    height, width = image.shape
    at = pixels.astype(np.float32)
    x, y = at[..., 0], at[..., 1]
    inside = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    shape = (-1, 1)  # one column, because OpenCV limits the image width to 32,767
    gray = cv2.remap(
        image, x.reshape(shape), y.reshape(shape), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(gray.reshape(x.shape), dtype=np.float64), inside


@lru_cache(maxsize=64)
def _across(columns: int, rows: int, axis: int) -> FloatArray:
    """Grid coordinates ahead of and behind the borders across an axis, (near or far, ahead or behind, n, 2).

    The borders across u are sampled midway between two rows of corners, those across v between two columns.
    """
    counts = [columns, rows]
    along = [np.arange(n) if k == axis else np.arange(n - 1) + 0.5 for k, n in enumerate(counts)]
    uv = np.stack(np.meshgrid(*along), axis=-1).reshape(-1, 2)
    return np.asarray(uv + np.array([[_NEAR, -_NEAR], [_FAR, -_FAR]])[..., None, None] * np.eye(2)[axis])


def check_sharpness(image: GrayImage, grid_map: GridMap) -> Miss | None:
    """A Miss if the borders between squares are too wide for accurate corners, None otherwise.

    For a step blurred by a Gaussian of sigma s, the difference across a border at distance d is proportional
    to erf(d / (s sqrt(2))); the ratio at two distances gives s. The blurrier axis counts.
    """
    (rows, columns), widths = grid_map.shape, []
    for axis in (0, 1):
        brightness = sample(image, grid_map(_across(columns, rows, axis)))[0]
        near, far = np.abs(brightness[:, 0] - brightness[:, 1])
        ratio = float(np.median(near / np.maximum(far, 1.0)))
        widths.append(_WIDTH_PER_SIGMA * float(np.interp(-ratio, -_RATIOS, _SIGMAS)))
    if max(widths) <= _MOST_EDGE_WIDTH:
        return None
    return Miss(
        Reason.BLURRED, f"borders are {max(widths):.2f} squares wide (10 to 90 %), limit {_MOST_EDGE_WIDTH}"
    )


@lru_cache(maxsize=64)
def _samples(columns: int, rows: int, outer: float, beyond: int) -> FloatArray:
    """Nine grid coordinates in each square, (rows + 1 + 2 beyond, columns + 1 + 2 beyond, 9, 2).

    Args:
        outer: distance of the middle of an outer square's samples from the corners.
        beyond: number of lines of squares beyond the board, each one square further.
    """
    lines = [
        np.concatenate(
            [np.arange(-beyond, 1) - outer, np.arange(n - 1) + 0.5, n - 1 + outer + np.arange(beyond + 1)]
        )
        for n in (columns, rows)
    ]
    middle = np.stack(np.meshgrid(*lines), axis=-1)
    offset = _SPREAD * np.array([-1.0, 0.0, 1.0])
    return np.asarray(middle[:, :, None] + np.stack(np.meshgrid(offset, offset), axis=-1).reshape(9, 2))


def check_colors(image: GrayImage, grid_map: GridMap) -> bool | Miss:
    """Check that dark and light squares alternate, including the outer ones, and that the pattern ends there.

    Args:
        image: (height, width) gray.
        grid_map: grid coordinates to pixels.

    Returns:
        Whether the outer square diagonally next to corner 0 is dark, or the reason for rejection.
    """
    rows, columns = grid_map.shape
    brightness, in_image = sample(image, grid_map(_samples(columns, rows, _NEAR_OUTER, 1)))
    inside = np.asarray(in_image.all(axis=-1))
    board = inside[1:-1, 1:-1]
    outside = Miss(
        Reason.OCCLUDED,
        f"{int(np.sum(~board))} of the board's {board.size} squares are outside the image",
    )
    if not board[1:-1, 1:-1].all():
        return outside
    # A pair of neighbors has the sum of their signed brightness; with a square outside the image, it is NaN.
    signed = colors(*inside.shape) * np.where(inside, brightness.mean(axis=-1), np.nan)
    along_u, along_v = signed[:, :-1] + signed[:, 1:], signed[:-1] + signed[1:]
    inner = np.concatenate([along_u[2:-2, 2:-2].ravel(), along_v[2:-2, 2:-2].ravel()])
    flip = 1.0 if np.median(inner) > 0 else -1.0
    contrast = float(np.median(np.abs(inner)))
    noise = float(np.median(brightness[1:-1, 1:-1].std(axis=-1))) / 3
    least = max(_MIN_CONTRAST_GREY, _NOISE_FACTOR * noise)
    if contrast < least:
        return Miss(
            Reason.COLORS,
            f"contrast between neighboring squares {contrast:.1f} gray levels, minimum {least:.1f}",
        )
    wrong = int(np.sum(flip * inner < _WEAKEST * contrast))
    if wrong:
        return Miss(
            Reason.COLORS,
            f"{wrong} of {inner.size} pairs of neighboring inner squares do not alternate",
        )
    # From the outside: pairs beyond the board, those along its outer squares, and from these to the inner ones.
    u, v = along_u[:, 1:-1], along_v[1:-1]
    sides = {
        "left": (v[:, 0], v[:, 1], along_u[1:-1, 1]),
        "right": (v[:, -1], v[:, -2], along_u[1:-1, -2]),
        "upper": (u[0], u[1], along_v[1, 1:-1]),
        "lower": (u[-1], u[-2], along_v[-2, 1:-1]),
    }
    for side, (_, *outer) in sides.items():
        pairs = flip * np.concatenate(outer)
        good = pairs >= _WEAKEST * contrast
        if good.mean() < 0.75:
            if np.mean(good | np.isnan(pairs)) >= 0.75:
                return outside
            return Miss(
                Reason.OCCLUDED,
                f"{int(np.sum(~good))} of {good.size} pairs of outer squares on the {side} side do not alternate",
            )
    for side, (beyond, *_) in sides.items():
        pairs = flip * beyond[np.isfinite(beyond)]
        goes_on = int(np.sum(pairs > _BEYOND * contrast))
        if len(pairs) >= 3 and goes_on >= 0.6 * len(pairs):
            return Miss(
                Reason.LARGER,
                f"{goes_on} of {len(pairs)} pairs of squares beyond the {columns} x {rows} grid on the {side} "
                "side alternate",
            )
    return flip < 0


def outer_squares_whole(image: GrayImage, grid_map: GridMap) -> bool:
    """Whether the outer squares are as wide as the others: a board with narrow ones has its margin here."""
    rows, columns = grid_map.shape
    brightness, inside = sample(image, grid_map(_samples(columns, rows, _WHOLE_OUTER, 0)))
    signed = colors(rows + 1, columns + 1) * brightness.mean(axis=-1)
    contrast = float(np.median(signed[1:-1, 1:-2] + signed[1:-1, 2:-1]))
    lines = signed[0], signed[-1], signed[:, 0], signed[:, -1]
    ring = np.concatenate([line[1:] + line[:-1] for line in lines])
    return bool(inside.all() and np.all(ring * np.sign(contrast) > 0.5 * abs(contrast)))
