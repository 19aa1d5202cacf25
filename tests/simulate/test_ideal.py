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
from tests.extractions import ideal_extraction


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
