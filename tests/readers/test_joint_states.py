"""Joint states read like the ones before: the same result as by the message definition."""

from __future__ import annotations

import math
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Bag2Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model import JOINT_STATE, Sources, WheelSource
from mobilecal_cli.readers import open_recording, read_signals
from mobilecal_cli.readers.description import read_description
from mobilecal_cli.readers.messages import LARGEST_JOINT_STATE, Channel
from mobilecal_cli.readers.signals.joints import JointStateDecoder, JointStates

from . import recordings as r

S = 10**9
NAMES = ["pan", "wheel_left", "x", "wheel_right"]
SOURCES = Sources(
    image={},
    info={},
    joints=("/joint_states",),
    wheels={side: WheelSource("/joint_states", joint=f"wheel_{side}") for side in ("left", "right")},
)


def payload(ros1: bool, names, position, velocity=(), stamp_ns=r.START_NS, frame="", effort=(), little=True):
    store = r.ROS1 if ros1 else r.ROS2
    message = r.joint_state(names, position, velocity, stamp_ns)(store)
    message.header.frame_id, message.effort = frame, np.array(effort, dtype=float)
    if ros1:
        message.header.seq = stamp_ns % 1000
        return bytes(store.serialize_ros1(message, JOINT_STATE))
    return bytes(store.serialize_cdr(message, JOINT_STATE, little_endian=little))


def channel(ros1: bool) -> Channel:
    return Channel(1, "/joint_states", JOINT_STATE, "ros1" if ros1 else "cdr")


def write(path: Path, ros1: bool, payloads: list[bytes]) -> Path:
    """An MCAP file of joint states, logged 3 ms after one another."""
    schema, wire = r.schema_of(r.ROS1 if ros1 else r.ROS2, JOINT_STATE), "ros1" if ros1 else "cdr"
    messages = (
        r.Raw("/joint_states", r.START_NS + k * 3_000_000, data, schema, wire)
        for k, data in enumerate(payloads)
    )
    return r.write_raw(path, messages, "ros1" if ros1 else "ros2", chunk_size=4096)


def outcome(path: Path, repeats: bool):
    """All that is read, or why nothing could be; and how many messages were decoded by their definition."""
    decoded = []
    decode = Channel.decode

    def counted(self, data):
        decoded.append(len(data))
        return decode(self, data)

    learn = JointStateDecoder._learn if repeats else lambda *_: None
    with (
        mock.patch.object(JointStateDecoder, "_learn", learn),
        mock.patch.object(Channel, "decode", counted),
        open_recording([path]) as recording,
    ):
        try:
            logs = read_signals(recording, SOURCES, ("pan",))
        except RecordingError as error:
            return (error.message, error.hint), len(decoded)
        tracks = [track for one in logs for track in (*one.joints.values(), *one.wheels.values())]
        read = [(track.time_ns.tobytes(), track.value.tobytes()) for track in tracks]
        return (read, logs[0].notes, recording.damage), len(decoded)


#: What may be next on a topic; each makes a payload of a number and the stamp that is due.
KINDS = {
    "usual": lambda ros1, k, ns: payload(ros1, NAMES, [k, 2 * k, 0, 3 * k], [1, 2, 3, 4], ns),
    "other order": lambda ros1, k, ns: payload(ros1, NAMES[::-1], [3 * k, 0, 2 * k, k], [4, 3, 2, 1], ns),
    "fewer names": lambda ros1, k, ns: payload(ros1, NAMES[:2], [k, 2 * k], stamp_ns=ns),
    "other names": lambda ros1, k, ns: payload(ros1, ["a", "b", "c"], [k, k, k], stamp_ns=ns),
    "twice a name": lambda ros1, k, ns: payload(ros1, ["pan", *NAMES], [k, -1, 2 * k, 0, k], stamp_ns=ns),
    "rates only": lambda ros1, k, ns: payload(ros1, NAMES, [], [k, k, k, k], ns),
    "few positions": lambda ros1, k, ns: payload(ros1, NAMES, [k], [k, k], ns),
    "no names": lambda ros1, k, ns: payload(ros1, [], [k], stamp_ns=ns),
    "not finite": lambda ros1, k, ns: payload(ros1, NAMES, [math.nan, k, 0, math.inf], [1, 2, 3, 4], ns),
    "no stamp": lambda ros1, k, ns: payload(ros1, NAMES, [k, 2 * k, 0, 3 * k], [1, 2, 3, 4], 0),
    "same stamp": lambda ros1, k, ns: payload(ros1, NAMES, [-k, k, 0, k], [1, 2, 3, 4], r.START_NS),
    "stamp before 1970": lambda ros1, k, ns: payload(ros1, NAMES, [k, k, 0, k], [1, 2, 3, 4], -S),
    "in a frame": lambda ros1, k, ns: payload(ros1, NAMES, [k, 2 * k, 0, 3 * k], [], ns, "base", [1.0]),
    "cut": lambda ros1, k, ns: payload(ros1, NAMES, [k, 2 * k, 0, 3 * k], [1, 2, 3, 4], ns)[:-9],
    "nothing": lambda ros1, k, ns: b"",
    "bad text": lambda ros1, k, ns: payload(ros1, NAMES, [k, k, 0, k], stamp_ns=ns).replace(b"pan", b"\xff\xff\xff"),
    "big endian": lambda ros1, k, ns: payload(ros1, NAMES, [k, 2 * k, 0, 3 * k], [], ns, little=False),
}  # fmt: skip


@settings(max_examples=60, deadline=None)
@given(
    ros1=st.booleans(),
    runs=st.lists(st.tuples(st.sampled_from(sorted(KINDS)), st.integers(1, 30)), min_size=1, max_size=12),
    turns=st.booleans(),
)
def test_any_mixture_is_read_as_by_the_definition(tmp_path_factory, ros1, runs, turns):
    kinds = [kind for kind, count in runs for _ in range(count)]
    if turns:  # publishers that share a topic
        kinds = [kind for _ in range(10) for kind, _ in runs]
    data = [KINDS[kind](ros1, k, r.START_NS + k * 2_999_990) for k, kind in enumerate(kinds)]
    path = write(tmp_path_factory.mktemp("joints") / "log.mcap", ros1, data)
    assert outcome(path, repeats=True)[0] == outcome(path, repeats=False)[0]


@pytest.mark.parametrize("ros1", [False, True])
@pytest.mark.parametrize("kinds", [["usual"], ["usual", "fewer names", "rates only"]])
def test_messages_like_earlier_ones_are_not_decoded_by_their_definition(tmp_path, ros1, kinds):
    data = [KINDS[kinds[k % len(kinds)]](ros1, k, r.START_NS + k * S // 100) for k in range(300)]
    path = write(tmp_path / "log.mcap", ros1, data)
    read, decoded = outcome(path, repeats=True)
    assert decoded == len(kinds)
    assert outcome(path, repeats=False) == (read, 300)


def test_names_that_change_all_the_time(tmp_path):
    stamps = [r.START_NS + k * S for k in range(200)]
    data = [payload(False, [*NAMES, f"joint{k}" * k], [k] * 5, stamp_ns=ns) for k, ns in enumerate(stamps)]
    path = write(tmp_path / "log.mcap", False, data)
    assert outcome(path, repeats=True)[0] == outcome(path, repeats=False)[0]
    # Ten thousand new names in each of two thousand messages took 3 GB.
    group, decoder = JointStates("/joint_states"), JointStateDecoder(channel(False))
    group.want("pan")
    for k in range(200):
        names = [*(f"{k}_{i}{'x' * k}" for i in range(100)), "pan"]
        group.take(decoder(payload(False, names, [k] * 101)), k, k)
    assert len(group.position["pan"]) == 200
    assert len(group.present) <= 1001
    assert "pan" in group.present
    assert len(decoder._known) <= 64
    assert not decoder._repeats


def test_padding_does_not_matter(tmp_path):
    """Middlewares leave there what was in memory before."""
    rng = np.random.default_rng(1)
    data = []
    for k in range(50):
        bare = bytearray(KINDS["usual"](False, k, r.START_NS + k * S))
        # Bytes 54 and 55 are between the last name and the number of positions.
        assert bare[54:56] == b"\0\0"
        bare[54:56] = rng.integers(256, size=2, dtype=np.uint8).tobytes()
        data.append(bytes(bare))
    path = write(tmp_path / "log.mcap", False, data)
    assert outcome(path, repeats=True)[0] == outcome(path, repeats=False)[0]


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
        (signals,) = read_signals(recording, SOURCES, ("pan",))
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
        r.Raw("/joint_states", ns, bytes(store.serialize_cdr(trajectory(store, k, ns), name)), schema)
        for k, ns in enumerate(stamps_ns.tolist())
    )
    check_control(r.write_raw(tmp_path / "log.mcap", messages))


@pytest.mark.parametrize("ros1", [False, True])
def test_a_joint_state_that_no_robot_has_is_dropped(tmp_path, ros1):
    """A name of 100 MB was split into words, and written to every message that lists the joints."""
    usual = [payload(ros1, NAMES, [k, 2 * k, 0, 3 * k], stamp_ns=r.START_NS + k * 10**7) for k in range(1, 9)]
    long = payload(ros1, [*NAMES, "x" * LARGEST_JOINT_STATE], [0, 0, 0, 0, 0], stamp_ns=r.START_NS)
    with open_recording([write(tmp_path / "log.mcap", ros1, [long, *usual])]) as recording:
        assert read_description(recording).joint_names == {"/joint_states": tuple(NAMES)}
        (signals,) = read_signals(recording, SOURCES, ("pan",))
    assert len(signals.joints["pan"].value) == len(usual)
    assert any("1 of 9 messages do not match their type" in note for note in signals.notes)
    with pytest.raises(RecordingError, match=r"a joint state of 10\d{5} bytes \(limit 1048576\)"):
        channel(ros1).decode(long)
