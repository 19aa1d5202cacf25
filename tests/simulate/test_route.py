"""Routes keep the board in view, rest at their stations and move as their name says."""

from functools import cache
from typing import get_args

import cv2
import numpy as np
import pytest

from mobilecal_cli.errors import ConfigError
from mobilecal_cli.model.rig import Board
from mobilecal_cli.simulate.robot import ROBOTS
from mobilecal_cli.simulate.route import base_in_world, plan_route
from mobilecal_cli.targets import Motion

STATIONS = 6


@cache
def planned(name, motion):
    robot = ROBOTS[name]
    return robot, plan_route(robot, motion, STATIONS, Board(9, 6, 0.07), seed=3)


def camera_poses(robot, route, times_s):
    joints = route.joints(times_s)
    for base, angles in zip(base_in_world(route.drive.poses(times_s)), joints, strict=True):
        yield base @ robot.head_pose(angles) @ robot.T_h_c


@pytest.mark.parametrize(
    ("name", "motion"),
    [
        *(("paper", motion) for motion in get_args(Motion)),
        *((name, "standard") for name in ROBOTS if name != "paper"),
    ],
)
def test_both_cameras_see_the_whole_board(name, motion):
    """By OpenCV's projection, at every station or all along a moving route."""
    robot, route = planned(name, motion)
    times_s = route.rests_s.mean(axis=1) if len(route.rests_s) else np.arange(0, route.duration_s, 1.0)
    rig = robot.rig_cameras
    corners_k = route.board.grid() * route.board.square_m
    for T_w_c in camera_poses(robot, route, times_s):
        for camera, T_c_x in zip(rig.each, rig.T_c_each, strict=True):
            T = np.linalg.inv(T_w_c @ T_c_x) @ route.T_w_k
            assert (corners_k @ T[:3, :3].T + T[:3, 3])[:, 2].min() > 0.3
            rvec = cv2.Rodrigues(T[:3, :3])[0]
            at = cv2.projectPoints(corners_k, rvec, T[:3, 3], camera.K, camera.D)[0].reshape(-1, 2)
            assert at.min() > 20
            assert np.all(at < np.array([camera.width, camera.height]) - 20)


@pytest.mark.parametrize("motion", [motion for motion in get_args(Motion) if motion != "moving"])
def test_base_and_head_stand_still_at_the_rests(motion):
    robot, route = planned("paper", motion)
    assert len(route.rests_s) == STATIONS
    for begin, end in route.rests_s:
        times_s = np.linspace(begin + 1e-9, end - 1e-9, 7)
        assert np.ptp(route.joints(times_s), axis=0).max() < 1e-12
        assert np.ptp(route.drive.poses(times_s), axis=0).max() < 1e-7
        assert np.ptp(route.drive.wheel_angles(times_s, robot.wheels), axis=0).max() < 1e-7


def ranges(motion):
    """Ranges of pan and tilt, way along and across, and turning (rad, m)."""
    robot, route = planned("paper", motion)
    times_s = np.linspace(0, route.duration_s, 400)
    names = robot.joint_names
    pan, tilt = (np.ptp(route.joints(times_s)[:, names.index(name)]) for name in (robot.pan, robot.tilt))
    along, across, turned = np.ptp(route.drive.poses(times_s), axis=0)
    return pan, tilt, along, across, turned


def test_each_motion_is_what_its_name_says():
    pan, tilt, along, across, turned = ranges("standard")
    assert min(pan, tilt) > 0.1
    assert min(along, across) > 0.1
    assert turned > 0.5
    assert ranges("head_fixed")[:2] == pytest.approx((0, 0), abs=1e-12)
    pan, tilt = ranges("pan_only")[:2]
    assert pan > 0.1
    assert tilt == pytest.approx(0, abs=1e-12)
    assert ranges("straight")[3:] == pytest.approx((0, 0), abs=1e-12)
    assert ranges("straight")[2] > 0.3
    assert ranges("spin")[2:4] == pytest.approx((0, 0), abs=1e-12)
    assert ranges("spin")[4] > 0.5
    assert ranges("base_fixed")[2:] == (0, 0, 0)
    moving = planned("paper", "moving")[1]
    assert len(moving.rests_s) == 0
    assert moving.duration_s == pytest.approx(3 * STATIONS, abs=1)


@pytest.mark.parametrize("seed", range(6))
def test_large_turns_turn_by_more_than_half_a_turn_and_no_more_than_300_degrees(seed):
    route = plan_route(ROBOTS["paper"], "large_turns", STATIONS, seed=seed)
    headings = route.drive.poses(route.rests_s.mean(axis=1))[:, 2]
    assert 180 < np.degrees(np.abs(np.diff(headings)).max()) <= 300.001


def test_the_same_seed_gives_the_same_route_and_another_seed_another():
    robot = ROBOTS["paper"]
    first, again, other = (plan_route(robot, "standard", 4, seed=seed) for seed in (5, 5, 6))
    assert np.array_equal(first.knots_rad, again.knots_rad)
    assert first.drive.stretches == again.drive.stretches
    assert first.drive.stretches != other.drive.stretches
    with pytest.raises(ConfigError, match="whole board"):
        plan_route(ROBOTS["paper"], "standard", 4, Board(9, 6, 0.5))
