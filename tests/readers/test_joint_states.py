"""Joint states, whose names may change from message to message, and controllers' states that are read as such."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Bag2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model.rig import Sources, WheelSource
from mobilecal_cli.model.signals import JOINT_STATE
from mobilecal_cli.readers import open_recording, read_signals
from mobilecal_cli.readers.description import read_description
from mobilecal_cli.readers.messages import LARGEST_JOINT_STATE, Channel
from mobilecal_cli.readers.signals.joints import StatedJoint
from tests.records import Record, written

from . import recordings as r

S = 10**9
NAMES = ["pan", "wheel_left", "x", "wheel_right"]
SOURCES = Sources(
    image={},
    info={},
    joints={"pan": "/joint_states"},
    wheels={side: WheelSource("/joint_states", joint=f"wheel_{side}") for side in ("left", "right")},
)


def payload(ros1: bool, names, position, velocity=(), stamp_ns=r.START_NS, little=True):
    store = r.ROS1 if ros1 else r.ROS2
    message = r.joint_state(names, position, velocity, stamp_ns)(store)
    if ros1:
        message.header.seq = stamp_ns % 1000
        return bytes(store.serialize_ros1(message, JOINT_STATE))
    return bytes(store.serialize_cdr(message, JOINT_STATE, little_endian=little))


def channel(ros1: bool) -> Channel:
    return Channel("/joint_states", JOINT_STATE, "ros1" if ros1 else "cdr")


def write(path: Path, ros1: bool, payloads: list[bytes]) -> Path:
    """An MCAP file of joint states, logged 3 ms after one another."""
    schema = r.schema_of(r.ROS1 if ros1 else r.ROS2, JOINT_STATE)
    messages = (
        Record("/joint_states", time_ns=r.START_NS + k * 3_000_000, data=data, **schema)
        for k, data in enumerate(payloads)
    )
    return written(path, messages, "ros1" if ros1 else "ros2", chunk_size=4096)


@pytest.mark.parametrize("ros1", [False, True])
def test_names_may_change_from_message_to_message(tmp_path, ros1):
    kinds = (
        lambda k, ns: payload(ros1, NAMES, [k, 2 * k, 0, 3 * k], [1, 2, 3, 4], ns),
        lambda k, ns: payload(ros1, NAMES[::-1], [3 * k, 0, 2 * k, k], [4, 3, 2, 1], ns, little=False),
        lambda k, ns: payload(ros1, ["pan", *NAMES], [k, -1, 2 * k, 0, 3 * k], stamp_ns=ns),
        lambda k, ns: payload(ros1, NAMES[:2], [k, 2 * k], stamp_ns=ns),
        lambda k, ns: payload(ros1, NAMES, [k, 2 * k], stamp_ns=ns),
        lambda k, ns: payload(ros1, ["a", "b", "c"], [-1, -1, -1], stamp_ns=ns),
        lambda k, ns: payload(ros1, NAMES, [k, k, 0, k], stamp_ns=ns)[:-9],
        lambda k, ns: b"",
        lambda k, ns: payload(ros1, NAMES, [k, k, 0, k], stamp_ns=ns).replace(b"pan", b"\xff\xff\xff"),
    )
    data = [kinds[k % len(kinds)](k, r.START_NS + k * 3_000_000) for k in range(90)]
    with open_recording([write(tmp_path / "log.mcap", ros1, data)]) as recording:
        (signals,) = read_signals(recording, SOURCES)
    for track, factor, last in ((signals.joints["pan"], 1, 5), (signals.wheels["right"], 3, 3)):
        expected = np.array([k for k in range(90) if k % len(kinds) < last])
        np.testing.assert_array_equal(track.value, factor * expected)
        np.testing.assert_array_equal(track.time_ns, r.START_NS + expected * 3_000_000)
    assert any("30 of 90 messages do not match their type" in note for note in signals.notes)


def test_names_that_change_all_the_time():
    # Ten thousand new names in each of two thousand messages took 3 GB.
    joint = StatedJoint("/joint_states", "pan")
    for k in range(200):
        names = [*(f"{k}_{i}{'x' * k}" for i in range(100)), "pan"]
        joint.take(channel(False).decode(payload(False, names, [k] * 101)), k, k)
    assert len(joint) == 200
    assert len(joint.present) <= 1001
    assert "pan" in joint.present


def test_the_limit_holds_for_each_message_that_says_what_a_joint_state_says():
    """It held for sensor_msgs alone."""
    name, store = "control_msgs/msg/DynamicJointState", control_store()
    message = replace(dynamic(store, 1, r.START_NS), joint_names=[*MOVING, "x" * LARGEST_JOINT_STATE])
    definition, _ = store.generate_msgdef(name, ros_version=2)
    with pytest.raises(RecordingError, match=r"a joint state of 10\d{5} bytes \(limit 1048576\)"):
        Channel("/joint_states", name, "cdr", definition.encode()).decode(store.serialize_cdr(message, name))


CONTROL = {
    "control_msgs/msg/InterfaceValue": "string[] interface_names\nfloat64[] values",
    "control_msgs/msg/DynamicJointState": (
        "std_msgs/Header header\nstring[] joint_names\ncontrol_msgs/InterfaceValue[] interface_values"
    ),
    "control_msgs/msg/JointTrajectoryControllerState": (
        "std_msgs/Header header\nstring[] joint_names\ntrajectory_msgs/JointTrajectoryPoint {0}\n"
        "trajectory_msgs/JointTrajectoryPoint {1}\ntrajectory_msgs/JointTrajectoryPoint error"
    ),
}
MOVING = ["wheel_left", "wheel_right", "pan"]


def control_store(fields=("reference", "feedback")):
    store = get_typestore(Stores.ROS2_HUMBLE)
    for name, definition in CONTROL.items():
        store.register(get_types_from_msg(definition.format(*fields), name))
    return store


def dynamic(store, k, stamp_ns):
    value = store.types["control_msgs/msg/InterfaceValue"]
    interfaces = ["velocity", "position"]
    values = [value(interfaces, np.array([9.0, factor * k])) for factor in (2.0, 3.0, 1.0)]
    kind = store.types["control_msgs/msg/DynamicJointState"]
    return kind(r.header(store, stamp_ns), MOVING, values)


def trajectory(store, k, stamp_ns):
    point, time = (store.types[f"{name}"] for name in (POINT, "builtin_interfaces/msg/Duration"))
    none = np.zeros(0)
    measured = point(np.array([2.0 * k, 3.0 * k, 1.0 * k]), none, none, none, time(0, 0))
    other = point(np.full(3, 77.0), none, none, none, time(0, 0))
    kind = store.types["control_msgs/msg/JointTrajectoryControllerState"]
    return kind(r.header(store, stamp_ns), MOVING, other, measured, other)


POINT = "trajectory_msgs/msg/JointTrajectoryPoint"


def control_log(folder, store, name, make):
    """A rosbag2 of the time before definitions were stored."""
    with Bag2Writer(folder, version=8, storage_plugin=StoragePlugin.SQLITE3) as writer:
        connection = writer.add_connection("/joint_states", name, typestore=store)
        for k in range(5):
            stamp_ns = r.START_NS + k * S // 10
            writer.write(connection, stamp_ns, store.serialize_cdr(make(store, k, stamp_ns), name))
    return folder


def check_control(path):
    with open_recording([path]) as recording:
        assert recording.topic("/joint_states").type == JOINT_STATE
        (signals,) = read_signals(recording, SOURCES)
    np.testing.assert_array_equal(signals.joints["pan"].value, np.arange(5))
    np.testing.assert_array_equal(signals.wheels["left"].value, 2.0 * np.arange(5))
    np.testing.assert_array_equal(signals.wheels["right"].value, 3.0 * np.arange(5))
    np.testing.assert_array_equal(signals.joints["pan"].time_ns, r.START_NS + np.arange(5) * S // 10)


def test_dynamic_joint_states_without_a_definition(tmp_path):
    name = "control_msgs/msg/DynamicJointState"
    check_control(control_log(tmp_path / "log", control_store(), name, dynamic))


@pytest.mark.parametrize("fields", [("reference", "feedback"), ("desired", "actual")])
def test_measured_states_of_trajectory_controllers(tmp_path, fields):
    name, store = "control_msgs/msg/JointTrajectoryControllerState", control_store(fields)
    schema, stamps_ns = r.schema_of(store, name), r.START_NS + np.arange(5) * S // 10
    messages = (
        Record(
            "/joint_states", time_ns=ns, data=store.serialize_cdr(trajectory(store, k, ns), name), **schema
        )
        for k, ns in enumerate(stamps_ns.tolist())
    )
    check_control(written(tmp_path / "log.mcap", messages))


@pytest.mark.parametrize("ros1", [False, True])
def test_a_joint_state_that_no_robot_has_is_dropped(tmp_path, ros1):
    """A name of 100 MB was split into words, and written to every message that lists the joints."""
    usual = [payload(ros1, NAMES, [k, 2 * k, 0, 3 * k], stamp_ns=r.START_NS + k * 10**7) for k in range(1, 9)]
    long = payload(ros1, [*NAMES, "x" * LARGEST_JOINT_STATE], [0, 0, 0, 0, 0], stamp_ns=r.START_NS)
    with open_recording([write(tmp_path / "log.mcap", ros1, [long, *usual])]) as recording:
        assert read_description(recording).joint_names == {"/joint_states": tuple(NAMES)}
        (signals,) = read_signals(recording, SOURCES)
    assert len(signals.joints["pan"].value) == len(usual)
    assert any("1 of 9 messages do not match their type" in note for note in signals.notes)
