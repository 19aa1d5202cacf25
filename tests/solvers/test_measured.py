"""Poses that somebody else measured in place of corners."""

from dataclasses import replace

import numpy as np
import pytest

from mobilecal_cli import se3
from mobilecal_cli.calibrate.steps import Data, Report, fitted
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.kinematics import integrate
from mobilecal_cli.kinematics.wheels import Increments
from mobilecal_cli.measured import Drive, TargetPose, from_motions, from_poses
from mobilecal_cli.model import Parameters, SensorMotion, WheelGeometry
from mobilecal_cli.simulate.robot import paper_robot
from mobilecal_cli.solvers.solve import solve
from tests.extractions import Noise, simulated
from tests.report.schema import validated
from tests.robots import chain_of
from tests.truth import parameters_of

SIGMA = np.array([1e-3, 1e-3, 1e-3, 5e-4, 5e-4, 2e-3])  # rad, m


def drive(seed, stated=1.0):
    """A pan-tilt robot's poses of a target, with noise of `SIGMA`; the covariance is stated with another scale."""
    robot, random = paper_robot(), np.random.default_rng(seed)
    exact = simulated("standard", Noise(0, 0.003, 0, 1e-4), robot, 20, seed)
    covariance = np.diag((stated * SIGMA) ** 2)
    poses = []
    for o in exact.observations:
        joints = dict(zip(chain_of(robot).joints, o.joints.tolist(), strict=True))
        T_c_k = se3.exp(random.normal(size=6) * SIGMA) @ o.T_c_k
        poses.append(TargetPose(o.time_ns / 1e9, T_c_k, covariance, joints))
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
    solution = solve(from_poses([given], tuple(robot.wheels.vector), chain_of(robot)))
    assert len(solution.outliers) == 1
    assert np.abs(off(solution, parameters_of(robot))).max() < 4


WHEELS = WheelGeometry(0.0207, 0.0206, 0.088)
T_V_C = se3.transform(se3.rotation_z(np.array(0.4)), np.array([0.03, -0.01, 0.1]))


def legs(count, seed, wrong=0.0):
    """Single legs of a robot with a planar sensor; a share of the sensor's motions is wrong by decimeters."""
    random = np.random.default_rng(seed)
    found = []
    for _ in range(count):
        right, left = random.choice([-0.8, 0.8, 1.0, 0.5], 2)
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


def test_bad_covariances_and_missing_joints_are_named():
    robot, recorded = drive(3)
    first = recorded.poses[0]
    negative = TargetPose(0.0, first.T_c_k, -np.eye(6), first.joints)
    for bad, said in (
        (negative, "drive 1, pose 1: the covariance is not positive"),
        (TargetPose(0.0, first.T_c_k, np.eye(6)), "drive 1, pose 1: no reading of"),
    ):
        with pytest.raises(ConfigError, match=said):
            from_poses([Drive([bad], *([np.zeros(2)] * 3))], (0.1, 0.1, 0.4), chain_of(robot))
    with pytest.raises(ConfigError, match="leg 1: the covariance"):
        from_motions([SensorMotion(1.0, 1.0, np.zeros(3), np.zeros((3, 3)))], (0.1, 0.1, 0.4), np.eye(4))


def test_measured_poses_and_motions_have_a_report():
    """Plots of corners are left out; all numbers are finite, and the page is whole."""
    robot, recorded = drive(3)
    nominal = T_V_C @ se3.transform(se3.rotation_z(np.array(0.005)), np.array([0.001, 0.001, 0.0]))
    for extraction in (
        from_poses([recorded], tuple(robot.wheels.vector * 1.001), chain_of(robot)),
        from_motions(legs(150, 1), (0.0206, 0.0206, 0.0885), nominal),
    ):
        report = Report(Data(extraction, (), {}), fitted(extraction))
        assert report.verdict.level == "PASS"
        assert "Reprojection" not in str(report)
        assert "measured poses, over their stated standard deviation" in report.html
        assert "All corner residuals" not in report.html
        assert "NaN" not in report.json
        validated(report.json)


@pytest.mark.parametrize("wheels_m", [(0.0, 0.02, 0.09), (-0.02, 0.02, 0.09), (float("nan"), 0.02, 0.09)])
def test_wheels_that_are_not_positive_are_refused(wheels_m):
    with pytest.raises(ConfigError, match="not positive"):
        from_motions(legs(8, 1), wheels_m, T_V_C)
