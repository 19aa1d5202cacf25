"""Corners by a model of what a blurred checkerboard corner looks like, fitted to all corners at once.

``I(p) = m + a erf(d1 / (sqrt(2) s)) erf(d2 / (sqrt(2) s)) + g . (p - c)``, where d1 and d2 are the distances of pixel
p from the two edges that cross in the corner c, s is the blur, and g a gradient of light. Every pixel around
a corner takes part, not only those on the edges, which brings the error near its Cramer-Rao bound.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import erf

from mobilecal_cli.model import BoolArray, FloatArray, GrayImage

# Reach of a corner's window in units of the edge: up to the middle of a square, short of the next edge's blur;
# less to the outside of the board, where printed boards often have squares of less than half the width.
_INNER_REACH, _OUTER_REACH = 0.45, 0.28
_MAX_HALF_PX = 7
_ROUNDS = 4
_DAMPING = 1e-4
_LEAST_BLUR_PX, _MOST_BLUR_PX = 0.3, 4.0
_LEAST_PIXELS = 20
_LEAST_CONTRAST_GREY = 4.0  # half of the step from dark to light; below it there is no corner
_LARGEST_MOVE = 0.15  # in units of the edge, from where cornerSubPix left it
_UNKNOWNS = 9


@dataclass(frozen=True, slots=True, eq=False)
class FittedCorners:
    """Corners of one board after the fit.

    Attributes:
        pixels: (M, 2) px; where the fit failed, the start.
        sigma_px: (M,) standard deviation of one coordinate as the fit's own residual tells, px.
        fitted: (M,) where the fit stands.
    """

    pixels: FloatArray
    sigma_px: FloatArray
    fitted: BoolArray


@dataclass(frozen=True, slots=True, eq=False)
class _Windows:
    """Pixels around each corner: positions relative to a whole pixel, grey values, weights; (M, P) each."""

    origin: FloatArray
    dx: FloatArray
    dy: FloatArray
    grey: FloatArray
    weight: FloatArray


def _edge_vectors(grid: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Steps to the next corner along a row and along a column, (rows, columns, 2) each, by central differences."""
    return np.gradient(grid, axis=1), np.gradient(grid, axis=0)


def _reaches(rows: int, columns: int, outer_whole: bool) -> FloatArray:
    """How far each window reaches in units of the edge: towards -x, +x, -y, +y of the board, (M, 4)."""
    reach = np.full((rows, columns, 4), _INNER_REACH)
    if not outer_whole:
        reach[:, 0, 0] = reach[:, -1, 1] = reach[0, :, 2] = reach[-1, :, 3] = _OUTER_REACH
    return reach.reshape(-1, 4)


def _cut_windows(
    image: GrayImage, grid: FloatArray, along: FloatArray, down: FloatArray, outer_whole: bool
) -> _Windows:
    rows, columns = grid.shape[:2]
    centres = grid.reshape(-1, 2)
    steps = np.stack([along.reshape(-1, 2), down.reshape(-1, 2)], axis=-1)  # (M, 2, 2): board to pixels
    extent = _INNER_REACH * np.abs(steps).sum(axis=2).max()
    half = int(np.clip(np.ceil(extent), 2, _MAX_HALF_PX))
    offset = np.arange(-half, half + 1)
    oy, ox = (o.ravel() for o in np.meshgrid(offset, offset, indexing="ij"))
    origin = np.round(centres)
    x = origin[:, :1].astype(np.int64) + ox
    y = origin[:, 1:].astype(np.int64) + oy
    height, width = image.shape
    inside = (x >= 0) & (x < width) & (y >= 0) & (y < height)
    grey = image[np.clip(y, 0, height - 1), np.clip(x, 0, width - 1)].astype(np.float64)
    from_centre = np.stack([x - centres[:, :1], y - centres[:, 1:]], axis=-1)
    on_board = from_centre @ np.swapaxes(np.linalg.inv(steps), 1, 2)
    reach = _reaches(rows, columns, outer_whole)[:, None]
    near = (on_board[..., 0] > -reach[..., 0]) & (on_board[..., 0] < reach[..., 1])
    near &= (on_board[..., 1] > -reach[..., 2]) & (on_board[..., 1] < reach[..., 3])
    shape = x.shape
    return _Windows(
        origin,
        np.broadcast_to(ox, shape).astype(np.float64),
        np.broadcast_to(oy, shape).astype(np.float64),
        grey,
        (near & inside).astype(np.float64),
    )


def _shape_terms(windows: _Windows, unknowns: FloatArray) -> tuple[FloatArray, ...]:
    """Both edges' profiles and their derivatives by distance and blur, (M, P) each."""
    x, y, angle_1, angle_2, blur = (unknowns[:, k, None] for k in range(5))
    dx, dy = windows.dx - x, windows.dy - y
    terms: list[FloatArray] = [dx, dy]
    for angle in (angle_1, angle_2):
        distance = dx * np.cos(angle) + dy * np.sin(angle)
        scaled = distance / (np.sqrt(2) * blur)
        slope = np.sqrt(2 / np.pi) / blur * np.exp(-(scaled**2))
        terms += [erf(scaled), slope, -slope * distance / blur, -dx * np.sin(angle) + dy * np.cos(angle)]
    return tuple(terms)


def _linear_part(windows: _Windows, unknowns: FloatArray) -> FloatArray:
    """Amplitude, mean and gradient for given edges, written into the unknowns (columns 5 to 8)."""
    dx, dy, first, _, _, _, second, *_ = _shape_terms(windows, unknowns)
    columns = np.stack([first * second, np.ones_like(dx), dx, dy], axis=-1) * windows.weight[..., None]
    normal = np.swapaxes(columns, 1, 2) @ columns + 1e-9 * np.eye(4)
    right_side = np.swapaxes(columns, 1, 2) @ (windows.grey * windows.weight)[..., None]
    filled = unknowns.copy()
    filled[:, 5:] = np.linalg.solve(normal, right_side)[..., 0]
    return filled


def _residual_and_jacobian(windows: _Windows, unknowns: FloatArray) -> tuple[FloatArray, FloatArray]:
    dx, dy, first, slope_1, blur_1, turn_1, second, slope_2, blur_2, turn_2 = _shape_terms(windows, unknowns)
    angle_1, angle_2 = unknowns[:, 2, None], unknowns[:, 3, None]
    a, m, gx, gy = (unknowns[:, k, None] for k in range(5, 9))
    model = m + a * first * second + gx * dx + gy * dy
    towards_1, towards_2 = a * second * slope_1, a * first * slope_2
    J = np.stack(
        [
            -towards_1 * np.cos(angle_1) - towards_2 * np.cos(angle_2) - gx,
            -towards_1 * np.sin(angle_1) - towards_2 * np.sin(angle_2) - gy,
            towards_1 * turn_1,
            towards_2 * turn_2,
            a * (second * blur_1 + first * blur_2),
            first * second,
            np.ones_like(dx),
            dx,
            dy,
        ],
        axis=-1,
    )
    return (model - windows.grey) * windows.weight, J * windows.weight[..., None]


def fit_corners(image: GrayImage, grid: FloatArray, outer_whole: bool) -> FittedCorners:
    """Fit the corner model to every corner of a board.

    Args:
        image: (height, width) grey.
        grid: (rows, columns, 2) corners to a fraction of a pixel, px.
        outer_whole: the outer squares are about as wide as the others.

    Returns:
        Corner index = row * columns + column. A corner whose fit does not settle, leaves its place or lies on
        too few pixels keeps its start and is marked so.
    """
    along, down = _edge_vectors(grid)
    windows = _cut_windows(image, grid, along, down, outer_whole)
    start = grid.reshape(-1, 2)
    count = len(start)
    unknowns = np.zeros((count, _UNKNOWNS))
    unknowns[:, :2] = start - windows.origin
    # An edge's normal is at right angles to the board's axis along which the edge runs.
    unknowns[:, 2] = np.arctan2(along[..., 0], -along[..., 1]).ravel()
    unknowns[:, 3] = np.arctan2(down[..., 0], -down[..., 1]).ravel()
    unknowns[:, 4] = 0.8
    unknowns = _linear_part(windows, unknowns)
    residual, J = _residual_and_jacobian(windows, unknowns)
    cost = np.sum(residual**2, axis=1)
    damping = np.full(count, _DAMPING)
    for _ in range(_ROUNDS):
        normal = np.swapaxes(J, 1, 2) @ J
        diagonal = np.diagonal(normal, axis1=1, axis2=2) + 1e-9
        damped = (
            normal
            + np.einsum("m,mk,kl->mkl", damping, diagonal, np.eye(_UNKNOWNS))
            + 1e-9 * np.eye(_UNKNOWNS)
        )
        step = np.linalg.solve(damped, np.swapaxes(J, 1, 2) @ residual[..., None])[..., 0]
        trial = unknowns - step
        trial[:, 4] = np.clip(trial[:, 4], _LEAST_BLUR_PX, _MOST_BLUR_PX)
        trial_residual, trial_J = _residual_and_jacobian(windows, trial)
        trial_cost = np.sum(trial_residual**2, axis=1)
        better = trial_cost <= cost
        unknowns = np.where(better[:, None], trial, unknowns)
        residual = np.where(better[:, None], trial_residual, residual)
        J = np.where(better[:, None, None], trial_J, J)
        cost = np.where(better, trial_cost, cost)
        damping = np.where(better, damping / 5, damping * 10)
    pixels = windows.origin + unknowns[:, :2]
    used = windows.weight.sum(axis=1)
    edge = np.minimum(np.linalg.norm(along, axis=-1), np.linalg.norm(down, axis=-1)).ravel()
    variance = cost / np.maximum(used - _UNKNOWNS, 1)
    information = np.swapaxes(J, 1, 2) @ J + 1e-9 * np.eye(_UNKNOWNS)
    covariance = np.linalg.inv(information)[:, :2, :2] * variance[:, None, None]
    sigma = np.sqrt(np.trace(covariance, axis1=1, axis2=2) / 2)
    fitted = (used >= _LEAST_PIXELS) & (np.linalg.norm(pixels - start, axis=1) < _LARGEST_MOVE * edge)
    fitted &= np.abs(unknowns[:, 5]) > np.maximum(_LEAST_CONTRAST_GREY, 3 * np.sqrt(variance))
    fitted &= np.isfinite(sigma) & (sigma < _LARGEST_MOVE * edge)
    return FittedCorners(
        np.where(fitted[:, None], pixels, start), np.where(fitted, sigma, _LARGEST_MOVE * edge), fitted
    )
