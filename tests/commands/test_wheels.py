"""Robots with four wheels and with odometry alone, and one camera, from the recording to the exports."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from ruamel.yaml import YAML

from mobilecal_cli.calibrate.evaluate import evaluate
from mobilecal_cli.calibrate.export import export
from mobilecal_cli.calibrate.extract import extract
from mobilecal_cli.calibrate.load import read_params
from mobilecal_cli.calibrate.steps import calibrate
from mobilecal_cli.comparison import difference
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.export.params import parameters_from_yaml
from mobilecal_cli.model.calibration import CalibratedRobot
from mobilecal_cli.model.rig import FACTORS, AssumedOdometry, WheelGeometry
from mobilecal_cli.rig.config import load_rig
from mobilecal_cli.simulate.robot import urdf_text
from tests.command import run
from tests.robots import rgbd_with_odometry, skid_steer_that_pans
from tests.truth import nees

YAML_ = YAML(typ="safe", pure=True)
ROBOTS = {"skid_steer_pan": skid_steer_that_pans(), "rgbd_odometry": rgbd_with_odometry()}
SQUARE = {"board.square_m": 0.08}


@pytest.fixture(scope="module")
def made(sample_logs, tmp_path_factory):
    """Robot → its recording, the directory of its result, the report on it, and the truth."""
    folder, results = tmp_path_factory.mktemp("made"), {}
    for name in ROBOTS:
        log, truth = sample_logs / f"{name}.mcap", sample_logs / f"{name}.truth.yaml"
        report = calibrate([log], folder / name, config=load_rig(None, SQUARE))
        results[name] = log, folder / name, report, YAML_.load(truth.read_text(encoding="utf-8"))
    return results


@pytest.mark.parametrize("name", ROBOTS)
def test_the_height_of_the_camera_is_as_described(made, name):
    report = made[name][2]
    assert report.verdict.level == "PASS"
    assert "The camera's height is from the robot description" in report.verdict.reason
    assert report.fit.solution.uncertainty.described.tolist() == [k == 5 for k in range(9)]


def test_an_evaluation_takes_the_board_of_a_calibration_with_one_camera_and_leaves_the_height_out(made):
    """It asked for the size of squares that params.yaml has."""
    log, folder, *_ = made["rgbd_odometry"]
    evaluated = evaluate([log], folder / "params.yaml")
    assert evaluated.verdict.level == "PASS"
    named = {check.name for check in evaluated.verdict.checks}
    assert "wheel separation multiplier" in named
    assert "wheel separation" not in named
    assert "camera position without its height" in evaluated.verdict.reason
    assert any("9 x 6 inner corners, squares of 80 mm" in note for note in evaluated.notes)
    other = load_rig(None, {"board.square_m": 0.09})
    assert evaluate([log], folder / "params.yaml", config=other).verdict.level == "FAIL"


def test_four_wheels(made):
    _, folder, report, _ = made["skid_steer_pan"]
    assert (
        nees(report.fit.parameters, report.fit.covariance, ROBOTS["skid_steer_pan"], np.arange(9) != 5) < 2.7
    )
    found = read_params(folder / "params.yaml")
    assert found.side_joints["left"] == ("front_left_wheel_joint", "rear_left_wheel_joint")
    assert 0 < report.fit.solution.constants["turn_slip"].value < 0.04
    controller = export(folder / "params.yaml", "ros2_control").content.decode()
    assert 'left_wheel_names: ["front_left_wheel_joint", "rear_left_wheel_joint"]' in controller
    values = YAML_.load(controller)["diff_drive_controller"]["ros__parameters"]
    assert values["wheel_separation_multiplier"] == pytest.approx(found.wheels.separation_m / 0.376)


def test_odometry_alone(made):
    _, folder, report, truth = made["rgbd_odometry"]
    found = read_params(folder / "params.yaml")
    for name, std in found.factors_std.items():
        assert abs(found.factors[name] - truth["odometry"][name]) < 3 * std < 0.03
    assert "linear scale" in str(report)
    params = YAML_.load((folder / "params.yaml").read_text())
    assert "wheels" not in params
    assert "radius" not in json.dumps(params["uncertainty"]["order"]).replace("radius_multiplier", "")
    data = json.loads((folder / "report.json").read_text())
    assert data["parameters"]["radius_right_mm"] is None
    for name, value in found.factors.items():
        assert data["parameters"]["odometry"]["factors"][name]["value"] == pytest.approx(value)
    assert data["metrics"]["std.odometry.angular_scale"] == pytest.approx(
        found.factors_std["angular_scale"], rel=1e-6
    )
    assert data["metrics"]["std.wheels.separation_m"] is None
    assert "turn_sides" in data["constants"]
    assert "wheel_delay" not in data["constants"]  # its wheels are read at one time
    assert {name for name in data["metrics"] if "odometry" in name} == {
        f"std.odometry.{name}" for name in FACTORS
    }
    controller = YAML_.load(export(folder / "params.yaml", "ros2_control").content.decode())
    values = controller["diff_drive_controller"]["ros__parameters"]
    assert values == pytest.approx({name: found.factors[name] for name in FACTORS[:3]})
    exported = json.loads(export(folder / "params.yaml", "json").content)
    assert exported["odometry"]["linear_scale"] == pytest.approx(found.factors["linear_scale"])
    assert "radius_left_m" not in exported
    assert b"mobilecal_odometry_angular_scale" in export(folder / "params.yaml", "xacro").content
    assert export(folder / "params.yaml", "odometry_covariance").content
    text = (folder / "params.yaml").read_text()
    robot = parameters_from_yaml(text)
    assert robot.odometry.topic == "/odom"
    for before, after, said in (
        ("odometry:", "odometri:", "wheels: missing"),
        ("  right_wheel_radius_multiplier: ", "  right_wheel_radius_multiplier: -", "greater than"),
        ("order: [r_x", "order: [r_y", "order and observable must list"),
    ):
        with pytest.raises(ConfigError, match=said):
            parameters_from_yaml(text.replace(before, after, 1))


@pytest.mark.parametrize(
    ("robot", "belongs"), [("rgbd_odometry", "factors"), ("skid_steer_pan", "the effective separation")]
)
def test_the_urdf_keeps_its_wheels(made, tmp_path, robot, belongs):
    text = urdf_text(ROBOTS[robot])
    (tmp_path / "robot.urdf").write_text(text)
    done = export(made[robot][1] / "params.yaml", "urdf", urdf=tmp_path / "robot.urdf")
    assert any(belongs in note and "wheels are unchanged" in note for note in done.notes)
    kept, drawn = (
        [line for line in urdf.splitlines() if "wheel" in line] for urdf in (done.content.decode(), text)
    )
    assert kept == drawn


def test_evaluate_and_compare(made, tmp_path):
    log, folder, _, _ = made["rgbd_odometry"]
    second = made["skid_steer_pan"][1] / "params.yaml"
    with pytest.raises(ConfigError, match="of wheels, and the recording is read as odometry alone"):
        evaluate([log], second, config=load_rig(None, SQUARE))
    first, other = read_params(folder / "params.yaml"), read_params(second)
    with pytest.raises(ConfigError, match="the factors of odometry"):
        difference(first, replace(other, parent_frame=first.parent_frame, child_frame=first.child_frame))
    wider = first.with_assumed(WheelGeometry(0.2, 0.2, 0.5))
    assert np.abs(difference(first, wider).change).max() < 1e-12
    text = run("compare", folder / "params.yaml", folder / "params.yaml", cwd=tmp_path).out
    assert "wheel_separation_multiplier" in text


def test_other_assumed_wheels_have_the_same_drift():
    """Run and turn by odometry, mapped by the wheels of two assumptions: only the creep in turns differs."""
    odometry = AssumedOdometry("/odom", WheelGeometry(0.1, 0.1, 0.4))
    robot = CalibratedRobot("a", "b", np.eye(4), WheelGeometry(0.101, 0.098, 0.41), odometry=odometry)
    other = robot.with_assumed(WheelGeometry(0.05, 0.05, 0.3))

    def mapped(one):
        right, left, separation, *_ = one.factors.values()
        b = one.odometry.wheels.separation_m
        return (right + left) / 2, (right - left) / (separation * b), (right + left) / (2 * separation)

    assert mapped(robot) == pytest.approx(mapped(other))
    for name in FACTORS[3:]:
        assert robot.factors[name] == pytest.approx(other.factors[name])


def test_the_axle_is_where_the_odometry_turns(made, tmp_path, monkeypatch):
    """A URDF without wheels, and a base frame 50 mm behind the axle."""
    urdf = re.sub(
        r'<joint name="[^"]*wheel.*?</joint>', "", urdf_text(ROBOTS["rgbd_odometry"]), flags=re.DOTALL
    )
    (tmp_path / "robot.urdf").write_text(urdf)
    config = load_rig(None, SQUARE | {"head.urdf": str(tmp_path / "robot.urdf")})
    monkeypatch.setattr("mobilecal_cli.readers.signals.wheels.Odometry.check_forward", lambda *_: -0.05)
    extraction, _ = extract([made["rgbd_odometry"][0]], config)
    assert extraction.rig.chain.links[0].T_parent_child[:3, 3] == pytest.approx([-0.05, 0, 0])
    assert any("is 50 mm behind the axle" in note for note in extraction.notes)


def test_wrong_squares_are_told_from_odometry_that_is_wrong(made, tmp_path):
    again = load_rig(None, SQUARE | {"board.square_m": 0.072})
    report = calibrate([made["rgbd_odometry"][0]], tmp_path / "out", config=again)
    assert re.fullmatch(
        r"The odometry's distances are at least (9|10)\.\d % too long\.", report.verdict.reason
    )
    assert "Measure ten squares" in report.verdict.next_step
    assert "in the odometry's driver" in report.verdict.next_step


@pytest.mark.long
def test_nominal_wheels_make_lengths_of_odometry(made, tmp_path):
    log, _, _, truth = made["rgbd_odometry"]
    wheels = {"radius_left_m": 0.035, "radius_right_m": 0.035, "separation_m": 0.23}
    report = calibrate([log], tmp_path / "out", config=load_rig(None, SQUARE | {"nominal.wheels": wheels}))
    std = np.sqrt(np.diag(report.fit.covariance))[6:]
    true = [truth["wheels"][name] for name in ("radius_right_m", "radius_left_m", "separation_m")]
    assert np.all(np.abs(report.robot.wheels.vector - true) < 4 * std)
