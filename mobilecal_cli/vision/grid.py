"""The board's corners as a grid: a smooth map from board coordinates to pixels, and the numbering of corners.

Grid coordinates (u, v) count squares: corner (column, row) is at (u, v) = (column, row), and the borders
between squares are at whole numbers, also beyond the inner corners.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from mobilecal_cli.model import FloatArray, IntArray


@dataclass(frozen=True, slots=True, eq=False)
class Places:
    """Grid coordinates prepared for repeated evaluation.

    Attributes:
        w: (n, 2) centered and scaled coordinates.
        terms: (n, terms) monomials of the polynomial.
    """

    w: FloatArray
    terms: FloatArray


@dataclass(frozen=True, slots=True, eq=False)
class GridMap:
    """Map from grid coordinates to pixels: a homography, and a polynomial for the lens distortion.

    Attributes:
        H: (3, 3) homography from centered grid coordinates to pixels.
        bend: (terms, 2) coefficients of the polynomial, px.
        degree: of the polynomial; 0 for none.
        `centre`, `size`: offset and scale of the grid coordinates.
        residual: (rows, columns, 2) corner minus smooth map, px.
        sigma_px: noise of one coordinate, from the residuals and their degrees of freedom.
    """

    H: FloatArray
    bend: FloatArray
    degree: int
    centre: FloatArray
    size: float
    residual: FloatArray
    sigma_px: float

    def __call__(self, uv: FloatArray) -> FloatArray:
        """(..., 2) grid coordinates → (..., 2) px."""
        w = (uv - self.centre) / self.size
        return _through(self.H, w) + _monomials(w, self.degree) @ self.bend

    @property
    def worst_px(self) -> float:
        """Largest distance of a corner from the smooth map, px."""
        return float(np.sqrt(np.sum(self.residual**2, axis=-1).max()))

    def at(self, places: Places) -> FloatArray:
        """(n, 2) px at places prepared for the same board size."""
        return _through(self.H, places.w) + places.terms @ self.bend


def _through(H: FloatArray, w: FloatArray) -> FloatArray:
    h = w @ H[:, :2].T + H[:, 2]
    pixels: FloatArray = h[..., :2] / h[..., 2:]
    return pixels


def _monomials(w: FloatArray, degree: int) -> FloatArray:
    x, y = w[..., 0], w[..., 1]
    return np.stack([x**i * y ** (d - i) for d in range(degree + 1) for i in range(d + 1)], axis=-1)


def _products(w: FloatArray) -> FloatArray:
    """(M, 9) outer products of (w, 1) with itself, flattened."""
    one = np.column_stack([w, np.ones(len(w))])
    return np.asarray((one[:, :, None] * one[:, None, :]).reshape(-1, 9))


def _homography(products: FloatArray, pixels: FloatArray) -> FloatArray:
    """Direct linear transformation with normalized pixels (Hartley and Zisserman 2004, algorithm 4.2).

    The normal matrix A^T A is assembled from sums of `_products`, weighted by x, y and x^2 + y^2.
    """
    mean, spread = pixels.mean(axis=0), pixels.std()
    p = (pixels - mean) / spread
    weights = np.stack([np.ones(len(p)), p[:, 0], p[:, 1], p[:, 0] ** 2 + p[:, 1] ** 2])
    plain, by_x, by_y, by_both = (weights @ products).reshape(4, 3, 3)
    normal = np.zeros((9, 9))
    normal[:3, :3] = normal[3:6, 3:6] = plain
    normal[:3, 6:] = normal[6:, :3] = -by_x
    normal[3:6, 6:] = normal[6:, 3:6] = -by_y
    normal[6:, 6:] = by_both
    H = np.linalg.eigh(normal)[1][:, 0].reshape(3, 3)
    back = np.array([[spread, 0, mean[0]], [0, spread, mean[1]], [0, 0, 1]])
    homography: FloatArray = back @ H
    return homography


def scatter_px(uv: FloatArray, pixels: FloatArray) -> FloatArray:
    """Residuals of scattered corners from a smooth map: a homography and a low-degree polynomial.

    Args:
        uv: (n, 2) positions on the board, any unit, n at least 6.
        pixels: (n, 2) px.

    Returns:
        (n, 2) residuals, px, scaled up for the lost degrees of freedom: their mean square is the noise
        variance.
    """
    w = (uv - uv.mean(axis=0)) / max(float(np.ptp(uv, axis=0).max()) / 2, 1e-9)
    bent = pixels - _through(_homography(_products(w), pixels), w)
    degree = 4 if len(w) >= 40 else 3 if len(w) >= 24 else 2 if len(w) >= 12 else 0
    residual, unknowns = bent, 8
    if degree:
        terms = _monomials(w, degree)
        residual = bent - terms @ np.linalg.lstsq(terms, bent, rcond=None)[0]
        unknowns = 2 * terms.shape[1] + 2
    return np.asarray(residual * np.sqrt(2 * len(w) / max(2 * len(w) - unknowns, 1)))


@dataclass(frozen=True, slots=True, eq=False)
class _Frame:
    """The part of `fit_grid` that depends only on the board's size.

    Attributes:
        w: (M, 2) centered and scaled grid coordinates.
        products: (M, 9) see `_products`.
        `centre`, `size`: offset and scale of the grid coordinates.
        degree: of the polynomial.
        solver: (terms, M) from the homography's residuals to the polynomial's coefficients.
        finer: (M, k) orthonormal basis of the polynomials that residuals are computed against.
        unknowns: number of parameters of the homography and that polynomial.
    """

    w: FloatArray
    products: FloatArray
    centre: FloatArray
    size: float
    degree: int
    solver: FloatArray
    finer: FloatArray
    unknowns: int


@lru_cache(maxsize=64)
def _frame(rows: int, columns: int) -> _Frame:
    uv = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).astype(np.float64)
    centre = np.array([(columns - 1) / 2, (rows - 1) / 2])
    size = max(columns, rows) / 2
    w = ((uv - centre) / size).reshape(-1, 2)
    # A grid of n lines determines a polynomial of degree n - 1; a degree of n - 2 leaves residuals.
    finest = min(4, min(rows, columns) - 2)
    if finest <= 1:
        return _Frame(w, _products(w), centre, size, 0, np.zeros((1, len(w))), np.zeros((len(w), 0)), 8)
    degree, terms = min(3, finest), _monomials(w, finest)
    finer = np.linalg.qr(terms)[0]
    # Six of the homography's eight parameters are an affine map, which the polynomial contains.
    unknowns = 2 * terms.shape[1] + 2
    solver = np.asarray(np.linalg.pinv(_monomials(w, degree)), dtype=np.float64)
    return _Frame(w, _products(w), centre, size, degree, solver, finer, unknowns)


def places(uv: FloatArray, columns: int, rows: int) -> Places:
    """Prepare (..., 2) grid coordinates of a board for `GridMap.at`, flattened."""
    frame = _frame(rows, columns)
    w = (uv.reshape(-1, 2) - frame.centre) / frame.size
    return Places(w, _monomials(w, frame.degree))


def fit_grid(grid: FloatArray) -> GridMap:
    """Fit a smooth map through (rows, columns, 2) corners, px.

    The polynomial is cubic if the board has enough corners, so that it can be extrapolated. Residuals are
    computed against one degree more, so that they show the noise of the corners and not the lens distortion.
    """
    frame = _frame(*grid.shape[:2])
    pixels = grid.reshape(-1, 2)
    H = _homography(frame.products, pixels)
    bent = pixels - _through(H, frame.w)
    residual, sigma_px = _scatter(frame, bent)
    bend = np.asarray(frame.solver @ bent)
    return GridMap(H, bend, frame.degree, frame.centre, frame.size, residual.reshape(grid.shape), sigma_px)


def homography_px(grid: FloatArray) -> FloatArray:
    """(rows, columns, 2) corners by the homography that fits (rows, columns, 2) best."""
    frame = _frame(*grid.shape[:2])
    pixels = grid.reshape(-1, 2)
    return _through(_homography(frame.products, pixels), frame.w).reshape(grid.shape)


def noise_px(bent: FloatArray) -> float:
    """Noise of one coordinate, px, from differences (rows, columns, 2) from a homography that are smooth without it."""
    return _scatter(_frame(*bent.shape[:2]), bent.reshape(-1, 2))[1]


def _scatter(frame: _Frame, bent: FloatArray) -> tuple[FloatArray, float]:
    """Residuals (M, 2) of differences from a homography about a polynomial, and the noise of one coordinate, px."""
    residual = bent - frame.finer @ (frame.finer.T @ bent)
    return residual, float(np.sqrt(np.sum(residual**2) / max(2 * len(bent) - frame.unknowns, 1)))


def smallest_edge_px(grid: FloatArray) -> float:
    """Shortest distance between neighboring corners of (rows, columns, 2), px."""
    along, down = grid[:, 1:] - grid[:, :-1], grid[1:] - grid[:-1]
    return float(min(np.hypot(step[..., 0], step[..., 1]).min() for step in (along, down)))


def right_handed(grid: FloatArray) -> FloatArray:
    """The same corners, (rows, columns, 2), with x cross y pointing away from the camera."""
    x = grid[:, -1].mean(axis=0) - grid[:, 0].mean(axis=0)
    y = grid[-1].mean(axis=0) - grid[0].mean(axis=0)
    return grid if x[0] * y[1] - x[1] * y[0] > 0 else grid[:, ::-1]


def turns(columns: int, rows: int) -> tuple[int, ...]:
    """Quarter turns, 0 first, after which a board of this size looks the same, including the square colors.

    Only 0 if the counts differ in parity, because opposite outer squares differ in color. Otherwise also a
    half turn; for a square board with even counts all quarter turns.
    """
    if (columns + rows) % 2:
        return (0,)
    return (0, 1, 2, 3) if columns == rows and columns % 2 == 0 else (0, 2)


def turned(values: FloatArray, columns: int, rows: int, quarter_turns: int) -> FloatArray:
    """Corner values (columns * rows, ...) renumbered for a board rotated by quarter turns about its normal.

    Odd numbers of quarter turns need columns == rows.
    """
    grid = values.reshape(rows, columns, *values.shape[1:])
    return np.ascontiguousarray(np.rot90(grid, quarter_turns)).reshape(values.shape)


def canonical(grid: FloatArray, dark_at_origin: bool) -> tuple[IntArray, bool]:
    """Canonical order of the corners, as far as the square colors determine it.

    The outer square diagonally next to corner 0 is dark, if a rotation of the board can achieve that. Any
    remaining ambiguity (see `turns`) is resolved for now by pointing x as far to the right of the image as
    possible; `settle_numbering` resolves it finally.

    Args:
        grid: (rows, columns, 2) right-handed, px.
        dark_at_origin: whether that square is dark in the given order.

    Returns:
        (rows * columns,) index of the given corner at each position, and whether that square is dark
        afterwards.
    """
    rows, columns = grid.shape[:2]
    order = np.arange(rows * columns).reshape(rows, columns)
    odd_square = columns == rows and columns % 2 == 1
    settled = (columns + rows) % 2 == 1 or odd_square
    if not dark_at_origin and settled:
        order = np.rot90(order, 1 if odd_square else 2)
    corners = grid.reshape(-1, 2)
    candidates = [np.rot90(order, k) for k in turns(columns, rows)]
    best = max(candidates, key=lambda numbers: _x_direction(corners[numbers]))
    return np.ascontiguousarray(best, dtype=np.int64).ravel(), dark_at_origin or settled


def _x_direction(grid: FloatArray) -> float:
    x = grid[:, -1].mean(axis=0) - grid[:, 0].mean(axis=0)
    return float(x[0] / np.linalg.norm(x))
