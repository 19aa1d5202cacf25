"""Acceptance checks of detected corners: a whole checkerboard of the expected size, in focus.

The checks use the brightness of the squares, so they share no assumption with the detector.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from math import erf, sqrt

import cv2
import numpy as np

from mobilecal_cli.model import BoolArray, FloatArray, GrayImage
from mobilecal_cli.vision.grid_map import GridMap, Places, places
from mobilecal_cli.vision.values import Miss

# Outer squares are sampled near the corners, because printed boards often have narrow ones.
_OUTER = 0.24
_WHOLE = 0.6
_SPREAD = 0.12
_WEAKEST = 0.15  # least contrast of a pair of neighbors, as a share of the board's
_BEYOND = 0.35  # contrast from which a pair beyond the outer squares counts as part of a board
_MIN_CONTRAST_GREY = 4.0
_NOISE_FACTOR = 5.0
MAX_EDGE_WIDTH = 0.6  # of a square, 10 to 90 %
# Distances from the borders for the sharpness check, in squares, and the contrast ratio there for each blur
# sigma.
_NEAR, _FAR = 0.15, 0.38
_SIGMAS = np.linspace(0.02, 1.0, 99)
_RATIOS = np.array([erf(_NEAR / (s * sqrt(2))) / erf(_FAR / (s * sqrt(2))) for s in _SIGMAS])


def sample(image: GrayImage, pixels: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Interpolate brightness: (..., 2) px → (...) whole gray levels, and which points are in the image."""
    height, width = image.shape
    at = pixels.astype(np.float32)
    x, y = at[..., 0], at[..., 1]
    inside = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    shape = (-1, 1)  # one column, because OpenCV limits the image width to 32,767
    grey = cv2.remap(
        image, x.reshape(shape), y.reshape(shape), cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
    )
    return np.asarray(grey.reshape(x.shape), dtype=np.float64), inside


def _centres(count: int, outer: float) -> FloatArray:
    """Sampling positions along an axis of `count` corners; the outer ones are `outer` beyond the corners."""
    return np.concatenate([[-outer], np.arange(count - 1) + 0.5, [count - 1 + outer]])


def _around(u: FloatArray, v: FloatArray) -> FloatArray:
    """Nine positions in each square at u x v, (len(v), len(u), 9, 2)."""
    offset = _SPREAD * np.array([-1.0, 0.0, 1.0])
    du, dv = np.meshgrid(offset, offset)
    uu, vv = np.meshgrid(u, v)
    return np.stack([uu[..., None] + du.ravel(), vv[..., None] + dv.ravel()], axis=-1)


@dataclass(frozen=True, slots=True, eq=False)
class _Probes:
    """Sampling positions for boards of one size.

    Attributes:
        squares: all squares, the outer ones near the corners, then four lines of squares beyond the board.
        whole: all squares, the outer ones at `_WHOLE`.
        borders: for each axis, positions on both sides of the borders, near and far.
        lines: side → start and end of its squares among those beyond the board, and the parity of the first.
    """

    squares: Places
    whole: Places
    borders: tuple[Places, Places]
    lines: dict[str, tuple[int, int, int]]


@lru_cache(maxsize=64)
def _probes(columns: int, rows: int) -> _Probes:
    u, v = _centres(columns, _OUTER), _centres(rows, _OUTER)
    beyond = {
        "left": (np.array([-1 - _OUTER]), v, -1),
        "right": (np.array([columns + _OUTER]), v, columns + 1),
        "upper": (u, np.array([-1 - _OUTER]), -1),
        "lower": (u, np.array([rows + _OUTER]), rows + 1),
    }
    parts, lines, begin = [_around(u, v).reshape(-1, 9, 2)], {}, 0
    for side, (line_u, line_v, index) in beyond.items():
        parts.append(_around(line_u, line_v).reshape(-1, 9, 2))
        lines[side] = (begin, begin + len(parts[-1]), index)
        begin += len(parts[-1])
    borders = []
    for axis in (0, 1):
        # Borders across u are sampled midway between two rows of corners, borders across v between two
        # columns.
        along_u = np.arange(columns) if axis == 0 else np.arange(columns - 1) + 0.5
        along_v = np.arange(rows - 1) + 0.5 if axis == 0 else np.arange(rows)
        uv = np.stack(np.meshgrid(along_u, along_v), axis=-1).reshape(-1, 2).astype(np.float64)
        steps = np.array([_NEAR, -_NEAR, _FAR, -_FAR])[:, None, None] * np.eye(2)[axis]
        borders.append(places(uv + steps, columns, rows))
    whole = _around(_centres(columns, _WHOLE), _centres(rows, _WHOLE))
    squares = places(np.concatenate(parts), columns, rows)
    return _Probes(squares, places(whole, columns, rows), (borders[0], borders[1]), lines)


def _squares(image: GrayImage, grid_map: GridMap, where: Places) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Mean brightness, scatter, and whether it is fully in the image, of each square; (n,) each."""
    values, inside = sample(image, grid_map.at(where))
    nine = values.reshape(-1, 9)
    return nine.mean(axis=1), nine.std(axis=1), np.all(inside.reshape(-1, 9), axis=1)


@dataclass(frozen=True, slots=True)
class Polarity:
    """Result of the check that dark and light squares alternate.

    Attributes:
        contrast_grey: median difference of neighboring squares, gray levels.
        dark_at_origin: the outer square diagonally next to corner 0 is dark.
    """

    contrast_grey: float
    dark_at_origin: bool


def check_polarity(image: GrayImage, grid_map: GridMap, columns: int, rows: int) -> Polarity | Miss:
    """Check that the squares alternate, including the outer ones, and that the pattern ends there.

    Args:
        image: (height, width) gray.
        grid_map: grid coordinates to pixels.
        columns, rows: inner corners.

    Returns:
        The polarity, or the reason for rejection.
    """
    means, scatters, insides = _squares(image, grid_map, _probes(columns, rows).squares)
    own = (rows + 1) * (columns + 1)
    inside = insides[:own].reshape(rows + 1, columns + 1)
    outside = Miss(
        "board partly occluded or outside the image",
        f"{int(np.sum(~inside))} of the board's {inside.size} squares are outside the image",
    )
    if not inside[1:-1, 1:-1].all():
        return outside
    # A pair with a square outside the image does not count as alternating.
    values, scatter = np.where(inside, means[:own].reshape(inside.shape), np.nan), scatters[:own]
    # Pair i of a row is (square i, square i + 1); its expected sign alternates with the squares.
    j, i = np.indices(values.shape)
    sign = np.where((i + j) % 2 == 0, 1.0, -1.0)
    along_u = sign[:, :-1] * (values[:, :-1] - values[:, 1:])
    along_v = sign[:-1] * (values[:-1] - values[1:])
    inner_u, inner_v = along_u[1:-1, 1:-1], along_v[1:-1, 1:-1]
    inner = np.concatenate([inner_u.ravel(), inner_v.ravel()])
    flip = 1.0 if np.median(inner) > 0 else -1.0
    contrast = float(np.median(np.abs(inner)))
    noise = float(np.median(scatter)) / 3
    least = max(_MIN_CONTRAST_GREY, _NOISE_FACTOR * noise)
    if contrast < least:
        return Miss(
            "square colors do not alternate",
            f"contrast between neighboring squares {contrast:.1f} gray levels, minimum {least:.1f}",
        )
    wrong = int(np.sum(flip * inner < _WEAKEST * contrast))
    if wrong:
        return Miss(
            "square colors do not alternate",
            f"{wrong} of {inner.size} pairs of neighboring inner squares do not alternate",
        )
    sides = {
        "left": (along_v[:, 0], along_u[:, 0]),
        "right": (along_v[:, -1], along_u[:, -1]),
        "upper": (along_u[0], along_v[0]),
        "lower": (along_u[-1], along_v[-1]),
    }
    for side, parts in sides.items():
        pairs = flip * np.concatenate(parts)
        good = pairs >= _WEAKEST * contrast
        if good.mean() < 0.75:
            if np.mean(good | np.isnan(pairs)) >= 0.75:
                return outside
            return Miss(
                "board partly occluded or outside the image",
                f"{int(np.sum(~good))} of {good.size} pairs of outer squares on the {side} side do not alternate",
            )
    beyond = _goes_on(means[own:], insides[own:], columns, rows, flip * contrast)
    if beyond is not None:
        return beyond
    return Polarity(contrast, dark_at_origin=flip < 0)


def _goes_on(values: FloatArray, inside: BoolArray, columns: int, rows: int, contrast: float) -> Miss | None:
    """Check that the pattern does not alternate along a line one square beyond the outer squares."""
    for side, (begin, end, index) in _probes(columns, rows).lines.items():
        line, seen = values[begin:end], inside[begin : end - 1] & inside[begin + 1 : end]
        sign = np.where((np.arange(len(line)) + index) % 2 == 0, 1.0, -1.0)
        pair = sign[:-1] * (line[:-1] - line[1:]) / contrast
        if np.sum(seen) >= 3 and np.mean(pair[seen] > _BEYOND) >= 0.6:
            return Miss(
                "board extends beyond the grid",
                f"{int(np.sum(pair[seen] > _BEYOND))} of {int(np.sum(seen))} pairs of squares beyond the "
                f"{columns} x {rows} grid on the {side} side alternate",
            )
    return None


def outer_squares_whole(image: GrayImage, grid_map: GridMap, columns: int, rows: int) -> bool:
    """Whether the outer squares are as wide as the others: a board with narrow ones has its margin here."""
    means, _, inside = _squares(image, grid_map, _probes(columns, rows).whole)
    values = means.reshape(rows + 1, columns + 1)
    j, i = np.indices(values.shape)
    signed = np.where((i + j) % 2 == 0, 1.0, -1.0) * values
    inner = signed[1:-1, 1:-2] + signed[1:-1, 2:-1]
    contrast = float(np.median(inner))
    lines = signed[0], signed[-1], signed[:, 0], signed[:, -1]
    ring = np.concatenate([line[1:] + line[:-1] for line in lines])
    return bool(inside.all() and np.all(ring * np.sign(contrast) > 0.5 * abs(contrast)))


def edge_width(image: GrayImage, grid_map: GridMap, columns: int, rows: int) -> float:
    """Median width of the borders between squares (10 to 90 %), of the worse axis, in squares.

    For a step blurred by a Gaussian of sigma s, the difference across a border at distance d is proportional
    to erf(d / (s sqrt(2))); the ratio at two distances gives s.
    """
    widths = []
    for where in _probes(columns, rows).borders:
        ahead_near, behind_near, ahead_far, behind_far = sample(image, grid_map.at(where))[0].reshape(4, -1)
        near, far = np.abs(ahead_near - behind_near), np.abs(ahead_far - behind_far)
        ratio = float(np.median(near / np.maximum(far, 1.0)))
        widths.append(float(np.interp(-ratio, -_RATIOS, _SIGMAS)))
    return 2.563 * max(widths)


def check_sharpness(image: GrayImage, grid_map: GridMap, columns: int, rows: int) -> Miss | None:
    """A Miss if the borders between squares are too wide for accurate corners, None otherwise."""
    width = edge_width(image, grid_map, columns, rows)
    if width <= MAX_EDGE_WIDTH:
        return None
    return Miss("blurred", f"borders are {width:.2f} squares wide (10 to 90 %), limit {MAX_EDGE_WIDTH}")
