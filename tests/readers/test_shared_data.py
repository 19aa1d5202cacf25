"""Recordings that others made: real robots, other tools' writers, published traps."""

from pathlib import Path

import numpy as np
import pytest

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model import Sources, WheelSource
from mobilecal_cli.readers import join_splits, open_recording, read_description

from . import recordings as r

CONFORMANCE = {
    "NoData": (0, 6),
    "OneAttachment": (0, 14),
    "OneMetadata": (0, 14),
    "OneMessage": (1, 154),
    "OneSchemalessMessage": (1, 74),
    "TenMessages": (10, 154),
}


def counted(path: Path) -> tuple[int, int, tuple[str, ...]]:
    """Messages read, messages that the file states, damage."""
    with open_recording([path]) as recording:
        topics = {t.name for t in recording.topics}
        read = sum(1 for part in recording.parts for _ in part.messages(topics))
        return read, sum(t.count for t in recording.topics), recording.damage


@pytest.mark.parametrize("kind", CONFORMANCE)
def test_mcap_conformance(shared_data, kind):
    expected, files = CONFORMANCE[kind]
    paths = sorted((shared_data / "bags" / "mcap_conformance" / kind).glob("*.mcap"))
    assert len(paths) == files
    for path in paths:
        assert counted(path) == (expected, expected, ()), path.name


BAGS = {
    "example-unsorted-chunks.bag": 3,
    "fetch_calibration/fetch_calibration/config/calibration_poses.bag": 101,
    "fetch_calibration/fetch_calibration/config/calibration_poses_ground.bag": 130,
    "fetch_calibration/fetch_calibration/config/checkerboard_poses.bag": 21,
    "foxglove_noetic_generated/noetic-empty.bag": 0,
    "foxglove_noetic_generated/noetic-multitopic-bz2.bag": 3,
    "foxglove_noetic_generated/noetic-multitopic-lz4.bag": 3,
    "foxglove_noetic_generated/noetic-multitopic-none.bag": 3,
    "foxglove_rosbag/fixtures/example-bz2.bag": 8647,
    "foxglove_rosbag/fixtures/example-lz4.bag": 8647,
    "foxglove_rosbag/fixtures/example.bag": 8647,
    "foxglove_rosbag/fixtures/no-messages.bag": 0,
    "mvtb/tests/data/test_ros1.bag": 9,
    "mvtb/tests/data/test_ros2": 9,
    "robot_calibration_ubr/launch/calibration_poses.bag": 61,
    "rosbag2/ros2bag/test/resources/empty_bag": 0,
    "rosbag2/rosbag2_cpp/test/rosbag2_cpp/bags/only_services.mcap": 12,
    "rosbag2/rosbag2_cpp/test/rosbag2_cpp/bags/only_topics.mcap": 7,
    "rosbag2/rosbag2_cpp/test/rosbag2_cpp/bags/topics_and_services.db3": 13,
    "rosbag2/rosbag2_cpp/test/rosbag2_cpp/bags/topics_and_services.mcap": 13,
    "rosbag2/rosbag2_py/test/resources/mcap/convert_a": 150,
    "rosbag2/rosbag2_py/test/resources/mcap/talker": 20,
    "rosbag2/rosbag2_py/test/resources/mcap/wbag": 6074,
    "rosbag2/rosbag2_py/test/resources/mcap/reindex_test_bags/multiple_files": 3177,
    "rosbag2/rosbag2_py/test/resources/sqlite3/convert_b": 75,
    "rosbag2/rosbag2_py/test/resources/sqlite3/wbag": 6074,
    "rosbag2/rosbag2_py/test/resources/sqlite3/reindex_test_bags/multiple_files": 3177,
    "rosbag2/rosbag2_transport/test/resources/sqlite3/test_bag_for_seek": 5,
    "rosbags_rs_all_types/tests/test_bags/test_bag_mcap": 188,
    "rosbags_rs_all_types/tests/test_bags/test_bag_sqlite3": 188,
    "tiryoh_analyzer/e2e/fixtures/test_sample.bag": 14,
    "tiryoh_analyzer/e2e/fixtures/test_sample.mcap": 14,
    "tiryoh_analyzer/e2e/fixtures/test_sample.mcap.zstd": 14,
}


@pytest.mark.parametrize("name", BAGS)
def test_whole_bags(shared_data, name):
    assert counted(shared_data / "bags" / name) == (BAGS[name], BAGS[name], ())


@pytest.mark.parametrize(
    ("name", "messages", "note"),
    [
        ("test_sample_truncated.mcap", 14, "at byte 1475 of 1533; 14 messages (3.5 s)"),
        ("test_truncated.bag", 3, "at byte 4117 of 5992"),
        ("test_unindexed.bag", 14, "no usable index"),
    ],
)
def test_damaged_bags(shared_data, name, messages, note):
    read, stated, damage = counted(shared_data / "bags/tiryoh_analyzer/e2e/fixtures" / name)
    assert (read, stated) == (messages, messages)
    assert note in damage[0]
    if name == "test_unindexed.bag":
        with open_recording([shared_data / "bags/tiryoh_analyzer/e2e/fixtures" / name]) as recording:
            assert {t.name: t.count for t in recording.topics} == {"/rosout_agg": 10, "/diagnostics_agg": 4}


def test_every_other_file_is_read_or_refused(shared_data):
    for path in sorted((shared_data / "bags").rglob("*")):
        if "mcap_conformance" in path.parts:
            continue
        try:
            read, _, _ = counted(path)
        except RecordingError:
            continue
        assert read >= 0


def test_split_bags_are_joined_and_a_wrong_serialization_is_named(shared_data):
    for storage in ("mcap", "db3"):
        kind = "sqlite3" if storage == "db3" else "mcap"
        folder = shared_data / f"bags/rosbag2/rosbag2_py/test/resources/{kind}/wbag"
        paths = sorted(folder.glob(f"*.{storage}"))
        assert len(paths) == 5
        assert join_splits(paths[::-1]) == [paths]
    path = shared_data / "bags/rosbag2/rosbag2_tests/resources/mcap/wrong_rmw_test"
    with (
        open_recording([path]) as recording,
        pytest.raises(RecordingError, match="wrong_format"),
    ):
        recording.messages([recording.topics[0].name])


ROBOTS = {
    "fetch_calibration/fetch_calibration/config/checkerboard_poses.bag": ("{}_wheel_joint", 21),
    "fetch_calibration/fetch_calibration/config/calibration_poses.bag": ("{}_wheel_joint", 101),
    "robot_calibration_ubr/launch/calibration_poses.bag": ("base_{}_wheel_joint", 61),
}


@pytest.mark.parametrize("name", ROBOTS)
def test_joint_states_of_real_robots_serve_as_joints_and_wheels(shared_data, name):
    joint, count = ROBOTS[name]
    left, right = joint.format("l"), joint.format("r")
    head = ("head_pan_joint", "head_tilt_joint")
    with open_recording([shared_data / "bags" / name]) as recording:
        (topic,) = read_description(recording).joint_names
        wheels = {"left": WheelSource(topic, joint=left), "right": WheelSource(topic, joint=right)}
        signals = r.one_log(recording, Sources({}, {}, (topic,), wheels), head)
        raw = [m.decode() for m in recording.messages([topic])]
        log = [m.log_time_ns for m in recording.messages([topic])]
    stamped = any(m.header.stamp.sec for m in raw)
    assert stamped == name.startswith("robot_calibration_ubr")
    assert any("header stamps are zero; the log time is used" in note for note in signals.notes) != stamped
    times = [m.header.stamp.sec * 10**9 + m.header.stamp.nanosec for m in raw] if stamped else log
    for joint, track in ((head[0], signals.joints[head[0]]), (left, signals.wheels["left"])):
        read = {t: m.position[m.name.index(joint)] for t, m in zip(times, raw, strict=True)}
        assert len(track.time_ns) == len(set(times)) <= count
        start = track.value[0] - read[int(track.time_ns[0])]
        found = track.value - start
        turns = (found - [read[int(t)] for t in track.time_ns]) / (2 * np.pi)
        np.testing.assert_allclose(turns, np.round(turns), atol=1e-9)
    assert np.ptp(signals.joints["head_pan_joint"].value) > 0.1
