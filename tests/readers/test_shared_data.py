"""Recordings that others made: real robots, other tools' writers, published traps."""

from pathlib import Path
from runpy import run_path

import numpy as np
import pytest

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model.rig import Sources, WheelSource
from mobilecal_cli.readers import join_splits, open_recording, read_description

from . import recordings as r

PAGE = Path(__file__).parents[2] / "docs" / "reference" / "recordings-read.md"


def test_the_page_of_published_recordings_says_what_is_read(shared_data):
    """Counts of messages, damage and refusals of more than 400 files."""
    page = run_path(str(PAGE.parents[1] / "generate" / "recordings.py"))["page"]
    assert page(shared_data / "bags") == PAGE.read_text(encoding="utf-8")


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
        signals = r.one_log(recording, Sources({}, {}, dict.fromkeys(head, topic), wheels))
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
