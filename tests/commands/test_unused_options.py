"""No option is silently ignored: those that a method or a format does not use are refused."""

from dataclasses import replace

import pytest

from mobilecal_cli.calibrate.export import export
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.export.extraction import extraction_to_npz
from mobilecal_cli.model.rig import Nominal
from mobilecal_cli.solvers import constraints_of, solve
from mobilecal_cli.solvers.inference import dataset_for
from mobilecal_cli.targets import Target
from tests.command import run
from tests.report.example import ROBOT, make_extraction

SEPARATION = ["--fix", "separation=0.6"]
CASES = {
    "--fix separation": SEPARATION,
    "--prior separation": ["--prior", "separation=0.6±0.01"],
    "--estimate pan_zero": ["--estimate", "pan_zero"],
    "--set noise.pixel_px": ["--set", "noise.pixel_px=0.3"],
    "--set priors.all": ["--set", "priors.all=free"],
}


@pytest.fixture(scope="module")
def extraction(tmp_path_factory):
    path = tmp_path_factory.mktemp("data") / "extraction.npz"
    path.write_bytes(extraction_to_npz(make_extraction()))
    return path


@pytest.mark.parametrize("method", ["linear", "lm", "paper"])
@pytest.mark.parametrize("option", CASES)
def test_the_method_does_not_use_it(extraction, tmp_path, method, option):
    done = run("calibrate", extraction, "--method", method, *CASES[option], cwd=tmp_path)
    assert (done.code, done.left) == (2, [])
    assert done.err.startswith(f"error: {option}: not used by --method {method}\nhint: ")


@pytest.mark.parametrize(
    ("fix", "prior", "estimate"),
    [
        (["separation=0.3", "separation=0.4"], [], []),
        (["separation=0.3", "wheels"], [], []),
        (["separation=0.3"], ["separation=0.3±0.1"], []),
        ([], ["separation=0.3±0.1", "separation=0.4±0.1"], []),
        (["pan_zero"], [], ["pan_zero"]),
        ([], ["pan_zero=0±0.1"], ["pan_zero"]),
    ],
)
def test_only_one_of_two_would_count(fix, prior, estimate):
    with pytest.raises(ConfigError, match="given twice"):
        constraints_of(fix, prior, estimate)


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("--fix", "time_joints=0.1"),
        ("--prior", "time_joints=0.1±0.01"),
        ("--estimate", "time_joints"),
        ("--estimate", "clock"),
    ],
)
def test_the_recording_does_not_show_it(extraction, tmp_path, option, value):
    """The robot rests at every station, so that its clocks have no effect."""
    done = run("calibrate", extraction, option, value, cwd=tmp_path)
    assert (done.code, done.left) == (2, [])
    name = value.partition("=")[0]
    assert f"{option} {name}: no effect on the measurements of this recording" in done.err


def test_a_group_that_the_robot_lacks():
    constraints = constraints_of([], [], ["stereo", "lenses"])
    with pytest.raises(ConfigError, match=r"^--estimate stereo: no effect"):
        constraints.check_shown(["focal_length"])
    assert [*constraints.given] == ["--estimate stereo", "--estimate lenses"]


def test_what_is_fixed_is_named_as_it_was_typed():
    assert [*constraints_of(["head_eye"], [], []).given] == ["--fix head_eye"]
    given = constraints_of(["rotation", "t_x=1", "t_y=0", "t_z=2"], ["separation=0.5±0.1"], []).given
    assert [*given] == ["--fix t_x", "--fix t_y", "--fix t_z", "--fix rotation", "--prior separation"]
    assert given["--fix rotation"] == ("r_x", "r_y", "r_z")


def test_a_constant_without_effect_may_be_fixed_as_stated():
    asked = constraints_of(["time_joints", "time_wheels=0"], [], ["clock"])
    assert "time_joints" not in {row.name for row in dataset_for(make_extraction(), asked).layout.constants}


#: Option of `mobilecal export` → the formats that use it, and an example.
OPTIONS = {
    "--urdf": (["urdf"], {"urdf": "robot.urdf"}),
    "--left-joint": (["ros2_control", "urdf"], {"wheel_joints": {"left": "left_wheel"}}),
    "--right-joint": (["ros2_control", "urdf"], {"wheel_joints": {"right": "right_wheel"}}),
    "--with-chain": (["urdf"], {"with_chain": True}),
    "--rate": (["odometry_covariance"], {"rate_hz": 10.0}),
    "--distance": (["odometry_covariance"], {"distance_m": 2.0}),
    "--log": (["foxglove"], {"logs": "log.mcap"}),
}


@pytest.mark.parametrize(
    ("option", "target"),
    [(option, target) for option in OPTIONS for target in Target if target not in OPTIONS[option][0]],
)
def test_the_format_does_not_use_it(tmp_path, option, target):
    params, (formats, given) = tmp_path / "params.yaml", OPTIONS[option]
    params.write_text(PARAMS)
    with pytest.raises(ConfigError, match=f"{option} applies only to --to {' and '.join(formats)}$"):
        export(params, target, **given)


PARAMS = """\
schema_version: 3
head_eye: {parent_frame: head, child_frame: camera, translation_m: [0.0, 0.0, 0.0], quaternion_xyzw: [0, 0, 0, 1]}
wheels: {radius_left_m: 0.1, radius_right_m: 0.1, separation_m: 0.4}
"""


@pytest.mark.parametrize(
    ("fix", "prior", "lacking"),
    [
        (["r_y=0.01"], [], "--fix r_y: relative to nominal.head_eye"),
        (["r_y"], [], "--fix r_y: relative to nominal.head_eye"),
        (["rotation"], [], "--fix rotation: relative to nominal.head_eye"),
        (["t_x"], [], "--fix t_x: relative to nominal.head_eye"),
        (["wheels"], [], "relative to nominal.wheels"),
        ([], ["r_y=0.01±0.0001"], "--prior r_y: relative to nominal.head_eye"),
    ],
)
def test_a_rotation_needs_something_to_be_relative_to(fix, prior, lacking):
    extraction = make_extraction()
    assert extraction.rig.nominal.T_h_reference is None
    with pytest.raises(ConfigError, match=lacking):
        solve(extraction, constraints=constraints_of(fix, prior, []))


def test_a_rotation_is_relative_to_the_nominal_one():
    extraction = make_extraction()
    rig = replace(extraction.rig, nominal=Nominal(ROBOT.T_h_c))
    found = solve(replace(extraction, rig=rig), constraints=constraints_of(["r_y=0.01"], [], []))
    turn = found.parameters.T_h_c[:3, :3] @ ROBOT.T_h_c[:3, :3].T
    assert turn[0, 2] == pytest.approx(0.01, abs=1e-3)
    constraints_of(["t_x=0.04"], ["radius_left=0.08±0.01"], []).check([], Nominal())
