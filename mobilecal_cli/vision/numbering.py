"""Boards that look the same when turned: all stations brought to agree on one numbering, by the motion.

The head's chain gives the vertical in the head's frame at every station, h_i = R_v_h^T z. Head and camera are
one rigid body and the board does not move, so with A = R_c_h and the vertical n in the board's frame

    A h_i = R_ci_k n

at all stations, however the base has turned. A station whose board is numbered from the other end has R_ci_k
turned by 180 degrees about the board's normal, and does not fit, unless the normal is vertical.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from mobilecal_cli.model import Board, FloatArray, IntArray, Observation, Rejection
from mobilecal_cli.vision.grid import turned, turns
from mobilecal_cli.vision.pose import absolute_orientation

_ROUNDS = 100
_SETTLED = 20  # rounds that A and n are given to follow the turns
_CLEAR_RAD = 0.15  # how much worse than the best numbering the second best must fit
_CLEAR_FACTOR = 3.0  # the same in units of the rms misfit
_RIVAL_RAD = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """One local minimum.

    Attributes:
        choice: (N,) index into the turns.
        misfit_rad: (N, turns) angle between A h_i and R_ci_k n for every turn.
    """

    choice: IntArray
    misfit_rad: FloatArray

    @property
    def rms_rad(self) -> float:
        """Misfit of the chosen numberings."""
        return float(np.sqrt(np.mean(self.misfit_rad[np.arange(len(self.choice)), self.choice] ** 2)))


def _turn(observation: Observation, board: Board, quarter_turns: int) -> Observation:
    """The same observation with the board numbered from another corner."""
    if quarter_turns == 0:
        return observation

    def renumber(values: FloatArray) -> FloatArray:
        return turned(values, board.columns, board.rows, quarter_turns)

    square_m = observation.square_m if board.square_m is None else board.square_m
    grid_m = square_m * board.grid()
    T_k_turned = absolute_orientation(renumber(grid_m), grid_m)
    left, right = (
        replace(corners, pixels=renumber(corners.pixels), relative_cov=renumber(corners.relative_cov))
        for corners in (observation.left, observation.right)
    )
    return replace(
        observation,
        left=left,
        right=right,
        points_c=renumber(observation.points_c),
        points_cov=renumber(observation.points_cov),
        T_c_k=observation.T_c_k @ T_k_turned,
    )


def _rotation_between(a: FloatArray, b: FloatArray) -> FloatArray:
    """R with a ~ R b for unit vectors (N, 3), by singular value decomposition (Wahba's problem)."""
    U, _, Vt = np.linalg.svd(a.T @ b)
    R: FloatArray = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    return R


def _fit(R_c_k: FloatArray, vertical_h: FloatArray, choice: IntArray, vertical_k: FloatArray) -> _Fit:
    """Alternate between A, n and the turns from a start: R_c_k is (turns, N, 3, 3)."""
    stations = np.arange(len(vertical_h))
    misfit = np.zeros((len(stations), len(R_c_k)))
    for round_ in range(_ROUNDS):
        A = _rotation_between(R_c_k[choice, stations] @ vertical_k, vertical_h)
        vertical_c = vertical_h @ A.T
        backward = np.einsum("nji,nj->ni", R_c_k[choice, stations], vertical_c).mean(axis=0)
        vertical_k = backward / max(float(np.linalg.norm(backward)), 1e-12)
        cosine = np.einsum("tnij,j,ni->nt", R_c_k, vertical_k, vertical_c)
        misfit = np.arccos(np.clip(cosine, -1, 1))
        best = np.argmin(misfit, axis=1)
        if np.array_equal(best, choice) and round_ > _SETTLED:
            break
        choice = best
    return _Fit(choice, misfit)


def settle_numbering(
    observations: Sequence[Observation], R_v_h: FloatArray, board: Board
) -> tuple[tuple[Observation, ...], tuple[Rejection, ...]]:
    """Bring all stations to one numbering of the board.

    Args:
        observations: of all stations, any number of logs (the board stands upright in the same way in all).
        R_v_h: (N, 3, 3) head to vehicle rotation at each of them.
        board: the board.

    Returns:
        The observations in one numbering (which of the possible ones is of no consequence), and a rejection
        for each whose numbering the motion does not tell. A board with markers, or whose counts differ in parity, is
        unambiguous: its observations come back as they are.
    """
    possible = turns(board.columns, board.rows)
    if board.markers is not None or len(possible) == 1 or len(observations) < 2:
        return tuple(observations), ()
    R_k_turned = [
        absolute_orientation(turned(board.grid(), board.columns, board.rows, k), board.grid())[:3, :3]
        for k in possible
    ]
    seen = np.stack([o.T_c_k[:3, :3] for o in observations])
    R_c_k = np.stack([seen @ R for R in R_k_turned])
    vertical_h = np.asarray(R_v_h)[:, 2, :]
    # First guess: each station numbered so that the board is turned least against the first station's view.
    relative = np.einsum("ji,tnjk->tnik", seen[0], R_c_k)
    nearest = np.argmax(np.trace(relative, axis1=2, axis2=3), axis=0)
    starts = [np.array(s, dtype=np.float64) for s in product((-1, 0, 1), repeat=3) if any(s)]
    fits = [_fit(R_c_k, vertical_h, nearest, s / np.linalg.norm(s)) for s in starts]
    best = min(fits, key=lambda fit: fit.rms_rad)
    count = len(possible)
    chosen = (best.choice - best.choice[0]) % count
    ordered = np.sort(best.misfit_rad, axis=1)
    gap = ordered[:, 1] - ordered[:, 0]
    needed = max(_CLEAR_RAD, _CLEAR_FACTOR * best.rms_rad)
    told = (gap > needed) & (ordered[:, 0] < needed)
    for rival in fits:
        if rival.rms_rad <= max(2 * best.rms_rad, _RIVAL_RAD):
            told &= (rival.choice - rival.choice[0]) % count == chosen
            # A rival to which numberings make no difference (the board's normal vertical) explains all of them.
            rival_order = np.sort(rival.misfit_rad, axis=1)
            told &= rival_order[:, 1] - rival_order[:, 0] > _RIVAL_RAD
    settled = tuple(
        _turn(o, board, possible[k]) for o, k, good in zip(observations, chosen, told, strict=True) if good
    )
    rejections = tuple(
        Rejection(
            "vision",
            "board's numbering cannot be told",
            f"a board of {board.columns} x {board.rows} looks the same when turned by {360 // count} degrees; "
            f"the motion prefers one numbering by {np.degrees(g):.1f} degrees, need {np.degrees(needed):.1f}",
            o.time_ns,
            o.station,
            o.log,
        )
        for o, g, good in zip(observations, gap, told, strict=True)
        if not good
    )
    return settled, rejections
