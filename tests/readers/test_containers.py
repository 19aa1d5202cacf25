"""One set of assertions over all containers."""

from pathlib import Path

import numpy as np
import pytest
import zstandard

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.files.reading import RECORDED
from mobilecal_cli.readers import (
    join_splits,
    open_recording,
    read_description,
    sha256_of,
)
from mobilecal_cli.readers.containers import CONTAINERS
from mobilecal_cli.readers.containers.blocks import BlockStorage
from mobilecal_cli.readers.messages import ZSTD_MAGIC

from . import recordings as r

ITEMS = r.world()


@pytest.fixture(params=r.CONTAINERS)
def path(request, in_container) -> Path:
    return in_container(request.param)


def check_contents(recording) -> None:
    signals = r.one_log(recording, r.SOURCES)
    k = np.arange(60)
    for name, slope in (("pan", 0.01), ("tilt", -0.02)):
        np.testing.assert_array_equal(signals.joints[name].time_ns, r.START_NS + k * r.STEP_NS)
        np.testing.assert_array_equal(signals.joints[name].value, slope * k)
    np.testing.assert_array_equal(signals.wheels["left"].value, 0.1 * k)
    np.testing.assert_allclose(signals.wheels["right"].value, 16 * k * 2 * np.pi / 1000, rtol=1e-14, atol=0)
    np.testing.assert_array_equal(signals.wheels["right"].time_ns, r.START_NS + k * r.STEP_NS + 3_000_001)
    for side in ("left", "right"):
        np.testing.assert_array_equal(signals.images[side].time_ns, r.START_NS + k[::10] * r.STEP_NS)
    assert signals.notes == ("/ticks: messages have no header stamp; the log time is used",)
    assert recording.damage == ()

    places = {"left": [2], "right": [0, 5]}
    wanted = {side: set(signals.images[side].time_ns[at].tolist()) for side, at in places.items()}
    images = r.read_images(recording, r.SOURCES.image, wanted)
    got = {(side, (ns - r.START_NS) // r.STEP_NS): gray for side, ns, gray in images}
    assert set(got) == {("left", 20), ("right", 0), ("right", 50)}
    np.testing.assert_array_equal(got["left", 20], r.picture(20))
    np.testing.assert_array_equal(got["right", 50], r.picture(51))


def test_same_contents_from_every_container(path):
    counts = {"/joint_states": 60, "/ticks": 60, "/left/image_raw": 6, "/right/image/compressed": 6}
    counts |= {"/left/camera_info": 1, "/right/camera_info": 1, "/robot_description": 1}
    with open_recording([path]) as recording:
        assert {t.name: t.count for t in recording.topics} == counts
        assert {t.type for t in recording.topics if t.name == "/ticks"} == {"std_msgs/msg/UInt16"}
        assert recording.start_ns == r.START_NS
        assert recording.end_ns == ITEMS[-1].log_ns
        check_contents(recording)
        description = read_description(recording)
    assert description.urdfs == {"/robot_description": r.URDF}
    assert description.joint_names == {"/joint_states": ("pan", "tilt", "wheel_left")}
    frames = {"/left/image_raw": "left_optical", "/right/image/compressed": "right_optical"}
    assert description.image_frames == frames
    np.testing.assert_array_equal(description.infos["/left/camera_info"].K, r.K_LEFT)
    np.testing.assert_array_equal(description.infos["/left/camera_info"].D, [0.1, 0, 0, 0, 0])
    assert description.infos["/right/camera_info"].distortion == "none"


@pytest.mark.parametrize("name", ["bag-lz4", "rosbag2-sqlite3", "mcap-zstd", "mcap-no-summary"])
def test_parts_in_any_order_are_one_recording(tmp_path, name):
    write = r.CONTAINERS[name]
    halves = [write(tmp_path / "a", ITEMS[:70]), write(tmp_path / "b", ITEMS[70:])]
    for paths in (halves, halves[::-1]):
        assert join_splits(paths) == [halves]
        with open_recording(paths) as recording:
            check_contents(recording)
            times = [m.log_time_ns for m in recording.messages(["/ticks", "/joint_states"])]
            logged = recording.log_times()["/joint_states"].tolist()
        assert times == sorted(times)
        assert logged == [item.log_ns for item in ITEMS if item.topic == "/joint_states"]


def test_separate_recordings_are_not_joined(tmp_path):
    later = [r.Item(i.topic, i.log_ns + 20 * 10**9, i.make) for i in ITEMS]
    first = r.write_mcap(tmp_path / "first.mcap", ITEMS)
    again = r.write_bag(tmp_path / "again.bag", ITEMS)  # at the same time
    paths = [r.write_mcap(tmp_path / "later.mcap", later), first, again]
    assert join_splits(paths) == [[paths[0]], [paths[1]], [paths[2]]]


def test_two_recorders_side_by_side_are_one_recording(tmp_path):
    of_cameras = [i for i in ITEMS if i.topic.startswith(("/left", "/right"))]
    cameras = r.write_bag(tmp_path / "cameras.bag", of_cameras)
    rest = r.write_bag(tmp_path / "rest.bag", [i for i in ITEMS if i not in of_cameras])
    assert [set(group) for group in join_splits([cameras, rest])] == [{cameras, rest}]
    with open_recording([cameras, rest]) as recording:
        check_contents(recording)


def refused_directory(folder) -> str:
    with pytest.raises(RecordingError) as caught:
        open_recording([folder]).close()
    assert "all recordings of one robot" in caught.value.hint
    return caught.value.message.removeprefix(f"{folder}: ")


def test_a_directory_with_several_recordings_lists_them(tmp_path):
    """Also next to one that metadata.yaml lists, and in directories of their own: none of them is read as the only one."""
    bag = r.write_bag2(tmp_path / "bag", ITEMS)
    (own,) = (path.name for path in bag.glob("*.db3"))
    r.write_mcap(bag / "other.mcap", ITEMS)
    assert refused_directory(bag) == f"contains 2 recordings: {own}; other.mcap"
    (bag / "other.mcap").unlink()
    both = tmp_path / "both"
    both.mkdir()
    bag.rename(both / "bag")
    assert refused_directory(both) == "contains a directory with a recording: bag/"
    r.write_mcap(both / "other.mcap", ITEMS)
    assert refused_directory(both) == "contains 2 recordings: other.mcap; bag/"
    r.write_mcap(both / "more.mcap", ITEMS)
    assert refused_directory(both) == "contains 3 recordings: more.mcap; other.mcap; bag/"


def test_an_unpacked_copy_is_no_other_recording(tmp_path):
    """The player of rosbag2 unpacks a compressed file next to it."""
    bag = r.write_bag2(tmp_path / "bag", ITEMS, "SQLITE3", "FILE")
    (packed,) = bag.glob("*.zstd")
    unpacked = zstandard.ZstdDecompressor().decompressobj().decompress(packed.read_bytes())
    packed.with_suffix("").write_bytes(unpacked)
    (bag / "notes.txt").write_text("monday")
    with open_recording([bag]) as recording:
        check_contents(recording)


def test_only_what_is_asked_for_is_read(tmp_path, monkeypatch):
    path = r.write_mcap(tmp_path / "log.mcap", ITEMS)
    opened, load_any = [], BlockStorage.load
    monkeypatch.setattr(BlockStorage, "load", lambda self, b: opened.append(b) or load_any(self, b))
    with open_recording([path]) as recording:
        assert not opened
        check_contents(recording)
    with open_recording([path]) as recording:
        part = recording.parts[0]
        loaded = []
        load = part.load
        monkeypatch.setattr(part, "load", lambda block: loaded.append(block) or load(block))
        list(recording.messages(["/robot_description"]))
        assert len(part.blocks) > 5
        assert len(loaded) == 1
    with (
        open_recording([r.write_mcap(tmp_path / "log.mcap", ITEMS)]) as recording,
        pytest.raises(RecordingError, match=r"no topic /nope; topics present: /joint_states \(sensor_msgs"),
    ):
        recording.messages(["/nope"])


@pytest.mark.parametrize("encoding", ["cbor", "protobuf"])
def test_other_encodings_fail_only_when_asked_for(tmp_path, encoding):
    odd = r.Item("/odd", r.START_NS, r.number("String", "{}"))
    good = r.write_mcap(tmp_path / "good.mcap", ITEMS)
    path = r.write_mcap(tmp_path / "odd.mcap", [odd], encoding=encoding)
    with open_recording([good, path]) as recording:
        check_contents(recording)
        with pytest.raises(RecordingError, match=f"/odd.*{encoding}"):
            recording.messages(["/odd"])


def test_hash_of_file_and_directory(tmp_path):
    (tmp_path / "d").mkdir()
    (tmp_path / "d" / "b").write_bytes(b"c")
    (tmp_path / "d" / "a").write_bytes(b"ab")
    (tmp_path / "whole").write_bytes(b"abc")
    assert sha256_of(tmp_path / "d") == sha256_of(tmp_path / "whole")
    assert sha256_of(tmp_path / "whole").startswith("ba7816bf")
    with pytest.raises(RecordingError, match="none: no such file"):
        sha256_of(tmp_path / "none")


def test_every_container_is_told_from_text():
    assert all(magic.startswith(RECORDED) for magic in (*CONTAINERS, ZSTD_MAGIC))
