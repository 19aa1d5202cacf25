"""The gate behind the detector: are these corners a whole chessboard, and nothing but it?

Looks at the picture's brightness on the grid itself, so it shares no assumption with the detector.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import erf

from mobilecal_cli.model import BoolArray, FloatArray, GrayImage
from mobilecal_cli.vision.grid import GridMap
from mobilecal_cli.vision.values import Miss

# The outer squares are sampled near the corners, because printed boards often have them narrower than the rest.
_OUTER = 0.24
_WHOLE = 0.6
_SPREAD = 0.12
_WEAKEST = 0.15  # least contrast of a pair of neighbours, in units of the board's
_BEYOND = 0.35  # contrast that a pair beyond the outer squares needs to count as board
_MIN_CONTRAST_GREY = 4.0
_NOISE_FACTOR = 5.0
_MAX_EDGE_WIDTH = 0.6  # of a square, 10 to 90 %


def sample(image: GrayImage, pixels: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Brightness by bilinear interpolation: (..., 2) px → (...) grey, and which lie in the picture."""
    height, width = image.shape
    x, y = pixels[..., 0], pixels[..., 1]
    inside = (x >= 0) & (x <= width - 1) & (y >= 0) & (y <= height - 1)
    x, y = np.where(inside, x, 0.0), np.where(inside, y, 0.0)
    i = np.minimum(x.astype(np.intp), width - 2)
    j = np.minimum(y.astype(np.intp), height - 2)
    fx, fy = x - i, y - j
    top = image[j, i] * (1 - fx) + image[j, i + 1] * fx
    bottom = image[j + 1, i] * (1 - fx) + image[j + 1, i + 1] * fx
    return top * (1 - fy) + bottom * fy, inside


def _centres(count: int, outer: float) -> FloatArray:
    """Where squares are sampled along one axis of `count` corners: the outer ones `outer` past the last corner."""
    return np.concatenate([[-outer], np.arange(count - 1) + 0.5, [count - 1 + outer]])


def _square_means(
    image: GrayImage, grid_map: GridMap, u: FloatArray, v: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray]:
    """Mean brightness of squares at u x v: (len(v), len(u)) means, scatter inside a square, wholly in the picture."""
    offset = _SPREAD * np.array([-1.0, 0.0, 1.0])
    du, dv = np.meshgrid(offset, offset)
    uu, vv = np.meshgrid(u, v)
    uv = np.stack([uu[..., None] + du.ravel(), vv[..., None] + dv.ravel()], axis=-1)
    values, inside = sample(image, grid_map(uv))
    return values.mean(axis=-1), values.std(axis=-1), np.all(inside, axis=-1, keepdims=True)[..., 0]


@dataclass(frozen=True, slots=True)
class Polarity:
    """How the squares alternate.

    Attributes:
        contrast_grey: median difference of neighbouring squares.
        dark_at_origin: the outer square diagonally next to corner 0 is dark.
    """

    contrast_grey: float
    dark_at_origin: bool


def check_polarity(image: GrayImage, grid_map: GridMap, columns: int, rows: int) -> Polarity | Miss:
    """Squares must alternate, the ring of outer ones included, and must not go on beyond that ring.

    Args:
        image: (height, width) grey.
        grid_map: grid to picture.
        columns, rows: inner corners.

    Returns:
        The polarity, or why not.
    """
    values, scatter, inside = _square_means(
        image, grid_map, _centres(columns, _OUTER), _centres(rows, _OUTER)
    )
    if not inside.all():
        return Miss(
            "board partly hidden or cut off by the border",
            f"{int(np.sum(~inside))} of the board's {inside.size} squares reach out of the picture",
        )
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
            "board polarity does not alternate",
            f"contrast between neighbouring squares {contrast:.1f} grey levels, need {least:.1f}",
        )
    wrong = int(np.sum(flip * inner < _WEAKEST * contrast))
    if wrong:
        return Miss(
            "board polarity does not alternate",
            f"{wrong} of {inner.size} pairs of neighbouring inner squares do not alternate",
        )
    sides = {
        "left": (along_v[:, 0], along_u[:, 0]),
        "right": (along_v[:, -1], along_u[:, -1]),
        "upper": (along_u[0], along_v[0]),
        "lower": (along_u[-1], along_v[-1]),
    }
    for side, parts in sides.items():
        good = flip * np.concatenate(parts) >= _WEAKEST * contrast
        if good.mean() < 0.75:
            return Miss(
                "board partly hidden or cut off by the border",
                f"{int(np.sum(~good))} of {good.size} outer squares on the grid's {side} side do not alternate",
            )
    beyond = _goes_on(image, grid_map, columns, rows, flip * contrast)
    if beyond is not None:
        return beyond
    return Polarity(contrast, dark_at_origin=flip < 0)


def _goes_on(image: GrayImage, grid_map: GridMap, columns: int, rows: int, contrast: float) -> Miss | None:
    """Does the pattern alternate along a line one square beyond the outer squares?"""
    u, v = _centres(columns, _OUTER), _centres(rows, _OUTER)
    lines = {
        "left": (np.array([-1 - _OUTER]), v, -1),
        "right": (np.array([columns + _OUTER]), v, columns + 1),
        "upper": (u, np.array([-1 - _OUTER]), -1),
        "lower": (u, np.array([rows + _OUTER]), rows + 1),
    }
    for side, (line_u, line_v, index) in lines.items():
        means, _, all_inside = _square_means(image, grid_map, line_u, line_v)
        values, inside = means.ravel(), all_inside.ravel()
        sign = np.where((np.arange(len(values)) + index) % 2 == 0, 1.0, -1.0)
        pair = sign[:-1] * (values[:-1] - values[1:]) / contrast
        seen = inside[:-1] & inside[1:]
        if np.sum(seen) >= 3 and np.mean(pair[seen] > _BEYOND) >= 0.6:
            return Miss(
                "board continues beyond the grid",
                f"{int(np.sum(pair[seen] > _BEYOND))} of {int(np.sum(seen))} pairs of squares beyond the "
                f"{columns} x {rows} grid's {side} side alternate too",
            )
    return None


def outer_squares_whole(image: GrayImage, grid_map: GridMap, columns: int, rows: int) -> bool:
    """Do the outer squares still alternate where a board with narrow ones has its margin?"""
    values, _, inside = _square_means(image, grid_map, _centres(columns, _WHOLE), _centres(rows, _WHOLE))
    j, i = np.indices(values.shape)
    signed = np.where((i + j) % 2 == 0, 1.0, -1.0) * values
    inner = signed[1:-1, 1:-2] + signed[1:-1, 2:-1]
    contrast = float(np.median(inner))
    lines = signed[0], signed[-1], signed[:, 0], signed[:, -1]
    ring = np.concatenate([line[1:] + line[:-1] for line in lines])
    return bool(inside.all() and np.all(ring * np.sign(contrast) > 0.5 * abs(contrast)))


def edge_width(image: GrayImage, grid_map: GridMap, columns: int, rows: int) -> float:
    """Width of the borders between squares, 10 to 90 % of a blurred step, in squares; the worse direction's median.

    Differences across a border at two distances d from it, for a step blurred by a Gaussian of width s, go as
    erf(d / (s sqrt(2))); their ratio gives s.
    """
    near, far = 0.15, 0.38
    sigma = np.linspace(0.02, 1.0, 99)
    ratios = erf(near / (sigma * np.sqrt(2))) / erf(far / (sigma * np.sqrt(2)))
    widths = []
    along = np.arange(columns), np.arange(rows)
    for axis in (0, 1):
        # Borders across u pass midway between two rows of corners, and the other way round.
        u = along[0] if axis == 0 else along[0][:-1] + 0.5
        v = along[1][:-1] + 0.5 if axis == 0 else along[1]
        uv = np.stack(np.meshgrid(u, v), axis=-1).astype(np.float64)
        step = np.eye(2)[axis]
        difference = []
        for d in (near, far):
            ahead, behind = (sample(image, grid_map(uv + s * d * step))[0] for s in (1, -1))
            difference.append(np.abs(ahead - behind))
        ratio = float(np.median(difference[0] / np.maximum(difference[1], 1.0)))
        widths.append(float(np.interp(-ratio, -ratios, sigma)))
    return 2.563 * max(widths)


def check_sharpness(image: GrayImage, grid_map: GridMap, columns: int, rows: int) -> Miss | None:
    """A Miss where the borders between squares are wider than corners can stand."""
    width = edge_width(image, grid_map, columns, rows)
    if width <= _MAX_EDGE_WIDTH:
        return None
    return Miss("blurred", f"borders are {width:.2f} squares wide (10 to 90 %), limit {_MAX_EDGE_WIDTH}")
