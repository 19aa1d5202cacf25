"""Places of the board's corners: the errors of print and plate, as few constants as a recording is sensitive to.

Every corner may be off its place, in the plane and across it: 3 M numbers e. What they do to the images is in part the
same as a motion of the board at each station, in part the same as constants of the cameras, and for the rest it counts
as corner noise. Only the patterns that matter for one of the first two are estimated:

- Each station's board pose follows e linearly, ``delta_n = K_n e``; what moves all poses alike is the board's own pose.
  The singular vectors of the rest, stacked over the stations and in units of the prior, fall off fast.
- With the board's poses projected out, the cameras' constants c and the corners e have the informations ``H_cc`` and
  ``H_ee`` (with priors) and share ``H_ce``. A direction of c with the canonical correlation rho, a singular value of
  ``H_cc^-1/2 H_ce H_ee^-1/2``, has a variance that e makes 1 / (1 - rho^2) times larger, by its column of
  ``H_ee^-1/2 V`` alone.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import solve_triangular

from mobilecal_cli import se3
from mobilecal_cli.likelihood.dataset import Dataset
from mobilecal_cli.likelihood.effects import BoardEffect, CameraEffect
from mobilecal_cli.likelihood.nuisance import Constant, kind
from mobilecal_cli.likelihood.state import State
from mobilecal_cli.likelihood.views import corner_residuals, whitened
from mobilecal_cli.model import FloatArray, IntArray, Parameters, WheelGeometry

KIND = "board_corners"
_ACROSS = 2.0  # sigma across the board, in sigmas in the plane
_MOST_STATIONS = 100  # that the modes are made from
_POSE = np.array([1.75e-4] * 3 + [3e-4] * 3)  # rad, m: 0.01 degrees and 0.3 mm
_FELT = 0.02  # of these; smaller effects on a station's pose, root mean square, are left out
_CORRELATED = 0.5  # canonical correlation; a smaller one understates a sigma by less than 15 %
_PIXEL_PX = 0.1  # noise of a usual corner
_NEW = 0.1  # sine of the angle to all patterns that are there already


@dataclass(frozen=True, slots=True, eq=False)
class CornerMode(BoardEffect):
    """One pattern of displaced corners: (M, 3), m, for a value of 1 m."""

    pattern: FloatArray

    def displacement(self, points_k: FloatArray) -> FloatArray:
        """The pattern."""
        return self.pattern


def corner_modes(data: Dataset, rows: Sequence[Constant]) -> Iterator[Constant]:
    """Rows of the patterns that matter for the stations' board poses, or for the cameras' constants.

    Args:
        data: cameras and board as stated, and each station's board pose.
        rows: the other constants that are estimated.
    """
    if data.posed.all():
        return
    cameras = [row for row in rows if isinstance(row.effect, CameraEffect)]
    every = np.arange(0, data.stations, max(1, data.stations // _MOST_STATIONS))
    plain, T = data.with_constants(cameras), data.T_c_k[every]
    anywhere = Parameters(np.eye(4), WheelGeometry(1.0, 1.0, 1.0)), np.eye(4)[None]
    state = State.without_errors(plain, *anywhere, np.zeros((data.stations, 3)))
    _, J = corner_residuals(plain, state, T, every)
    J = np.where(data.seen[every][:, None, ..., None], whitened(data.whitening[every], J), 0.0)
    J *= np.sqrt(data.stations / len(every)) / _PIXEL_PX
    scale = kind(KIND).sigma * np.tile([1.0, 1.0, _ACROSS], data.points_k.shape[0])
    by_corner = np.einsum("npcmx,npq->nqcmx", J[:, 3:6], T[:, :3, :3])
    G = np.einsum("nacmx,nbcmx->nab", J, J, optimize=True)
    E = np.einsum("nacmx,nqcmx->namq", J, by_corner).reshape(*J.shape[:2], -1) * scale
    of_pose = np.linalg.pinv(G[:, :6, :6], hermitian=True)
    K = of_pose @ E[:, :6]
    modes = _felt(se3.adjoint(se3.inverse(T)) @ K, data.log[every])

    # Both informations for known poses, less what the poses hold of them.
    H_ee = np.eye(len(scale)) - np.tensordot(E[:, :6], K, ((0, 1), (0, 1)))
    for m, block in enumerate(np.einsum("nqcmx,nrcmx->mqr", by_corner, by_corner)):
        mine = slice(3 * m, 3 * m + 3)
        H_ee[mine, mine] += block * np.outer(scale[mine], scale[mine])
    H_cc = np.sum(G[:, 6:, 6:] - G[:, 6:, :6] @ of_pose @ G[:, :6, 6:], axis=0)
    H_cc += np.diag([row.sigma**-2 for row in cameras])
    H_ce = np.sum(E[:, 6:] - G[:, 6:, :6] @ K, axis=0)
    L_c, L_e = np.linalg.cholesky(H_cc), np.linalg.cholesky(H_ee)
    shared = solve_triangular(L_c, solve_triangular(L_e, H_ce.T, lower=True).T, lower=True)
    _, rho, V = np.linalg.svd(shared, full_matrices=False)
    for pattern in solve_triangular(L_e.T, V[rho > _CORRELATED].T).T:
        rest = pattern - modes.T @ (modes @ pattern)
        if np.linalg.norm(rest) > _NEW * np.linalg.norm(pattern):
            modes = np.concatenate([modes, rest[None] / np.linalg.norm(rest)])
    for number, mode in enumerate(modes, 1):
        effect = CornerMode((mode * scale / kind(KIND).sigma).reshape(-1, 3))
        yield Constant(
            f"{KIND}_{number}",
            KIND,
            "board",
            f"places of the corners, pattern {number}",
            effect,
            kind(KIND).sigma,
        )


def _felt(moved: FloatArray, log: IntArray) -> FloatArray:
    """Orthonormal patterns (K, 3 M), in units of the prior, that move the board against itself, the strongest first.

    Args:
        moved: (N, 6, 3 M) the board's poses in its own frame.
        log: (N,) the recording of each station.
    """
    _, board, count = np.unique(log, return_inverse=True, return_counts=True)
    common = np.zeros((len(count), *moved.shape[1:]))
    np.add.at(common, board, moved / count[board, None, None])
    felt = (moved - common[board]) / _POSE[:, None]
    _, size, modes = np.linalg.svd(felt.reshape(-1, moved.shape[2]), full_matrices=False)
    return np.asarray(modes[size / np.sqrt(len(log)) > _FELT])
