"""Noise of corners of boards with few corners, under lenses with distortion."""

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from mobilecal_cli.model.rig import Board, Camera
from mobilecal_cli.vision import detect
from mobilecal_cli.vision.grid_map import fit_grid, roughness_px
from tests.vision.scenes import detected, random_pose, seen, stereo_rig

NOISE_PX = 0.05


def slightly_wrong(camera: Camera) -> Camera:
    """0.3 % longer, the principal point 2 px to the right."""
    K = camera.K.copy()
    K[:2, :2] *= 1.003
    K[0, 2] += 2
    return replace(camera, K=K)


@pytest.mark.parametrize(("columns", "rows", "square_m"), [(9, 6, 0.05), (5, 3, 0.1)])
@pytest.mark.parametrize("kind", ["raw", "fisheye", "rectified"])
@pytest.mark.parametrize("exact", [True, False])
def test_the_noise_is_true_for_few_corners_too(
    columns: int, rows: int, square_m: float, kind: str, exact: bool
) -> None:
    rng, rig, board = np.random.default_rng(0), stereo_rig(kind), Board(columns, rows)
    camera = rig.each[0] if exact else slightly_wrong(rig.each[0])
    squares = []
    for _ in range(100):
        _, left, _ = seen(rig, random_pose(rng, board, square_m), board, square_m)
        noisy = left + NOISE_PX * rng.standard_normal(left.shape)
        squares.append(roughness_px(camera, noisy.reshape(rows, columns, 2)) ** 2)
    assert np.sqrt(np.mean(squares)) == pytest.approx(NOISE_PX, rel=0.08)


def test_without_the_lens_the_same_corners_look_rough():
    """Why the camera's model is used: a board of 6 x 4 under a fisheye lens, without any noise."""
    rig, board = stereo_rig("fisheye"), Board(6, 4)
    _, left, _ = seen(rig, random_pose(np.random.default_rng(1), board, 0.08), board, 0.08)
    grid = left.reshape(4, 6, 2)
    assert fit_grid(grid).sigma_px > 0.1
    assert roughness_px(rig.each[0], grid) < 1e-6
    rig, board = stereo_rig("raw"), Board(6, 4)
    _, left, _ = seen(rig, random_pose(np.random.default_rng(2), board, 0.08), board, 0.08)
    left[8] += 1.0
    assert roughness_px(rig.each[0], left.reshape(4, 6, 2)) > 0.1


def test_pixels_that_the_model_cannot_produce_fall_back() -> None:
    camera = replace(stereo_rig("raw").each[0], D=np.array([-0.9, 0.0, 0.0, 0.0, 0.0]))
    x, y = np.meshgrid(np.linspace(10, 630, 6), np.linspace(10, 470, 4))
    grid = np.stack([x, y], axis=-1)
    assert roughness_px(camera, grid) == fit_grid(grid).sigma_px


def test_a_real_board_under_a_fisheye_lens(shared_data: Path) -> None:
    """BoofCV's picture 3: with a model fitted to all eight pictures, the corners scatter by 0.08 px about its pose."""
    camera = Camera(
        "boofcv", 640, 720, [[192.04, 0, 319.15], [0, 192.04, 320.77], [0, 0, 1]],
        np.array([-8.3238e-3, -9.8244e-4, 1.95207e-3, -1.3119e-3]), "equidistant",
    )  # fmt: skip
    image = cv2.imread(str(shared_data / "fisheye/boofcv/3.jpg"), cv2.IMREAD_GRAYSCALE)
    found = detected(detect(image, 6, 4))
    grid = found.pixels.reshape(4, 6, 2)
    assert fit_grid(grid).sigma_px > 0.6
    assert roughness_px(camera, grid) == pytest.approx(0.078, rel=0.1)
