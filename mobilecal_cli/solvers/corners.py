"""Gross corners and wrong boards, found at each station by itself."""

from __future__ import annotations

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.likelihood.dataset import Dataset
from mobilecal_cli.likelihood.noise import FEWEST_CORNERS
from mobilecal_cli.likelihood.state import State
from mobilecal_cli.likelihood.views import blocks_of, corner_residuals, whitened
from mobilecal_cli.model import BoolArray, FloatArray

_CORNER_SIGMAS = 5.5
_BAD_IMAGE = 0.4  # share of gross corners from which on the whole board is rejected
_BAD_BOARD = 6.0  # corner noise of one station against the usual
_LOCAL_STEPS, _STILL = 12, 1e-6  # steps of a board pose, rad and m: the last ones move no corner visibly


def _median(size: FloatArray, seen: BoolArray) -> FloatArray:
    """(N,) median over the detected corners, (N, 2, M)."""
    return np.asarray(np.nanmedian(np.where(seen, size, np.nan), axis=(1, 2)))


def _own_misfit(data: Dataset, state: State, stations: slice) -> FloatArray:
    """(n, 2, M) distance of the corners of some stations from the boards that fit each best, robustly."""
    seen, T = data.seen[stations], data.T_c_k[stations]
    for _ in range(_LOCAL_STEPS):
        residual, J = corner_residuals(data, state, T, stations)
        W = data.whitening[stations]
        residual, J = whitened(W, residual), whitened(W, J[:, :6])
        size = np.linalg.norm(residual, axis=-1)
        scale = np.maximum(_median(size, seen), 1e-9)
        # Cauchy's weight, whose pull fades with distance.
        root = (seen / np.sqrt(1 + (size / (2 * scale[:, None, None])) ** 2))[..., None]
        At = (J * root[:, None]).reshape(len(T), 6, -1)
        r = (residual * root).reshape(len(T), -1)
        A = np.swapaxes(At, 1, 2)
        step = np.linalg.solve(At @ A, -(At @ r[..., None]))[..., 0]
        T = se3.exp(step) @ T
        if np.abs(step).max() < _STILL:
            break
    residual, _ = corner_residuals(data, state, T, stations)
    return np.asarray(np.linalg.norm(whitened(data.whitening[stations], residual), axis=-1))


def gross_corners(data: Dataset, state: State) -> tuple[BoolArray, BoolArray, FloatArray]:
    """Corners and whole boards that fit the board's own shape, each station by itself.

    Args:
        data: the corners, and a first board pose of each station.
        state: gives the cameras and the board.

    Returns:
        (N, 2, M) inlier corners, (N,) inlier boards, and (N,) each station's corner noise, px.
    """
    if data.posed.any():
        return data.seen, np.ones(data.stations, dtype=np.bool_), np.zeros(data.stations)
    if not state.constants:  # as stated: the derivatives by constants would only take time
        data = data.with_constants(())
    size = np.concatenate([_own_misfit(data, state, block) for block in blocks_of(data.stations)])
    # The median length of a two-dimensional normal vector is 1.1774 sigma.
    own = _median(size, data.seen) / 1.1774
    common = max(float(np.median(own)), 1e-9)
    near = size <= _CORNER_SIGMAS * np.maximum(common, np.minimum(own, _BAD_BOARD * common))[:, None, None]
    inliers = near & data.seen
    enough = np.all(inliers.sum(axis=2) >= (1 - _BAD_IMAGE) * data.seen.sum(axis=2), axis=1)
    enough &= inliers.sum(axis=(1, 2)) >= FEWEST_CORNERS
    return inliers, enough & (own < _BAD_BOARD * common), own
