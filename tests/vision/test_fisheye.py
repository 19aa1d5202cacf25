"""Boards under strong fisheye lenses: found without a camera model, with no wrong corner."""

from pathlib import Path

import cv2
import numpy as np
import pytest

from mobilecal_cli import se3
from mobilecal_cli.model.rig import Board, Camera
from mobilecal_cli.vision import Miss, detect, identify_size
from mobilecal_cli.vision.grid_map import fit_grid
from tests.vision.scenes import detected, opencv_pixels, pose, render

BOARD = Board(9, 6)
SQUARE_M = 0.05
# 180 degrees over 566 px, with a principal point 30 px beside the middle.
K = np.array([[180.0, 0, 340], [0, 180, 215], [0, 0, 1]])
CAMERA = Camera("fisheye", 640, 480, K, np.zeros(4), "equidistant")
NEAR = (
    pose(0.0, 0.0, 0.16, (0.1, 0.1, 0.0), BOARD, SQUARE_M),
    pose(0.1, -0.02, 0.2, (0.2, -0.4, 0.1), BOARD, SQUARE_M),
    pose(-0.12, 0.05, 0.22, (-0.1, 0.25, 0.3), BOARD, SQUARE_M),
)
SHAPES = {"boofcv": (6, 4), "camodocal": (9, 6)}


def truth(T_c_k: np.ndarray) -> np.ndarray:
    return opencv_pixels(CAMERA, se3.act(T_c_k, SQUARE_M * BOARD.grid()))


@pytest.mark.parametrize("T_c_k", NEAR)
def test_rendered_boards_are_found_exactly(T_c_k: np.ndarray) -> None:
    image = render(CAMERA, T_c_k, BOARD, SQUARE_M, blur_px=0.7, noise=2)
    grid = truth(T_c_k).reshape(6, 9, 2)
    assert fit_grid(grid).sigma_px > 0.5, "the lens is too weak for this test"
    found = detected(detect(image, 9, 6))
    assert np.abs(found.pixels - truth(T_c_k)).max() < 0.2
    assert found.sigma_px < 0.1


def test_the_lens_is_found_from_one_image_of_a_board():
    grid_map = fit_grid(truth(NEAR[0]).reshape(6, 9, 2), (480, 640))
    assert grid_map.lens is not None
    assert grid_map.lens.focal_px == pytest.approx(180, rel=0.02)
    assert np.abs(grid_map.lens.center_px - [340, 215]).max() < 3
    outside = np.array([[-1.0, -1], [9, -1], [9, 6], [-1, 6], [4, 7]])
    points = se3.act(NEAR[0], SQUARE_M * np.column_stack([outside, np.zeros(5)]))
    assert np.abs(grid_map(outside) - opencv_pixels(CAMERA, points)).max() < 1.0
    rng = np.random.default_rng(1)
    flat = np.stack(np.meshgrid(20.0 * np.arange(9), 21.0 * np.arange(6)), axis=-1) + 100
    rough = flat + rng.normal(0, 0.3, flat.shape)
    assert fit_grid(rough, (480, 640)).lens is None


@pytest.mark.parametrize("corner", [(0, 0), (5, 8), (0, 4), (2, 3)])
def test_a_wrong_corner_is_not_taken_for_a_lens(corner: tuple[int, int]) -> None:
    grid = truth(NEAR[1]).reshape(6, 9, 2)
    grid[corner] += [3.0, 2.0]
    assert fit_grid(grid, (480, 640)).off_px[corner] > 2.0  # of 3.6; the lens takes the rest


def test_the_size_of_a_board_under_a_fisheye_lens() -> None:
    images = [render(CAMERA, T_c_k, BOARD, SQUARE_M, blur_px=0.7, noise=2) for T_c_k in NEAR]
    assert identify_size(images).votes == {(9, 6): 3}
    assert isinstance(detect(images[0], 8, 6), Miss)
    assert isinstance(detect(images[0], 8, 5), Miss)


@pytest.mark.parametrize("folder", SHAPES)
def test_every_real_image(shared_data: Path, folder: str) -> None:
    """All boards are found, with the corners of findChessboardCorners, of which all were checked."""
    columns, rows = SHAPES[folder]
    expected = np.load(shared_data / "fisheye" / folder / "corners.npz")
    assert len(expected.files) == 8
    for n, name in enumerate(expected.files):
        image = cv2.imread(str(shared_data / "fisheye" / folder / name), cv2.IMREAD_GRAYSCALE)
        found = detected(detect(image, columns, rows))
        distance = np.linalg.norm(found.pixels[:, None] - expected[name].reshape(1, -1, 2), axis=-1)
        assert distance.min(axis=1).max() < 2, name
        assert len(set(distance.argmin(axis=1))) == columns * rows, name
        wrong = ((columns - 1, rows), (columns, rows - 1))[n % 2]
        assert isinstance(detect(image, *wrong), Miss), (name, wrong)
