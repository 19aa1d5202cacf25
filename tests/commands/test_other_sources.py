"""The sample log in protobuf and transforms through the whole product: the same numbers."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mobilecal_cli.calibrate import steps
from mobilecal_cli.kinematics.urdf import parse_urdf
from mobilecal_cli.readers import open_recording, read_description
from mobilecal_cli.rig.config import load_rig
from tests.readers.test_encodings import in_protobuf_and_json, written_in_json
from tests.readers.test_transforms import fields_of


def in_transforms(recording, urdf, folder, camera_frame):
    """The recording's head joints only as transforms of links that the URDF names; wheels stay joint states."""
    states = [(m.log_time_ns, m.decode()) for m in recording.messages(["/joint_states"])]
    path = urdf.path("base_link", "head_link")
    messages = []
    for log_ns, state in states:
        stamp = {"sec": state.header.stamp.sec, "nanosec": state.header.stamp.nanosec}
        read = dict(zip(state.name, state.position.tolist(), strict=True))
        sent = []
        for joint in path:
            rotation = Rotation.from_matrix(joint.T_parent_child[:3, :3])
            if joint.kind != "fixed":
                rotation = rotation * Rotation.from_rotvec(read[joint.name] * joint.axis)
            sent.append(
                (joint.parent, joint.child, fields_of(joint.T_parent_child[:3, 3], rotation.as_quat()))
            )
        mounted = fields_of(np.array([0, -0.05, 0]), Rotation.from_euler("xyz", [-1.57, 0, -1.5]).as_quat())
        sent.append(("head_link", camera_frame, mounted))
        items = [
            {"header": {"stamp": stamp, "frame_id": parent}, "child_frame_id": child, "transform": transform}
            for parent, child, transform in sent
        ]
        messages.append(("/tf", log_ns, "tf2_msgs/TFMessage", {"transforms": items}))
        wheels = [name for name in read if "wheel" in name]
        header = {"stamp": stamp, "frame_id": ""}
        fields = {"header": header, "name": wheels, "position": [read[name] for name in wheels]}
        messages.append(("/wheels", log_ns, "sensor_msgs/JointState", fields))
    return written_in_json(folder / "tf.mcap", messages)


@pytest.mark.long
def test_neither_urdf_nor_joint_states_but_transforms(sample_logs, tmp_path):
    """The zeros of pan and tilt are lost; the head-eye transform is that of the head frame as it was first."""
    log = sample_logs / "paper_robot.mcap"
    usual = steps.calibrate([log], tmp_path / "usual").fit.solution
    with open_recording([log]) as recording:
        (text,) = read_description(recording).urdfs.values()
        urdf = parse_urdf(text)
        pictures, _ = in_protobuf_and_json(recording, tmp_path)
        logs = [pictures, in_transforms(recording, urdf, tmp_path, "stereo_left_optical")]
    nominal = {f"nominal.wheels.{name}": 0.22 for name in ("radius_left_m", "radius_right_m")}
    flags = {**nominal, "nominal.wheels.separation_m": 0.5}
    found = steps.calibrate(logs, tmp_path / "out", config=load_rig(None, flags))
    assert any("no URDF" in note for note in found.fit.extraction.notes)
    assert found.fit.extraction.rig.chain.joints == tuple(
        joint.child for joint in urdf.path("base_link", "head_link") if joint.kind != "fixed"
    )
    a, b = usual.parameters, found.fit.solution.parameters
    # The same chain otherwise parametrised: the pose of the head in the base is the same, and so is everything else.
    # Only the priors differ a little: they count from other zeros.
    assert np.abs(a.minus(b) / found.fit.solution.uncertainty.std).max() < 0.1
