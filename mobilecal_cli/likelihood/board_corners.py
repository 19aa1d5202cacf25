"""Places of the board's corners: the errors of print and plate, as few constants as a recording is sensitive to.

Every corner may be off its place, in the plane and across it: 3 M numbers e. What they do to the images counts as
corner noise, but for the patterns that would spoil the result: the constants of cameras and board, and the camera's
pose, together c. With the board's pose eliminated, and with it that at each station, which is tied to what joints,
wheels and floor say of it, c and e have the informations ``H_cc`` and ``H_ee`` (with priors) and share ``H_ce``. An
estimate with some patterns, the orthonormal columns of M in units of the prior, states the information ::

    I = H_cc - B M^T H_ec,    B = H_ce M (M^T H_ee M)^-1,

and what is left of e, of unit variance across M, adds ``D D^T`` with ``D = (H_ce - B M^T H_ee) (1 - M M^T)`` to the
variance I of its right side. The largest generalized eigenvalue of ``(D D^T, I)`` is by how much the variance of a
direction w of c is understated; with the pattern ``H_ee^-1 H_ec w``, ``w^T D`` is zero.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import partial

import numpy as np
from scipy.linalg import block_diag, eigh

from mobilecal_cli import se3
from mobilecal_cli.likelihood.dataset import Dataset
from mobilecal_cli.likelihood.effects import BoardEffect, CameraEffect
from mobilecal_cli.likelihood.nuisance import Constant, kind
from mobilecal_cli.likelihood.state import State
from mobilecal_cli.likelihood.views import corner_residuals, whitened
from mobilecal_cli.model import FloatArray, Parameters, WheelGeometry

KIND = "board_corners"
#: Of the variance of the direction that suffers most: a sigma by 2.5 %.
UNDERSTATED = 0.05
_ACROSS = 2.0  # sigma across the board, in sigmas in the plane
_MOST_STATIONS = 100  # that the modes are made from
_TIED = np.array([1.75e-4] * 3 + [3e-4] * 3)  # rad, m: 0.01 degrees and 0.3 mm of a station's board pose
_ANYWHERE = 1e3 * _TIED  # of camera and board
_PIXEL_PX = 0.1  # noise of a usual corner
_WIDER = 10.0  # priors of contradicted constants become so much wider


def corner_modes(data: Dataset, rows: Sequence[Constant]) -> Iterator[Constant]:
    """Rows of the patterns that matter for the poses of camera and board, or for the constants of both.

    Args:
        data: cameras and board as stated, and each station's board pose.
        rows: the other constants that are estimated.
    """
    if data.posed.all():
        return
    scale = kind(KIND).sigma * np.tile([1.0, 1.0, _ACROSS], data.points_k.shape[0])
    modes = _modes(*_informations(data, rows, scale))
    for number, mode in enumerate(modes, 1):
        effect = BoardEffect(partial(_displaced, pattern=(mode * scale / kind(KIND).sigma).reshape(-1, 3)))
        meaning = f"places of the corners, pattern {number}"
        yield Constant(f"{KIND}_{number}", KIND, "board", meaning, effect, kind(KIND).sigma)


def _displaced(points_k: FloatArray, pattern: FloatArray) -> FloatArray:
    """The pattern (M, 3), m, for a value of 1 m."""
    return pattern


def _modes(H_cc: FloatArray, H_ce: FloatArray, H_ee: FloatArray) -> FloatArray:
    """Orthonormal patterns (K, 3 M), in units of the prior."""
    modes, mending = np.zeros((0, len(H_ee))), np.linalg.solve(H_ee, H_ce.T)
    while len(modes) < len(H_cc):
        B = np.linalg.solve(modes @ H_ee @ modes.T, modes @ H_ce.T).T
        D = H_ce - B @ modes @ H_ee
        D -= D @ modes.T @ modes
        excess, directions = eigh(D @ D.T, H_cc - B @ modes @ H_ce.T)
        if excess[-1] < UNDERSTATED:
            break
        pattern = mending @ directions[:, -1]
        pattern -= modes.T @ (modes @ pattern)
        modes = np.concatenate([modes, pattern[None] / np.linalg.norm(pattern)])
    return modes


def _informations(
    data: Dataset, rows: Sequence[Constant], scale: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """``H_cc``, ``H_ce`` and ``H_ee``; c are the constants and the camera's pose."""
    in_images = [row for row in rows if isinstance(row.effect, CameraEffect | BoardEffect)]
    every = np.arange(0, data.stations, max(1, data.stations // _MOST_STATIONS))
    each = data.stations / len(every)  # stations that one of these stands for
    plain, T = data.with_constants(in_images), data.T_c_k[every]
    anywhere = Parameters(np.eye(4), WheelGeometry(1.0, 1.0, 1.0)), np.eye(4)[None]
    state = State.without_errors(plain, *anywhere, np.zeros((data.stations, 3)))
    _, J = corner_residuals(plain, state, T, every)
    J = np.where(data.seen[every][:, None, ..., None], whitened(data.whitening[every], J), 0.0)
    J *= np.sqrt(each) / _PIXEL_PX
    by_corner = np.einsum("npcmx,npq->nqcmx", J[:, 3:6], T[:, :3, :3])
    G = np.einsum("nacmx,nbcmx->nab", J, J, optimize=True)
    E = np.einsum("nacmx,nqcmx->namq", J, by_corner).reshape(*J.shape[:2], -1) * scale

    # A board pose is tied to what joints, wheels and floor say of it, up to the poses of camera and board.
    _, recording = np.unique(data.log[every], return_inverse=True)
    of_board = np.einsum("nl,nab->nalb", np.eye(recording.max() + 1)[recording], se3.adjoint(T))
    moved = np.concatenate(
        [np.broadcast_to(np.eye(6), (len(T), 6, 6)), of_board.reshape(len(T), 6, -1)], axis=2
    )
    tie = each * np.diag(_TIED**-2)
    with_pose = np.concatenate([G[:, :6, 6:], -tie @ moved, E[:, :6]], axis=2)

    sizes = (len(in_images), 6, moved.shape[2] - 6, len(scale))
    constants, camera, board, corners = (
        slice(end - size, end) for size, end in zip(sizes, np.cumsum(sizes), strict=True)
    )
    poses = slice(camera.start, board.stop)
    H = np.zeros((sum(sizes), sum(sizes)))
    H[constants, constants] = G[:, 6:, 6:].sum(axis=0) + np.diag(
        [(_WIDER * row.sigma) ** -2 for row in in_images]
    )
    H[constants, corners] = E[:, 6:].sum(axis=0)
    H[corners, constants] = H[constants, corners].T
    H[poses, poses] = np.sum(np.swapaxes(moved, 1, 2) @ tie @ moved, axis=0)
    H[poses, poses] += np.diag(np.tile(_ANYWHERE**-2, moved.shape[2] // 6))
    of_corners = np.einsum("nqcmx,nrcmx->mqr", by_corner, by_corner)
    H[corners, corners] = np.eye(len(scale)) + block_diag(*of_corners) * np.outer(scale, scale)
    of_pose = np.linalg.inv(G[:, :6, :6] + tie)
    H -= np.einsum("nax,nab,nby->xy", with_pose, of_pose, with_pose, optimize=True)
    H -= H[:, board] @ np.linalg.solve(H[board, board], H[board])
    c = np.r_[constants, camera]
    return H[np.ix_(c, c)], H[c, corners], H[corners, corners]
