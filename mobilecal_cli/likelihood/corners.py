"""Corners of the board in the images of the cameras, and their derivatives by its pose and by the constants.

Constants that change the cameras or the board itself have columns of their own ("direct").
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import numpy as np

from mobilecal_cli import camera as lens
from mobilecal_cli import se3
from mobilecal_cli.likelihood.dataset import Dataset
from mobilecal_cli.likelihood.effects import BoardEffect, CameraEffect, ImageEffect
from mobilecal_cli.likelihood.measurements import LEAST_DEPTH_M
from mobilecal_cli.likelihood.state import State
from mobilecal_cli.model.arrays import BoolArray, FloatArray, IntArray

FEWEST_CORNERS = 4  # of one station, in all images together: fewer do not hold a board pose
_AT_ONCE = 2700  # corners
#: Gauss-Newton steps of a board pose, and rad and m: the last ones move no corner visibly.
_POSE_STEPS, _STILL = 12, 1e-6
_LARGEST_DEEPER = 0.5  # of its depth: the board's way along the camera's axis in one step


def whitened(W: FloatArray, values: FloatArray) -> FloatArray:
    """Corner residuals (..., 2), or their derivatives (..., 2, k), px, by lower triangles W (..., 2, 2)."""
    if values.ndim < W.ndim:
        return whitened(W, values[..., None])[..., 0]
    out: FloatArray = np.diagonal(W, axis1=-2, axis2=-1)[..., None] * values
    out[..., 1, :] += W[..., 1, :1] * values[..., 0, :]
    return out


def blocks_of(data: Dataset, stations: int | None = None) -> Iterator[slice]:
    """All or so many stations in blocks: derivatives of their corners take a few MB however many there are."""
    size = max(1, _AT_ONCE // math.prod(data.seen.shape[1:]))
    yield from (slice(i, i + size) for i in range(0, data.stations if stations is None else stations, size))


def of_camera(
    state: State,
    k: int,
    T_c_k: FloatArray,
    stations: slice | IntArray,
    rates: FloatArray | None,
    effects: Sequence[ImageEffect],
) -> tuple[FloatArray, FloatArray]:
    """Predicted minus detected pixels of one camera, (n, M, 2), and (n, M, 2, 6 + K) their derivatives.

    Args:
        state: of all stations.
        k: index of the camera.
        T_c_k: (n, 4, 4) board poses of some stations.
        stations: which.
        rates: (C, n, 6) see `State.view_rates`, of these stations; at rest if None.
        effects: K, of direct constants. The derivatives are by delta and by these.
    """
    data, change, stated = state.data, state.camera_change, state.data.cameras.each[k]
    camera, T_c_camera = state.cameras.each[k], state.cameras.T_c_each[k]
    detected, T_camera_c = data.pixels[stations, k], se3.inverse(T_c_camera)
    points = se3.act(T_c_k, state.points_k)
    twist = (np.zeros((len(points), 6)) if rates is None else rates[k])[:, None]
    velocity = np.cross(twist[..., :3], points) + twist[..., 3:]
    rows = ((detected[..., 1] + 0.5) / stated.height - 0.5)[..., None]
    late_s = change.late_s(k, rows)
    exposed = points + late_s * velocity
    in_camera = exposed if k == 0 else se3.act(T_camera_c, exposed)
    # A camera without the board may look elsewhere; its corners count for nothing, and stay finite.
    elsewhere = (in_camera[..., 2] < LEAST_DEPTH_M) & ~data.seen[stations, k]
    in_camera = np.where(elsewhere[..., None], [0.0, 0.0, 1.0], in_camera)
    pixels, J_p = lens.project_with_jacobian(replace(camera, correction=None), in_camera)
    shares = change.lens[k]
    if not (effects or np.any(shares[4:])):
        shares = shares[:4]  # the waves are not needed
    terms, by_pixels = lens.lens_terms(stated, stated.K[:2, 2], pixels, shares)
    through = np.eye(2) + by_pixels
    by_exposed = through @ J_p if k == 0 else through @ J_p @ T_camera_c[:3, :3]
    by_point = by_exposed
    if np.any(late_s):  # points at the stamp turn until they are exposed
        by_point = by_exposed + np.cross(by_exposed, (late_s * twist[..., :3])[..., None, :])
    J = np.empty((*pixels.shape, 6 + len(effects)))
    J[..., :3] = np.cross(points[:, :, None], by_point)
    J[..., 3:6] = by_point

    # Derivatives by the attributes of `CameraChange`: a camera that moves moves the points the other way.
    position = T_c_camera[:3, 3]
    by_change: dict[str, Callable[[], FloatArray]] = {
        "turn": lambda: (
            np.cross(by_exposed, (exposed - position)[:, :, None]) @ se3.left_jacobian_so3(change.turn[k])
        ),
        "swing": lambda: np.cross(by_exposed, position) @ se3.left_jacobian_so3(change.swing[k]),
        "length": lambda: by_exposed @ -position[:, None] / (1 + change.length[k]),
        "shift": lambda: -by_exposed,
        "focal": lambda: through * ((pixels - camera.K[:2, 2]) / (1 + change.focal[k]))[..., None, :],
        "principal": lambda: through * stated.width,
        "lens": lambda: terms,
        "delay_s": lambda: by_exposed @ velocity[..., None],
        "readout_s": lambda: by_exposed @ (rows * velocity)[..., None],
    }
    of_board, of_cameras = dict[int, BoardEffect](), dict[str, dict[int, tuple[float, ...]]]()
    for column, effect in enumerate(effects, 6):
        if isinstance(effect, CameraEffect):
            of_cameras.setdefault(effect.of, {})[column] = effect.along
        elif isinstance(effect, BoardEffect):
            of_board[column] = effect
    for of, mine in of_cameras.items():
        values, along = by_change[of](), np.zeros((getattr(change, of).shape[1], len(mine)))
        for at, vector in enumerate(mine.values()):
            along[: len(vector), at] = vector
        J[..., [*mine]] = values if np.array_equal(along, np.eye(len(along))) else values @ along
    if of_board:
        moved = np.stack([e.displacement(data.points_k) for e in of_board.values()], axis=-1)
        J[..., [*of_board]] = by_point @ T_c_k[:, None, :3, :3] @ moved
    return np.asarray(pixels + np.tensordot(terms, shares, 1) - detected), J


def corner_residuals(
    state: State,
    T_c_k: FloatArray,
    stations: slice | IntArray = slice(None),
    rates: FloatArray | None = None,
    by_constants: bool = True,
) -> tuple[FloatArray, FloatArray]:
    """The same of all cameras: (n, C, M, 2), and (n, C, M, 2, Q) derivatives by (delta, direct constants), or by delta.

    Args:
        state, T_c_k, stations, rates: see `of_camera`.
        by_constants: whether the derivatives by the direct constants are needed.
    """
    direct = state.data.layout.direct if by_constants else ()
    shape = len(T_c_k), len(state.cameras.each), state.points_k.shape[0], 2
    residual, J = np.empty(shape), np.zeros((*shape, 6 + len(direct)))
    for k in range(shape[1]):
        columns, effects = columns_of(direct, k)
        residual[:, k], J[:, k][..., columns] = of_camera(state, k, T_c_k, stations, rates, effects)
    return residual, J


def columns_of(
    direct: Sequence[tuple[int, str, ImageEffect]], camera: int
) -> tuple[IntArray, list[ImageEffect]]:
    """Columns of (delta, direct constants) on which the pixels of a camera depend, and the effects of the constants."""
    mine = [(column, effect) for column, (_, _, effect) in enumerate(direct, 6) if effect.concerns(camera)]
    return np.array([*range(6), *(column for column, _ in mine)]), [effect for _, effect in mine]


def board_poses(state: State, corners: BoolArray) -> FloatArray:
    """(N, 4, 4) T_c_k with which the cameras and the board of a state show what was detected at each station.

    Measured poses stay. The corners (N, C, M) are those that count, unless they are too few at a station.
    """
    data, poses = state.data, state.data.T_c_k.copy()
    if data.posed:
        return poses
    rates = state.view_rates
    few = corners.sum(axis=(1, 2)) < FEWEST_CORNERS
    counted = np.where(few[:, None, None], data.seen, corners)
    for block in blocks_of(data):
        poses[block] = fitted_poses(state, poses[block], block, counted[block], rates[:, block])
    return poses


def median_size(size: FloatArray, corners: BoolArray) -> FloatArray:
    """(N,) median over the corners (N, C, M) that count."""
    return np.asarray(np.nanmedian(np.where(corners, size, np.nan), axis=(1, 2)))


def fitted_poses(
    state: State,
    T_c_k: FloatArray,
    stations: slice | IntArray,
    corners: BoolArray,
    rates: FloatArray | None = None,
    robust: bool = False,
) -> FloatArray:
    """Poses (n, 4, 4) of the board at some stations that fit the corners best, each station by itself.

    Args:
        state, stations, rates: see `of_camera`.
        T_c_k: (n, 4, 4) where to start.
        corners: (n, C, M) those that count.
        robust: whether the pull of a corner fades with its distance (Cauchy's weight, in units of the median).
    """
    for _ in range(_POSE_STEPS):
        residual, J = corner_residuals(state, T_c_k, stations, rates, by_constants=False)
        W = state.data.whitening[stations]
        residual, J = whitened(W, residual), whitened(W, J)
        root = corners.astype(np.float64)[..., None]
        if robust:
            size = np.linalg.norm(residual, axis=-1)
            scale = np.maximum(median_size(size, corners), 1e-9)[:, None, None]
            root = (corners / np.sqrt(1 + (size / (2 * scale)) ** 2))[..., None]
        A = (J * root[..., None]).reshape(len(T_c_k), -1, 6)
        r = (residual * root).reshape(len(T_c_k), -1, 1)
        step = np.asarray(np.linalg.solve(A.mT @ A, -(A.mT @ r))[..., 0])
        # Far off, a step may lead behind the camera, where nothing leads back.
        deeper = np.abs(np.cross(step[:, :3], T_c_k[:, :3, 3])[:, 2] + step[:, 5])
        share = np.minimum(_LARGEST_DEEPER * np.abs(T_c_k[:, 2, 3]) / np.maximum(deeper, _STILL), 1.0)
        T_c_k = se3.exp(share[:, None] * step) @ T_c_k
        if np.abs(step).max() < _STILL:
            break
    return T_c_k
