"""Poses that somebody else measured in place of corners."""

import re
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from mobilecal_cli import se3
from mobilecal_cli.calibrate.steps import Data, Report, fitted
from mobilecal_cli.errors import ConfigError, SolveError
from mobilecal_cli.kinematics import head_pose, integrate
from mobilecal_cli.kinematics.wheels import Increments
from mobilecal_cli.measured import Drive, TargetPose, from_motions, from_poses
from mobilecal_cli.model.calibration import Parameters
from mobilecal_cli.model.observations import SensorMotion
from mobilecal_cli.model.rig import WheelGeometry
from mobilecal_cli.simulate.robot import FIXED_CAMERA_ROBOT, PAPER_ROBOT
from mobilecal_cli.solvers.constraints import Constraints
from mobilecal_cli.solvers.inference import Inference
from mobilecal_cli.solvers.solve import solve
from tests.extractions import Noise, simulated
from tests.judging import judge
from tests.report.schema import validated
from tests.robots import chain_of
from tests.truth import parameters_of

SIGMA = np.array([1e-3, 1e-3, 1e-3, 5e-4, 5e-4, 2e-3])  # rad, m
OPTICAL = se3.transform(se3.from_rpy(np.radians([-90.0, 0.0, -90.0])), np.zeros(3))  # in the body frame
ON_BASE = se3.transform(se3.from_rpy(np.array([0.1, 0.2, 0.3])), np.array([0.6, 0.0, 0.4]))


@cache
def drive(seed, stated=1.0, times=1.0, late_s=None, robot=PAPER_ROBOT):
    """A pan-tilt robot's poses of a target, with noise of `times` `SIGMA`; the covariance is stated with another scale.

    They are taken at stops, or in motion with stamps that are late.
    """
    random, sigma = np.random.default_rng(seed), times * SIGMA
    exact = simulated("standard", Noise(0, 0.003, 0, 1e-4), robot, 20, seed)
    if late_s is not None:
        exact = simulated("moving", Noise(0, 0.003, 0, 1e-4), robot, 12, seed, images=40)
    covariance = np.diag((stated * sigma) ** 2)
    poses = []
    for o in exact.observations:
        joints = dict(zip(chain_of(robot).joints, o.joints.tolist(), strict=True))
        T_c_k = se3.exp(random.normal(size=6) * sigma) @ o.T_c_k
        poses.append(TargetPose(o.time_ns / 1e9 + (late_s or 0.0), T_c_k, covariance, joints))
    (track,) = exact.wheels
    return robot, Drive(poses, track.time_ns / 1e9, track.right_rad, track.left_rad)


def off(solution, parameters):
    """The nine errors in standard deviations."""
    std = np.sqrt(np.diag(solution.uncertainty.covariance))
    return solution.parameters.minus(parameters) / np.where(std > 0, std, 1.0)


@pytest.mark.parametrize("stated", [1.0, 5.0])
def test_poses_of_a_target_give_all_nine(stated):
    robot, recorded = drive(3, stated)
    extraction = from_poses([recorded], tuple(robot.wheels.vector * 1.02), chain_of(robot))
    solution = solve(extraction)
    assert solution.uncertainty.observable.all()
    assert np.abs(off(solution, parameters_of(robot))).max() < 4
    assert solution.uncertainty.noise.pose_scale == pytest.approx(1 / stated, rel=0.3)
    assert np.sqrt(np.diag(solution.uncertainty.covariance)[:3]).max() < 5e-3


def test_a_wrong_pose_is_left_out():
    robot, recorded = drive(4)
    wrong = recorded.poses[7]
    moved = replace(wrong, T_c_k=se3.exp(np.array([0, 0.2, 0, 0.3, 0, 0.0])) @ wrong.T_c_k)
    poses = [*recorded.poses[:7], moved, *recorded.poses[8:]]
    given = Drive(poses, recorded.wheel_time_s, recorded.right_rad, recorded.left_rad)
    extraction = from_poses([given], tuple(robot.wheels.vector), chain_of(robot))
    solution = solve(extraction)
    (outlier,) = solution.outliers
    assert re.search(r"the target is .* Its pose is excluded\.", outlier.text)
    verdict = judge(solution, extraction)
    assert verdict.check("stations").name == "stations with a measured pose"
    assert not [check.id for check in verdict.checks if check.unit == "px"], "there are no images"
    assert np.abs(off(solution, parameters_of(robot))).max() < 4


WHEELS = WheelGeometry(0.0207, 0.0206, 0.088)
T_V_C = se3.transform(se3.rotation_z(np.array(0.4)), np.array([0.03, -0.01, 0.1]))


def legs(count, seed, wrong=0.0, times=1.0):
    """Single legs of a robot with a planar sensor, of some length; a share of its motions is wrong by decimeters."""
    random = np.random.default_rng(seed)
    found = []
    for _ in range(count):
        right, left = times * random.choice([-0.8, 0.8, 1.0, 0.5], 2)
        turned = np.array([right, left]) + 0.003 * random.normal(size=2) * np.sqrt(np.abs([right, left]))
        motion = integrate(Increments(turned[:1], turned[1:], np.zeros(1, dtype=np.int64), 1), WHEELS)
        T_b = se3.transform(se3.rotation_z(motion.psi_rad[0]), np.append(motion.t_m[0], 0.0))
        T = se3.inverse(T_V_C) @ T_b @ T_V_C
        seen = np.array([*T[:2, 3], np.arctan2(T[1, 0], T[0, 0])])
        seen = seen + random.normal(size=3) * [6e-4, 6e-4, 2e-3]
        if random.uniform() < wrong:
            seen = seen + random.normal(size=3) * [0.1, 0.1, 0.2]
        found.append(SensorMotion(right, left, seen, np.diag([1e-3, 1e-3, 3e-3]) ** 2))
    return found


@pytest.mark.parametrize("wrong", [0.0, pytest.param(0.04, marks=pytest.mark.long)])
def test_single_legs_with_a_planar_sensor(wrong):
    nominal = T_V_C @ se3.transform(se3.rotation_z(np.array(0.05)), np.array([0.01, 0.01, 0.0]))
    solution = solve(from_motions(legs(150, 1, wrong), (0.02, 0.02, 0.09), nominal))
    seen = [2, 3, 4, 6, 7, 8]
    assert solution.uncertainty.observable[seen].all()
    assert solution.uncertainty.fixed[[0, 1, 5]].all()
    assert np.abs(off(solution, Parameters(T_V_C, WHEELS))[seen]).max() < 4
    assert np.all(np.sqrt(np.diag(solution.uncertainty.covariance)[6:]) < 0.005 * WHEELS.vector)


def with_pose(recorded, k=0, **changes):
    """The drive with one pose changed."""
    poses = list(recorded.poses)
    poses[k] = replace(poses[k], **changes)
    return replace(recorded, poses=poses)


def test_bad_poses_readings_and_times_are_named():
    robot, recorded = drive(3)
    T, time_s = recorded.poses[0].T_c_k, recorded.wheel_time_s
    longer, mirrored = np.diag([1.1, 1.1, 1.1, 1.0]), np.diag([1.0, 1.0, -1.0, 1.0])
    in_mm = se3.transform(T[:3, :3], 1000 * T[:3, 3])
    failed = np.where(np.arange(len(time_s)) == 7, np.nan, recorded.right_rad)
    unread = dict(recorded.poses[0].joints, **{chain_of(robot).joints[0]: np.nan})
    for bad, said in (
        (with_pose(recorded, covariance=-np.eye(6)), "drive 1, pose 1: the covariance is not positive"),
        (with_pose(recorded, covariance=np.zeros((6, 6))), "of a standard deviation below 1e-06 rad or m"),
        (with_pose(recorded, joints={}), "drive 1, pose 1: no reading of"),
        (with_pose(recorded, joints=unread), f"drive 1, pose 1: {chain_of(robot).joints[0]} is not finite"),
        (with_pose(recorded, T_c_k=T * np.nan), "drive 1, pose 1: not a finite 4 x 4 matrix"),
        (with_pose(recorded, T_c_k=T @ longer), "drive 1, pose 1: not a rigid transform .R.T R .* by 0.21"),
        (with_pose(recorded, T_c_k=T @ mirrored), "drive 1, pose 1: not a rigid transform .*determinant -1"),
        (with_pose(recorded, T_c_k=in_mm), r"drive 1, pose 1: a translation of \d{4} m"),
        (with_pose(recorded, time_s=time_s[-1] + 1.0), "drive 1: no wheel readings at 1 of 20 poses"),
        (replace(recorded, right_rad=failed), r"drive 1: right_rad\[7\] is nan"),
        (replace(recorded, left_rad=recorded.left_rad[1:]), "drive 1: .* wheel times, .* left readings"),
        (replace(recorded, wheel_time_s=np.round(time_s)), "drive 1: wheel_time_s does not increase"),
    ):
        with pytest.raises(ConfigError, match=said):
            from_poses([bad], (0.1, 0.1, 0.4), chain_of(robot))
    with pytest.raises(ConfigError, match="T_h_c: not a rigid transform"):
        from_poses([recorded], (0.1, 0.1, 0.4), chain_of(robot), longer)
    with pytest.raises(ConfigError, match="leg 1: the covariance"):
        from_motions([SensorMotion(1.0, 1.0, np.zeros(3), np.zeros((3, 3)))], (0.1, 0.1, 0.4), np.eye(4))


def test_poses_count_in_any_order():
    robot, recorded = drive(3)
    given = tuple(robot.wheels.vector), chain_of(robot)
    shuffled = replace(recorded, poses=recorded.poses[::-1])
    times = [[o.time_ns for o in from_poses([each], *given).observations] for each in (recorded, shuffled)]
    assert times[0] == times[1] == sorted(times[0])


@pytest.mark.long
@pytest.mark.parametrize("seed", [3, 4])
def test_inverse_poses_are_named(seed):
    robot, recorded = drive(seed)
    inverse = [replace(pose, T_c_k=se3.inverse(pose.T_c_k)) for pose in recorded.poses]
    extraction = from_poses([replace(recorded, poses=inverse)], tuple(robot.wheels.vector), chain_of(robot))
    with pytest.raises(SolveError, match="the measured poses are inverted"):
        solve(extraction)


@pytest.mark.parametrize(
    ("in_base", "said"),
    [
        (lambda T_v_c, T_c_k: T_v_c @ T_c_k, "the measured poses are those in the frame of the base"),
        (lambda T_v_c, _: se3.inverse(T_v_c) @ ON_BASE, "the target stays where it is against the base"),
    ],
)
def test_poses_in_the_base_and_a_target_on_it_are_named(in_base, said):
    """The causes were joints in degrees, and wheels that are swapped or whose encoders have the wrong sign."""
    robot, recorded = drive(3)
    poses = []
    for pose in recorded.poses:
        T_v_h = head_pose(chain_of(robot), np.array([[*pose.joints.values()]]))[0]
        T_c_k = in_base(T_v_h @ robot.T_h_c, pose.T_c_k)
        poses.append(replace(pose, T_c_k=se3.exp(SIGMA * np.sin(1e3 * np.arange(6) * pose.time_s)) @ T_c_k))
    extraction = from_poses([replace(recorded, poses=poses)], tuple(robot.wheels.vector), chain_of(robot))
    with pytest.raises(SolveError, match=said):
        solve(extraction)


def test_a_target_that_moves_is_named_with_its_way_along_the_floor():
    """The leg's odometry was left out as a slip, and with it most of the way: "15 mm"; and the floor was to blame."""
    robot, recorded = drive(6)
    step = se3.exp(np.array([0.0, 0.0, 0.1, 0.1, 0.0, 0.0]))
    poses = [replace(p, T_c_k=p.T_c_k @ step) if k >= 10 else p for k, p in enumerate(recorded.poses)]
    extraction = from_poses([replace(recorded, poses=poses)], tuple(robot.wheels.vector), chain_of(robot))
    solution = solve(extraction)
    (jump,) = solution.jumps
    assert (jump.part, jump.station) == ("board", 10)
    assert jump.move_m == pytest.approx(0.1, abs=0.02)
    assert np.degrees(jump.turn_rad) == pytest.approx(5.7, abs=0.5)
    assert np.abs(off(solution, parameters_of(robot))).max() < 4
    assert judge(solution, extraction).level == "PASS"


@pytest.mark.parametrize("late_s", [0.0, 0.05])
def test_poses_in_motion_show_the_clock_of_the_wheels(late_s):
    """Poses that were stamped 20 ms late were wheels that slip, or were inverted, and a FAIL."""
    robot, recorded = drive(2, late_s=late_s)
    nominal = robot.T_h_c @ se3.exp(np.array([0.02, -0.03, 0.02, 0.01, 0.01, -0.01]))
    extraction = from_poses([recorded], tuple(robot.wheels.vector * 1.01), chain_of(robot), nominal)
    solution = solve(extraction)
    assert solution.constants["time_wheels"].value == pytest.approx(-late_s, abs=0.005)
    assert np.abs(off(solution, parameters_of(robot))).max() < 4
    assert judge(solution, extraction).level == "PASS"


def test_several_poses_at_one_stop_are_one():
    """Their errors are not independent: results were off by 4.5 sigmas, or the camera had moved on the head."""
    robot, recorded = drive(3)
    flipped = se3.exp(np.array([0.5, 0.0, 0.0, 0.0, 0.0, 0.0]))
    poses = [
        replace(pose, time_s=pose.time_s + late_s, T_c_k=pose.T_c_k @ turn)
        for pose in recorded.poses
        for late_s, turn in ((-0.02, np.eye(4)), (0.0, flipped), (0.02, np.eye(4)))
    ]
    once, often = (
        from_poses([replace(recorded, poses=each)], tuple(robot.wheels.vector), chain_of(robot))
        for each in (recorded.poses, poses)
    )
    assert (len(once.observations), len(often.observations)) == (20, 20)
    assert often.notes == ("drive 1: of several poses at one stop, the median counts: 60 are 20.",)
    for one, several in zip(once.observations, often.observations, strict=True):
        assert several.T_c_k == pytest.approx(one.T_c_k, abs=1e-9)


def test_wheels_that_are_read_at_the_stops_alone_rest_there():
    robot, recorded = drive(3)
    times_s = np.array([pose.time_s for pose in recorded.poses])
    rare = Drive(recorded.poses, times_s, 3.0 * times_s, 2.0 * times_s)
    extraction = from_poses([rare], tuple(robot.wheels.vector), chain_of(robot))
    assert all(o.at_rest for o in extraction.observations)


@pytest.mark.parametrize("times", [1.0, 8.0])
def test_the_noise_of_poses_is_no_error_of_the_calibration(times):
    """It was one: honest poses of 5 mrad and 10 mm were a FAIL, "depth noise alone: 0.0 mm"."""
    robot, recorded = drive(5, times=times)
    solution = solve(extraction := from_poses([recorded], tuple(robot.wheels.vector), chain_of(robot)))
    verdict = judge(solution, extraction)
    (check,) = (check for check in verdict.checks if check.id == "point_error")
    assert check.outcome == "pass"
    assert "noise of the poses alone" in check.measured_text
    assert 0.3 < solution.residuals.corner_noise_m / solution.point_rms_m < 1.2
    assert times == 1 or solution.residuals.corner_noise_m == pytest.approx(solution.point_rms_m, rel=0.2)


def test_a_scale_that_the_poses_hardly_show_is_no_wrong_scale():
    """Poses of 1.4 degrees and 50 mm: wheels 5 % off, by less than four of their sigmas, were a FAIL."""
    robot, recorded = drive(7, times=25.0)
    extraction = from_poses([recorded], tuple(1.053 * robot.wheels.vector), chain_of(robot))
    assert judge(solve(extraction), extraction).level == "NOT ENOUGH"


def test_noise_of_joints_may_be_that_of_the_poses():
    """Rotations that are stated too exactly were noise of the joint readings, and nothing else was to check."""
    robot, recorded = drive(5)
    random, stated = np.random.default_rng(0), np.diag([1e-4] * 3 + [2e-3] * 3) ** 2
    poses = [
        replace(
            p, T_c_k=se3.exp(np.append(0.02 * random.normal(size=3), [0, 0, 0])) @ p.T_c_k, covariance=stated
        )
        for p in recorded.poses
    ]
    given = from_poses([replace(recorded, poses=poses)], tuple(robot.wheels.vector), chain_of(robot))
    verdict = judge(solve(given), given)
    assert "that the covariances of the poses" in verdict.next_step


def test_measured_poses_and_motions_have_a_report():
    """Plots of corners are left out; all numbers are finite, and the page is whole."""
    robot, recorded = drive(3)
    nominal = T_V_C @ se3.transform(se3.rotation_z(np.array(0.005)), np.array([0.001, 0.001, 0.0]))
    for extraction in (
        from_poses([recorded], tuple(robot.wheels.vector * 1.001), chain_of(robot)),
        from_motions(legs(60, 1), (0.0206, 0.0206, 0.0885), nominal),
    ):
        report = Report(Data(extraction, (), {}), fitted(extraction))
        assert report.verdict.level == "PASS"
        assert "Reprojection" not in str(report)
        assert "measured poses, over their stated standard deviation" in report.html
        assert "All corner residuals" not in report.html
        assert "NaN" not in report.json
        validated(report.json)


@pytest.mark.parametrize("wheels_m", [(0.0, 0.02, 0.09), (-0.02, 0.02, 0.09), (float("nan"), 0.02, 0.09)])
def test_wheels_that_are_not_possible_are_refused(wheels_m):
    with pytest.raises(ConfigError, match=r"radius_right: .* is not possible"):
        from_motions(legs(8, 1), wheels_m, T_V_C)


def poses_since_the_first(motions):
    """The pose of the sensor at the end of each leg, in its frame at the start of the first."""
    T = np.eye(4)
    for x, y, heading in motions:
        T = T @ se3.transform(se3.rotation_z(np.array(heading)), np.array([x, y, 0.0]))
        yield [*T[:2, 3], np.arctan2(T[1, 0], T[0, 0])]


def in_a_fixed_frame(motions):
    poses = np.array([[0.0, 0.0, 0.0], *poses_since_the_first(motions)])
    cos, sin = np.cos(1.3), np.sin(1.3)
    return np.column_stack([np.diff(poses[:, :2], axis=0) @ [[cos, sin], [-sin, cos]], motions[:, 2]])


def inverted(motions):
    T = se3.inverse(se3.transform(se3.rotation_z(motions[:, 2]), np.insert(motions[:, :2], 2, 0.0, axis=1)))
    return np.column_stack([T[:, :2, 3], -motions[:, 2]])


WRONG_MOTIONS = {
    "the motions have headings in degrees": (lambda m, t: (m * [1, 1, 180 / np.pi], t)),
    "the motions have x and y exchanged": (lambda m, t: (m[:, [1, 0, 2]], t)),
    "the motions are inverted": (lambda m, t: (inverted(m), t)),
    "the motions are poses since the first leg": (lambda m, t: ([*poses_since_the_first(m)], t)),
    "the motions are differences of coordinates in a fixed frame": (lambda m, t: (in_a_fixed_frame(m), t)),
    "of a sensor whose z points the other way than T_v_c says": (lambda m, t: (m * [1, -1, -1], t)),
    "the motions have the wrong sign of y": (lambda m, t: (m * [1, -1, 1], t)),
    "the motions have the wrong sign of heading": (lambda m, t: (m * [1, 1, -1], t)),
    "12 of 24 motions repeat that of the leg before": (lambda m, t: (np.repeat(m[::2], 2, axis=0), t)),
    "all motions are the same, but the wheels turn otherwise": (lambda m, t: (m * 0 + m[0], t)),
    "radii and separation that fit are all": (lambda m, t: (m * [100, 100, 1], t)),
    "of about 100 % of a leg too late": (lambda m, t: (m, np.roll(t, 1, axis=0))),
    "the left and right wheels are swapped": (lambda m, t: (m, t[:, ::-1])),
    "the encoders of both wheels have the wrong sign": (lambda m, t: (m, -t)),
    "the right wheel's encoder has the wrong sign": (lambda m, t: (m, t * [-1, 1])),
    "1/57: the readings are in degrees": (lambda m, t: (m, np.degrees(t))),
}


def changed_legs(motions, change):
    seen, turned = (np.array([[*of(leg)] for leg in motions]) for of in (lambda m: m.motion, turns_of))
    seen, turned = change(seen, turned)
    return [
        replace(leg, motion=np.array(m), right_rad=float(right), left_rad=float(left))
        for leg, m, (right, left) in zip(motions, seen, turned, strict=True)
    ]


def turns_of(leg):
    return leg.right_rad, leg.left_rad


@pytest.mark.parametrize("said", WRONG_MOTIONS)
def test_mistakes_in_motions_are_named(said):
    """After half a minute, the answer was "did not converge", or more stations with the whole board in the images."""
    given = changed_legs(legs(24, 2, times=6.0), WRONG_MOTIONS[said])
    nominal = T_V_C @ se3.transform(se3.rotation_z(np.array(0.03)), np.array([0.002, -0.002, 0.0]))
    with pytest.raises(SolveError, match=said) as raised:
        solve(from_motions(given, (0.0206, 0.0206, 0.0885), nominal))
    assert not re.search(r"rig\.yaml|camera|image|board|wheels\.|nominal\.", raised.value.hint)


@pytest.mark.parametrize("scale", [0.98, 1.0, 1.02])
def test_a_scale_of_headings_is_named(scale):
    """The separation followed, 13 sigmas off, with a PASS."""
    given = changed_legs(legs(60, 2, times=12.0), lambda m, t: (m * [1, 1, scale], t))
    extraction = from_motions(given, (0.0206, 0.0206, 0.0885), T_V_C)
    verdict = judge(solve(extraction), extraction)
    if scale == 1.0:
        assert verdict.level == "PASS"
        return
    assert verdict.level == "FAIL"
    assert f"too {'large' if scale > 1 else 'small'} for their directions" in verdict.reason


def test_motions_without_a_known_mistake_are_refused_at_once():
    random = np.random.default_rng(0)
    given = changed_legs(legs(24, 2, times=6.0), lambda m, t: (random.permutation(m), t))
    with pytest.raises(SolveError, match=r"no known mistake explains it: they differ by .* mm on most legs"):
        solve(from_motions(given, (0.0206, 0.0206, 0.0885), T_V_C))


def test_words_of_recordings_are_those_of_arguments_and_names_stay():
    measured = from_motions(legs(4, 1), (0.0206, 0.0206, 0.0885), T_V_C)
    told = measured.worded("The camera, or nominal.head_eye in rig.yaml, and joint 'camera_pan'")
    assert told == "The sensor, or T_v_c, and joint 'camera_pan'"


@pytest.mark.parametrize("noise", [1.0, 30.0])
def test_no_mistake_is_named_in_motions_that_are_right(noise):
    """Also where they are much noisier than stated."""
    random = np.random.default_rng(1)
    given = changed_legs(
        legs(24, 2, times=6.0), lambda m, t: (m + noise * random.normal(size=m.shape) * [3e-4, 3e-4, 1e-3], t)
    )
    assert solve(from_motions(given, (0.0206, 0.0206, 0.0885), T_V_C)).diagnosis is None


@pytest.mark.parametrize("slip_m", [0.05, 0.3])
def test_the_size_of_a_slip_is_that_against_the_sensor(slip_m):
    """300 mm were "0 mm": the base of a leg that is left out stays where the last fit left it."""
    turned = slip_m / WHEELS.radius_right_m
    motions = legs(40, 1)
    motions[5] = replace(
        motions[5], right_rad=motions[5].right_rad + turned, left_rad=motions[5].left_rad + turned
    )
    solution = solve(from_motions(motions, tuple(WHEELS.vector), T_V_C))
    (outlier,) = solution.outliers
    assert outlier.text.startswith("Wheel slip, or a wrong motion, between stations 6:0 and 6:1")
    assert "wheels and the sensor differ by" in outlier.text
    size_mm = float(outlier.text.split("differ by ")[1].split(" mm")[0])
    assert size_mm == pytest.approx(1e3 * slip_m, rel=0.15)


def test_rounded_rotations_are_the_nearest_ones():
    """Three digits of a rotation matrix moved results by up to four standard deviations."""
    robot, recorded = drive(5)

    def with_poses(change):
        poses = [replace(pose, T_c_k=change(pose.T_c_k)) for pose in recorded.poses]
        given = replace(recorded, poses=poses)
        return solve(from_poses([given], tuple(robot.wheels.vector), chain_of(robot)))

    def rounded(T):
        return se3.transform(np.round(T[:3, :3], 4), T[:3, 3])

    def nearest(T):
        U, _, Vt = np.linalg.svd(np.round(T[:3, :3], 4))
        return se3.transform(U @ Vt, T[:3, 3])

    assert with_poses(rounded).parameters.vector == pytest.approx(
        with_poses(nearest).parameters.vector, abs=1e-9
    )


def on_a_circle(T_v_c, seed):
    """Poses by a sensor on a base that drives to and fro on one circle, over an uneven floor."""
    random, curvature = np.random.default_rng(seed), 0.9
    at_m = np.cumsum(random.uniform(0.2, 0.5, 16) * np.where(np.arange(16) % 8 < 4, 1, -1))
    T_w_k = se3.transform(se3.from_rpy(np.radians([90.0, 0, -90.0])), np.array([3.0, 0.3, 0.6]))
    poses = []
    for k, along in enumerate(curvature * at_m):
        place = np.array([np.sin(along), 1 - np.cos(along), 0.0]) / curvature
        floor = se3.exp(np.array([2e-3, 2e-3, 0, 0, 0, 1e-3]) * random.normal(size=6))
        T_w_c = se3.transform(se3.rotation_z(along), place) @ floor @ T_v_c
        poses.append(TargetPose(k + 1.0, se3.inverse(T_w_c) @ T_w_k, np.diag([1e-3] * 3 + [2e-3] * 3) ** 2))
    reading = np.concatenate([at_m[:1], at_m, at_m[-1:]]) / 0.1
    right, left = reading * (1 + curvature * 0.2), reading * (1 - curvature * 0.2)
    return Drive(poses, np.arange(18.0), right, left)


@pytest.mark.parametrize(
    ("robot", "change", "level", "said"),
    [
        (
            PAPER_ROBOT,
            lambda T: T @ OPTICAL,
            "PASS",
            "T_h_c looks like the pose of an optical frame (z forward), not",
        ),
        (
            FIXED_CAMERA_ROBOT,
            se3.inverse,
            "FAIL",
            "The sensor's height, which no motion shows, is taken from it.",
        ),
    ],
)
def test_a_nominal_pose_of_another_frame_is_told(robot, change, level, said):
    """It was not, and the height of a sensor on the base is taken from it: half a meter off, with a PASS."""
    robot, recorded = drive(3, robot=robot)
    nominal = change(robot.T_h_c)
    extraction = from_poses([recorded], tuple(robot.wheels.vector), chain_of(robot), nominal)
    verdict = judge(solve(extraction), extraction)
    assert verdict.level == level
    assert said in f"{verdict.reason} {verdict.next_step}"


@pytest.mark.parametrize("seed", range(3))
def test_on_one_circle_the_sensor_is_not_upside_down(seed):
    """Upside down, it fits as well: five of twelve starts were so, and "wheels are swapped" the answer."""
    T_v_c = se3.transform(se3.from_rpy(np.radians([-100.0, 2.0, -88.0])), np.array([0.2, 0.05, 0.6]))
    nominal = T_v_c @ se3.exp(np.radians([2.0, -1.0, 1.0, 0, 0, 0]))
    extraction = from_poses([on_a_circle(T_v_c, seed)], (0.102, 0.099, 0.41), T_h_c=nominal)
    start = Inference.of(extraction, Constraints()).initial().T_h_c
    assert np.linalg.norm(se3.log_so3(T_v_c[:3, :3].T @ start[:3, :3])) < 0.01
