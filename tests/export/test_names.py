"""Any frame name through all exporters: a file that its format's parser reads, or an error that says so."""

import json
import shlex
from contextlib import suppress
from dataclasses import replace
from xml.dom.minidom import parseString

import numpy as np
import yaml
from hypothesis import example, given
from hypothesis import strategies as st

from mobilecal_cli.errors import ConfigError
from mobilecal_cli.export.formats.ros2_control import diff_drive_yaml
from mobilecal_cli.export.formats.urdf import patched_urdf
from mobilecal_cli.kinematics.urdf import parse_urdf
from mobilecal_cli.model import CalibratedRobot, WheelGeometry
from tests.formats import text_of

NAMES = st.text(st.characters(exclude_categories=["Cs"]), min_size=1, max_size=12)
URDF = (
    b'<robot name="r"><link name="base"/><link name="head"/><joint name="tilt" type="fixed"><parent link="base"/>'
    b'<child link="head"/></joint></robot>'
)


def robot(parent: str, child: str) -> CalibratedRobot:
    return CalibratedRobot(parent, child, np.eye(4), WheelGeometry(0.1, 0.1, 0.5), rectified=True)


@given(NAMES, NAMES)
@example("---", "-")
@example("a--", "b\x07\x1b[31m")
@example("$(env HOME)", "${x}")
@example("]]>", "<!--")
def test_any_frame_name(parent, child):
    named = robot(parent, child)
    assert json.loads(text_of("json", named))["child_frame"] == child
    parseString(text_of("xacro", named))
    message = yaml.safe_load(text_of("static_transform_yaml", named))
    assert (message["header"]["frame_id"], message["child_frame_id"]) == (parent, child)
    drive = yaml.safe_load(diff_drive_yaml(named, {"left": parent, "right": child}))
    assert drive["diff_drive_controller"]["ros__parameters"]["left_wheel_names"] == [parent]
    with suppress(ConfigError):
        node = parseString(text_of("static_transform_launch", named)).getElementsByTagName("node")[0]
        words = shlex.split(node.getAttribute("args"))
        assert words[-4:] == ["--frame-id", parent, "--child-frame-id", child]
        assert "$(" not in node.getAttribute("args")
    with suppress(ConfigError):
        patched = patched_urdf(URDF, replace(named, parent_frame="head"), {}).content
        joints = parse_urdf(patched.decode()).joints.values()
        assert child in {"base", "head"} or ("head", child) in {
            (joint.parent, joint.child) for joint in joints
        }
