"""Joint states read many at once: the same result as message by message."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from unittest import mock

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap.writer import Writer

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model import JOINT_STATE, Sources, WheelSource
from mobilecal_cli.readers import joint_states, layouts, open_recording, read_signals
from mobilecal_cli.readers.channels import Channel
from mobilecal_cli.readers.series import Series
from mobilecal_cli.readers.stamps import Clock

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
    profile, store = ("ros1", r.ROS1) if ros1 else ("ros2", r.ROS2)
    with path.open("wb") as stream:
        writer = Writer(stream, chunk_size=4096)
        writer.start(profile)
        definition = store.generate_msgdef(JOINT_STATE, ros_version=1 if ros1 else 2)[0]
        schema = writer.register_schema(JOINT_STATE, f"{profile}msg", definition.encode())
        number = writer.register_channel("/joint_states", "ros1" if ros1 else "cdr", schema)
        for k, data in enumerate(payloads):
            writer.add_message(number, r.START_NS + k * 3_000_000, data, 0)
        writer.finish()
    return path


def outcome(path: Path, at_once: bool):
    """All that is read, or why nothing could be; and how many messages were decoded one by one."""
    decoded = []
    decode = Channel.decode

    def counted(self, data):
        decoded.append(len(data))
        return decode(self, data)

    encodings = layouts.ENCODINGS if at_once else ()
    with (
        mock.patch.object(joint_states, "BATCH_MESSAGES", 37),
        mock.patch.object(layouts, "ENCODINGS", encodings),
        mock.patch.object(Channel, "decode", counted),
        open_recording([path]) as recording,
    ):
        try:
            signals = read_signals(recording, SOURCES, ("pan",), ())
        except RecordingError as error:
            return (error.message, error.hint), len(decoded)
        tracks = [*signals.joints.values(), *signals.wheels.values()]
        read = [(track.time_ns.tobytes(), track.value.tobytes()) for track in tracks]
        return (read, signals.notes, recording.damage), len(decoded)


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
def test_any_mixture_is_read_as_it_is_one_by_one(tmp_path_factory, ros1, runs, turns):
    kinds = [kind for kind, count in runs for _ in range(count)]
    if turns:  # publishers that share a topic
        kinds = [kind for _ in range(10) for kind, _ in runs]
    data = [KINDS[kind](ros1, k, r.START_NS + k * 2_999_990) for k, kind in enumerate(kinds)]
    path = write(tmp_path_factory.mktemp("joints") / "log.mcap", ros1, data)
    assert outcome(path, at_once=True)[0] == outcome(path, at_once=False)[0]


@pytest.mark.parametrize("ros1", [False, True])
@pytest.mark.parametrize("kinds", [["usual"], ["usual", "other order", "fewer names"]])
def test_messages_of_few_layouts_are_not_decoded(tmp_path, ros1, kinds):
    data = [KINDS[kinds[k % len(kinds)]](ros1, k, r.START_NS + k * S // 100) for k in range(8 * 37)]
    path = write(tmp_path / "log.mcap", ros1, data)
    read, decoded = outcome(path, at_once=True)
    assert decoded == len(kinds)
    assert outcome(path, at_once=False) == (read, 8 * 37)


def test_a_topic_whose_layout_changes_all_the_time(tmp_path):
    data = [payload(False, [*NAMES, f"joint{k}"], [k] * 5, stamp_ns=r.START_NS + k * S) for k in range(200)]
    path = write(tmp_path / "log.mcap", False, data)
    assert outcome(path, at_once=True)[0] == outcome(path, at_once=False)[0]


def test_what_lies_in_padding_does_not_matter(tmp_path):
    """Middlewares leave there what was in memory before."""
    rng = np.random.default_rng(1)
    data = []
    for k in range(50):
        bare = bytearray(KINDS["usual"](False, k, r.START_NS + k * S))
        layout = layouts.layout_of(channel(False), bytes(bare))
        assert layout is not None
        gaps = padding(bare, layout)
        assert gaps
        for place in gaps:
            bare[place] = rng.integers(256)
        data.append(bytes(bare))
    path = write(tmp_path / "log.mcap", False, data)
    read, decoded = outcome(path, at_once=True)
    assert decoded == 1
    assert outcome(path, at_once=False) == (read, 50)


def padding(data: bytes, layout: layouts.Layout) -> list[int]:
    """Bytes that are neither part of the layout, nor of the stamp, nor of the numbers."""
    free = set(np.flatnonzero(layout.fixed.view(np.uint8)[: len(data)] == 0).tolist()) - set(range(12))
    for begin, count in layout.numbers.values():
        free -= set(range(begin, begin + 8 * count))
    return sorted(free)


@pytest.mark.parametrize("ros1", [False, True])
@pytest.mark.parametrize("names", [["a"], ["ab", "abc", "abcd"], ["pan", "tilt"], []])
@pytest.mark.parametrize("frame", ["", "base_link"])
def test_the_layout_holds_every_byte_that_the_decoder_minds(ros1, names, frame):
    data = payload(ros1, names, range(len(names)), [5.0], r.START_NS, frame, [1.0, 2.0])
    layout = layouts.layout_of(channel(ros1), data)
    assert layout is not None
    assert layout.names == tuple(names)
    gaps = padding(data, layout)
    assert not (ros1 and gaps)
    expected = channel(ros1).decode(data)
    for place in gaps:
        changed = bytearray(data)
        changed[place] ^= 0xFF
        found = channel(ros1).decode(bytes(changed))
        assert (found.name, found.header.frame_id) == (names, frame)
        for field in ("position", "velocity", "effort"):
            np.testing.assert_array_equal(getattr(found, field), getattr(expected, field))
    rows = layouts.gathered([data])
    assert layout.fits(rows).tolist() == [True]
    for place in np.flatnonzero(layout.fixed.view(np.uint8)[: len(data)]):
        changed = rows.copy()
        changed[0, place] ^= 1
        assert layout.fits(changed).tolist() == [False]
    assert layout.column(rows, "position", len(names)) is None
    columns = [layout.column(rows, "effort", k) for k in (0, 1)]
    assert [column.tolist() for column in columns if column is not None] == [[1.0], [2.0]]
    seconds, nanoseconds = layout.stamps(rows)
    assert int(seconds[0]) * S + int(nanoseconds[0]) == r.START_NS


def test_what_has_no_layout():
    data = payload(False, NAMES, [1.0, 2, 3, 4])
    assert layouts.layout_of(channel(False), data) is not None
    assert layouts.layout_of(channel(False), data[:-1]) is None
    assert layouts.layout_of(channel(False), b"") is None
    assert layouts.layout_of(channel(False), payload(False, NAMES, [1.0], little=False)) is None
    assert layouts.layout_of(replace(channel(False), encoding="json"), data) is None
    assert layouts.layout_of(replace(channel(False), type="control_msgs/msg/DynamicJointState"), data) is None


@given(st.lists(st.tuples(st.integers(-(2**62), 2**62), st.floats(width=64))))
def test_series_takes_many_like_one_after_the_other(readings):
    one_by_one, at_once = Series("s"), Series("s")
    for time_ns, value in readings:
        one_by_one.add(time_ns, value)
    at_once.extend(
        np.array([time_ns for time_ns, _ in readings], dtype=np.int64), np.array([v for _, v in readings])
    )
    assert (len(at_once), at_once.not_finite) == (len(one_by_one), one_by_one.not_finite)
    if len(at_once):
        for found, expected in zip(at_once.ordered([]), one_by_one.ordered([]), strict=True):
            np.testing.assert_array_equal(found, expected)


def test_lags_of_the_first_messages_are_kept():
    clock = Clock("/j")
    log = np.arange(300) * S
    stamped = np.arange(300) % 2 == 1
    for part in np.array_split(np.arange(300), 7):
        clock.count(np.where(stamped, log - 5, log)[part], ~stamped[part], log[part])
    assert (clock.messages, clock.unstamped) == (300, 150)
    assert clock.lag_s == [5e-9] * 101


def test_a_message_larger_than_a_batch_is_read_in_its_turn(tmp_path, monkeypatch):
    data = [KINDS["usual"](False, k, r.START_NS + k * S) for k in range(40)]
    data[20] = payload(False, ["pan"], [7.0], stamp_ns=r.START_NS + 20 * S, frame="f" * 5000)
    path = write(tmp_path / "log.mcap", False, data)
    monkeypatch.setattr(joint_states, "BATCH_BYTES", 4000)
    read, decoded = outcome(path, at_once=True)
    assert decoded == 2
    assert outcome(path, at_once=False)[0] == read
