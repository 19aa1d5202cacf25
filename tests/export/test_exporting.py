"""What leaves as an export: only what passed, of one robot, and numbers that the recording determines."""

import io
import json
import math
import re
import shutil
from dataclasses import replace

import numpy as np
import pytest
import yaml
from defusedxml.ElementTree import fromstring
from mcap.reader import make_reader

import mobilecal_cli as mc
from mobilecal_cli.calibrate.steps import Data
from mobilecal_cli.errors import ConfigError, QualityError
from mobilecal_cli.export.extraction import extraction_to_npz
from mobilecal_cli.export.formats import with_verdict
from mobilecal_cli.export.formats.urdf import patched_urdf
from mobilecal_cli.export.params import parameters_from_yaml
from mobilecal_cli.kinematics.urdf import parse_urdf
from mobilecal_cli.likelihood.constants import WHEEL_SIGMA
from mobilecal_cli.model.calibration import CalibratedRobot, Knowledge
from mobilecal_cli.model.observations import LogSource
from mobilecal_cli.model.rig import AssumedOdometry, Nominal, WheelGeometry
from mobilecal_cli.simulate.robot import ROBOTS, urdf_text
from mobilecal_cli.targets import Target
from tests.command import run
from tests.extractions import Noise, simulated
from tests.formats import text_of

NOISE = Noise(pixel_px=0.1, wheel_rad_per_sqrt_rad=0.003, joint_rad=5e-4)
ROBOT = ROBOTS["paper"]


def recorded(motion, name="paper", seed=3, log="0"):
    """An extraction without images, with nominal wheels."""
    described = ROBOTS[name]
    extraction = simulated(motion, NOISE, name, seed=seed)
    nominal = Nominal(described.T_h_c @ extraction.rig.cameras.T_c_reference, described.nominal_wheels)
    return replace(
        extraction, rig=replace(extraction.rig, nominal=nominal), logs=(LogSource("log.mcap", log * 64),)
    )


def saved(folder, extraction, fit=None):
    data = Data(extraction)
    mc.Report(data, fit or mc.solve(data)).save(folder)
    (folder.parent / "robot.urdf").write_text(urdf_text(ROBOT), encoding="utf-8")
    return folder / "params.yaml"


@pytest.fixture(scope="module")
def straight(tmp_path_factory):
    """params.yaml from straight driving: the separation is unobservable, the verdict is NOT ENOUGH."""
    return saved(tmp_path_factory.mktemp("straight") / "result", recorded("straight"))


@pytest.fixture(scope="module")
def fit():
    """A fit with the verdict PASS."""
    return mc.solve(Data(recorded("standard")))


@pytest.fixture(scope="module")
def passed(fit, tmp_path_factory):
    """params.yaml of it."""
    return saved(tmp_path_factory.mktemp("passed") / "result", fit.extraction, fit)


def options(params, target):
    return {"urdf": params.parent.parent / "robot.urdf"} if target == Target.urdf else {}


# -- the verdict ----------------------------------------------------------------------------------


def test_params_yaml_states_the_verdict(straight, passed):
    stated = yaml.safe_load(straight.read_text(encoding="utf-8"))["verdict"]
    report = json.loads(straight.with_name("report.json").read_text(encoding="utf-8"))["verdict"]
    assert stated["level"] == report["level"] == "NOT ENOUGH"
    assert stated["reasons"][0] == report["reason"]
    robot = mc.load(straight)
    assert (robot.verdict, robot.reasons) == ("NOT ENOUGH", tuple(stated["reasons"]))
    assert yaml.safe_load(passed.read_text(encoding="utf-8"))["verdict"] == {"level": "PASS", "reasons": []}
    made = mc.export_to(passed, "ros2_control")
    assert made.notes == ()
    assert b"erdict" not in made.content
    drawn = mc.export_to(passed, "urdf", **options(passed, Target.urdf)).content
    assert drawn.startswith(b'<?xml version="1.0"?>\n<robot')
    with pytest.raises(ConfigError, match=r"verdict\.level"):
        parameters_from_yaml("schema_version: 3\nverdict: {level: good}\n")


@pytest.mark.parametrize("target", list(Target))
def test_what_did_not_pass_is_refused_or_states_its_verdict(straight, target):
    with pytest.raises(QualityError, match=r"NOT ENOUGH\. The wheel separation is not determined") as caught:
        mc.export_to(straight, target, **options(straight, target))
    assert "--allow-failed" in caught.value.hint
    made = mc.export_to(straight, target, **options(straight, target), allow_failed=True)
    assert "Verdict of the calibration: NOT ENOUGH." in made.notes
    if target == Target.foxglove:
        (record,) = make_reader(io.BytesIO(made.content)).iter_metadata()
        assert (record.name, record.metadata["verdict"]) == ("mobilecal", "NOT ENOUGH")
        assert "wheel separation is not determined" in record.metadata["reasons"]
        return
    text = made.content.decode()
    assert "NOT ENOUGH" in text
    assert "The wheel separation is not determined" in text
    if target == Target.json:
        assert json.loads(text)["verdict"] == "NOT ENOUGH"
    elif text.startswith("<"):
        fromstring(text)
    else:
        assert text.startswith("# Verdict of the calibration: NOT ENOUGH.\n")
        assert yaml.safe_load(text)


def test_a_hyphen_is_standard_output(passed, tmp_path):
    """It was the name of a file, but not of `init`."""
    named, plain = (
        run("export", passed, "--to", "ros2_control", *more, cwd=tmp_path) for more in (["-o", "-"], [])
    )
    assert (named.code, named.out, named.left) == (0, plain.out, [])
    two = run("export", passed, "--to", "foxglove", "-o", "-", cwd=tmp_path)
    assert (two.code, two.left) == (2, [])


def test_a_file_without_a_verdict_has_an_unknown_one(passed, tmp_path):
    text = passed.read_text(encoding="utf-8")
    without = text[: text.index("# PASS:")] + text[text.index("# Head-eye") :]
    shutil.copytree(passed.parent, tmp_path / "result")
    path = tmp_path / "result" / "params.yaml"
    path.write_text(without, encoding="utf-8")
    made = mc.export_to(path, "ros2_control")
    (note,) = made.notes
    assert note.startswith("Verdict of the calibration: unknown")
    assert made.content.decode().startswith(f"# {note}\n")
    assert json.loads(mc.export_to(path, "json").content)["verdict"] is None


@pytest.mark.parametrize(
    "start", [b"", b"<?xml version='1.0'?>", b"\xef\xbb\xbf<?xml version='1.0'?>\r\n", b"\n "]
)
def test_the_comment_keeps_xml_valid(start):
    content = start + b"<robot name='a'/>\n"
    if start.startswith(b"\n"):
        content = content.lstrip(b"\n")
    failed = CalibratedRobot(
        "h", "c", np.eye(4), WheelGeometry(0.1, 0.1, 0.4), verdict="FAIL", reasons=("a -- b <c>",)
    )
    made = with_verdict(content, failed)
    assert fromstring(made).tag == "robot"
    assert b"<!-- Verdict of the calibration: FAIL. -->" in made


# -- unobservable parameters ----------------------------------------------------------------------


def partly(unobservable, nominal=WheelGeometry(0.1, 0.1, 0.43)):  # noqa: B008 - frozen
    observable = np.ones(9, dtype=bool)
    observable[list(unobservable)] = False
    T = np.eye(4)
    T[:3, 3] = 0.05, 0.06, 0.07
    known = Knowledge(np.eye(9) * 0.01, observable)
    return CalibratedRobot(
        "head", "optical", T, WheelGeometry(0.101, 0.102, 0.43), known, nominal_wheels=nominal
    )


def sized(*lengths):
    return replace(partly([], WheelGeometry(*lengths)), wheels=WheelGeometry(*lengths))


URDF = b"""<robot name="r"><link name="base"/><link name="head"/><link name="optical"/>
<joint name="pan" type="revolute"><parent link="base"/><child link="head"/><origin xyz="0 0 1"/>
<axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
<joint name="mount" type="fixed"><parent link="head"/><child link="optical"/>
<origin xyz="0.01 0.02 0.03" rpy="0.1 0.2 0.3"/></joint>
<link name="l"><visual><geometry><cylinder radius="0.1" length="0.1"/></geometry></visual></link>
<link name="r"><visual><geometry><cylinder radius="0.1" length="0.1"/></geometry></visual></link>
<joint name="left" type="continuous"><parent link="base"/><child link="l"/><origin xyz="0 0.2 0"/></joint>
<joint name="right" type="continuous"><parent link="base"/><child link="r"/><origin xyz="0 -0.2 0"/></joint>
</robot>"""
JOINTS = {"left": "left", "right": "right"}


def test_unobservable_wheels_and_a_fixed_one():
    made = patched_urdf(URDF, partly([8]), JOINTS)
    assert [line for line in URDF.splitlines() if b"continuous" in line] == [
        line for line in made.content.splitlines() if b"continuous" in line
    ]
    assert b'radius="0.101"' in made.content
    assert any("separation unchanged, it is unobservable" in change for change in made.notes)
    sizes = yaml.safe_load(text_of("ros2_control", partly([8]), wheel_joints=JOINTS))["diff_drive_controller"]
    assert set(sizes["ros__parameters"]) == {
        "left_wheel_names", "right_wheel_names", "wheel_radius", "left_wheel_radius_multiplier",
        "right_wheel_radius_multiplier",
    }  # fmt: skip
    made = patched_urdf(URDF, partly([6, 7]), JOINTS)
    assert made.content.count(b'radius="0.1"') == 2
    assert b"0 0.215 0" in made.content
    sizes = yaml.safe_load(text_of("ros2_control", partly([6, 7]), wheel_joints=JOINTS))[
        "diff_drive_controller"
    ]
    assert not [name for name in sizes["ros__parameters"] if "radius" in name]
    with pytest.raises(ConfigError, match="neither the wheel radii nor the separation"):
        text_of("ros2_control", partly([6, 7, 8]), wheel_joints=JOINTS)
    robot = partly([8])
    C = robot.knowledge.covariance.copy()
    C[8, 8] = 0.0
    fixed = replace(robot, knowledge=Knowledge(C, robot.knowledge.observable))
    assert not fixed.unobservable.any()
    assert b"0 0.215 0" in patched_urdf(URDF, fixed, JOINTS).content


def test_an_unobservable_height_of_the_camera_stays():
    urdf = parse_urdf(patched_urdf(URDF, partly([5]), {}).content.decode())
    T = urdf.joints["mount"].T_parent_child
    assert T[:3, 3] == pytest.approx([0.05, 0.06, 0.03])
    assert T[:3, :3] == pytest.approx(np.eye(3))
    hidden = parse_urdf(patched_urdf(URDF, partly([0, 1, 2]), {}).content.decode())
    before = parse_urdf(URDF.decode()).joints["mount"].T_parent_child
    assert hidden.joints["mount"].T_parent_child[:3, :3] == pytest.approx(before[:3, :3])


def test_the_covariance_of_odometry_has_the_full_width(straight):
    """The drive has a full turn: 20 % of the separation are 72 degrees of heading."""
    made = mc.export_to(straight, "odometry_covariance", allow_failed=True)
    values = yaml.safe_load(made.content)["diff_drive_controller"]["ros__parameters"]
    robot = mc.load(straight)
    relative = math.sqrt(robot.knowledge.covariance[8, 8]) / robot.wheels.separation_m
    assert relative > 0.1
    assert math.sqrt(values["pose_covariance_diagonal"][5]) > 2 * math.pi * relative
    assert "1 m straight ahead, then a full turn in place" in made.content.decode()


# -- two robots -----------------------------------------------------------------------------------


@pytest.mark.parametrize("target", ["foxglove", "camchain", "odometry_covariance"])
def test_measurements_of_another_robot_are_refused(passed, tmp_path, target):
    shutil.copytree(passed.parent, tmp_path / "result")
    params = tmp_path / "result" / "params.yaml"
    other = recorded("standard", "tick", log="1")
    params.with_name("extraction.npz").write_bytes(extraction_to_npz(other))
    with pytest.raises(
        ConfigError, match=r"not the measurements of .*SHA-256.*00000000 .*11111111"
    ) as caught:
        mc.export_to(params, target)
    assert "nominal wheels in mm" in caught.value.message


def test_a_report_on_the_data_of_another_robot_is_refused(fit):
    other = Data(recorded("standard", "tick", log="1"))
    with pytest.raises(ConfigError, match="the fit was not made from these data: recordings"):
        mc.Report(other, fit)
    again = Data(recorded("standard", seed=4))
    with pytest.raises(ConfigError, match=r"\d+ of 12 stations of the fit are not in the data"):
        mc.Report(again, fit)
    same = Data(recorded("standard"))
    assert mc.Report(same, fit).verdict.level == "PASS"


@pytest.mark.parametrize(
    ("robot", "joints", "said"),
    [
        (replace(partly([]), nominal_wheels=WheelGeometry(0.2, 0.2, 0.43)), JOINTS, None),
        (sized(0.2, 0.2, 0.4), JOINTS, "URDF: radius_left_m is 0.1; in the calibration it is 0.2"),
        (sized(0.1, 0.1, 0.6), JOINTS, "URDF: separation_m is 0.4; in the calibration it is 0.6"),
        (replace(partly([]), head_joints=("neck",)), JOINTS, "no joint 'neck', which moves the calibrated"),
        (partly([]), {"left": "pan"}, "joint 'pan' carries the head"),
        (partly([]), {"left": "mount"}, "joint 'mount' is fixed, so it is not that of the left wheel"),
        (
            partly([]),
            {"left": "right", "right": "left"},
            "'right' is on the other side of the robot than the l",
        ),
        (partly([]), {"right": "left"}, "'left' is on the other side of the robot than the right wheel"),
    ],
)
def test_the_urdf_of_another_robot_is_refused(robot, joints, said):
    if said is None:
        assert patched_urdf(URDF, robot, joints).notes
        return
    with pytest.raises(ConfigError, match=said):
        patched_urdf(URDF, robot, joints)


def test_odometry_of_another_separation_than_that_of_the_urdf_is_refused():
    urdf = re.sub(rb'joint name="(left|right)"', rb'joint name="wheel_\1_joint"', URDF)
    of_urdf = AssumedOdometry("/odom", WheelGeometry(0.1, 0.1, 0.23), WHEEL_SIGMA)
    with pytest.raises(
        ConfigError, match=r"the wheels are 0.4 m apart; in the calibration 0.23 m are assumed"
    ):
        patched_urdf(urdf, replace(partly([]), odometry=of_urdf), {})
    unknown = replace(of_urdf, separation_share=0.5)
    assert patched_urdf(urdf, replace(partly([]), odometry=unknown), {}).notes


def test_the_file_of_a_wrong_urdf_is_named(straight, tmp_path):
    wrong = tmp_path / "robot.yaml"
    wrong.write_text("board: {}", encoding="utf-8")
    with pytest.raises(ConfigError, match=r"^\S+/robot.yaml: not valid XML"):
        mc.export_to(straight, "urdf", urdf=wrong, allow_failed=True)


@pytest.mark.parametrize(
    ("joints", "said"),
    [
        ({"left": "head_pan_joint"}, "--left-joint head_pan_joint: this joint moves the head"),
        ({"left": "wheel_right_joint"}, "--left-joint wheel_right_joint: this joint is that of the right"),
        ({"right": "wheel_left_joint"}, "--right-joint wheel_left_joint: this joint is that of the left"),
        ({"left": "a", "right": "a"}, "this joint is that of the right wheel"),
    ],
)
def test_the_joint_of_a_wheel_is_not_that_of_the_head_or_of_the_other_wheel(passed, joints, said):
    with pytest.raises(ConfigError, match=said):
        mc.export_to(passed, "ros2_control", wheel_joints=joints)
