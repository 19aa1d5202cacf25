"""Sub-pixel corners by fitting a model of a blurred checkerboard corner to all corners of a board at once.

``I(p) = m + a erf(d1 / (sqrt(2) s)) erf(d2 / (sqrt(2) s)) + g . (p - o)``, where d1 and d2 are the distances
of pixel p from the two edges that intersect at the corner, s is the blur, and g a brightness gradient about
the window's center o. The fit uses every pixel around a corner, not only edge pixels, so its error is near
the Cramer-Rao bound.

The edge directions follow from the corners of the neighbors and are updated in each iteration. By symmetry, a
small error of an edge direction does not move the corner. One Gauss-Newton iteration takes a few array
operations on all windows. `refine` finds the start by image gradients.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from mobilecal_cli.model.arrays import BoolArray, FloatArray, GrayImage, IntArray
from mobilecal_cli.vision.values import Appearance, Single

# Half windows of `refine` in units of the shortest edge. Printed boards often have narrow outer squares, and a window
# that extends beyond them biases the corner by pixels.
_NARROW = 0.28
_WIDE = 0.45
_MIN_HALF, _MAX_HALF = 2, 11  # of a window, px: enough gradients, and what a corner's surroundings may cost
# Iterations, and the last step, px. A tracked board is near its corners, and the fit of the model goes on from there.
_FINE, _COARSE = (60, 1e-4), (10, 0.05)
# Half width of a corner's window in units of the edge: up to the middle of a square, outside the next edge's
# blur. It is smaller toward the outside of the board, because printed boards often have narrow outer squares.
_INNER_REACH, _OUTER_REACH = 0.5, 0.28
_LEAST_HALF_PX, _MOST_HALF_PX = 2, 7  # of a window: for seven unknowns, and for the time that it takes
_MOST_ROUNDS = 5  # two or three are usual
_LEAST_BLUR_PX, _MOST_BLUR_PX = 0.3, 4.0  # a pixel's own width, and that of half a window
_LEAST_PIXELS = 20  # of a corner near the image border, for seven unknowns
_LEAST_CONTRAST_GREY = 4.0  # half of the step from dark to light; a lower contrast is no corner
_LARGEST_MOVE = 0.15  # in units of the edge, from the result of cornerSubPix
_OF_BLUR = 2.0  # times the blur is a marker's edge away
_UNKNOWNS = 7
_STEP_PX, _STEP_BLUR_PX = 1.0, 0.4  # largest step of a corner and of the blur in one iteration
# One iteration leaves about 1/50 of the step (measured: 0.06 sigma of 3). After a step no longer than this,
# in units of sigma, another iteration would reduce the variance by less than 1 %.
_CONVERGED = 6.0
# Approximation of erf(z / sqrt(2)) within 4e-4 by tanh, which is fast in single precision.
_TANH_1 = np.float32(np.sqrt(2 / np.pi))
_TANH_3 = np.float32(0.044715 * np.sqrt(2 / np.pi))
_RIDGE = 1e-6 * np.eye(_UNKNOWNS)
_NO_CONTRAST = 1e-3


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


@dataclass(frozen=True, slots=True, eq=False)
class FittedCorners:
    """Corners of one board after the fit.

    Attributes:
        pixels: (M, 2) px; the initial position where the fit failed.
        cov: (M, 2, 2) covariances, scaled by the residuals of the fit, px^2.
        contrast_grey: (M,) half of the step from dark to light, gray levels; its sign gives the square
            colors.
        fitted: (M,) whether the fit succeeded.
        blur_px: sigma of the edges' blur, px.
        noise_grey: sigma of a pixel, gray levels.
    """

    pixels: FloatArray
    cov: FloatArray
    contrast_grey: FloatArray
    fitted: BoolArray
    blur_px: float
    noise_grey: float | None


def _steps(grid: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Steps to the next corner along a row and along a column, (M, 2) each, by differences of second order."""
    down, along = np.gradient(grid, axis=(0, 1), edge_order=2)
    return along.reshape(-1, 2), down.reshape(-1, 2)


def _normals(along: FloatArray, down: FloatArray) -> FloatArray:
    """(M, 2, 2) unit normals of the edges: row 0 of the one along the board's rows, row 1 of the other."""
    normals = np.empty((len(along), 2, 2))
    normals[:, 0, 0], normals[:, 0, 1] = -along[:, 1], along[:, 0]
    normals[:, 1, 0], normals[:, 1, 1] = down[:, 1], -down[:, 0]
    normals /= np.hypot(normals[..., 0], normals[..., 1])[..., None]
    return normals


@lru_cache(maxsize=16)
def _reach(rows: int, columns: int, outer_whole: bool) -> Single:
    """(M, 2, 1, 2) lower and upper limit of the windows along the normal of each edge, in widths of the squares."""
    reach = np.full((rows, columns, 2, 2), _INNER_REACH, dtype=np.float32)
    if not outer_whole:
        reach[0, :, 0, 0] = reach[-1, :, 0, 1] = reach[:, 0, 1, 0] = reach[:, -1, 1, 1] = _OUTER_REACH
    return reach.reshape(-1, 2, 1, 2) * np.array([-1, 1], dtype=np.float32)


@lru_cache(maxsize=16)
def _offsets(half: int) -> Single:
    """Homogeneous coordinates (x, y, 1) of a window's pixels relative to its center, (3, P), px."""
    reach = np.arange(-half, half + 1, dtype=np.float32)
    x, y = np.meshgrid(reach, reach)
    offsets = np.stack([x.ravel(), y.ravel(), np.ones(x.size, dtype=np.float32)])
    offsets.setflags(write=False)
    return offsets


def _windows(image: GrayImage, middle: IntArray, half: int) -> tuple[NDArray[np.uint8], BoolArray]:
    """Square windows centered on whole pixels, (M, P), and which of their pixels are in the image."""
    side, (height, width) = 2 * half + 1, image.shape
    corner = np.clip(middle - half, -side, [width, height])
    x, y = corner[:, :1] + np.arange(side), corner[:, 1:] + np.arange(side)
    inside = ((y >= 0) & (y < height))[:, :, None] & ((x >= 0) & (x < width))[:, None]
    padded = np.asarray(cv2.copyMakeBorder(image, side, side, side, side, cv2.BORDER_REPLICATE), np.uint8)
    grey = sliding_window_view(padded, (side, side))[corner[:, 1] + side, corner[:, 0] + side]
    return grey.reshape(len(middle), -1), inside.reshape(len(middle), -1)


class _Fit:
    """Windows of all corners, and Gauss-Newton iterations on them.

    The Jacobian columns of the edge shifts and of the blur omit the contrast as a factor. The problem is then
    linear in contrast, mean and gradient, so they need no initial estimate.

    Attributes:
        step, cov: (M, 2) last step of the corners, px, and (M, 2, 2) their covariances, px^2.
        contrast_grey, sigma_grey: (M,) half of the step from dark to light, and sigma of a pixel, gray levels.
    """

    step: FloatArray
    cov: FloatArray
    contrast_grey: FloatArray
    sigma_grey: FloatArray

    def __init__(
        self, image: GrayImage, grid: FloatArray, appearance: Appearance, margin: float | None
    ) -> None:
        self.shape = (grid.shape[0], grid.shape[1])
        self.pixels = grid.reshape(-1, 2)
        along, down = _steps(grid)
        self.edge_px = np.minimum(np.hypot(*along.T), np.hypot(*down.T))
        area = np.abs(along[:, 0] * down[:, 1] - along[:, 1] * down[:, 0])
        width = np.stack([area / np.hypot(*along.T), area / np.hypot(*down.T)], axis=1).astype(np.float32)
        limits = _reach(*self.shape, appearance.outer_whole) * width[:, :, None, None]
        self._lower, self._upper = limits[..., 0], limits[..., 1]
        self._margin = None if margin is None else margin * width[:, :, None] - _OF_BLUR * appearance.blur_px
        extent = _INNER_REACH * float((np.abs(along) + np.abs(down)).max())
        half = min(max(int(np.ceil(extent)), _LEAST_HALF_PX), _MOST_HALF_PX)
        self._middle = np.rint(self.pixels).astype(np.int64)
        self._grey, self._inside = _windows(image, self._middle, half)
        self._offsets = _offsets(half)
        self.blur = np.full(len(along), appearance.blur_px)
        self.noise_grey = appearance.noise_grey
        # Columns: shifts of edges 1 and 2, blur, contrast, mean, gradient in x and y; and the image itself.
        self._columns = np.empty((len(along), _UNKNOWNS + 1, self._offsets.shape[1]), dtype=np.float32)
        self.used = np.zeros(len(along))

    def _distances(self, normals: FloatArray) -> Single:
        """Distances of the windows' pixels from the two edges, (M, 2, P), px."""
        lines = np.empty((len(normals), 2, 3), dtype=np.float32)
        lines[..., :2] = normals
        at = self.pixels - self._middle
        lines[..., 2] = -(normals[..., 0] * at[:, :1] + normals[..., 1] * at[:, 1:])
        distances: Single = lines.reshape(-1, 3) @ self._offsets
        return distances.reshape(len(normals), 2, -1)

    def _choose_pixels(self, distance: Single) -> None:
        """Select the pixels used for the fit, and fill the constant columns."""
        near = (distance > self._lower) & (distance < self._upper)
        if self._margin is not None:
            near &= np.any(np.abs(distance) < self._margin, axis=1, keepdims=True)
        weight = self._columns[:, 4]
        weight[:] = near[:, 0] & near[:, 1] & self._inside
        self.used = weight.sum(axis=1).astype(np.float64)
        np.multiply(weight[:, None], self._offsets[:2], out=self._columns[:, 5:7])
        np.multiply(weight, self._grey, out=self._columns[:, 7])

    def _fill_columns(self, distance: Single) -> None:
        """Fill in the derivatives of the model, with edge shifts in units of the blur."""
        columns, weight = self._columns, self._columns[:, 4]
        scaled = distance * (1 / self.blur).astype(np.float32)[:, None, None]
        square = scaled * scaled
        profile = np.tanh(scaled * (_TANH_1 + _TANH_3 * square))
        slope = (1 - profile * profile) * (_TANH_1 + 3 * _TANH_3 * square)
        profile *= weight[:, None]
        np.multiply(slope, profile[:, ::-1], out=columns[:, :2])  # one edge's slope times the other's profile
        scaled *= columns[:, :2]
        np.add(scaled[:, 0], scaled[:, 1], out=columns[:, 2])
        np.multiply(profile[:, 0], profile[:, 1], out=columns[:, 3])

    def _steady(self, normal: FloatArray, right_side: FloatArray) -> None:
        """Add a prior on the gradient: the light varies inside a window as it does over the board."""
        if self.noise_grey is None:
            return
        level = (right_side[:, 4] / np.maximum(normal[:, 4, 4], 1)).reshape(self.shape)
        squares = ((level[1:] - level[:-1]) ** 2).sum() + ((level[:, 1:] - level[:, :-1]) ** 2).sum()
        gradient = squares / max(2 * level.size - sum(self.shape), 1) / upper_median(self.edge_px) ** 2
        normal[:, [5, 6], [5, 6]] += self.noise_grey**2 / max(gradient, 1e-6)

    def round(self) -> None:
        """Do one Gauss-Newton iteration."""
        normals = _normals(*_steps(self.pixels.reshape(*self.shape, 2)))
        distance = self._distances(normals)
        if not self.used.any():
            self._choose_pixels(distance)
        self._fill_columns(distance)
        # NumPy multiplies an array by a copy of itself faster than by itself.
        products = (self._columns.copy() @ np.swapaxes(self._columns, 1, 2)).astype(np.float64)
        normal, right_side = products[:, :_UNKNOWNS, :_UNKNOWNS], products[:, :_UNKNOWNS, _UNKNOWNS]
        self._steady(normal, right_side)
        normal += _RIDGE
        # Three right-hand sides: the solution, and two columns of the inverse for the corner's covariance.
        sides = np.zeros((len(normal), _UNKNOWNS, 3))
        sides[:, :, 0] = right_side
        sides[:, 0, 1] = sides[:, 1, 2] = 1.0
        solved = np.linalg.solve(normal, sides)
        unknowns = solved[..., 0]
        cost = products[:, _UNKNOWNS, _UNKNOWNS] - np.einsum("mi,mi->m", unknowns, right_side)
        variance = np.maximum(cost, 0.0) / np.maximum(self.used - _UNKNOWNS, 1)
        contrast = unknowns[:, 3].astype(np.float64)
        # The edge shifts are in units of the blur and multiplied by the contrast.
        unit = self.blur / np.where(np.abs(contrast) > _NO_CONTRAST, contrast, _NO_CONTRAST)
        by_shift = _inverse_2x2(normals)
        shift = unknowns[:, :2] * unit[:, None]
        self.step = -(by_shift @ shift[..., None])[..., 0]
        of_shift = solved[:, :2, 1:] * (variance * unit**2)[:, None, None]
        self.cov = by_shift @ of_shift @ np.swapaxes(by_shift, 1, 2)
        self.pixels = self.pixels + np.minimum(np.maximum(self.step, -_STEP_PX), _STEP_PX)
        wider = np.minimum(np.maximum(-unknowns[:, 2] * unit, -_STEP_BLUR_PX), _STEP_BLUR_PX)
        self.blur = np.minimum(np.maximum(self.blur + wider, _LEAST_BLUR_PX), _MOST_BLUR_PX)
        self.noise_grey = float(np.sqrt(upper_median(variance)))
        self.contrast_grey, self.sigma_grey = contrast, np.sqrt(variance)


def upper_median(values: FloatArray) -> float:
    """The upper median; faster than `np.median` for short arrays."""
    return float(np.partition(values, len(values) // 2)[len(values) // 2])


def _inverse_2x2(matrices: FloatArray) -> FloatArray:
    """(M, 2, 2) inverses in closed form, faster than LAPACK."""
    a, b, c, d = matrices[:, 0, 0], matrices[:, 0, 1], matrices[:, 1, 0], matrices[:, 1, 1]
    determinant = a * d - b * c
    inverse = np.empty_like(matrices)
    inverse[:, 0, 0], inverse[:, 0, 1] = d / determinant, -b / determinant
    inverse[:, 1, 0], inverse[:, 1, 1] = -c / determinant, a / determinant
    return inverse


@np.errstate(all="ignore")  # a wrong grid gives arbitrary values, and `fitted` marks them
def fit_corners(
    image: GrayImage, grid: FloatArray, appearance: Appearance, margin: float | None = None
) -> FittedCorners:
    """Fit the corner model to every corner of a board.

    Args:
        image: (height, width) gray.
        grid: (rows, columns, 2) initial corners with sub-pixel accuracy, px.
        appearance: to start from; that of an earlier image, with its noise, saves one iteration.
        margin: width of the part of each square along its edges beside which there is a marker, in squares; None for
            squares without markers.

    Returns:
        Corner index = row * columns + column. A corner keeps its initial position and is marked as not fitted
        if its fit does not converge, moves too far or has too few pixels.
    """
    fit = _Fit(image, grid, appearance, margin)
    for done in range(1, _MOST_ROUNDS + 1):
        fit.round()
        variance = (fit.cov[:, 0, 0] + fit.cov[:, 1, 1]) / 2
        moved = (fit.step[:, 0] ** 2 + fit.step[:, 1] ** 2) / 2
        converged = upper_median(moved) < _CONVERGED**2 * upper_median(variance)
        if converged and (appearance.noise_grey is not None or done > 1):
            break
    start = grid.reshape(-1, 2)
    off = fit.pixels - start
    limit = _LARGEST_MOVE * fit.edge_px
    fitted = (
        (fit.used >= _LEAST_PIXELS) & (off[:, 0] ** 2 + off[:, 1] ** 2 < limit**2) & (variance < limit**2)
    )
    fitted &= np.abs(fit.contrast_grey) > np.maximum(_LEAST_CONTRAST_GREY, 2 * fit.sigma_grey)
    poor = limit[:, None, None] ** 2 * np.eye(2)
    return FittedCorners(
        np.where(fitted[:, None], fit.pixels, start),
        np.where(fitted[:, None, None], fit.cov, poor),
        fit.contrast_grey,
        fitted,
        upper_median(fit.blur),
        fit.noise_grey,
    )
