"""A calibration in other programs' formats, read back by programs that are not ours."""

import json
import shlex
from contextlib import suppress
from dataclasses import replace
from xml.dom.minidom import parseString
from xml.etree import ElementTree

import cv2
import jsonschema
import numpy as np
import pytest
import xacro
import yaml
from hypothesis import example, given
from hypothesis import strategies as st
from pytransform3d.rotations import matrix_from_quaternion

from mobilecal_cli import se3
from mobilecal_cli.camera import project
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.export.formats import foxglove
from mobilecal_cli.export.formats.camchain import camchain_yaml
from mobilecal_cli.export.formats.camera_info import camera_info_yaml, rectified_pair
from mobilecal_cli.export.formats.urdf import patched_urdf
from mobilecal_cli.kinematics.urdf import parse_urdf
from mobilecal_cli.model.calibration import NINE, CalibratedRobot, Knowledge
from mobilecal_cli.model.rig import WheelGeometry
from mobilecal_cli.simulate.robot import ROBOTS
from tests.formats import HEAD_EYE, text_of
from tests.pairs import with_pair

T = se3.transform(se3.from_rpy(np.array([-1.6, 1.56, 0.4])), np.array([0.05, -0.0123456789, 2e-6]))
ROBOT = CalibratedRobot(
    "head", "camera's eye", T, WheelGeometry(0.101, 0.102, 0.5), Knowledge(np.eye(9) * 1e-6, np.ones(9, bool))
)
CAMERAS = ROBOTS["paper"].rig_cameras
#: What ros2_controllers' documentation says of these parameters: names, types, what must be above zero.
POSITIVE = {"type": "number", "exclusiveMinimum": 0}
NAMES = {"type": "array", "items": {"type": "string", "minLength": 1}, "minItems": 1}
DIFF_DRIVE = {
    "type": "object",
    "properties": {
        "left_wheel_names": NAMES,
        "right_wheel_names": NAMES,
        **dict.fromkeys(
            ["wheel_separation", "wheel_radius", "wheel_separation_multiplier", "left_wheel_radius_multiplier",
             "right_wheel_radius_multiplier"], POSITIVE),
    },
    "required": ["wheel_separation", "wheel_radius"],
    "additionalProperties": False,
}  # fmt: skip


@pytest.mark.parametrize("made", HEAD_EYE)
def test_formats_with_frames_state_the_images(made):
    """`child_frame` means another frame for rectified images: each file says which."""
    raw, rectified = text_of(made, ROBOT), text_of(made, replace(ROBOT, rectified=True))
    assert "x_parent = R x_child" in raw
    if made == "json":
        assert json.loads(raw)["child_frame_images"] == "raw"
        assert json.loads(rectified)["child_frame_images"] == "rectified"
        return
    assert "is the optical frame of the raw images" in raw
    assert "is the rectified optical frame: the calibration was made from rectified images" in rectified


def test_camera_formats_state_the_images():
    topics = {"left": "/l", "right": "/r"}
    assert "those of the raw images" in camchain_yaml(CAMERAS, topics)
    assert "those of the rectified images" in camchain_yaml(replace(CAMERAS, rectified=True), topics)
    pair = rectified_pair(CAMERAS)
    text = camera_info_yaml(CAMERAS.each[0], *pair["left"])
    assert "the optical frame of the raw images" in text
    with_third = replace(CAMERAS.each[0], D=np.array([0.1, 0, 0, 0, 0.05]))
    with pytest.raises(ConfigError, match="no third radial"):
        camchain_yaml(with_pair(CAMERAS, left=with_third), {"left": "", "right": ""})
    rational = replace(CAMERAS.each[1], distortion="rational_polynomial", D=np.zeros(8))
    with pytest.raises(ConfigError, match="no model for rational"):
        camchain_yaml(with_pair(CAMERAS, right=rational), {"left": "", "right": ""})


def from_quaternion(x, y, z, w):
    return matrix_from_quaternion([w, x, y, z])


def test_json():
    data = json.loads(text_of("json", ROBOT))
    assert data["T_parent_child"] == T.tolist()
    assert data["order"] == list(NINE)
    assert from_quaternion(*data["quaternion_xyzw"]) == pytest.approx(T[:3, :3])
    assert json.loads(text_of("json", replace(ROBOT, knowledge=None)))["covariance"] is None


def test_static_transforms():
    data = yaml.safe_load(text_of("static_transform_yaml", ROBOT))
    assert (data["header"]["frame_id"], data["child_frame_id"]) == ("head", "camera's eye")
    move, turn = data["transform"]["translation"], data["transform"]["rotation"]
    assert [move[k] for k in "xyz"] == pytest.approx(T[:3, 3])
    assert from_quaternion(*(turn[k] for k in "xyzw")) == pytest.approx(T[:3, :3])
    # As launch would: an XML reader, then the words of a shell.
    node = ElementTree.fromstring(text_of("static_transform_launch", ROBOT)).find("node")
    assert (node.get("pkg"), node.get("exec")) == ("tf2_ros", "static_transform_publisher")
    words = shlex.split(node.get("args"))
    args = {name.removeprefix("--"): value for name, value in zip(words[::2], words[1::2], strict=True)}
    assert (args["frame-id"], args["child-frame-id"]) == ("head", "camera's eye")
    assert [float(args[k]) for k in "xyz"] == pytest.approx(T[:3, 3])
    assert from_quaternion(*(float(args[f"q{k}"]) for k in "xyzw")) == pytest.approx(T[:3, :3])


def test_xacro_reads_the_properties(tmp_path):
    properties = tmp_path / "calibration.xacro"
    properties.write_text(text_of("xacro", replace(ROBOT, child_frame="a--b")), encoding="utf-8")
    robot = f"""<robot name="r" xmlns:xacro="http://www.ros.org/wiki/xacro">
      <xacro:include filename="{properties}"/>
      <origin xyz="${{mobilecal_head_eye_xyz}}" rpy="${{mobilecal_head_eye_rpy}}"/>
      <wheel b="${{mobilecal_wheel_separation}}" l="${{2 * mobilecal_wheel_radius_left}}"
        r="${{mobilecal_wheel_radius_right}}"/></robot>"""
    document = parseString(robot)
    xacro.process_doc(document)
    origin, wheel = (document.getElementsByTagName(name)[0] for name in ("origin", "wheel"))
    assert np.array(origin.getAttribute("xyz").split(), float) == pytest.approx(T[:3, 3])
    rpy = np.array(origin.getAttribute("rpy").split(), float)
    assert se3.from_rpy(rpy) == pytest.approx(T[:3, :3])
    assert [float(wheel.getAttribute(k)) for k in "blr"] == pytest.approx([0.5, 0.204, 0.101])


@pytest.mark.parametrize("nominal", [None, WheelGeometry(0.1, 0.1, 0.48)])
def test_ros2_control(nominal):
    robot = replace(ROBOT, nominal_wheels=nominal)
    text = text_of("ros2_control", robot, wheel_joints={"left": "l", "right": "r"})
    data = yaml.safe_load(text)["diff_drive_controller"]["ros__parameters"]
    jsonschema.validate(data, DIFF_DRIVE)
    # As the controller multiplies them out.
    assert data["wheel_separation"] * data["wheel_separation_multiplier"] == pytest.approx(0.5)
    assert data["wheel_radius"] * data["left_wheel_radius_multiplier"] == pytest.approx(0.102)
    assert data["wheel_radius"] * data["right_wheel_radius_multiplier"] == pytest.approx(0.101)
    assert data["wheel_radius"] == pytest.approx(0.1 if nominal else 0.1015)
    assert (data["left_wheel_names"], data["right_wheel_names"]) == (["l"], ["r"])
    several = replace(robot, side_joints={"left": ("a", "b"), "right": ("c", "d")})
    named = yaml.safe_load(text_of("ros2_control", several, wheel_joints={"left": "l"}))[
        "diff_drive_controller"
    ]
    names = (named["ros__parameters"][f"{side}_wheel_names"] for side in ("left", "right"))
    assert list(names) == [["l"], ["c", "d"]]  # a joint that the user names stands for its whole side


#: Model of the lenses → coefficients, and the model in exports for ROS and for Kalibr with the number of coefficients.
MODELS = {
    "none": ([], ("plumb_bob", 5), ("radtan", 4)),
    "plumb_bob": (CAMERAS.first.D, ("plumb_bob", 5), ("radtan", 4)),
    "equidistant": ([0.01, -0.002, 0.001, 0.0], ("equidistant", 4), ("equidistant", 4)),
    "rational_polynomial": ([0.05, -0.02, 0, 0, 0.01, 0.01, 0, 0], ("rational_polynomial", 8), None),
}
POINTS = np.random.default_rng(0).uniform([-0.3, -0.2, 1], [0.3, 0.2, 2], (20, 3))


def cameras_of(model):
    """The robot's pair with lenses of a model."""
    lens = {"distortion": model, "D": np.array(MODELS[model][0], dtype=float)}
    left, right = (replace(camera, **lens) for camera in CAMERAS.each)
    return with_pair(CAMERAS, left=left, right=right)


def seen_by(cameras):
    """Pixels of the points in each image."""
    poses = zip(cameras.each, cameras.T_c_each, strict=True)
    return [project(camera, se3.act(se3.inverse(T_c), POINTS)) for camera, T_c in poses]


@pytest.mark.parametrize("model", [model for model, (*_, kalibr) in MODELS.items() if kalibr])
def test_camchain_projects_as_the_cameras_do(model):
    """Each camera by the rules of Kalibr's reader, projected by OpenCV."""
    cameras, (*_, named) = cameras_of(model), MODELS[model]
    text = camchain_yaml(cameras, {"left": "/left", "right": "/right"})
    assert "x_cam1 = T_cn_cnm1 x_cam0" in text
    data = yaml.safe_load(text)
    assert list(data) == ["cam0", "cam1"]
    pose, opencv = np.eye(4), cv2.fisheye if model == "equidistant" else cv2
    for chain, camera, own in zip(data.values(), cameras.each, seen_by(cameras), strict=True):
        assert chain["camera_model"] == "pinhole"
        assert (chain["distortion_model"], len(chain["distortion_coeffs"])) == named
        assert all(isinstance(value, float) and value >= 0 for value in chain["intrinsics"])
        assert chain["resolution"] == [camera.width, camera.height]
        assert isinstance(chain["rostopic"], str)
        pose = np.array(chain.get("T_cn_cnm1", np.eye(4))) @ pose
        fu, fv, pu, pv = chain["intrinsics"]
        found, _ = opencv.projectPoints(
            POINTS[:, None], cv2.Rodrigues(pose[:3, :3])[0], pose[:3, 3],
            np.array([[fu, 0, pu], [0, fv, pv], [0, 0, 1]]), np.array(chain["distortion_coeffs"]),
        )  # fmt: skip
        assert found[:, 0] == pytest.approx(own, abs=1e-6)


@pytest.mark.parametrize("model", MODELS)
def test_camera_info_makes_rows_of_one_height(model):
    """OpenCV's undistortion with the written numbers: a point's two pictures are in one row, as far apart as P says.

    Matrices have fixed sizes, and coefficients are those of the models of sensor_msgs. Foxglove has a name of its own
    for one of them.
    """
    cameras, (_, named, _) = cameras_of(model), MODELS[model]
    pair, rows, P = rectified_pair(cameras), {}, {}
    for side, camera, seen in zip(("left", "right"), cameras.each, seen_by(cameras), strict=True):
        data = yaml.safe_load(camera_info_yaml(camera, *pair[side]))
        read = {
            name: np.array(entry["data"]).reshape(entry["rows"], entry["cols"])
            for name, entry in data.items()
            if name.endswith(("matrix", "coefficients"))
        }
        assert [read[f"{name}_matrix"].shape for name in ("camera", "rectification", "projection")] == [
            (3, 3), (3, 3), (3, 4),
        ]  # fmt: skip
        assert (data["distortion_model"], read["distortion_coefficients"].shape) == (named[0], (1, named[1]))
        assert (data["image_width"], data["image_height"]) == (camera.width, camera.height)
        undistort = cv2.fisheye.undistortPoints if model == "equidistant" else cv2.undistortPoints
        rectified = undistort(
            seen[:, None], read["camera_matrix"], read["distortion_coefficients"],
            R=read["rectification_matrix"], P=read["projection_matrix"][:, :3],
        )  # fmt: skip
        rows[side], P[side] = rectified[:, 0], read["projection_matrix"]
    assert rows["left"][:, 1] == pytest.approx(rows["right"][:, 1], abs=1e-3)
    depth = POINTS @ pair["left"][0][2]
    assert rows["left"][:, 0] - rows["right"][:, 0] == pytest.approx(-P["right"][0, 3] / depth, abs=1e-2)
    assert -P["right"][0, 3] / P["right"][0, 0] == pytest.approx(CAMERAS.baseline_m, rel=1e-6)
    shown = foxglove._calibration(cameras.first, "camera", 0)
    assert (shown.distortion_model, len(shown.D)) == (
        named[0].replace("equidistant", "kannala_brandt"),
        named[1],
    )
    assert (len(shown.K), len(shown.R), len(shown.P)) == (9, 9, 12)


FRAMES = st.text(st.characters(exclude_categories=["Cs"]), min_size=1, max_size=12)
FIXED = (
    b'<robot name="r"><link name="base"/><link name="head"/><joint name="tilt" type="fixed"><parent link="base"/>'
    b'<child link="head"/></joint></robot>'
)


@given(FRAMES, FRAMES)
@example("---", "-")
@example("a--", "b\x07\x1b[31m")
@example("$(env HOME)", "${x}")
@example("]]>", "<!--")
def test_any_frame_name(parent, child):
    """A file that the parser of its format reads, or an error that says so."""
    named = replace(ROBOT, parent_frame=parent, child_frame=child, rectified=True)
    assert json.loads(text_of("json", named))["child_frame"] == child
    parseString(text_of("xacro", named))
    message = yaml.safe_load(text_of("static_transform_yaml", named))
    assert (message["header"]["frame_id"], message["child_frame_id"]) == (parent, child)
    drive = yaml.safe_load(text_of("ros2_control", named, wheel_joints={"left": parent, "right": child}))
    assert drive["diff_drive_controller"]["ros__parameters"]["left_wheel_names"] == [parent]
    with suppress(ConfigError):
        node = parseString(text_of("static_transform_launch", named)).getElementsByTagName("node")[0]
        words = shlex.split(node.getAttribute("args"))
        assert words[-4:] == ["--frame-id", parent, "--child-frame-id", child]
        assert "$(" not in node.getAttribute("args")
    with suppress(ConfigError):
        patched = patched_urdf(FIXED, replace(named, parent_frame="head"), {}).content
        joints = parse_urdf(patched.decode()).joints.values()
        assert child in {"base", "head"} or ("head", child) in {
            (joint.parent, joint.child) for joint in joints
        }
