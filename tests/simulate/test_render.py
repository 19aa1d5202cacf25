"""Rendered corners, measured by an independent saddle point fit, against OpenCV's projection."""

import cv2
import numpy as np
import pytest
from scipy.ndimage import map_coordinates, spline_filter
from scipy.spatial.transform import Rotation

from mobilecal_cli.model.rig import Board, Camera
from mobilecal_cli.simulate.render import BoardRenderer
from mobilecal_cli.simulate.robot import PAPER_ROBOT

BOARD = Board(9, 6, 0.08)
CORNERS_K = BOARD.grid() * BOARD.square_m
BLUR_PX = 0.6
TRUE_TO_PX = 0.02


def saddles(picture, near, sigma_px=1.5, reach=3):
    """(M, 2) saddle points of a smoothed image, by a quadric in a window that is centered on each."""
    smooth = spline_filter(cv2.GaussianBlur(picture.astype(np.float64), (0, 0), sigma_px), order=5)
    dy, dx = (part.ravel() for part in np.mgrid[-reach : reach + 1, -reach : reach + 1].astype(float))
    quadric = np.linalg.pinv(np.stack([np.ones_like(dx), dx, dy, dx**2, dx * dy, dy**2], axis=1))
    found = []
    for at in near:
        for _ in range(8):
            grey = map_coordinates(smooth, [at[1] + dy, at[0] + dx], order=5, prefilter=False)
            _, x, y, xx, xy, yy = quadric @ grey
            at = at + np.linalg.solve([[2 * xx, xy], [xy, 2 * yy]], [-x, -y])
        found.append(at)
    return np.array(found)


def board_pose(distance_m, roll_deg=0.0, tilt_deg=0.0, yaw_deg=0.0, aside_m=(0.0, 0.0)):
    T_c_k = np.eye(4)
    angles = [roll_deg, tilt_deg, yaw_deg]
    T_c_k[:3, :3] = Rotation.from_euler("zxy", angles, degrees=True).as_matrix()
    T_c_k[:3, 3] = [*aside_m, distance_m] - T_c_k[:3, :3] @ CORNERS_K.mean(axis=0)
    return T_c_k


def projected(camera, T_c_k, points_k=CORNERS_K):
    rvec = cv2.Rodrigues(T_c_k[:3, :3])[0]
    return cv2.projectPoints(points_k, rvec, T_c_k[:3, 3], camera.K, camera.D)[0].reshape(-1, 2)


def renderer(camera, board=BOARD):
    return BoardRenderer(camera, board, BLUR_PX, np.random.default_rng(0))


@pytest.fixture(scope="module")
def lens():
    return PAPER_ROBOT.rig_cameras.each[1]


@pytest.fixture(scope="module")
def through_lens(lens):
    return renderer(lens)


@pytest.mark.parametrize(
    "T_c_k",
    [
        pytest.param(board_pose(1.3), id="frontal"),
        pytest.param(board_pose(1.6, 4, 25, -30), id="tilted"),
        pytest.param(board_pose(2.4, -8, -20, 15), id="far"),
        pytest.param(board_pose(1.7, 45, 10, 10), id="diagonal"),
        pytest.param(board_pose(1.7, 2, 5, 8, (0.35, 0.2)), id="in the corner"),
        pytest.param(board_pose(1.5, 180, 5, 5), id="upside down"),
    ],
)
def test_corners_are_where_geometry_puts_them(lens, through_lens, T_c_k):
    exact = projected(lens, T_c_k)
    grid = exact.reshape(BOARD.rows, BOARD.columns, 2)
    assert min(np.linalg.norm(np.diff(grid, axis=axis), axis=-1).min() for axis in (0, 1)) >= 15
    picture = np.clip(np.round(through_lens.picture(T_c_k)), 0, 255).astype(np.uint8)
    assert np.linalg.norm(saddles(picture, exact) - exact, axis=1).max() < TRUE_TO_PX


@pytest.mark.parametrize("phase_px", [0.0, 0.1, 0.25, 0.37, 0.5])
def test_edges_along_the_pixels_rows_are_not_drawn_to_the_grid_of_subpixels(phase_px):
    camera = Camera("c", 640, 480, np.array([[550, 0, 320], [0, 550, 240.0], [0, 0, 1]]), [], "none")
    T_c_k = board_pose(1.375, aside_m=(phase_px * 1.375 / 550, 0.0))  # 550 / 1.375 * 0.08: squares of 32 px
    exact = CORNERS_K[:, :2] * 400 + T_c_k[:2, 3] * 400 + [320, 240]
    assert np.abs(saddles(renderer(camera).picture(T_c_k), exact) - exact).max() < 0.005


def test_the_square_outside_corner_0_is_dark_and_a_white_margin_lies_around(lens, through_lens):
    T_c_k = board_pose(1.5, 3, 10, 10)
    picture = through_lens.picture(T_c_k)

    def grey(x, y):
        u, v = np.rint(projected(lens, T_c_k, np.array([[x, y, 0.0]]) * BOARD.square_m)[0]).astype(int)
        return picture[v, u]

    last_x, last_y = BOARD.columns, BOARD.rows
    for y in range(-1, last_y):
        for x in range(-1, last_x):
            dark = (x + y) % 2 == 0
            assert (grey(x + 0.5, y + 0.5) < 60) == dark, (x, y)
    for x in range(-1, last_x):
        assert min(grey(x + 0.5, -1.5), grey(x + 0.5, last_y + 0.5)) > 150
    for y in range(-1, last_y):
        assert min(grey(-1.5, y + 0.5), grey(last_x + 0.5, y + 0.5)) > 150


def test_a_white_square_runs_into_the_margin_without_a_line(lens, through_lens):
    T_c_k = board_pose(1.2)
    a_white_outer_square = [np.linspace(8.5, 9.5, 60), np.full(60, -0.5), np.zeros(60)]
    across = np.stack(a_white_outer_square, axis=1)
    u, v = projected(lens, T_c_k, across * BOARD.square_m).T
    picture = through_lens.picture(T_c_k)
    line = map_coordinates(picture, [v, u], order=1)
    assert np.abs(np.diff(line)).max() < 4  # gray levels in a sixtieth of a square: shading, no edge
    assert line.min() > 150


def test_a_board_out_of_the_picture_or_cut_by_its_edge_is_drawn(lens, through_lens):
    empty = through_lens.picture(board_pose(2.0, aside_m=(4.0, 0.0)))
    cut = through_lens.picture(board_pose(1.2, aside_m=(0.6, 0.0)))
    assert empty.shape == cut.shape == (lens.height, lens.width)
    assert np.isfinite(empty).all()
    assert np.array_equal(cut[:, :100], empty[:, :100])
    assert not np.array_equal(cut[:, -100:], empty[:, -100:])
