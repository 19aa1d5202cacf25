"""Imperfect robots: every constant against a computation written out here with OpenCV, and the noise's statistics."""

from dataclasses import replace
from functools import cache

import cv2
import numpy as np
import pytest
from scipy.stats import kurtosis

from mobilecal_cli.simulate.messages import START_NS
from mobilecal_cli.simulate.robot import ROBOTS, tick_robot
from mobilecal_cli.simulate.route import plan_route
from tests.actual import (
    PRIORS,
    approach_directions,
    constant_kinds,
    crosswise,
    draw,
    station_times_s,
)
from tests.extractions import (
    Imperfection,
    Noise,
    Outside,
    OutsideRobot,
    ideal_extraction,
    imperfect_extraction,
)
from tests.robots import corners_of

JOINT_KEYS = {
    **{name: {"pan_joint": "pan", "tilt_joint": "tilt"} for name in ("tick", "skid_steer", "odometry_only")},
    "paper": {
        **{name: name for name in ("torso_pitch_joint", "torso_roll_joint")},
        **{"head_pan_joint": "pan", "head_tilt_joint": "tilt"},
    },
}
CROSS = {(0, 0, 1): "xy", (0, 1, 0): "xz", (1, 0, 0): "yz"}
AXES = dict(zip("xyz", np.eye(3), strict=True))


@cache
def route_of(name, motion="standard", stations=5):
    return plan_route(ROBOTS[name](), motion, stations, seed=5)


def seen(name, constants, motion="standard", noise=None, outside=None, **options):
    imperfection = Imperfection(constants, noise or Noise(), outside or Outside())
    return imperfect_extraction(ROBOTS[name](), route_of(name, motion), imperfection, **options)


def turned(rotvec):
    T = np.eye(4)
    T[:3, :3] = cv2.Rodrigues(np.array(rotvec, dtype=float))[0]
    return T


def shifted(x, y, z):
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


def board_in_camera(robot, route, time_s, joints=None, floor=None):
    """T_c_k of one moment, from the joints in a list of a test's own."""
    x, y, heading = route.drive.poses(np.array([time_s]))[0]
    T = shifted(x, y, 0) @ turned([0, 0, heading]) @ (np.eye(4) if floor is None else floor)
    angles = iter(route.joints(np.array([time_s]))[0])
    for joint in joints or robot.joints:
        roll, pitch, yaw = joint.rpy_rad
        T = T @ shifted(*joint.xyz_m) @ turned([0, 0, yaw]) @ turned([0, pitch, 0]) @ turned([roll, 0, 0])
        if joint.name:
            T = T @ turned(next(angles) * np.array(joint.axis))
    return np.linalg.inv(T @ robot.T_h_c) @ route.T_w_k


def projected(camera, T_x_k, points_k, K=None):
    rvec = cv2.Rodrigues(T_x_k[:3, :3])[0]
    return cv2.projectPoints(points_k, rvec, T_x_k[:3, 3], camera.K if K is None else K, camera.D)[0][:, 0]


def both(rig, T_c_k, points_k, K_left=None, K_right=None, T_c_r=None):
    T_r_k = np.linalg.inv(rig.T_c_each[1] if T_c_r is None else T_c_r) @ T_c_k
    return projected(rig.each[0], T_c_k, points_k, K_left), projected(rig.each[1], T_r_k, points_k, K_right)


def same_pixels(extraction, expected):
    """Left and right pixels of every station, to a millionth of a pixel."""
    for o, (left, right) in zip(extraction.observations, expected, strict=True):
        np.testing.assert_allclose(o.views[0].pixels, left, rtol=0, atol=1e-6)
        np.testing.assert_allclose(o.views[1].pixels, right, rtol=0, atol=1e-6)


def expected_pixels(name, motion="standard", points_k=None, joints=None, **cameras):
    robot, route = ROBOTS[name](), route_of(name, motion)
    points_k = corners_of(route) if points_k is None else points_k
    poses = (board_in_camera(robot, route, t, joints) for t in station_times_s(route))
    return [both(robot.rig_cameras, T_c_k, points_k, **cameras) for T_c_k in poses]


def test_the_constants_of_a_pan_tilt_robot():
    kinds = constant_kinds(tick_robot())
    of_camera = ("focal_{}", "focal_aspect_{}", "principal_{}_x", "principal_{}_y")
    terms = ("radial_1", "radial_2", "tangential_x", "tangential_y")
    of_camera += tuple(f"distortion_{{}}_{term}" for term in terms)
    cameras = {name.format(side) for side in ("left", "right") for name in of_camera}
    stereo = {"stereo_r_x", "stereo_r_y", "stereo_r_z", "baseline_y", "baseline_z", "baseline_scale"}
    board = {"square_scale", "square_aspect", "board_bend_x", "board_bend_y", "board_twist", "board_shear"}
    pan = {"pan_zero", "pan_scale", "pan_axis_x", "pan_axis_y", "pan_position_x", "pan_position_y"}
    tilt = {"tilt_scale", "tilt_axis_x", "tilt_axis_z", "tilt_position_x", "tilt_position_z"}
    rest = {"backlash_pan", "backlash_tilt", "time_joints", "time_wheels", "time_right", "readout"}
    rest |= {"lean_roll", "lean_pitch"}
    assert set(kinds) == cameras | stereo | board | pan | tilt | rest
    assert set(kinds.values()) == set(PRIORS) - {"camera_rotation", "camera_position"}
    assert "torso_pitch_joint_zero" in constant_kinds(ROBOTS["paper"]())


def test_draws_have_the_priors_sigmas_and_do_not_depend_on_the_other_kinds():
    robot = tick_robot()
    kinds = constant_kinds(robot)
    draws = [draw(robot, np.random.default_rng(seed), 2.0, PRIORS) for seed in range(400)]
    assert set(draws[0]) == set(kinds)
    for name, kind in kinds.items():
        values = np.array([one[name] for one in draws]) / (2 * PRIORS[kind])
        assert np.std(values) == pytest.approx(1, abs=0.15)  # four sigmas of the scatter
        assert abs(np.mean(values)) < 0.2
    some = draw(robot, np.random.default_rng(7), 2.0, ["backlash", "focal_left"])
    assert some == {name: draws[7][name] for name in ("focal_left", "backlash_pan", "backlash_tilt")}
    of_motion = {"time_joints", "time_wheels", "time_right", "readout"}
    assert set(kinds) - set(draw(robot, np.random.default_rng(7))) == of_motion
    with pytest.raises(ValueError, match="tilt_zero"):
        draw(robot, np.random.default_rng(7), kinds=["tilt_zero"])
    with pytest.raises(ValueError, match="tilt_zero"):
        seen("tick", {"tilt_zero": 0.1})


@pytest.mark.parametrize("side", ["left", "right"])
def test_focal_length_and_principal_point(side):
    camera = tick_robot().rig_cameras.each[["left", "right"].index(side)]
    (fx, _, cx), (_, fy, cy), _ = camera.K
    K = np.array([[fx * 1.05, 0, cx + 0.02 * 640], [0, fy * 1.05, cy - 0.03 * 640], [0, 0, 1]])
    constants = {f"focal_{side}": 0.05, f"principal_{side}_x": 0.02, f"principal_{side}_y": -0.03}
    same_pixels(seen("tick", constants), expected_pixels("tick", **{f"K_{side}": K}))


@pytest.mark.parametrize("side", ["left", "right"])
@pytest.mark.parametrize("term", ["radial_1", "radial_2", "tangential_x", "tangential_y"])
def test_distortion_displaces_the_pixels(side, term):
    rig = tick_robot().rig_cameras
    center, rho = rig.each[["left", "right"].index(side)].K[:2, 2], np.hypot(640, 480) / 2

    def d(x, y):
        r2 = x**2 + y**2
        return {
            "radial_1": np.array([x * r2, y * r2]),
            "radial_2": np.array([x * r2**2, y * r2**2]),
            "tangential_x": np.array([3 * x**2 + y**2, 2 * x * y]),
            "tangential_y": np.array([2 * x * y, x**2 + 3 * y**2]),
        }[term]

    length = np.linalg.norm(d(0.8, 0.6))  # 640 and 480 over the diagonal
    expected = []
    for pixels in expected_pixels("tick"):
        mine = pixels[side == "right"]
        displaced = mine + (0.01 * 640 * d(*((mine - center) / rho).T) / length).T
        expected.append((displaced, pixels[1]) if side == "left" else (pixels[0], displaced))
    same_pixels(seen("tick", {f"distortion_{side}_{term}": 0.01}), expected)


def test_stereo_rotation_and_baseline():
    T_c_r = tick_robot().rig_cameras.T_c_each[1].copy()
    turn = turned([0.01, -0.02, 0.015])[:3, :3]
    constants = {"stereo_r_x": 0.01, "stereo_r_y": -0.02, "stereo_r_z": 0.015}
    rotated = T_c_r.copy()
    rotated[:3, :3] = turn @ T_c_r[:3, :3]
    same_pixels(seen("tick", constants), expected_pixels("tick", T_c_r=rotated))
    b = T_c_r[:3, 3] / np.linalg.norm(T_c_r[:3, 3])
    y = AXES["y"] - b[1] * b
    y /= np.linalg.norm(y)
    z = np.cross(b, y)  # the z axis made orthogonal to both
    assert z[2] > 0.99
    moved = T_c_r.copy()
    moved[:3, 3] = 1.04 * turned(0.02 * y - 0.03 * z)[:3, :3] @ T_c_r[:3, 3]
    constants = {"baseline_y": 0.02, "baseline_z": -0.03, "baseline_scale": 0.04}
    same_pixels(seen("tick", constants), expected_pixels("tick", T_c_r=moved))


def test_the_board_is_larger_oblong_bent_and_twisted():
    x, y, _ = corners_of(route_of("tick")).T  # squares of 80 mm, 9 x 6 corners
    xi, eta = x / 0.32 - 1, y / 0.2 - 1
    z = 0.004 * (1 - xi**2) - 0.003 * (1 - eta**2) + 0.002 * xi * eta
    points_k = np.stack([x * 1.02 * 1.005, y * 1.02 * 0.995, z], axis=1)
    constants = {"square_scale": 0.02, "square_aspect": 0.01, "board_twist": 0.002}
    extraction = seen("tick", constants | {"board_bend_x": 0.004, "board_bend_y": -0.003})
    same_pixels(extraction, expected_pixels("tick", points_k=points_k))
    # The measured squares show the scale, the stated ones remain.
    assert np.mean([o.square_m for o in extraction.observations]) == pytest.approx(0.0816, rel=2e-3)
    assert extraction.board.square_m == 0.08


@pytest.mark.parametrize("name", ROBOTS)
def test_axes_and_positions_of_the_joints(name):
    robot = ROBOTS[name]()
    for joint in (j for j in robot.joints if j.name):
        key, letters = JOINT_KEYS[name][joint.name], CROSS[joint.axis]
        a, b = (AXES[letter] for letter in letters)
        tilted = replace(joint, axis=tuple(turned(0.03 * a - 0.02 * b)[:3, :3] @ joint.axis))
        moved = replace(joint, xyz_m=tuple(np.array(joint.xyz_m) + 0.02 * a - 0.01 * b))
        changes = (("axis", tilted, (0.03, -0.02)), ("position", moved, (0.02, -0.01)))
        for constant, changed, values in changes:
            constants = {f"{key}_{constant}_{letters[k]}": values[k] for k in (0, 1)}
            joints = [changed if j is joint else j for j in robot.joints]
            same_pixels(seen(name, constants), expected_pixels(name, joints=joints))


def test_a_position_is_measured_in_the_joints_own_frame():
    """Joint frame turned against its parent: x of the joint is y of the parent."""
    robot = tick_robot()
    pan, tilt, head = robot.joints
    quarter = (0.0, 0.0, np.pi / 2)
    back = replace(head, xyz_m=(0.0, -0.03, 0.02), rpy_rad=(0.0, 0.0, -np.pi / 2))
    turned_robot = replace(robot, joints=(pan, replace(tilt, rpy_rad=quarter, axis=(1, 0, 0)), back))
    route = route_of("tick")
    constants = {"tilt_position_y": 0.01, "tilt_position_z": 0.02}
    found = imperfect_extraction(turned_robot, route, Imperfection(constants))
    moved = replace(tilt, xyz_m=tuple(np.add(tilt.xyz_m, (-0.01, 0.0, 0.02))))
    # A rotation about the parent's y is one about the joint's x, turned by a quarter: x of the joint is the parent's y.
    same_pixels(found, expected_pixels("tick", joints=[pan, moved, head]))


def test_the_axes_across_a_direction_are_orthonormal_and_nearest_to_the_coordinate_axes():
    direction = np.array([0.1, 0.97, -0.2])
    found = crosswise(direction)
    assert list(found) == ["x", "z"]
    frame = np.stack([*found.values(), direction / np.linalg.norm(direction)])
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-12)
    assert min(found["x"][0], found["z"][2]) > 0.97


@pytest.mark.parametrize("motion", ["standard", "moving"])
def test_readings_of_joints_with_zero_scale_and_backlash(motion):
    route = route_of("tick", motion)
    constants = {"pan_zero": 0.1, "pan_scale": 0.05, "tilt_scale": -0.04}
    plays = {"backlash_pan": 0.02, "backlash_tilt": 0.03}
    extraction = seen("tick", constants | plays, motion)
    times_s = station_times_s(route)
    before = route.joints(times_s) - route.joints(times_s - 1e-6)
    if motion == "standard":  # at rest: the last motion is that between the knots before
        before = np.diff(route.knots_rad[::2], axis=0, prepend=route.knots_rad[:1])
        assert not np.any(before[0])
    expected = route.joints(times_s) + np.sign(before) * [0.01, 0.015] - [0.1, 0]
    readings = np.array([o.joints for o in extraction.observations])
    np.testing.assert_allclose(readings, expected / [1.05, 0.96], rtol=0, atol=1e-12)
    assert {-1, 1} <= set(np.sign(before[:, 0]))
    # The pictures are of the true positions.
    same_pixels(extraction, expected_pixels("tick", motion))
    for track, column, play in zip(extraction.joint_tracks[0], (0, 1), (0.01, 0.015), strict=True):
        zero, scale = ((0.1, 1.05), (0, 0.96))[column]
        at_s = (track.time_ns - START_NS) / 1e9
        off = track.value * scale + zero - route.joints(at_s)[:, column]
        np.testing.assert_allclose(np.abs(off)[(np.abs(off) > 1e-9)], play, rtol=0, atol=1e-7)
        assert np.mean(np.abs(off) > 1e-9) > 0.5


def test_directions_before_the_first_motion_are_zero():
    route = route_of("tick")
    rests = route.rests_s
    assert np.array_equal(approach_directions(route, np.array([0.0, rests[0, 1]])), np.zeros((2, 2)))
    during = approach_directions(route, np.array([rests[0, 1] + 0.2]))
    assert np.array_equal(during[0], np.sign(route.knots_rad[2] - route.knots_rad[0]))


def test_clocks_move_the_signals_against_the_pictures():
    route = route_of("tick", "moving")
    extraction = seen("tick", {"time_joints": 0.11, "time_wheels": -0.07}, "moving")
    times_s = station_times_s(route)
    assert np.array_equal([o.time_ns - START_NS for o in extraction.observations], np.round(times_s * 1e9))
    readings = np.array([o.joints for o in extraction.observations])
    np.testing.assert_allclose(readings, route.joints(times_s - 0.11), atol=1e-12)
    stamps = np.array([o.time_ns for o in extraction.observations])
    for k, track in enumerate((extraction.wheels[0].right, extraction.wheels[0].left)):
        true = route.drive.wheel_angles(times_s + 0.07, tick_robot().wheels)[:, k]
        np.testing.assert_allclose(track.at(stamps), true, atol=1e-7)
    # Late cameras are early joints and wheels.
    late = seen("tick", {}, "moving", camera_late_s=0.05)
    early = seen("tick", {"time_joints": -0.05, "time_wheels": -0.05}, "moving")
    for a, b in zip(late.observations, early.observations, strict=True):
        np.testing.assert_allclose(a.joints, b.joints, atol=1e-12)


@pytest.mark.long
def test_the_floor_rolls_pitches_and_lifts_the_base_at_every_station():
    robot, route = tick_robot(), route_of("tick")
    noise = Noise(floor_rad=np.radians(0.1), floor_m=0.0005)
    found = []
    for seed in range(40):
        stations = seen("tick", {}, noise=noise, seed=seed).observations
        for o, t in zip(stations, station_times_s(route), strict=True):
            T_c_v = board_in_camera(robot, route, t) @ np.linalg.inv(
                route.T_w_k
            )  # of an even floor, to world
            x, y, heading = route.drive.poses(np.array([t]))[0]
            T_w_v = shifted(x, y, 0) @ turned([0, 0, heading])
            # T_w_v F Y = T_w_k T_k_c, with Y the camera in the base
            Y = np.linalg.inv(T_w_v) @ np.linalg.inv(T_c_v)
            F = np.linalg.inv(T_w_v) @ route.T_w_k @ np.linalg.inv(o.T_c_k) @ np.linalg.inv(Y)
            found.append([*cv2.Rodrigues(F[:3, :3])[0][:, 0], *F[:3, 3]])
    found = np.array(found)  # 200 stations: sigmas to 5 %
    sigmas = np.array([np.radians(0.1), np.radians(0.1), 0.0005])
    np.testing.assert_allclose(np.std(found[:, [0, 1, 5]], axis=0) / sigmas, 1, atol=0.2)
    np.testing.assert_allclose(found[:, [2, 3, 4]], 0, atol=1e-11)
    assert np.abs(np.corrcoef(found[:, [0, 1, 5]].T) - np.eye(3)).max() < 0.3


@pytest.mark.long
def test_each_wheel_has_a_scale_error_of_its_own_on_each_leg():
    route = route_of("tick")
    truth = seen("tick", {})
    stamps = np.array([o.time_ns for o in truth.observations])
    shares = []
    for seed in range(60):
        noisy = seen("tick", {}, noise=Noise(wheel_share=0.01), seed=seed)
        wheels = [(e.wheels[0].right, e.wheels[0].left) for e in (truth, noisy)]
        legs = [[np.diff(wheel.at(stamps)) for wheel in both_wheels] for both_wheels in wheels]
        shares.append(np.array(legs[1]) / np.array(legs[0]) - 1)
        if seed == 0:  # within a leg the error is in proportion
            rest_s = route.rests_s[0, 1]
            moments = START_NS + np.round(1e9 * np.linspace(rest_s + 0.1, route.rests_s[1, 0], 5)).astype(int)
            for side in ("right", "left"):
                a, b = (np.diff(getattr(e.wheels[0], side).at(moments)) for e in (truth, noisy))
                np.testing.assert_allclose(b / a, b[0] / a[0], rtol=1e-6)
    shares = np.array(shares)  # 60 seeds, 2 wheels, 4 legs
    np.testing.assert_allclose(np.std(shares, axis=(0, 2)), 0.01, rtol=0.2)
    flat = np.moveaxis(shares, 0, -1).reshape(8, 60)
    assert np.abs(np.corrcoef(flat) - np.eye(8)).max() < 0.5  # four sigmas of 60 pairs


@pytest.mark.long
def test_stamps_jitter_in_motion_only():
    still = seen("tick", {}, noise=Noise(stamp_s=0.01))
    assert [o.time_ns for o in still.observations] == [o.time_ns for o in seen("tick", {}).observations]
    route = route_of("tick", "moving")
    off = []
    for seed in range(5):
        moving = seen("tick", {}, "moving", Noise(stamp_s=0.01), seed=seed, camera_late_s=0.02)
        stamps = np.array([o.time_ns for o in moving.observations])
        at_s = (stamps - START_NS) / 1e9
        off.append(at_s - station_times_s(route))
        # The pictures are those of the true time; joints and wheels are read at the stamp.
        same_pixels(moving, expected_pixels("tick", "moving"))
        np.testing.assert_allclose([o.joints for o in moving.observations], route.joints(at_s), atol=1e-8)
        angles = route.drive.wheel_angles(at_s, tick_robot().wheels)
        np.testing.assert_allclose(moving.wheels[0].right.at(stamps), angles[:, 0], atol=1e-7)
    assert np.std(off) == pytest.approx(0.01, rel=0.2)  # 200 stamps
    assert np.mean(off) == pytest.approx(0.02, abs=0.003)


def test_a_rolling_shutter_and_a_late_right_camera():
    robot, route = tick_robot(), route_of("tick", "moving")
    rig, corners_k = robot.rig_cameras, corners_of(route)
    extraction = seen("tick", {"readout": 0.02, "time_right": 0.003}, "moving")
    for o, t in list(zip(extraction.observations, station_times_s(route), strict=True))[::8]:
        for side, late_s in ((0, 0.0), (1, 0.003)):
            pixels = (o.views[0].pixels, o.views[1].pixels)[side]
            for k in (0, 30, 53):
                row_s = ((pixels[k, 1] + 0.5) / 480 - 0.5) * 0.02
                T_c_k = board_in_camera(robot, route, t + late_s + row_s)
                expected = both(rig, T_c_k, corners_k[k : k + 1])[side][0]
                np.testing.assert_allclose(pixels[k], expected, rtol=0, atol=1e-3)
    plain = seen("tick", {}, "moving")
    pairs = zip(extraction.observations, plain.observations, strict=True)
    assert max(np.linalg.norm(a.views[0].pixels - b.views[0].pixels, axis=1).max() for a, b in pairs) > 0.5


def test_sag_and_gravity_play_change_the_reading_of_the_tilt_alone():
    route = route_of("tick")
    true = route.joints(station_times_s(route))
    outside = Outside(sag_rad=0.02, gravity_play_rad=0.01)
    readings = np.array([o.joints for o in seen("tick", {}, outside=outside).observations])
    tilt = true[:, 1]
    np.testing.assert_allclose(readings[:, 0], true[:, 0], atol=1e-15)
    np.testing.assert_allclose(readings[:, 1], tilt - 0.02 * np.sin(tilt) - 0.005 * np.sign(tilt), atol=1e-15)


@pytest.mark.long
def test_heavy_tails_keep_the_variance_of_the_wheels_noise():
    route = plan_route(tick_robot(), "standard", 12, seed=5)
    level = Noise(wheel_rad_per_sqrt_rad=0.003)
    truth = ideal_extraction(tick_robot(), route).wheels[0].right_rad
    scaled = {}
    for heavy in (False, True):
        parts = []
        for seed in range(10):
            what = Imperfection({}, level, Outside(heavy_tails=heavy))
            noisy = imperfect_extraction(tick_robot(), route, what, seed)
            a, b = np.diff(truth), np.diff(noisy.wheels[0].right_rad)
            turning = np.abs(a) > 1e-6
            parts.append((b - a)[turning] / np.sqrt(np.abs(a[turning])))
        scaled[heavy] = np.concatenate(parts)
    assert np.std(scaled[False]) == pytest.approx(0.003, rel=0.03)
    assert np.std(scaled[True]) == pytest.approx(0.003, rel=0.15)  # its fourth moment is infinite
    # Half of all values: within 0.674 sigma of a normal, within 0.765 / sqrt(3) of a Student t distribution.
    assert np.median(np.abs(scaled[True])) == pytest.approx(0.003 * 0.765 / np.sqrt(3), rel=0.05)
    assert kurtosis(scaled[True]) > 5 > 1 > kurtosis(scaled[False])


def test_the_half_of_a_board_on_another_sheet_is_displaced():
    board = plan_route(tick_robot(), "standard", stations=4, seed=0).board
    boards = (OutsideRobot(tick_robot(), {}, o) for o in (Outside(), Outside(sheet_m=0.0003)))
    whole, halves = (robot.corners_k(board) for robot in boards)
    beyond = board.grid()[:, 0] > (board.columns - 1) / 2
    assert beyond.any()
    assert not beyond.all()
    assert halves - whole == pytest.approx(np.where(beyond[:, None], [0.0003, 0.0003, 0.0], 0.0), abs=1e-12)
