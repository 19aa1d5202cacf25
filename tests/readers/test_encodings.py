"""Recordings in protobuf and JSON: the paper's robot's sample log, written anew with Foxglove's own schemas."""

import base64
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration
from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
from google.protobuf.timestamp_pb2 import Timestamp
from mcap_protobuf.writer import Writer as ProtobufWriter

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model.rig import JointField, Sources, WheelSource
from mobilecal_cli.readers import open_recording, read_description
from mobilecal_cli.readers.messages import stamp_of
from mobilecal_cli.rig.config import RigConfig
from mobilecal_cli.rig.resolve import complete_rig, survey_rig
from tests.records import Record, written

from . import recordings as r

LOG = Path(__file__).parents[2] / "sample_logs" / "paper_robot.mcap"
STEP_NS = 10_000_000


def stamp(message):
    return Timestamp(seconds=message.header.stamp.sec, nanos=message.header.stamp.nanosec)


def in_protobuf(message):
    """A picture or calibration of ROS as Foxglove's message; other messages stay."""
    frame = {"timestamp": stamp(message), "frame_id": message.header.frame_id}
    if hasattr(message, "distortion_model"):
        matrices = {name: getattr(message, name.lower()).tolist() for name in "DKRP"}
        size = {"width": message.width, "height": message.height}
        return CameraCalibration(**frame, **size, distortion_model=message.distortion_model, **matrices)
    return CompressedImage(**frame, data=bytes(message.data), format="jpeg")


def in_json(message):
    """A joint state as bridges write it, pictures and calibrations as Foxglove's JSON schemas have them."""
    sec, nanosec = message.header.stamp.sec, message.header.stamp.nanosec
    frame = {"timestamp": {"sec": sec, "nsec": nanosec}, "frame_id": message.header.frame_id}
    if hasattr(message, "distortion_model"):
        matrices = {name: getattr(message, name.lower()).tolist() for name in "DKRP"}
        size = {"width": message.width, "height": message.height}
        model = {"distortion_model": message.distortion_model}
        return "foxglove.CameraCalibration", {**frame, **size, **model, **matrices}
    if hasattr(message, "position"):
        header = {"stamp": {"sec": sec, "nanosec": nanosec}, "frame_id": ""}
        fields = {"header": header, "name": message.name, "position": message.position.tolist()}
        return "sensor_msgs/JointState", fields
    data = base64.b64encode(bytes(message.data)).decode()
    return "foxglove.CompressedImage", {**frame, "format": "jpeg", "data": data}


def in_protobuf_and_json(recording, folder):
    """Pictures and calibrations in Foxglove's protobuf, joint states in JSON; no URDF."""
    pictured = [info.name for info in recording.topics if info.type != "std_msgs/msg/String"]
    pictured.remove("/joint_states")
    with (folder / "protobuf.mcap").open("wb") as stream, ProtobufWriter(stream) as writer:
        for m in recording.messages(pictured):
            writer.write_message(m.topic, in_protobuf(m.decode()), m.log_time_ns)
    joints = ((m.topic, m.log_time_ns, *in_json(m.decode())) for m in recording.messages(["/joint_states"]))
    return [folder / "protobuf.mcap", r.write_json(folder / "joints.mcap", joints)]


@pytest.fixture(scope="module")
def original():
    with open_recording([LOG]) as recording:
        yield recording


@pytest.fixture(scope="module", params=["protobuf", "json"])
def other(request, original, tmp_path_factory):
    """The sample log without a single ROS message, but for its URDF and (beside protobuf) its joint states."""
    folder = tmp_path_factory.mktemp("encodings")
    if request.param == "json":
        topics = [info.name for info in original.topics if info.name != "/robot_description"]
        messages = ((m.topic, m.log_time_ns, *in_json(m.decode())) for m in original.messages(topics))
        paths = [r.write_json(folder / "json.mcap", messages)]
    else:
        paths = in_protobuf_and_json(original, folder)
    with open_recording(paths) as recording:
        yield recording


def test_it_says_the_same_as_the_ros_recording(original, other):
    urdfs = read_description(original).urdfs
    logs = [replace(read_description(recording), urdfs=urdfs) for recording in (original, other)]
    rigs = [complete_rig(survey_rig(RigConfig(), log)) for log in logs]
    for side in ("left", "right"):
        ours, theirs = (rig.cameras.each[side == "right"] for rig in rigs)
        assert np.array_equal(ours.K, theirs.K)
        assert np.array_equal(ours.D, theirs.D)
    assert np.array_equal(rigs[0].cameras.T_c_each[1], rigs[1].cameras.T_c_each[1])
    assert rigs[0].sources == rigs[1].sources

    joints = rigs[0].chain.joints
    signals = [r.one_log(recording, rigs[0].sources) for recording in (original, other)]
    for name in joints:
        assert np.array_equal(signals[0].joints[name].value, signals[1].joints[name].value)
        assert np.array_equal(signals[0].joints[name].time_ns, signals[1].joints[name].time_ns)
    for side in ("left", "right"):
        assert np.array_equal(signals[0].wheels[side].value, signals[1].wheels[side].value)
        assert np.array_equal(signals[0].images[side].time_ns, signals[1].images[side].time_ns)

    wanted = {side: signals[0].images[side].time_ns[:2].tolist() for side in ("left", "right")}
    found = (r.read_images(each, rigs[0].sources.image, wanted) for each in (original, other))
    pictures = [{(side, time): picture for side, time, picture in images} for images in found]
    assert pictures[0].keys() == pictures[1].keys()
    assert len(pictures[0]) == 4
    assert all(np.array_equal(picture, pictures[1][key]) for key, picture in pictures[0].items())


def test_joints_and_wheels_in_messages_of_any_kind(tmp_path):
    """Degrees in nested JSON, and a joint that some messages lack."""

    def head(i):
        counters = {"left": 10 * i, "right": 20 * i}
        angles = {"pan": {"angle": 90.0 + i}, "tilts": [0.1 * i] if i != 3 else []}
        return {"timestamp": {"sec": 7, "nsec": i}, "odometer": counters, **angles}

    messages = [("/head", r.START_NS + i * STEP_NS, "my.Head", head(i)) for i in range(6)]
    path = r.write_json(tmp_path / "log.mcap", messages)
    fields = {side: f"odometer.{side}" for side in ("left", "right")}
    wheels = {side: WheelSource("/head", field=at, ticks_per_revolution=100) for side, at in fields.items()}
    pan = JointField("/head", "pan.angle", np.radians(1))
    joints = {"pan": pan, "tilt": JointField("/head", "tilts[0]")}
    with open_recording([path]) as recording:
        signals = r.one_log(recording, Sources({}, {}, joints, wheels))
        wrong = {"pan": JointField("/head", "pan.angel")}
        said = r"/head: no field pan\.angel .*fields present: .*pan\.angle"
        with pytest.raises(RecordingError, match=said):
            r.one_log(recording, Sources({}, {}, wrong, wheels))
    assert signals.joints["pan"].value == pytest.approx(np.radians(90 + np.arange(6)))
    assert signals.joints["pan"].time_ns.tolist() == [7_000_000_000 + i for i in range(6)]
    assert signals.joints["tilt"].value == pytest.approx([0, 0.1, 0.2, 0.4, 0.5])
    assert any("1 of 6 messages have no value; ignored" in note for note in signals.notes)
    assert signals.wheels["right"].value[-1] == pytest.approx(2 * np.pi)


def test_dynamic_joint_states(tmp_path):
    """ros2_control's message: each joint with the interfaces that it happens to have."""

    def joint(**values):
        return {"interface_names": list(values), "values": list(values.values())}

    def state(i):
        interfaces = [joint(velocity=2.0, effort=9.0), joint(effort=1.0, position=0.1 * i)]
        header = {"stamp": {"sec": 5, "nanosec": i}, "frame_id": ""}
        return {"header": header, "joint_names": ["wheel", "pan"], "interface_values": interfaces}

    topic, kind = "/dynamic_joint_states", "control_msgs/DynamicJointState"
    messages = [(topic, r.START_NS + i * STEP_NS, kind, state(i)) for i in range(4)]
    wheel = WheelSource(topic, joint="wheel")
    with open_recording([r.write_json(tmp_path / "log.mcap", messages)]) as recording:
        assert read_description(recording).joint_names == {topic: ("wheel", "pan")}
        sources = Sources({}, {}, {"pan": topic}, {"left": wheel, "right": wheel})
        signals = r.one_log(recording, sources)
    assert signals.joints["pan"].value == pytest.approx([0, 0.1, 0.2, 0.3])
    assert signals.wheels["left"].value[-1] == pytest.approx(2.0 * 3e-9)


@pytest.mark.parametrize(
    ("payload", "said"),
    [
        (b"[1, 2]", "expected a JSON object, got list"),
        (b"{", "does not match its type"),
        (b"[" * 100_000, "does not match its type"),
        (b'{"timestamp": {"sec": 1, "nsec": 2}, "data": "!"}', "not base64"),
    ],
)
def test_json_that_is_no_message(tmp_path, payload, said):
    message = Record("/eye", "foxglove.CompressedImage", b"{}", r.START_NS, payload, **r.JSON)
    with open_recording([written(tmp_path / "log.mcap", [message])]) as recording:
        (message,) = recording.messages(["/eye"])
        with pytest.raises(RecordingError, match=said):
            message.decode()


@pytest.mark.parametrize("fields", [{}, {"transforms": 5}, {"transforms": [5]}])
def test_transforms_in_json_that_are_none(tmp_path, fields):
    path = r.write_json(tmp_path / "log.mcap", [("/tf", r.START_NS, "tf2_msgs/TFMessage", fields)])
    with open_recording([path]) as recording:
        assert read_description(recording).transforms == {}


@pytest.mark.parametrize(
    ("text", "stamp_ns"),
    [
        ("2023-11-14T22:13:20.123456789Z", 1_700_000_000_123_456_789),
        ("2023-11-14T23:13:20,5+01:00", 1_700_000_000_500_000_000),
        ("2023-11-14 22:13:20", 1_700_000_000_000_000_000),
        ("1700000000.020000000", 1_700_000_000_020_000_000),
        ("1700000000", 1_700_000_000_000_000_000),
    ],
)
def test_stamps_in_json_that_are_texts(tmp_path, text, stamp_ns):
    """They were no header: a calibration without a frame was "not a valid camera info"."""
    state = {"header": {"stamp": text, "frame_id": ""}, "name": ["pan"], "position": [0.5]}
    image = {"timestamp": text, "format": "png", "data": ""}
    messages = [("/j", 1, "sensor_msgs/JointState", state), ("/eye", 2, "foxglove.CompressedImage", image)]
    with open_recording([r.write_json(tmp_path / "log.mcap", messages)]) as recording:
        stamps = [stamp_of(message.decode(), 0) for message in recording.messages(["/j", "/eye"])]
    assert stamps == [stamp_ns, stamp_ns]


@pytest.mark.parametrize("definition", [b"", b"\xff\xff", b"\n\x07\n\x05a.foo"])
def test_a_protobuf_definition_that_cannot_be_used(tmp_path, definition):
    kinds = {"language": "protobuf", "encoding": "protobuf"}
    message = Record("/eye", "foxglove.RawImage", definition, r.START_NS, b"", **kinds)
    with (
        open_recording([written(tmp_path / "log.mcap", [message])]) as recording,
        pytest.raises(RecordingError, match=r"definition of the protobuf type foxglove\.RawImage"),
    ):
        recording.messages(["/eye"])
