"""The board's pose: exact data, Jacobians, spread."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mobilecal_cli import se3
from mobilecal_cli.camera import project
from mobilecal_cli.model.observations import Corners
from mobilecal_cli.model.rig import Board
from mobilecal_cli.vision import pose as geometry
from mobilecal_cli.vision.pose import absolute_orientation, pose_from_one, pose_residuals, square_from_points
from tests.pairs import board_pose
from tests.vision.scenes import random_pose, seen, stereo_rig

BOARD = Board(9, 6)
SQUARE_M = 0.06
POINTS_K = SQUARE_M * BOARD.grid()

twists = st.tuples(*[st.floats(-3, 3)] * 6).map(np.array)


@given(twist=twists, seed=st.integers(0, 1000))
def test_absolute_orientation_is_exact(twist: np.ndarray, seed: int) -> None:
    T_a_b = se3.exp(twist)
    for points_b in (np.random.default_rng(seed).standard_normal((7, 3)), POINTS_K):  # in space, in a plane
        found = absolute_orientation(se3.act(T_a_b, points_b), points_b)
        np.testing.assert_allclose(found, T_a_b, atol=1e-12)


def test_absolute_orientation_is_a_least_squares_minimum() -> None:
    rng = np.random.default_rng(3)
    points_b = rng.standard_normal((20, 3))
    points_a = se3.act(se3.exp(rng.standard_normal(6)), points_b) + 0.1 * rng.standard_normal((20, 3))
    T_a_b = absolute_orientation(points_a, points_b)
    assert np.linalg.det(T_a_b[:3, :3]) == pytest.approx(1)

    def cost(twist: np.ndarray) -> float:
        return float(np.sum((se3.act(se3.exp(twist) @ T_a_b, points_b) - points_a) ** 2))

    for direction in np.vstack([np.eye(6), -np.eye(6)]):
        assert cost(1e-3 * direction) > cost(np.zeros(6))


def test_square_from_points() -> None:
    rng = np.random.default_rng(0)
    points_c = se3.act(random_pose(rng, BOARD, SQUARE_M), POINTS_K)
    assert square_from_points(points_c, Board(9, 6).grid()) == pytest.approx(SQUARE_M, rel=1e-12)
    scattered = (points_c + 0.004 * rng.standard_normal(points_c.shape) for _ in range(400))
    noisy = [square_from_points(points, Board(9, 6).grid()) for points in scattered]
    assert np.mean(noisy) == pytest.approx(SQUARE_M, rel=1e-3)


@pytest.mark.parametrize("kind", ["raw", "fisheye", "rectified"])
def test_pose_jacobian_against_differences(kind: str) -> None:
    rig = stereo_rig(kind)
    T_c_k = random_pose(np.random.default_rng(2), BOARD, SQUARE_M)
    measured = np.zeros((BOARD.corners, 4))
    J = pose_residuals(rig, T_c_k, POINTS_K, measured)[1]
    h = 1e-6
    for i in range(7):
        step = np.zeros(7)
        step[i] = h
        moved = ((se3.exp(s[:6]) @ T_c_k, np.exp(s[6]) * POINTS_K) for s in (step, -step))
        sides = [pose_residuals(rig, *at, measured)[0] for at in moved]
        np.testing.assert_allclose(J[..., i], -(sides[0] - sides[1]) / (2 * h), atol=1e-5)


@pytest.mark.parametrize("kind", ["raw", "fisheye", "rectified"])
@pytest.mark.parametrize("free_scale", [False, True])
def test_exact_pixels_give_the_exact_pose(kind: str, free_scale: bool) -> None:
    rig = stereo_rig(kind)
    rng = np.random.default_rng(4)
    T_c_k = random_pose(rng, BOARD, SQUARE_M)
    _, left, right = seen(rig, T_c_k, BOARD, SQUARE_M)
    start = se3.exp(0.05 * rng.standard_normal(6)) @ T_c_k
    points_k = POINTS_K * (1.07 if free_scale else 1.0)
    found = board_pose(rig, points_k, left, right, 0.1, 0.1, start, free_scale)
    np.testing.assert_allclose(found.T_c_k, T_c_k, atol=1e-10)
    assert found.scale == pytest.approx(1 / 1.07 if free_scale else 1.0, rel=1e-10)
    assert found.rms_px < 1e-9


@pytest.mark.parametrize("free_scale", [False, True])
def test_pose_covariance_is_the_spread(free_scale: bool) -> None:
    rig = stereo_rig("raw")
    rng = np.random.default_rng(7)
    T_c_k = random_pose(rng, BOARD, SQUARE_M)
    _, left, right = seen(rig, T_c_k, BOARD, SQUARE_M)
    sigma_left, sigma_right, runs = 0.1, 0.2, 250
    deltas, fits = [], []
    for _ in range(runs):
        noisy_left = left + sigma_left * rng.standard_normal(left.shape)
        noisy_right = right + sigma_right * rng.standard_normal(right.shape)
        found = board_pose(rig, POINTS_K, noisy_left, noisy_right, sigma_left, sigma_right, T_c_k, free_scale)
        deltas.append(se3.log(found.T_c_k @ se3.inverse(T_c_k)))
        fits.append(found.rms_px)
    delta = np.array(deltas)
    distance = np.einsum("ri,ij,rj->r", delta, np.linalg.inv(found.T_c_k_cov), delta)
    assert abs(distance.mean() - 6) < 4 * np.sqrt(12 / runs)
    np.testing.assert_allclose(delta.std(axis=0), np.sqrt(np.diag(found.T_c_k_cov)), rtol=0.15)
    assert np.mean(fits) == pytest.approx(np.sqrt((sigma_left**2 + sigma_right**2) / 2), rel=0.05)


def test_the_pose_by_one_camera_is_the_better_one_of_two() -> None:
    """Far away, a board tilted the other way looks nearly the same: the least error is that of a start at the truth."""
    rig, rng = stereo_rig("raw").some([0]), np.random.default_rng(1)
    for _ in range(20):
        turn = np.array([*rng.uniform(-0.5, 0.5, 2), rng.uniform(-3, 3)])
        T_c_k = se3.transform(se3.exp_so3(turn), np.array([*rng.uniform(-0.3, 0.3, 2), 4.0]))
        pixels = project(rig.each[0], se3.act(T_c_k, POINTS_K)) + 0.3 * rng.standard_normal((54, 2))
        view = Corners(pixels, 0.3, 1)
        least = geometry.board_pose(rig, POINTS_K, [view], T_c_k).rms_px
        assert pose_from_one(rig, POINTS_K, view).rms_px <= least * (1 + 1e-6)
