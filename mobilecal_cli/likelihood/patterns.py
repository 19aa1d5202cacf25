"""Errors of many numbers: what lenses do beside their distortion, and places of the board's corners.

Every lens does more than the terms of its distortion say, in waves over the image; all of them are estimated. Every
corner of the board may be off its place, by print and plate, in the plane and across it. What such errors e do to the
images counts as corner noise, but for the patterns that would spoil the result: the constants of cameras and board, and
the camera's pose, together c. With the board's pose eliminated, and with it that at each station, which is tied to what
joints, wheels and floor say of it, c and e have the informations ``H_cc`` and ``H_ee`` (with priors) and share
``H_ce``. An estimate with some patterns, the orthonormal columns of M in units of the prior, states the information ::

    I = H_cc - B M^T H_ec,    B = H_ce M (M^T H_ee M)^-1,

and what is left of e, of unit variance across M, adds ``D D^T`` with ``D = (H_ce - B M^T H_ee) (1 - M M^T)`` to the
variance I of its right side. The largest generalized eigenvalue of ``(D D^T, I)`` is by how much the variance of a
direction w of c is understated; with the pattern ``H_ee^-1 H_ec w``, ``w^T D`` is zero. The patterns of all
directions whose variance is understated by much are added at once, until there are none.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial

import numpy as np
from scipy.linalg import block_diag, eigh

from mobilecal_cli import se3
from mobilecal_cli.camera import lens_terms_up_to
from mobilecal_cli.likelihood.constants import PATTERNS, Constant, kind_of
from mobilecal_cli.likelihood.corners import corner_residuals, whitened
from mobilecal_cli.likelihood.dataset import Dataset
from mobilecal_cli.likelihood.effects import BoardEffect, CameraEffect, ImageEffect
from mobilecal_cli.likelihood.measurements import BY_STATION
from mobilecal_cli.likelihood.state import State
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.calibration import Parameters
from mobilecal_cli.model.rig import WheelGeometry, camera_words

_CORNERS, _LENS = "board_corners", "lens_waves"
#: Of the variance of a direction: a sigma by 2.5 %.
UNDERSTATED = 0.05
_ACROSS = 2.0  # sigma across the board, in sigmas in the plane
_WAVES_RMS = 1.6  # amplitude of each of n waves, in the rms over the image of all together over sqrt(n)
# Half waves over the image of the shortest waves that are estimated; and in sharp images, which show what shorter waves
# do to the result: with all of their prior where corners are as exact as the first, px, and ever less to the second.
_HALF_WAVES, _HALF_WAVES_IF_SHARP, _SHARP_PX = 4, 6, (0.025, 0.03)
_MOST_STATIONS = 100  # that the patterns are made from
_TIED = np.array([1.75e-4] * 3 + [3e-4] * 3)  # rad, m: 0.01 degrees and 0.3 mm of a station's board pose
_ANYWHERE = 1e3 * _TIED  # of camera and board
_MOST_PX = 0.1  # noise of a usual corner; a smaller one shows more of the patterns
_WIDER = 10.0  # priors of contradicted constants become so much wider


def patterns(data: Dataset, rows: Sequence[Constant]) -> Iterator[Constant]:
    """Rows of all waves of the lenses, and of the patterns of corners that matter for all else in the images.

    Args:
        data: cameras and board as stated, and each station's board pose.
        rows: the other constants that are estimated.
    """
    if data.posed:
        return
    lenses = list(_of_lenses(data))
    yield from lenses
    sigmas = np.tile([1.0, 1.0, _ACROSS], data.points_k.shape[0])
    # Waves and displaced corners may look alike.
    for number, mode in enumerate(_modes(*_informations(data, [*rows, *lenses], sigmas)), 1):
        effect = BoardEffect(partial(_displaced, pattern=(mode * sigmas).reshape(-1, 3)))
        meaning = f"places of the corners, pattern {number}"
        yield Constant(f"{_CORNERS}_{number}", _CORNERS, "board", meaning, effect, kind_of(_CORNERS).sigma)


def _of_lenses(data: Dataset) -> Iterator[Constant]:
    shown = np.interp(data.claimed_px, _SHARP_PX, (1.0, 0.0))
    count = lens_terms_up_to(_HALF_WAVES_IF_SHARP if shown else _HALF_WAVES) - 4
    shares = np.where(np.arange(count) < lens_terms_up_to(_HALF_WAVES) - 4, 1.0, shown)
    amplitudes = _WAVES_RMS / np.sqrt(np.sum(shares**2) / 2) * np.diag(shares)
    for camera, name in enumerate(data.cameras.names):
        if not data.seen[:, camera].any():
            continue
        for number, wave in enumerate(amplitudes, 1):
            along = CameraEffect("lens", (0.0,) * 4 + tuple(wave.tolist()), camera)
            part, meaning = camera_words(name), f"waves over the image, {number}"
            yield Constant(f"{_LENS}_{name}_{number}", _LENS, part, meaning, along, kind_of(_LENS).sigma)


def _displaced(points_k: FloatArray, pattern: FloatArray) -> FloatArray:
    """The pattern (M, 3), m, for a value of 1 m."""
    return pattern


def _modes(H_cc: FloatArray, H_ce: FloatArray, H_ee: FloatArray) -> FloatArray:
    """Orthonormal patterns (K, E), in units of the prior."""
    modes, mending = np.zeros((0, len(H_ee))), np.linalg.solve(H_ee, H_ce.T)
    while len(modes) < min(H_ce.shape):
        B = np.linalg.solve(modes @ H_ee @ modes.T, modes @ H_ce.T).T
        D = H_ce - B @ modes @ H_ee
        D -= D @ modes.T @ modes
        excess, directions = eigh(D @ D.T, H_cc - B @ modes @ H_ce.T)
        understated = mending @ directions[:, excess >= UNDERSTATED]
        if not understated.size:
            break
        modes = np.linalg.qr(np.concatenate([modes.T, understated], axis=1))[0].T
    return modes


def _informations(
    data: Dataset, rows: Sequence[Constant], sigmas: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """``H_cc``, ``H_ce`` and ``H_ee`` of constants and camera pose c, and of the places of corners e.

    Args:
        data: cameras and board as stated, and each station's board pose.
        rows: all constants.
        sigmas: (3 M,) of the places, in sigmas of the kind.
    """
    in_images = [row for row in rows if isinstance(row.effect, ImageEffect)]
    wider = np.array([1.0 if row.kind in PATTERNS else _WIDER for row in in_images])
    known = (wider * [row.sigma for row in in_images]) ** -2
    every = slice(None, None, max(1, data.stations // _MOST_STATIONS))
    some = replace(data, **{name: getattr(data, name)[every] for name in BY_STATION})
    T, each = some.T_c_k, data.stations / some.stations  # stations that one of these stands for
    anywhere = Parameters(np.eye(4), WheelGeometry(1.0, 1.0, 1.0)), np.eye(4)[None]
    state = State.without_errors(some.with_constants(in_images), *anywhere, np.zeros((some.stations, 3)))
    J = whitened(some.whitening, corner_residuals(state, T)[1]) * np.sqrt(each)
    J /= min(data.claimed_px, _MOST_PX)
    J[~some.seen] = 0.0
    # About (delta, constants); shared with the places of the board's corners; and about these.
    G = np.asarray(np.einsum("ncmxa,ncmxb->nab", J, J, optimize=True))
    scale = kind_of(_CORNERS).sigma * sigmas
    by_corner = J[..., 3:6] @ T[:, None, None, :3, :3]
    shared = np.einsum("ncmxa,ncmxq->namq", J, by_corner, optimize=True)
    shared = shared.reshape(*shared.shape[:2], -1) * scale
    of_corners = np.einsum("ncmxq,ncmxr->mqr", by_corner, by_corner, optimize=True)
    among = block_diag(*of_corners) * np.outer(scale, scale)

    # A board pose is tied to what joints, wheels and floor say of it, up to the poses of camera and board.
    _, recording = np.unique(some.log, return_inverse=True)
    of_board = np.einsum("nl,nab->nalb", np.eye(recording.max() + 1)[recording], se3.adjoint(T))
    moved = np.concatenate(
        [np.broadcast_to(np.eye(6), (len(T), 6, 6)), of_board.reshape(len(T), 6, -1)], axis=2
    )
    tie = each * np.diag(_TIED**-2)
    with_pose = np.concatenate([G[:, :6, 6:], -tie @ moved, shared[:, :6]], axis=2)

    sizes = (len(known), 6, moved.shape[2] - 6, len(among))
    constants, camera, board, errors = (
        slice(end - size, end) for size, end in zip(sizes, np.cumsum(sizes), strict=True)
    )
    poses = slice(camera.start, board.stop)
    H = np.zeros((sum(sizes), sum(sizes)))
    H[constants, constants] = G[:, 6:, 6:].sum(axis=0) + np.diag(known)
    H[constants, errors] = shared[:, 6:].sum(axis=0)
    H[errors, constants] = H[constants, errors].T
    H[poses, poses] = np.sum(moved.mT @ tie @ moved, axis=0)
    H[poses, poses] += np.diag(np.tile(_ANYWHERE**-2, moved.shape[2] // 6))
    H[errors, errors] = np.eye(len(among)) + among
    of_pose = np.linalg.inv(G[:, :6, :6] + tie)
    H -= np.einsum("nax,nab,nby->xy", with_pose, of_pose, with_pose, optimize=True)
    H -= H[:, board] @ np.linalg.solve(H[board, board], H[board])
    c = np.r_[constants, camera]
    return H[np.ix_(c, c)], H[c, errors], H[errors, errors]
