"""Numbering of boards that look the same when rotated, resolved by the motion."""

import numpy as np
import pytest

from mobilecal_cli import se3
from mobilecal_cli.model.observations import Corners, Observation
from mobilecal_cli.model.rig import Board
from mobilecal_cli.vision import resolve_numbering
from mobilecal_cli.vision.grid import turned
from tests.vision.scenes import K

SQUARE_M = 0.06
# Head axes: x forward, y left, z up; the camera looks forward, and is mounted a little askew.
R_H_C = se3.exp_so3(np.array([0.05, -0.1, 0.08])) @ np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
# Board: x to the right, y down, z away from the base.
UPRIGHT = np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]])
LYING = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])


def observed(
    station: int, points: np.ndarray, T: np.ndarray, cov: np.ndarray, pixels: np.ndarray | None = None
) -> Observation:
    """Both cameras see the board where the first one sees points (M, 3)."""
    corners = Corners((points @ K.T)[:, :2] / points[:, 2:] if pixels is None else pixels, 0.1, 1)
    none, pose_cov = np.zeros(0), 1e-6 * np.eye(6)
    measured = (corners, corners), points, cov, T, pose_cov, SQUARE_M, 0.1
    return Observation(0, station, 1000 * station, True, none, none, *measured)


def world(
    board: Board, R_w_k: np.ndarray, count: int, rng: np.random.Generator, moves: bool = True
) -> tuple[list[Observation], np.ndarray]:
    """Observations in the true numbering, and R_v_h; pose errors of half a degree. The head moves, or is at rest."""
    cov = np.tile(1e-6 * np.eye(3), (board.corners, 1, 1)) * np.arange(1, board.corners + 1)[:, None, None]
    observations, heads = [], []
    for i in range(count):
        R_w_v = se3.rotation_z(np.array(rng.uniform(-0.6, 0.6)))
        R_v_h = se3.from_rpy(moves * np.array([0.0, rng.uniform(-0.3, 0.3), rng.uniform(-0.5, 0.5)]))
        R_c_k = (R_w_v @ R_v_h @ R_H_C).T @ R_w_k @ se3.exp_so3(rng.normal(0, 0.009, 3))
        T = se3.transform(R_c_k, rng.uniform([-0.3, -0.2, 1.0], [0.3, 0.2, 2.0]))
        observations.append(observed(i, se3.act(T, SQUARE_M * board.grid()), T, cov))
        heads.append(R_v_h)
    return observations, np.array(heads)


def renumbered(observation: Observation, board: Board, k: int) -> Observation:
    """As if the detector had started from another corner."""
    points = turned(observation.points_c, board, k)
    grid = points.reshape(board.rows, board.columns, 3)
    x, y = (grid[0, -1] - grid[0, 0]), (grid[-1, 0] - grid[0, 0])
    x, y = x / np.linalg.norm(x), y / np.linalg.norm(y)
    T = se3.transform(np.column_stack([x, y, np.cross(x, y)]), points[0])
    cov, pixels = (turned(v, board, k) for v in (observation.points_cov, observation.views[0].pixels))
    return observed(observation.station, points, T, cov, pixels)


def same_numbering(resolved: tuple[Observation, ...], truth: list[Observation], board: Board) -> bool:
    """All stations differ from the truth by one and the same turn, in all their parts."""
    for k in range(4) if board.columns == board.rows else (0, 2):
        wanted = [renumbered(o, board, k) for o in truth if o.station in {s.station for s in resolved}]
        both = list(zip(resolved, wanted, strict=True))
        if all(np.allclose(s.points_c, w.points_c, atol=1e-12) for s, w in both):
            for s, w in both:
                np.testing.assert_allclose(s.T_c_k, w.T_c_k, atol=1e-9)
                np.testing.assert_array_equal(s.views[0].pixels, w.views[0].pixels)
                np.testing.assert_array_equal(s.views[1].pixels, w.views[1].pixels)
                np.testing.assert_array_equal(s.points_cov, w.points_cov)
            return True
    return False


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize(("columns", "rows"), [(8, 6), (7, 7), (8, 8), (9, 7)])
@pytest.mark.parametrize("square_known", [False, True])
def test_upright_board(seed: int, columns: int, rows: int, square_known: bool) -> None:
    board = Board(columns, rows, SQUARE_M if square_known else None)
    rng = np.random.default_rng(seed)
    truth, heads = world(board, UPRIGHT, 10, rng)
    choices = [0, 1, 2, 3] if (columns, rows) == (8, 8) else [0, 2]
    mixed = [renumbered(o, board, int(rng.choice(choices))) for o in truth]
    resolved, rejections = resolve_numbering(mixed, heads, board)
    assert rejections == ()
    assert len(resolved) == 10
    assert same_numbering(resolved, truth, board)


def test_odd_board_comes_back_as_it_was() -> None:
    board = Board(9, 6)
    truth, heads = world(board, UPRIGHT, 4, np.random.default_rng(0))
    resolved, rejections = resolve_numbering(truth, heads, board)
    assert all(a is b for a, b in zip(resolved, truth, strict=True))
    assert rejections == ()


def test_board_lying_on_the_floor_cannot_be_told() -> None:
    board = Board(8, 6)
    truth, heads = world(board, LYING, 10, np.random.default_rng(1))
    resolved, rejections = resolve_numbering(truth, heads, board)
    assert resolved == ()
    assert len(rejections) == 10
    assert rejections[4].reason == "board orientation ambiguous"
    assert (rejections[4].station, rejections[4].time_ns) == (4, 4000)
    assert "8 x 6 looks the same when rotated by 180 degrees" in rejections[4].detail


def test_head_that_never_moves() -> None:
    board = Board(8, 6)
    rng = np.random.default_rng(2)
    still, heads = world(board, UPRIGHT, 10, rng, moves=False)
    mixed = [renumbered(o, board, int(rng.choice([0, 2]))) for o in still]
    resolved, rejections = resolve_numbering(mixed, heads, board)
    assert rejections == ()
    assert same_numbering(resolved, still, board)
