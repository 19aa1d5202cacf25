"""A calibration put into a URDF, read back by two parsers that are not ours."""

import difflib
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yourdfpy
from hypothesis import given
from hypothesis import strategies as st
from pytransform3d.urdf import UrdfTransformManager

from mobilecal_cli import se3
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.export.formats.urdf import patched_urdf
from mobilecal_cli.kinematics.urdf import parse_urdf
from mobilecal_cli.model.calibration import CalibratedRobot
from mobilecal_cli.model.rig import WheelGeometry

JOINTS = {"left": "wheel_left_joint", "right": "wheel_right_joint"}
URDF = b"""<?xml version='1.0'?>
<!-- a drawing: <joint name="mount"><origin xyz="9 9 9"/></joint> -->
<robot name="drawn"   >
  <link name="base_link"><visual><geometry><cylinder radius="0.9" length="1"/></geometry></visual></link>
  <link name="axle"/><link name="head"/><link name='cam > box'/><link name="optical"/>
  <joint name="axle_joint" type="fixed"><parent link="base_link"/><child link="axle"/>
    <origin rpy="0 0 1.5707963267948966" xyz="0.1 0 0.05"/></joint>
  <joint name="tilt" type="revolute"><parent link="base_link"/><child link="head"/><axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/><origin xyz="0 0 1"/></joint>
  <joint\tname="mount" type="fixed"><parent link="head"/><child link="cam > box"/></joint>
  <joint name="to_optical" type="fixed"><parent link="cam > box"/><child link="optical"/>
    <origin xyz="0.01 0.02 0.03" rpy="-1.5707963267948966 0 -1.5707963267948966"/></joint>
  <link name="l"><visual><geometry><cylinder length="0.1"
     radius='0.1'/></geometry></visual><collision><geometry><sphere radius = "0.1"/></geometry></collision></link>
  <link name="r"><visual><geometry><mesh filename="w.stl"/></geometry></visual></link>
  <joint name="wheel_left_joint" type="continuous"><parent link="axle"/><child link="l"/>
    <origin xyz="0.25 0.0 0.0"/><axis xyz="1 0 0"/></joint>
  <joint name="wheel_right_joint" type="continuous"><parent link="axle"/><child link="r"/>
    <origin xyz="-0.15 0.0 0.0"/><axis xyz="1 0 0"/></joint>
  <transmission name="t"><joint name="mount"><hardwareInterface/></joint></transmission>
</robot>
<!-- the end </robot -->"""


def robot(T=None, parent="head", child="optical"):
    if T is None:
        T = se3.transform(se3.from_rpy(np.array([-1.6, 0.03, -1.5])), np.array([0.05, -0.01, 0.02]))
    return CalibratedRobot(parent, child, T, WheelGeometry(0.101, 0.102, 0.5))


def two_readers(tmp_path: Path, content: bytes, child: str, parent: str):
    path = tmp_path / "robot.urdf"
    path.write_bytes(content)
    first = yourdfpy.URDF.load(str(path), load_meshes=False, build_scene_graph=True)
    second = UrdfTransformManager(check=False)
    second.load_urdf(content.decode())
    return first.get_transform(child, parent), second.get_transform(child, parent)


def changed_lines(before: bytes, after: bytes):
    lines = difflib.ndiff(before.decode().splitlines(), after.decode().splitlines())
    return [line[2:] for line in lines if line.startswith("- ")]


def test_both_parsers_find_the_camera_and_the_wheels(tmp_path):
    made = patched_urdf(URDF, robot(), JOINTS)
    for T in two_readers(tmp_path, made.content, "optical", "head"):
        assert pytest.approx(robot().T_parent_child, abs=1e-10) == T
    # By hand: the axle's frame is turned a quarter, so that its x is the base's y; the middle of the wheels, at
    # y = 0.05, stays.
    for side, y in (("l", 0.30), ("r", -0.20)):
        for T in two_readers(tmp_path, made.content, side, "base_link"):
            assert T[:3, 3] == pytest.approx([0.1, y, 0.05], abs=1e-10)
    assert made.content.count(b'radius = "0.102"') == made.content.count(b"radius='0.102'") == 1
    assert any("'r': no cylinder or sphere" in told for told in made.notes)


def test_every_other_byte_stays():
    made = patched_urdf(URDF, robot(), JOINTS)
    assert [line.strip() for line in changed_lines(URDF, made.content)] == [
        '<joint\tname="mount" type="fixed"><parent link="head"/><child link="cam > box"/></joint>',
        "radius='0.1'/></geometry></visual><collision><geometry><sphere radius = \"0.1\"/></geometry></collision></link>",
        '<origin xyz="0.25 0.0 0.0"/><axis xyz="1 0 0"/></joint>',
        '<origin xyz="-0.15 0.0 0.0"/><axis xyz="1 0 0"/></joint>',
    ]
    assert patched_urdf(made.content, robot(), JOINTS).content == made.content


GROUNDED = URDF.replace(b'xyz="0.1 0 0.05"', b'xyz="0.1 0 0"').replace(
    b'<mesh filename="w.stl"/>', b'<cylinder radius="0.1" length="0.1"/>'
)


def test_the_hub_of_a_wheel_keeps_its_size():
    """Every cylinder got the wheel's radius, and the height was that of the first one."""
    hub = b'<visual><geometry><cylinder radius="0.03" length="0.05"/></geometry></visual>'
    content = GROUNDED.replace(b'<link name="l">', b'<link name="l">' + hub).replace(
        b'0.25 0.0 0.0"', b'0.25 0.0 0.1"'
    )
    content = content.replace(b'-0.15 0.0 0.0"', b'-0.15 0.0 0.1"')
    assert hub in content
    made = patched_urdf(content, robot(), JOINTS)
    assert hub in made.content
    assert any("height 0.1015 m, the mean wheel radius" in change for change in made.notes)


def heights(made, tmp_path, link):
    """Heights of both wheel centers over a link, by two parsers."""
    return [T[2, 3] for side in "lr" for T in two_readers(tmp_path, made.content, side, link)]


def test_wheel_joints_over_the_ground_follow_the_radius(tmp_path):
    """base_link is on the ground: the wheel centers are a radius above it, before and after."""
    content = GROUNDED.replace(b'0.25 0.0 0.0"', b'0.25 0.0 0.1"').replace(
        b'-0.15 0.0 0.0"', b'-0.15 0.0 0.1"'
    )
    made = patched_urdf(content, robot(), JOINTS)
    assert heights(made, tmp_path, "base_link") == pytest.approx([0.1015] * 4, abs=1e-10)
    assert any("height 0.1015 m, the mean wheel radius" in change for change in made.notes)
    assert patched_urdf(made.content, robot(), JOINTS).content == made.content
    made = patched_urdf(GROUNDED, robot(), JOINTS)
    assert heights(made, tmp_path, "base_link") == pytest.approx([0.0] * 4, abs=1e-10)
    said = "the mean wheel radius is now 0.1015 m, before 0.1 m: no height follows from it, no frame is on the ground"
    assert said in made.notes


@pytest.mark.parametrize("upward", [True, False])
def test_a_base_footprint_stays_and_is_named(tmp_path, upward):
    """The joint of a base_footprint places the whole robot: it stays, and a note says so."""
    if upward:
        joint = b'<parent link="base_footprint"/><child link="base_link"/><origin xyz="0 0 0.1"/>'
    else:
        joint = b'<parent link="base_link"/><child link="base_footprint"/><origin xyz="0 0 -0.1"/>'
    content = GROUNDED.replace(
        b"</robot>\n",
        b'<link name="base_footprint"/><joint name="down" type="fixed">' + joint + b"</joint></robot>\n",
    )
    made = patched_urdf(content, robot(), JOINTS)
    assert heights(made, tmp_path, "base_footprint") == pytest.approx([0.1] * 4, abs=1e-10)
    height_m = "0.1" if upward else "-0.1"
    said = (
        f"joint 'down': height {height_m} m is unchanged; the mean wheel radius is now 0.1015 m, before 0.1 m"
    )
    assert f"{said}: correct it by hand" in made.notes


def test_what_stays_and_what_is_said_in_the_file(tmp_path):
    rectified = replace(robot(child="eye"), rectified=True)
    assert b"<!-- eye is the rectified optical frame" in patched_urdf(URDF, rectified, {}).content
    assert b"rectified" not in patched_urdf(URDF, robot(child="eye"), {}).content
    windows = b"\xef\xbb\xbf" + URDF.replace(b"\n", b"\r\n")
    made = patched_urdf(windows, robot(), JOINTS).content
    assert made.startswith(b"\xef\xbb\xbf<?xml")
    assert made.count(b"\r\n") == made.count(b"\n") == URDF.count(b"\n")


def test_an_added_camera_is_doubled_nowhere_and_changes_no_other_line(tmp_path):
    made = patched_urdf(URDF, robot(child="eye <left>"), {})
    assert changed_lines(URDF, made.content) == []
    for T in two_readers(tmp_path, made.content, "eye <left>", "head"):
        assert pytest.approx(robot().T_parent_child, abs=1e-10) == T
    # The name of its joint is taken, or its link is there without a joint.
    taken = robot(child="eye")
    joint = (
        b'<link name="x"/><joint name="eye_joint" type="fixed"><parent link="head"/><child link="x"/></joint>'
    )
    for content in (
        URDF.replace(b"</robot>\n", joint + b"</robot>\n"),
        URDF.replace(b'axle"/>', b"axle\"/><link name='eye'/>", 1),
    ):
        made = patched_urdf(content, taken, {}).content
        assert made.count(b'eye_joint"') == content.count(b'eye_joint"') + (b"eye_joint" not in content)
        parse_urdf(made.decode())
        for T in two_readers(tmp_path, made, "eye", "head"):
            assert pytest.approx(taken.T_parent_child, abs=1e-10) == T


@given(st.lists(st.floats(-3.1, 3.1), min_size=6, max_size=6))
def test_any_pose_survives(numbers):
    T = se3.transform(se3.exp_so3(np.array(numbers[:3])), np.array(numbers[3:]))
    content = patched_urdf(URDF, robot(T), {}).content
    reader = UrdfTransformManager(check=False)
    reader.load_urdf(content.decode())
    # Next to gimbal lock roll and yaw are large and opposite: twelve digits of each are left.
    assert reader.get_transform("optical", "head") == pytest.approx(T, abs=1e-9)


@pytest.mark.parametrize(
    ("content", "calibrated", "joints", "says"),
    [
        (URDF.replace(b"-0.15", b"0.25"), robot(), JOINTS, "are at the same place"),
        (URDF, robot(), dict.fromkeys(JOINTS, "wheel_left_joint"), "at the same place|in two ways"),
        (URDF, robot(child="eye\x07"), {}, "characters that XML does not allow"),
        (b"<robot", robot(), {}, "not valid XML"),
        (URDF.decode().encode("utf-16"), robot(), {}, "not UTF-8"),
        (b'<!DOCTYPE r [<!ENTITY a "b">]><robot/>', robot(), {}, "not valid XML"),
        (URDF, robot(parent="base_link"), {}, "is not fixed to 'base_link': joint 'tilt'"),
        (URDF, robot(parent="neck", child="eye"), {}, "neither 'eye' nor 'neck'"),
        (URDF, robot(), {"left": "wheel"}, "no joint 'wheel'"),
        (
            URDF.replace(b'"base_link"/><child link="axle"/>', b'"l"/><child link="axle"/>'),
            robot(),
            JOINTS,
            "no path",
        ),
    ],
)
def test_what_cannot_be_patched(content, calibrated, joints, says):
    with pytest.raises(ConfigError, match=says):
        patched_urdf(content, calibrated, joints)


@pytest.mark.parametrize(
    ("pattern", "head", "camera", "joints"),
    [
        ("*stretch*.urdf", "link_head_tilt", "camera_color_optical_frame",
         {"left": "joint_left_wheel", "right": "joint_right_wheel"}),
        ("*hsr*.urdf", "head_tilt_link", "head_l_stereo_camera_frame", {}),
    ],
)  # fmt: skip
def test_robots_of_others(shared_data, tmp_path, pattern, head, camera, joints):
    paths = sorted(shared_data.rglob(pattern))
    if not paths:
        pytest.skip(f"no {pattern} here")
    content = paths[0].read_bytes()
    calibrated = robot(parent=head, child=camera)
    made = patched_urdf(content, calibrated, joints)
    for T in two_readers(tmp_path, made.content, camera, head):
        assert pytest.approx(calibrated.T_parent_child, abs=1e-9) == T
    assert len(changed_lines(content, made.content)) <= 3 + 4


@pytest.mark.parametrize("encoding", ["utf-7", "utf-16", "base64", "undefined", "nope", "latin-1", "UTF-8"])
def test_the_text_is_utf8_whatever_its_declaration_says(encoding):
    """The encoding of the declaration was used to find the tags: ValueError, LookupError and others."""
    declared = URDF.replace(b"version='1.0'", f"version='1.0' encoding='{encoding}'".encode())
    made = patched_urdf(declared, robot(), JOINTS).content
    assert (
        made.replace(f" encoding='{encoding}'".encode(), b"") == patched_urdf(URDF, robot(), JOINTS).content
    )


LINK = '<link name="l{0}"/><joint name="j{0}" type="fixed"><parent link="{1}"/><child link="l{0}"/></joint>'
CHAIN = "".join(LINK.format(k, f"l{k - 1}" if k else "base_link") for k in range(3000)).encode()
ROUND = URDF.replace(b'<mesh filename="w.stl"/>', b'<cylinder radius="0.1" length="0.1"/>')


@pytest.mark.parametrize("more", [b"<x>" * 50_000 + b"</x>" * 50_000, CHAIN], ids=["nested", "chained"])
def test_large_files_take_linear_time(more):
    """Each element was compared with all around it, and each link with all above it: minutes."""
    large = ROUND.replace(b"</robot>\n", more + b"</robot>\n")
    begin = time.process_time()
    made, usual = patched_urdf(large, robot(), JOINTS), patched_urdf(ROUND, robot(), JOINTS)
    assert time.process_time() - begin < 4
    assert made.notes == usual.notes
    assert made.content.replace(more, b"") == usual.content
