"""Covariance of odometry: what its numbers mean to a filter, and how large the errors are."""

from dataclasses import replace

import numpy as np
import pytest
import yaml

from mobilecal_cli.calibrate import export as exporting
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.export.extraction import extraction_to_npz
from mobilecal_cli.export.formats import odometry_covariance as odometry
from mobilecal_cli.export.formats.odometry_covariance import odometry_covariance
from mobilecal_cli.export.text import rendered
from mobilecal_cli.kinematics import Increments, integrate
from mobilecal_cli.likelihood.dataset import dataset_of
from mobilecal_cli.model.calibration import CalibratedRobot, Knowledge
from mobilecal_cli.model.observations import LogSource
from mobilecal_cli.model.rig import AssumedOdometry, WheelGeometry
from mobilecal_cli.model.solution import Noise as LegNoise
from mobilecal_cli.simulate.robot import PAPER_ROBOT
from mobilecal_cli.targets import Target
from tests.actual import rolled_as_read
from tests.extractions import Noise, simulated

SQRT, SHARE, RATE_HZ, DISTANCE_M = 0.003, 0.002, 50.0, 4.0
LEVELS = {
    "wheel_rad_per_sqrt_rad": SQRT,
    "wheel_share": SHARE,
    "wheel_length_m": 1e6,
    "encoder_rad": 0.0,
    "floor_rad": 0.002,
    "floor_m": 0.001,
}
TRUE = PAPER_ROBOT.wheels
ROOT = np.array([[2e-4, 0, 0], [1.5e-4, 1e-4, 0], [4e-4, 3e-4, 1e-3]])


@pytest.fixture(scope="module")
def extraction():
    """Eleven legs, with given noise levels: nothing is widened."""
    made = simulated(noise=Noise(pixel_px=0.1), seed=4)
    known = {"wheel_rad_per_sqrt_rad": SQRT, "wheel_share": SHARE}
    return replace(made, rig=replace(made.rig, noise=known))


def robot_with(**levels):
    C = np.zeros((9, 9))
    C[6:, 6:] = ROOT @ ROOT.T
    known = Knowledge(C, np.ones(9, bool), {**LEVELS, **levels})
    return CalibratedRobot("head_link", "stereo_left_optical", np.eye(4), TRUE, known)


def test_the_variances_are_those_of_simulated_drives(extraction):
    """Straight drives with wheels drawn from the covariance of the calibration, and with noise of the wheels."""
    random, drives, n = np.random.default_rng(2), 1500, 20
    found = odometry_covariance(robot_with(), extraction, RATE_HZ, DISTANCE_M)
    true = np.linspace(0, DISTANCE_M, n + 1)[:, None] / TRUE.vector[:2]
    ends = []
    for _ in range(drives):
        rolled = rolled_as_read(
            true, np.zeros(n, int), Noise(wheel_rad_per_sqrt_rad=SQRT, wheel_share=SHARE), random
        )
        wheels = WheelGeometry.of(TRUE.vector + ROOT @ random.normal(size=3))
        motion = integrate(Increments(*np.diff(rolled, axis=0).T, np.zeros(n, int), 1), wheels)
        ends.append([*motion.t_m[0], motion.psi_rad[0]])
    x, y, heading = np.var(np.array(ends) - [DISTANCE_M, 0, 0], axis=0)
    of_variance = 4 * np.sqrt(2 / drives)
    assert x == pytest.approx(found.pose[0], rel=of_variance)
    assert y == pytest.approx(found.pose[1], rel=of_variance)
    assert y > 5 * x
    assert np.corrcoef(np.array(ends).T) == pytest.approx(found.correlation, abs=4 / np.sqrt(drives))
    assert found.motion == "4 m straight ahead"
    assert found.path_m == pytest.approx(DISTANCE_M)
    assert heading == pytest.approx(found.pose[5], rel=of_variance)
    messages = found.moving_s * RATE_HZ
    assert x == pytest.approx(found.twist[0] * messages / RATE_HZ**2, rel=of_variance)
    assert heading == pytest.approx(found.twist[5] * messages / RATE_HZ**2, rel=of_variance)


def test_across_is_across_the_drive_forward_and_backward(extraction):
    """Backward, the heading moves the end to the other side of the base, and to the same side of the drive."""
    data = dataset_of(extraction)
    noise = LegNoise.exact(pixel_px=0.1, wheel_rad_per_sqrt_rad=SQRT, joint_rad=0.0)
    step = 2.0 / 50 / TRUE.vector[:2]
    drives = (Increments(*(np.full(50, s) for s in way), np.zeros(50, int), 1) for way in (step, -step))
    forward, backward = (odometry._of_pose(data, way, TRUE, noise, np.zeros((3, 3))) for way in drives)
    assert backward == pytest.approx(forward, rel=1e-6, abs=1e-6)
    assert forward[1, 1] > 2 * forward[0, 0]
    assert forward[1, 2] > 0


def test_estimated_levels_widen_as_student_s_distribution_does(extraction):
    estimated = replace(extraction, rig=replace(extraction.rig, noise={}))
    given, widened = (odometry_covariance(robot_with(), each, RATE_HZ) for each in (extraction, estimated))
    assert given.widening == 1
    assert widened.widening == pytest.approx((2.200985 / 1.959964) ** 2, rel=1e-5)  # table of t, 11 degrees
    assert widened.twist[0] == pytest.approx(widened.widening * given.twist[0])


def test_the_levels_of_the_covariance(extraction):
    found = odometry_covariance(robot_with(), extraction, RATE_HZ)
    assert found.twist[2:5].tolist() == [1e6] * 3
    assert found.pose[2:5] == pytest.approx([0.001**2, 0.002**2, 0.002**2])
    found = odometry_covariance(robot_with(wheel_rad_per_sqrt_rad=1e-9), extraction, RATE_HZ)
    assert found.systematic == pytest.approx([1, 1], abs=1e-6)
    slow, fast = (odometry_covariance(robot_with(), extraction, rate) for rate in (10.0, 50.0))
    assert fast.twist[[0, 1, 5]] == pytest.approx(5 * slow.twist[[0, 1, 5]])
    assert fast.pose == pytest.approx(slow.pose)
    assert slow.legs == 11
    assert slow.moving_s == pytest.approx(2.6, abs=1.0)


def test_the_file_has_the_parameters_of_both_nodes(extraction):
    """Names and lengths as documented by ros2_controllers and robot_localization; read by another YAML loader."""
    found = odometry_covariance(robot_with(), extraction, RATE_HZ)
    data = yaml.safe_load(rendered("odometry_covariance.yaml", covariance=found, topic="/odom"))
    controller = data["diff_drive_controller"]["ros__parameters"]
    assert set(controller) == {"publish_rate", "pose_covariance_diagonal", "twist_covariance_diagonal"}
    assert controller["pose_covariance_diagonal"] == pytest.approx(found.pose.tolist())
    assert controller["twist_covariance_diagonal"] == pytest.approx(found.twist.tolist())
    assert all(
        isinstance(value, float) for values in controller.values() for value in np.ravel(values).tolist()
    )
    ekf = data["ekf_filter_node"]["ros__parameters"]
    used = [number for number, on in enumerate(ekf["odom0_config"]) if on]
    assert (len(ekf["odom0_config"]), used) == (15, [6, 7, 11])  # vx, vy, rotation about z
    assert ekf["odom0_differential"] is False


def test_refusals(extraction):
    with pytest.raises(ConfigError, match="does not state the noise of the wheels"):
        odometry_covariance(replace(robot_with(), knowledge=None), extraction, RATE_HZ)
    still = simulated("base_fixed", Noise(pixel_px=0.1), stations=5, seed=1)
    with pytest.raises(ConfigError, match="does not drive in the recording"):
        odometry_covariance(robot_with(), still, RATE_HZ)


@pytest.mark.parametrize(("distance_m", "noted"), [(None, True), (3.0, False)])
def test_a_note_on_short_legs(extraction, tmp_path, monkeypatch, distance_m, noted):
    """Legs of a few centimeters, as between images in motion, do not represent a robot's drives."""
    monkeypatch.setattr(exporting, "read_params", lambda _: robot_with())
    monkeypatch.setattr(odometry, "_LEAST_LEG_M", 1.0)
    (tmp_path / "extraction.npz").write_bytes(
        extraction_to_npz(replace(extraction, logs=(LogSource("log.mcap", "0" * 64),)))
    )
    made = exporting.export(tmp_path / "params.yaml", Target.odometry_covariance, distance_m=distance_m)
    assert any("--distance" in note for note in made.notes) == noted
    assert yaml.safe_load(made.content)["diff_drive_controller"]


@pytest.mark.parametrize("topic", ["/diff_drive_controller/odom", "/base/odom"])
def test_the_filter_reads_the_odometry_of_the_calibration(extraction, tmp_path, monkeypatch, topic):
    """For odometry alone, it read another topic than that of the recording."""
    robot = robot_with()
    if topic == "/base/odom":
        robot = replace(robot, odometry=AssumedOdometry(topic, robot.wheels))
    monkeypatch.setattr(exporting, "read_params", lambda _: robot)
    (tmp_path / "extraction.npz").write_bytes(
        extraction_to_npz(replace(extraction, logs=(LogSource("log.mcap", "0" * 64),)))
    )
    made = exporting.export(tmp_path / "params.yaml", Target.odometry_covariance)
    assert yaml.safe_load(made.content)["ekf_filter_node"]["ros__parameters"]["odom0"] == topic
