"""The board's corners as a grid: spacing, orientation, and numbering, in an image and over all stations.

A board that looks the same when rotated is numbered by the motion. The head chain gives the vertical in the head frame
at every station, h_i = R_v_h^T z. Head and camera are one rigid body and the board does not move. With A = R_c_h and
the vertical n in the board frame,

    A h_i = R_ci_k n

holds at all stations, for any motion of the base. If a board is numbered from the opposite corner, R_ci_k is
rotated by 180 degrees about the board's normal, and the equation does not hold unless the normal is vertical.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product

import cv2
import numpy as np

from mobilecal_cli.model.arrays import FloatArray, GrayImage, IntArray
from mobilecal_cli.model.observations import Corners, Observation
from mobilecal_cli.model.rig import Board
from mobilecal_cli.model.signals import Reason, Rejection
from mobilecal_cli.vision.pose import absolute_orientation, rotation_between

_ROUNDS = 100  # a few more than the least are usual
_LEAST_ROUNDS = 20  # least number of iterations, so that A and n can follow the turns
_CLEAR_RAD = 0.15  # least difference in misfit between the best and the second-best numbering
_CLEAR_FACTOR = 3.0  # the same, in units of the rms misfit
_RIVAL_RAD = 0.02  # misfit of another numbering that noise explains


def smallest_edge_px(grid: FloatArray) -> float:
    """Shortest distance between neighboring corners of (rows, columns, 2), px."""
    along, down = grid[:, 1:] - grid[:, :-1], grid[1:] - grid[:-1]
    return float(min(np.hypot(step[..., 0], step[..., 1]).min() for step in (along, down)))


def reduced(image: GrayImage, scale: float) -> GrayImage:
    """The image at a share of its size."""
    return np.asarray(cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8)


def at_full_size(corners: FloatArray, small: GrayImage, image: GrayImage) -> FloatArray:
    """(..., 2) px of an image, from those of the same image at reduced size."""
    ratio = np.array(image.shape[::-1]) / np.array(small.shape[::-1])
    return np.asarray((corners + 0.5) * ratio - 0.5, dtype=np.float64)


def right_handed(grid: FloatArray) -> FloatArray:
    """The same corners, (rows, columns, 2), with x cross y pointing away from the camera."""
    x = grid[:, -1].mean(axis=0) - grid[:, 0].mean(axis=0)
    y = grid[-1].mean(axis=0) - grid[0].mean(axis=0)
    return grid if x[0] * y[1] - x[1] * y[0] > 0 else grid[:, ::-1]


def turns(board: Board) -> tuple[int, ...]:
    """Quarter turns, 0 first, after which a board looks the same, including the square colors.

    Only 0 for a board with markers, or if the counts differ in parity, because opposite outer squares differ in color.
    Otherwise also a half turn; for a square board with even counts all quarter turns.
    """
    if board.markers is not None or (board.columns + board.rows) % 2:
        return (0,)
    return (0, 1, 2, 3) if board.columns == board.rows and board.columns % 2 == 0 else (0, 2)


def turned(values: FloatArray, board: Board, quarter_turns: int) -> FloatArray:
    """Corner values (M, ...) renumbered for a board rotated by one of its `turns` about its normal."""
    if quarter_turns == 0:
        return values
    grid = values.reshape(board.rows, board.columns, *values.shape[1:])
    return np.ascontiguousarray(np.rot90(grid, quarter_turns)).reshape(values.shape)


def turned_view(view: Corners, board: Board, quarter_turns: int) -> Corners:
    """The corners of an image, renumbered; see `turned`."""
    pixels, relative_cov = (turned(v, board, quarter_turns) for v in (view.pixels, view.relative_cov))
    return replace(view, pixels=pixels, relative_cov=relative_cov)


def canonical(grid: FloatArray, dark_at_origin: bool) -> tuple[IntArray, bool]:
    """Canonical order of the corners, as far as the square colors determine it.

    The outer square diagonally next to corner 0 is dark, if a rotation of the board can achieve that. Any
    remaining ambiguity (see `turns`) is resolved for now by pointing x as far to the right of the image as
    possible; `resolve_numbering` resolves it finally.

    Args:
        grid: (rows, columns, 2) right-handed, px.
        dark_at_origin: whether that square is dark in the given order.

    Returns:
        (rows * columns,) index of the given corner at each position, and whether that square is dark
        afterwards.
    """
    rows, columns = grid.shape[:2]
    order = np.arange(rows * columns).reshape(rows, columns)
    odd_square = columns == rows and columns % 2 == 1
    unambiguous = (columns + rows) % 2 == 1 or odd_square
    if not dark_at_origin and unambiguous:
        order = np.rot90(order, 1 if odd_square else 2)
    corners = grid.reshape(-1, 2)
    candidates = [np.rot90(order, k) for k in turns(Board(columns, rows))]
    best = max(candidates, key=lambda numbers: _x_direction(corners[numbers]))
    return np.ascontiguousarray(best, dtype=np.int64).ravel(), dark_at_origin or unambiguous


def _x_direction(grid: FloatArray) -> float:
    x = grid[:, -1].mean(axis=0) - grid[:, 0].mean(axis=0)
    return float(x[0] / np.linalg.norm(x))


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
            str(Reason.AMBIGUOUS),
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
