"""The sample log in other clothes through the whole product: the same numbers."""

from __future__ import annotations

import numpy as np
import pytest
from mcap_protobuf.writer import Writer as ProtobufWriter

from mobilecal_cli import pipeline
from mobilecal_cli.readers import open_recording
from tests.readers.test_encodings import in_json, in_protobuf, written_in_json


@pytest.fixture(scope="module")
def log(sample_logs):
    return sample_logs / "paper_robot.mcap"


@pytest.fixture(scope="module")
def usual(log, tmp_path_factory):
    return pipeline.calibrate([log], tmp_path_factory.mktemp("usual") / "out").solution


def in_other_clothes(log, folder):
    """Pictures and calibrations in Foxglove's protobuf, joints in JSON, only the URDF as ROS has it."""
    with open_recording([log]) as recording:
        topics = [info.name for info in recording.topics if info.name != "/robot_description"]
        (urdf,) = (m.decode().data for m in recording.messages(["/robot_description"]))
        with (folder / "pictures.mcap").open("wb") as stream, ProtobufWriter(stream) as writer:
            for m in recording.messages([name for name in topics if "joint" not in name]):
                writer.write_message(m.topic, in_protobuf(m.decode()), m.log_time_ns)
        joints = [
            (m.topic, m.log_time_ns, *in_json(m.decode())) for m in recording.messages(["/joint_states"])
        ]
    (folder / "robot.urdf").write_text(urdf)
    return [folder / "pictures.mcap", written_in_json(folder / "joints.mcap", joints)]


def test_protobuf_and_json(log, usual, tmp_path):
    (tmp_path / "rig.yaml").write_text("head: {urdf: robot.urdf}\n")
    logs = in_other_clothes(log, tmp_path)
    found = pipeline.calibrate(logs, tmp_path / "out", config_path=tmp_path / "rig.yaml")
    assert found.verdict.level == "PASS"
    np.testing.assert_allclose(found.solution.parameters.T_h_c, usual.parameters.T_h_c, atol=1e-9)
    for name in ("radius_right_m", "radius_left_m", "separation_m"):
        assert getattr(found.solution.parameters.wheels, name) == pytest.approx(
            getattr(usual.parameters.wheels, name), abs=1e-9
        )
