"""A smooth map from board coordinates to pixels, fitted to corners.

Grid coordinates (u, v) count squares: corner (column, row) is at (u, v) = (column, row), and the borders
between squares are at whole numbers, also beyond the inner corners.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from mobilecal_cli.camera import project, undistorted
from mobilecal_cli.model.arrays import BoolArray, FloatArray
from mobilecal_cli.model.rig import Camera

# A grid less smooth than this under a perspective camera may have been seen by a fisheye lens, px. The lens must
# leave less than this share of the noise.
_ROUGH_PX = 0.2
_BETTER = 0.7
_LENS_PX = 0.3  # error of the lens model, against which its likely values count
_LENS_TRIALS = 20  # most lenses that are tried
_FOCAL_LENGTHS = (0.2, 0.3, 0.45, 0.7)  # in units of the larger side of the image: 290 to 80 degrees across
_LARGEST_RAD = 3.0  # angle to the optical axis; the projection ends at pi
#: How far a lens may be from those tried: logarithm of the focal length, and center in units of the larger side.
_SPREAD = np.array([0.2, 0.1, 0.1])


@dataclass(frozen=True, slots=True, eq=False)
class Fisheye:
    """Distance from the principal point = focal length * angle to the optical axis.

    Attributes:
        center_px: (2,) principal point, px.
        focal_px: focal length, px.
    """

    center_px: FloatArray
    focal_px: float

    def reaches(self, pixels: FloatArray) -> bool:
        """Whether all pixels (M, 2) are images of directions."""
        return float(np.hypot(*(pixels - self.center_px).T).max()) < _LARGEST_RAD * self.focal_px

    def rays(self, pixels: FloatArray) -> FloatArray:
        """(M, 2) px → (M, 3) unit vectors."""
        x, y = ((pixels - self.center_px) / self.focal_px).T
        angle = np.hypot(x, y)
        sine = np.sinc(angle / np.pi)  # sin(angle) / angle
        return np.stack([sine * x, sine * y, np.cos(angle)], axis=-1)

    def project(self, points: FloatArray) -> FloatArray:
        """(..., 3) directions of any length → (..., 2) px."""
        across = np.hypot(points[..., 0], points[..., 1])
        angle = np.arctan2(across, points[..., 2])
        scale = self.focal_px * angle / np.maximum(across, 1e-12)
        return np.asarray(self.center_px + scale[..., None] * points[..., :2])


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
        freedom: (rows, columns) share of a corner's own error that its residual shows.
        unknowns: number of parameters of the homography and that polynomial.
    """

    w: FloatArray
    products: FloatArray
    centre: FloatArray
    size: float
    degree: int
    solver: FloatArray
    finer: FloatArray
    freedom: FloatArray
    unknowns: int


@dataclass(frozen=True, slots=True, eq=False)
class GridMap:
    """Map from grid coordinates to pixels: a homography, a lens, and a polynomial for other distortion.

    Attributes:
        frame: what depends only on the board's size.
        corners: (rows, columns, 2) the corners that it was fitted to, px.
        H: (3, 3) homography from centered grid coordinates to pixels, or to the rays of the lens.
        lens: of a fisheye camera; None for a perspective one.
        bend: (terms, 2) coefficients of the polynomial, px.
        residual: (rows, columns, 2) corner minus smooth map, px.
        sigma_px: noise of one coordinate, from the residuals and their degrees of freedom.
    """

    frame: _Frame
    corners: FloatArray
    H: FloatArray
    lens: Fisheye | None
    bend: FloatArray
    residual: FloatArray
    sigma_px: float

    def __call__(self, uv: FloatArray) -> FloatArray:
        """(..., 2) grid coordinates → (..., 2) px."""
        w = (uv - self.frame.centre) / self.frame.size
        return _through(self.H, w, self.lens) + _monomials(w, self.frame.degree) @ self.bend

    @property
    def shape(self) -> tuple[int, int]:
        """Numbers of rows and columns of the corners."""
        rows, columns, _ = self.corners.shape
        return rows, columns

    @property
    def off_px(self) -> FloatArray:
        """(rows, columns) distance of each corner from the map through all others, px.

        A corner at the edge of the board draws the map to itself; its residual shows a small part of its error.
        """
        return np.asarray(np.hypot(self.residual[..., 0], self.residual[..., 1]) / self.frame.freedom)

    def predicted(self, bad: BoolArray) -> FloatArray:
        """The corners (rows, columns, 2), px, the bad ones as the others predict them."""
        chosen = self.frame.finer[bad.ravel()]
        free = np.eye(len(chosen)) - chosen @ chosen.T
        better = self.corners.copy()
        better[bad] -= np.linalg.lstsq(free, self.residual[bad], rcond=1e-3)[0]
        return better


def _through(H: FloatArray, w: FloatArray, lens: Fisheye | None = None) -> FloatArray:
    h = w @ H[:, :2].T + H[:, 2]
    if lens is not None:
        return lens.project(h)
    pixels: FloatArray = h[..., :2] / h[..., 2:]
    return pixels


def _monomials(w: FloatArray, degree: int) -> FloatArray:
    x, y = w[..., 0], w[..., 1]
    return np.stack([x**i * y ** (d - i) for d in range(degree + 1) for i in range(d + 1)], axis=-1)


def _products(w: FloatArray) -> FloatArray:
    """(M, 9) outer products of (w, 1) with itself, flattened."""
    q = np.column_stack([w, np.ones(len(w))])
    return np.asarray((q[:, :, None] * q[:, None, :]).reshape(-1, 9))


def _homography(products: FloatArray, pixels: FloatArray) -> FloatArray:
    """Homography to pixels (M, 2), normalized for the direct linear transformation."""
    mean, spread = pixels.mean(axis=0), pixels.std()
    back = np.array([[spread, 0, mean[0]], [0, spread, mean[1]], [0, 0, 1]])
    return np.asarray(
        back @ _to_rays(products, np.column_stack([(pixels - mean) / spread, np.ones(len(pixels))]))
    )


def _to_rays(products: FloatArray, rays: FloatArray) -> FloatArray:
    """Homography to rays (M, 3) of any length (direct linear transformation: ray x H q = 0).

    Hartley and Zisserman 2004, algorithm 4.1, with all three equations of a corner.
    """
    squares = np.sum(rays**2, axis=1)[:, None, None] * np.eye(3) - rays[:, :, None] * rays[:, None, :]
    blocks = (squares.reshape(-1, 9).T @ products).reshape(3, 3, 3, 3)
    normal = blocks.transpose(0, 2, 1, 3).reshape(9, 9)
    homography: FloatArray = np.linalg.eigh(normal)[1][:, 0].reshape(3, 3)
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


@lru_cache(maxsize=64)
def _frame(rows: int, columns: int) -> _Frame:
    uv = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).astype(np.float64)
    centre = np.array([(columns - 1) / 2, (rows - 1) / 2])
    size = max(columns, rows) / 2
    w = ((uv - centre) / size).reshape(-1, 2)
    # A grid of n lines determines a polynomial of degree n - 1; a degree of n - 2 leaves residuals.
    finest = min(4, min(rows, columns) - 2)
    if finest <= 1:
        freedom = np.ones((rows, columns))
        none = np.zeros((1, len(w))), np.zeros((len(w), 0))
        return _Frame(w, _products(w), centre, size, 0, *none, freedom, 8)
    degree, terms = min(3, finest), _monomials(w, finest)
    finer = np.linalg.qr(terms)[0]
    freedom = (1 - np.sum(finer**2, axis=1)).reshape(rows, columns)
    # Six of the homography's eight parameters are an affine map, which the polynomial contains.
    unknowns = 2 * terms.shape[1] + 2
    solver = np.asarray(np.linalg.pinv(_monomials(w, degree)), dtype=np.float64)
    return _Frame(w, _products(w), centre, size, degree, solver, finer, freedom, unknowns)


def fit_grid(grid: FloatArray, image_shape: tuple[int, int] | None = None) -> GridMap:
    """Fit a smooth map through (rows, columns, 2) corners, px.

    The polynomial is cubic if the board has enough corners, so that it can be extrapolated. Residuals are
    computed against one degree more, so that they show the noise of the corners and not the lens distortion.

    Args:
        grid: the corners.
        image_shape: (height, width), to try fisheye lenses where a perspective camera leaves a rough grid.
    """
    perspective = _fit(grid, None)
    if image_shape is None or perspective.sigma_px <= _ROUGH_PX:
        return perspective
    best = _fisheye_fit(grid, image_shape)
    return best if best is not None and best.sigma_px < _BETTER * perspective.sigma_px else perspective


def _fisheye_fit(grid: FloatArray, image_shape: tuple[int, int]) -> GridMap | None:
    """The smoothest map through a fisheye lens: least squares on the lens, from the best of a few."""
    from scipy.optimize import least_squares  # slow to import, and few images need it

    (height, width), side_px = image_shape, max(image_shape)
    center_px = np.array([(width - 1) / 2, (height - 1) / 2])
    tried = [Fisheye(center_px, side_px * focal) for focal in _FOCAL_LENGTHS]
    lenses = [lens for lens in tried if lens.reaches(grid.reshape(-1, 2))]
    if not lenses:
        return None
    start = min(lenses, key=lambda lens: _fit(grid, lens).sigma_px)

    def fit(change: FloatArray) -> GridMap:
        """The map through the lens after a change (3,) of focal length and center, in units of what is likely."""
        by = _SPREAD * change
        return _fit(grid, Fisheye(start.center_px + side_px * by[1:], start.focal_px * float(np.exp(by[0]))))

    def cost(change: FloatArray) -> FloatArray:
        return np.append(fit(change).residual / _LENS_PX, change)

    return fit(least_squares(cost, np.zeros(3), method="lm", max_nfev=_LENS_TRIALS).x)


def _fit(grid: FloatArray, lens: Fisheye | None) -> GridMap:
    frame = _frame(*grid.shape[:2])
    pixels = grid.reshape(-1, 2)
    if lens is None:
        H = _homography(frame.products, pixels)
    else:
        rays = lens.rays(pixels)
        H = _to_rays(frame.products, rays)
        H *= np.sign(np.sum(rays * (frame.w @ H[:, :2].T + H[:, 2])))  # toward the camera's front
    bent = pixels - _through(H, frame.w, lens)
    residual, sigma_px = _scatter(frame, bent)
    bend = np.asarray(frame.solver @ bent)
    return GridMap(frame, grid, H, lens, bend, residual.reshape(grid.shape), sigma_px)


def roughness_px(camera: Camera, grid: FloatArray) -> float:
    """Noise of one corner coordinate, px, from the residuals of a smooth map.

    The map is a homography through the camera's model, and a polynomial for the errors of that model. A few corners
    determine too low a polynomial for the distortion of a lens itself, which would look like noise.

    Args:
        camera: the camera of the image.
        grid: (rows, columns, 2) px.
    """
    flat, inside = undistorted(camera, grid)
    if not inside.all():
        return fit_grid(grid).sigma_px
    frame = _frame(*grid.shape[:2])
    rays = np.ones((len(frame.w), 3))
    rays[:, :2] = _through(_homography(frame.products, flat.reshape(-1, 2)), frame.w)
    return _scatter(frame, grid.reshape(-1, 2) - project(camera, rays))[1]


def _scatter(frame: _Frame, bent: FloatArray) -> tuple[FloatArray, float]:
    """Residuals (M, 2) of differences from a homography about a polynomial, and the noise of one coordinate, px."""
    residual = bent - frame.finer @ (frame.finer.T @ bent)
    return residual, float(np.sqrt(np.sum(residual**2) / max(2 * len(bent) - frame.unknowns, 1)))
