"""Points from pairs of pixels, against truth and against their own covariance."""

from dataclasses import replace

import numpy as np
import pytest

from mobilecal_cli.model.rig import Board
from mobilecal_cli.vision.pose import StereoPoints
from tests.pairs import triangulate, with_pair
from tests.vision.scenes import missed, random_pose, seen, stereo_rig

BOARD = Board(9, 6)
SQUARE_M = 0.06


@pytest.mark.parametrize("kind", ["raw", "fisheye", "rectified"])
@pytest.mark.parametrize("seed", range(4))
def test_exact_pixels_give_exact_points(kind: str, seed: int) -> None:
    rig = stereo_rig(kind)
    T_c_k = random_pose(np.random.default_rng(seed), BOARD, SQUARE_M)
    points_c, left, right = seen(rig, T_c_k, BOARD, SQUARE_M)
    found = triangulate(rig, left, right, 0.1, 0.2)
    assert isinstance(found, StereoPoints)
    np.testing.assert_allclose(found.points_c, points_c, atol=1e-12)
    assert found.rms_px < 1e-11


@pytest.mark.parametrize("kind", ["raw", "rectified"])
def test_covariance_is_the_spread(kind: str) -> None:
    rig = stereo_rig(kind)
    rng = np.random.default_rng(5)
    points_c, left, right = seen(rig, random_pose(rng, BOARD, SQUARE_M), BOARD, SQUARE_M)
    sigma_left, sigma_right, runs = 0.08, 0.16, 200
    errors, epipolar = [], []
    for _ in range(runs):
        noisy_left = left + sigma_left * rng.standard_normal(left.shape)
        noisy_right = right + sigma_right * rng.standard_normal(right.shape)
        found = triangulate(rig, noisy_left, noisy_right, sigma_left, sigma_right)
        assert isinstance(found, StereoPoints)
        errors.append(found.points_c - points_c)
        epipolar.append(found.rms_px)
    error = np.array(errors)
    # The squared distance in units of the predicted covariance is chi-squared with 3 degrees of freedom:
    # its mean over n draws has a standard deviation of sqrt(6 / n).
    distance = np.einsum("rmi,mij,rmj->rm", error, np.linalg.inv(found.points_cov), error)
    assert abs(distance.mean() / 3 - 1) < 5 * np.sqrt(6 / distance.size) / 3 + 0.005
    for axis in range(3):
        predicted = np.sqrt(found.points_cov[:, axis, axis].mean())
        assert np.sqrt(np.mean(error[:, :, axis] ** 2)) == pytest.approx(predicted, rel=0.05)


def test_unequal_noise_moves_the_point_to_the_better_camera() -> None:
    rig = stereo_rig("rectified")
    _, left, right = seen(rig, random_pose(np.random.default_rng(1), BOARD, SQUARE_M), BOARD, SQUARE_M)
    found = triangulate(rig, left, right + np.array([0.0, 1.0]), 1e-3, 1.0)
    assert isinstance(found, StereoPoints)
    u = 548.0 * found.points_c[:, 1] / found.points_c[:, 2] + 241.0
    np.testing.assert_allclose(u, left[:, 1], atol=1e-4)


BARREL = replace(stereo_rig("rectified").each[0], D=np.array([-0.3, 0, 0, 0, 0]), distortion="plumb_bob")


@pytest.mark.parametrize(
    ("exchanged", "left_px", "right_px", "camera", "detail"),
    [
        (True, (0.0, 0.0), (0.0, 0.0), None, "triangulated corners are behind a camera"),
        (False, (0.0, 0.0), (0.0, 60.0), None, "distance from the epipolar lines"),
        (False, (500.0, 0.0), (0.0, 0.0), BARREL, "corners are outside the valid range"),
    ],
    ids=["exchanged cameras", "points that are not the same", "pixels that no ray reaches"],
)
def test_a_miss(exchanged, left_px, right_px, camera, detail) -> None:
    rig = stereo_rig("rectified")
    _, left, right = seen(rig, random_pose(np.random.default_rng(1), BOARD, SQUARE_M), BOARD, SQUARE_M)
    both = (right, left) if exchanged else (left + left_px, right + right_px)
    found = missed(triangulate(with_pair(rig, left=camera), *both, 0.1, 0.1))
    assert found.reason == "left and right images inconsistent"
    assert detail in found.detail
