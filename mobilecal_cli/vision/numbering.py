"""Consistent numbering over all stations of a board that looks the same when rotated, from the motion.

The head chain gives the vertical in the head frame at every station, h_i = R_v_h^T z. Head and camera are one
rigid body and the board does not move. With A = R_c_h and the vertical n in the board frame,

    A h_i = R_ci_k n

holds at all stations, for any motion of the base. If a board is numbered from the opposite corner, R_ci_k is
rotated by 180 degrees about the board's normal, and the equation does not hold unless the normal is vertical.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import numpy as np

from mobilecal_cli.model import Board, FloatArray, IntArray, Observation, Rejection
from mobilecal_cli.vision.grid import turned, turned_view, turns
from mobilecal_cli.vision.pose import absolute_orientation, rotation_between

AMBIGUOUS = "board orientation ambiguous"
_ROUNDS = 100  # a few more than the least are usual
_LEAST_ROUNDS = 20  # least number of iterations, so that A and n can follow the turns
_CLEAR_RAD = 0.15  # least difference in misfit between the best and the second-best numbering
_CLEAR_FACTOR = 3.0  # the same, in units of the rms misfit
_RIVAL_RAD = 0.02  # misfit of another numbering that noise explains


@dataclass(frozen=True, slots=True, eq=False)
class _Fit:
    """One local minimum.

    Attributes:
        choice: (N,) index into the turns.
        misfit_rad: (N, turns) angle between A h_i and R_ci_k n for every turn, rad.
    """

    choice: IntArray
    misfit_rad: FloatArray

    @property
    def rms_rad(self) -> float:
        """Misfit of the chosen numberings, rad."""
        return float(np.sqrt(np.mean(self.misfit_rad[np.arange(len(self.choice)), self.choice] ** 2)))

    @property
    def relative(self) -> IntArray:
        """(N,) index of each station's turn from that of the first."""
        return np.asarray((self.choice - self.choice[0]) % self.misfit_rad.shape[1])

    @property
    def gap_rad(self) -> FloatArray:
        """(N,) difference in misfit between the two best turns, rad."""
        ordered = np.sort(self.misfit_rad, axis=1)
        return np.asarray(ordered[:, 1] - ordered[:, 0])


def _turn(observation: Observation, board: Board, quarter_turns: int) -> Observation:
    """The same observation with the board numbered from another corner."""
    if quarter_turns == 0:
        return observation
    grid_m = (board.square_m or observation.square_m) * board.grid()
    return replace(
        observation,
        views=tuple(turned_view(view, board, quarter_turns) for view in observation.views),
        points_c=turned(observation.points_c, board, quarter_turns),
        points_cov=turned(observation.points_cov, board, quarter_turns),
        T_c_k=observation.T_c_k @ absolute_orientation(turned(grid_m, board, quarter_turns), grid_m),
    )


def _fit(R_c_k: FloatArray, vertical_h: FloatArray, choice: IntArray, vertical_k: FloatArray) -> _Fit:
    """Alternate between A, n and the turns from an initial estimate; R_c_k is (turns, N, 3, 3)."""
    stations = np.arange(len(vertical_h))
    misfit = np.zeros((len(stations), len(R_c_k)))
    for round_ in range(_ROUNDS):
        A = rotation_between(R_c_k[choice, stations] @ vertical_k, vertical_h)
        vertical_c = vertical_h @ A.T
        backward = np.einsum("nji,nj->ni", R_c_k[choice, stations], vertical_c).mean(axis=0)
        vertical_k = backward / max(float(np.linalg.norm(backward)), 1e-12)
        cosine = np.einsum("tnij,j,ni->nt", R_c_k, vertical_k, vertical_c)
        misfit = np.arccos(np.clip(cosine, -1, 1))
        best = np.argmin(misfit, axis=1)
        if np.array_equal(best, choice) and round_ > _LEAST_ROUNDS:
            break
        choice = best
    return _Fit(choice, misfit)


def resolve_numbering(
    observations: Sequence[Observation], R_v_h: FloatArray, board: Board
) -> tuple[tuple[Observation, ...], tuple[Rejection, ...]]:
    """Bring all stations to a common numbering of the board.

    Args:
        observations: of all stations, from any number of recordings (the board must have the same vertical in
            all).
        R_v_h: (N, 3, 3) head to vehicle rotation at each station.
        board: the board.

    Returns:
        The observations in a common numbering (any of the equivalent ones), and a rejection for each station
        whose numbering the motion does not determine. A board with markers, or with counts of different
        parity, is unambiguous: its observations are returned unchanged.
    """
    possible = turns(board)
    if len(possible) == 1 or len(observations) < 2:
        return tuple(observations), ()
    grid = board.grid()
    R_k_turned = [absolute_orientation(turned(grid, board, k), grid)[:3, :3] for k in possible]
    R_c_k_found = np.stack([o.T_c_k[:3, :3] for o in observations])
    R_c_k = np.stack([R_c_k_found @ R for R in R_k_turned])
    vertical_h = np.asarray(R_v_h)[:, 2, :]
    # Initial estimate: the numbering of each station that rotates the board least against the first station's view.
    relative = np.einsum("ji,tnjk->tnik", R_c_k_found[0], R_c_k)
    nearest = np.argmax(np.trace(relative, axis1=2, axis2=3), axis=0)
    starts = [np.array(s, dtype=np.float64) for s in product((-1, 0, 1), repeat=3) if any(s)]
    fits = [_fit(R_c_k, vertical_h, nearest, s / np.linalg.norm(s)) for s in starts]
    best = min(fits, key=lambda fit: fit.rms_rad)
    needed = max(_CLEAR_RAD, _CLEAR_FACTOR * best.rms_rad)
    told = (best.gap_rad > needed) & (best.misfit_rad.min(axis=1) < needed)
    for rival in fits:
        if rival.rms_rad <= max(2 * best.rms_rad, _RIVAL_RAD):
            told &= rival.relative == best.relative
            # Equal misfit for all numberings (vertical board normal) makes every station ambiguous.
            told &= rival.gap_rad > _RIVAL_RAD
    chosen = zip(observations, best.relative, told, strict=True)
    numbered = tuple(_turn(o, board, possible[k]) for o, k, good in chosen if good)
    rejections = tuple(
        Rejection(
            "vision",
            AMBIGUOUS,
            f"a board of {board.columns} x {board.rows} looks the same when rotated by {360 // len(possible)} degrees; "
            f"the misfits of the two best orientations differ by {np.degrees(g):.1f} degrees, "
            f"minimum {np.degrees(needed):.1f}",
            o.time_ns,
            o.station,
            o.log,
        )
        for o, g, good in zip(observations, best.gap_rad, told, strict=True)
        if not good
    )
    return numbered, rejections
