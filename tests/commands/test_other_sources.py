"""The sample log in other clothes through the whole product: the same numbers."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from mobilecal_cli.calibrate import steps
from mobilecal_cli.kinematics.urdf import parse_urdf
from mobilecal_cli.readers import open_recording, read_description
from mobilecal_cli.rig.config import load_rig
from tests.readers.test_encodings import in_protobuf_and_json, written_in_json
from tests.readers.test_transforms import fields_of


@pytest.fixture(scope="module")
def log(sample_logs):
    return sample_logs / "paper_robot.mcap"


@pytest.fixture(scope="module")
def usual(log, tmp_path_factory):
    return steps.calibrate([log], tmp_path_factory.mktemp("usual") / "out").fit.solution


def in_other_clothes(log, folder):
    """Pictures and calibrations in Foxglove's protobuf, joints in JSON, the URDF in a file."""
    with open_recording([log]) as recording:
        (urdf,) = read_description(recording).urdfs.values()
        (folder / "robot.urdf").write_text(urdf)
        return in_protobuf_and_json(recording, folder)


@pytest.mark.long
def test_protobuf_and_json(log, usual, tmp_path):
    (tmp_path / "rig.yaml").write_text("head: {urdf: robot.urdf}\n")
    logs = in_other_clothes(log, tmp_path)
    found = steps.calibrate(logs, tmp_path / "out", config=load_rig(tmp_path / "rig.yaml"))
    assert found.verdict.level == "PASS"
    np.testing.assert_allclose(found.fit.solution.parameters.T_h_c, usual.parameters.T_h_c, atol=1e-9)
    for name in ("radius_right_m", "radius_left_m", "separation_m"):
        assert getattr(found.fit.solution.parameters.wheels, name) == pytest.approx(
            getattr(usual.parameters.wheels, name), abs=1e-9
        )


def in_transforms(log, urdf, folder, camera_frame):
    """The recording's head joints only as transforms of links that the URDF names; wheels stay joint states."""
    with open_recording([log]) as recording:
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
def test_neither_urdf_nor_joint_states_but_transforms(log, usual, tmp_path):
    """The zeros of pan and tilt are lost; the head-eye transform is that of the head frame as it was first."""
    pictures, _ = in_other_clothes(log, tmp_path)
    urdf = parse_urdf((tmp_path / "robot.urdf").read_text())
    logs = [pictures, in_transforms(log, urdf, tmp_path, "stereo_left_optical")]
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
