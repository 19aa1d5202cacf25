"""Places of the board's corners: the errors of print and plate, as few constants as a recording is sensitive to.

Every corner may be off its place, in the plane and across it. Each station's board pose follows these 3 M numbers
linearly, ``delta_n = K_n e``, and what moves all poses alike is the board's own pose. The singular vectors of the rest,
stacked over the stations and in units of the prior, fall off fast: the first few hold all that matters, and only these
are estimated. What the others leave in the images counts as corner noise.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.likelihood.dataset import Dataset
from mobilecal_cli.likelihood.effects import BoardEffect
from mobilecal_cli.likelihood.nuisance import Constant, kind
from mobilecal_cli.likelihood.state import State
from mobilecal_cli.likelihood.views import corner_residuals, whitened
from mobilecal_cli.model import FloatArray, Parameters, WheelGeometry

KIND = "board_corners"
_ACROSS = 2.0  # sigma across the board, in sigmas in the plane
_MOST_STATIONS = 100  # that the modes are made from
_POSE = np.array([1.75e-4] * 3 + [3e-4] * 3)  # rad, m: 0.01 degrees and 0.3 mm
_FELT = 0.02  # of these; smaller effects on a station's pose, root mean square, are left out


@dataclass(frozen=True, slots=True, eq=False)
class CornerMode(BoardEffect):
    """One pattern of displaced corners: (M, 3), m, for a value of 1 m."""

    pattern: FloatArray

    def displacement(self, points_k: FloatArray) -> FloatArray:
        """The pattern."""
        return self.pattern


def corner_modes(data: Dataset) -> Iterator[Constant]:
    """Rows of the patterns that move the stations' board poses, the strongest first.

    Args:
        data: cameras and board as stated, and each station's board pose.
    """
    if data.posed.all():
        return
    every = np.arange(0, data.stations, max(1, data.stations // _MOST_STATIONS))
    plain, T = data.with_constants(()), data.T_c_k[every]
    anywhere = Parameters(np.eye(4), WheelGeometry(1.0, 1.0, 1.0)), np.eye(4)[None]
    state = State.without_errors(plain, *anywhere, np.zeros((data.stations, 3)))
    _, J = corner_residuals(plain, state, T, every)
    J = np.where(data.seen[every][:, None, ..., None], whitened(data.whitening[every], J), 0.0)
    by_corner = np.einsum("npcmx,npq->nqcmx", J[:, 3:6], T[:, :3, :3])
    G = np.einsum("nacmx,nbcmx->nab", J, J)
    across = np.einsum("nacmx,nqcmx->namq", J, by_corner).reshape(len(every), 6, -1)
    K = se3.adjoint(se3.inverse(T)) @ np.linalg.pinv(G, hermitian=True) @ across
    scale = np.tile([1.0, 1.0, _ACROSS], data.points_k.shape[0])
    sigma = kind(KIND).sigma
    _, board, count = np.unique(data.log[every], return_inverse=True, return_counts=True)
    common = np.zeros((len(count), *K.shape[1:]))
    np.add.at(common, board, K / count[board, None, None])
    felt = (K - common[board]) / _POSE[:, None] * (sigma * scale)
    _, size, modes = np.linalg.svd(felt.reshape(-1, len(scale)), full_matrices=False)
    for number, (mode, s) in enumerate(zip(modes, size / np.sqrt(len(every)), strict=True), 1):
        if s > _FELT:
            effect = CornerMode((mode * scale).reshape(-1, 3))
            yield Constant(
                f"{KIND}_{number}", KIND, "board", f"places of the corners, pattern {number}", effect, sigma
            )
