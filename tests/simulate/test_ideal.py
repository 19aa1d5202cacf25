"""Ideal extractions: exact without noise, by transforms written out here; as noisy as stated with it."""

from functools import cache
from typing import get_args

import cv2
import numpy as np
import pytest

from mobilecal_cli.kinematics import head_pose
from mobilecal_cli.simulate.robot import ROBOTS
from mobilecal_cli.simulate.route import plan_route
from mobilecal_cli.targets import Motion
from tests.extractions import Noise, ideal_extraction


@cache
def world(name, motion):
    robot = ROBOTS[name]()
    route = plan_route(robot, motion, 6, seed=5)
    return robot, route, ideal_extraction(robot, route)


def planar(x, y, heading):
    c, s = np.cos(heading), np.sin(heading)
    return np.array([[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, 0], [0, 0, 0, 1.0]])


def driven(track, wheels, begin_ns, end_ns):
    """T_vi_vj from the samples of a wheel track alone: one chord after the other, each along its mean heading."""
    T = np.eye(4)
    inside = (track.time_ns >= begin_ns) & (track.time_ns <= end_ns)
    assert track.time_ns[inside][0] == begin_ns
    assert track.time_ns[inside][-1] == end_ns
    for right, left in zip(np.diff(track.right_rad[inside]), np.diff(track.left_rad[inside]), strict=True):
        ahead = (wheels.radius_right_m * right + wheels.radius_left_m * left) / 2
        turn = (wheels.radius_right_m * right - wheels.radius_left_m * left) / wheels.separation_m
        chord = ahead if turn == 0 else 2 * ahead / turn * np.sin(turn / 2)
        T = T @ planar(chord * np.cos(turn / 2), chord * np.sin(turn / 2), turn)
    return T


#: Each motion with one robot, and each other robot with one motion.
WORLDS = [
    *(("paper", motion) for motion in get_args(Motion)),
    *((name, "standard") for name in ROBOTS if name != "paper"),
]


@pytest.mark.parametrize(("name", "motion"), WORLDS)
def test_the_closed_loop_holds_exactly(name, motion):
    """T_V_Hi X T_Ci_Cj = T_Vi_Vj T_V_Hj X (eq. 3), with the base's motion from the wheels alone."""
    robot, _, extraction = world(name, motion)
    if robot.slip:
        pytest.skip("its wheels slip")
    X = robot.T_h_c
    for i, j in zip(extraction.observations, extraction.observations[1:], strict=False):
        T_v_hi, T_v_hj = (head_pose(extraction.rig.chain, o.joints) for o in (i, j))
        T_vi_vj = driven(extraction.wheels[0], robot.wheels, i.time_ns, j.time_ns)
        T_ci_cj = i.T_c_k @ np.linalg.inv(j.T_c_k)
        np.testing.assert_allclose(T_v_hi @ X @ T_ci_cj, T_vi_vj @ T_v_hj @ X, rtol=0, atol=1e-12)


@pytest.mark.parametrize("name", ROBOTS)
def test_points_and_pixels_are_the_boards_corners_exactly(name):
    """The pixels by OpenCV's projection, the points by the pose."""
    _, route, extraction = world(name, "standard")
    rig = extraction.rig.cameras
    grid_k = extraction.board.grid() * extraction.board.square_m
    assert extraction.board.square_m == route.board.square_m
    for o in extraction.observations:
        points_c = grid_k @ o.T_c_k[:3, :3].T + o.T_c_k[:3, 3]
        np.testing.assert_allclose(o.points_c, points_c, rtol=0, atol=1e-14)
        for camera, T_c_x, corners in zip(rig.each, rig.T_c_each, o.views, strict=True):
            T = np.linalg.inv(T_c_x) @ o.T_c_k
            at = cv2.projectPoints(grid_k, cv2.Rodrigues(T[:3, :3])[0], T[:3, 3], camera.K, camera.D)[0]
            np.testing.assert_allclose(corners.pixels, at.reshape(-1, 2), rtol=0, atol=1e-9)
        assert o.reprojection_px < 1e-9
        if rig.calibrated:
            assert np.linalg.eigvalsh(o.points_cov).min() > 0
        assert np.linalg.eigvalsh(o.T_c_k_cov).min() > 0


def test_each_noise_is_as_large_as_stated():
    robot, route, exact = world("paper", "standard")
    noise = Noise(pixel_px=0.2, wheel_rad_per_sqrt_rad=0.003, joint_rad=np.radians(0.05))
    noisy = ideal_extraction(robot, route, noise, seed=1)
    pairs = list(zip(noisy.observations, exact.observations, strict=True))

    def off(pick):
        return np.concatenate([(pick(a) - pick(b)).ravel() for a, b in pairs])

    # 648 coordinates a side and 24 joint readings: the scatter of a measured sigma is 3 and 15 %.
    assert np.std(off(lambda o: o.views[0].pixels)) == pytest.approx(0.2, rel=0.1)
    assert np.std(off(lambda o: o.views[1].pixels)) == pytest.approx(0.2, rel=0.1)
    assert np.std(off(lambda o: o.joints)) == pytest.approx(np.radians(0.05), rel=0.5)
    # The points carry their own covariance: the mean of the normalized squares of 3 numbers is 3.
    away = [(a.points_c - b.points_c, a.points_cov) for a, b in pairs]
    squares = [p[:, None] @ np.linalg.solve(cov, p[:, :, None]) for p, cov in away]
    assert np.mean(squares) == pytest.approx(3.0, rel=0.15)
    for side in ("right_rad", "left_rad"):
        truth, measured = (np.diff(getattr(e.wheels[0], side)) for e in (exact, noisy))
        turning = np.abs(truth) > 1e-6
        scaled = (measured - truth)[turning] / np.sqrt(np.abs(truth[turning]))
        assert np.std(scaled) == pytest.approx(0.003, rel=0.1)
        np.testing.assert_allclose(measured[~turning], 0, atol=1e-5)


def test_encoders_show_whole_steps_never_more_than_one_beside_the_truth():
    robot, route, exact = world("paper", "standard")
    step = robot.encoder_step_rad
    stepped = ideal_extraction(robot, route, Noise(encoder_step_rad=step)).wheels[0]
    for side in ("right_rad", "left_rad"):
        measured = getattr(stepped, side)
        np.testing.assert_allclose(measured / step, np.round(measured / step), rtol=0, atol=1e-9)
        behind = getattr(exact.wheels[0], side) - measured
        assert behind.min() > -1e-12
        assert behind.max() < step * (1 + 1e-9)
        assert behind.max() > step / 2


def test_the_same_seed_gives_the_same_noise_and_another_seed_another():
    robot, route, _ = world("tick", "standard")
    noise = Noise(pixel_px=0.1, wheel_rad_per_sqrt_rad=0.003, joint_rad=1e-3)
    first, again, other = (ideal_extraction(robot, route, noise, seed) for seed in (7, 7, 8))
    for a, b, c in zip(first.observations, again.observations, other.observations, strict=True):
        assert np.array_equal(a.T_c_k, b.T_c_k)
        assert np.array_equal(a.joints, b.joints)
        assert not np.array_equal(a.views[0].pixels, c.views[0].pixels)
    assert np.array_equal(first.wheels[0].right_rad, again.wheels[0].right_rad)
    assert not np.array_equal(first.wheels[0].right_rad, other.wheels[0].right_rad)
