"""Robots with four wheels, with odometry alone, and with counters, from the recording to the exports."""

import json
from dataclasses import replace

import numpy as np
import pytest
from ruamel.yaml import YAML

from mobilecal_cli.calibrate.evaluate import evaluate
from mobilecal_cli.calibrate.export import export
from mobilecal_cli.calibrate.load import read_params
from mobilecal_cli.comparison import difference
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.export.params import parameters_from_yaml
from mobilecal_cli.model import FACTORS, AssumedOdometry, CalibratedRobot, WheelGeometry
from mobilecal_cli.simulate.record import simulate, truth_path
from mobilecal_cli.simulate.robot import ROBOTS, urdf_text
from mobilecal_cli.simulate.scenario import Scenario
from tests.command import run, succeeded

YAML_ = YAML(typ="safe", pure=True)

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def made(tmp_path_factory):
    """Recordings of both robots, and their results."""
    folder, results = tmp_path_factory.mktemp("made"), {}
    for robot, container in (("skid_steer", "mcap"), ("odometry_only", "bag")):
        log = folder / f"{robot}.{container}"
        simulate(Scenario(robot=robot, stations=10, seed=4, container=container, pictures_per_rest=1), log)
        done = succeeded("calibrate", log, "--board", "9x6", "--output", folder / robot, cwd=folder)
        results[robot] = log, folder / robot, done.out, YAML_.load(truth_path(log).read_text())
    return results


def test_four_wheels(made):
    _, folder, _, truth = made["skid_steer"]
    found = read_params(folder / "params.yaml")
    std = np.sqrt(np.diag(found.knowledge.covariance))[6:]
    true = [truth["wheels"][name] for name in ("radius_right_m", "radius_left_m", "separation_m")]
    assert np.all(np.abs(found.wheels.vector - true) < 4 * std + [0, 0, 0.002])  # it varies with the rate
    assert found.side_joints["left"] == ("front_left_wheel_joint", "rear_left_wheel_joint")
    constants = json.loads((folder / "report.json").read_text())["constants"]
    assert 0 < constants["turn_slip"]["value"] < 0.04
    controller = export(folder / "params.yaml", "ros2_control").content.decode()
    assert 'left_wheel_names: ["front_left_wheel_joint", "rear_left_wheel_joint"]' in controller
    values = YAML_.load(controller)["diff_drive_controller"]["ros__parameters"]
    assert values["wheel_separation_multiplier"] == pytest.approx(found.wheels.separation_m / 0.376)


def test_odometry_alone(made):
    _, folder, text, truth = made["odometry_only"]
    found = read_params(folder / "params.yaml")
    for name, std in found.factors_std.items():
        assert abs(found.factors[name] - truth["odometry"][name]) < 4 * std < 0.04
    assert "linear scale" in text
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
        ("  right_wheel_radius_multiplier: 0", "  right_wheel_radius_multiplier: -0", "greater than"),
        ("order: [r_x", "order: [r_y", "order and observable must list"),
    ):
        with pytest.raises(ConfigError, match=said):
            parameters_from_yaml(text.replace(before, after, 1))


@pytest.mark.parametrize(
    ("robot", "belongs"), [("odometry_only", "factors"), ("skid_steer", "the effective separation")]
)
def test_the_urdf_keeps_its_wheels(made, tmp_path, robot, belongs):
    text = urdf_text(ROBOTS[robot]())
    (tmp_path / "robot.urdf").write_text(text)
    done = export(made[robot][1] / "params.yaml", "urdf", urdf=tmp_path / "robot.urdf")
    assert any(belongs in note and "wheels are unchanged" in note for note in done.notes)
    kept, drawn = (
        [line for line in urdf.splitlines() if "wheel" in line] for urdf in (done.content.decode(), text)
    )
    assert kept == drawn


def test_evaluate_and_compare(made, tmp_path):
    log, folder, _, _ = made["odometry_only"]
    second = made["skid_steer"][1] / "params.yaml"
    done = evaluate([log], folder / "params.yaml")
    named = {check.name for check in done.verdict.checks}
    assert "wheel separation multiplier" in named
    assert "wheel separation" not in named
    assert done.verdict.level in ("PASS", "NOT ENOUGH")
    with pytest.raises(ConfigError, match="of wheels, and the recording is read as odometry alone"):
        evaluate([log], second)
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


def test_nominal_wheels_make_lengths_of_odometry(made, tmp_path):
    log, _, _, truth = made["odometry_only"]
    sizes = ("radius_left_m=0.0352", "radius_right_m=0.0352", "separation_m=0.23")
    flags = [part for size in sizes for part in ("--set", f"nominal.wheels.{size}")]
    succeeded("calibrate", log, "--output", tmp_path / "out", *flags, cwd=tmp_path)
    found = read_params(tmp_path / "out" / "params.yaml")
    std = np.sqrt(np.diag(found.knowledge.covariance))[6:]
    true = [truth["wheels"][name] for name in ("radius_right_m", "radius_left_m", "separation_m")]
    assert np.all(np.abs(found.wheels.vector - true) < 4 * std)
