"""Damaged files: what is whole is used and counted, and only RecordingError escapes."""

from __future__ import annotations

import shutil
import sqlite3
from pathlib import Path

import numpy as np
import pytest

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.readers import open_recording, read_images, read_prelude, read_signals

from . import recordings as r

ITEMS = r.world()
#: Containers that are one file, and so can be cut and flipped.
FILES = [
    "bag",
    "bag-bz2",
    "bag-lz4",
    "bare-db3",
    "bare-db3-zstd",
    "mcap-zstd",
    "mcap-lz4",
    "mcap-none",
    "mcap-unchunked",
    "mcap-no-summary",
    "mcap-no-index-at-all",
    "mcap-message-zstd",
]


@pytest.fixture(scope="module")
def originals(tmp_path_factory) -> dict[str, bytes]:
    folder = tmp_path_factory.mktemp("originals")
    return {name: r.CONTAINERS[name](folder / name, ITEMS).read_bytes() for name in FILES}


def read_all(path: Path) -> int:
    """Everything that a calibration reads; the number of messages."""
    with open_recording([path]) as recording:
        count = sum(1 for _ in recording.messages({t.name for t in recording.topics}))
        read_prelude(recording)
        signals = read_signals(recording, r.SOURCES, r.JOINTS)
        wanted = {side: stamps.tolist() for side, stamps in signals.image_ns.items()}
        assert sum(1 for _ in read_images(recording, r.SOURCES.image, wanted)) == sum(
            map(len, wanted.values())
        )
    return count


@pytest.mark.parametrize("name", FILES)
def test_fuzz_only_recording_errors_escape(originals, tmp_path, name):
    rng = np.random.default_rng(20 + FILES.index(name))
    original = originals[name]
    outcomes = []
    for attempt in range(24):
        data = bytearray(original)
        if attempt % 2:
            del data[rng.integers(1, len(data)) :]
        else:
            for place in rng.integers(0, len(data), rng.integers(1, 8)):
                data[place] ^= 1 << int(rng.integers(8))
        path = tmp_path / str(attempt)
        path.write_bytes(data)
        try:
            outcomes.append(read_all(path))
        except RecordingError as error:
            outcomes.append(-1 if error.message and error.hint else -2)
    assert -2 not in outcomes, "an error without message or hint"
    assert max(outcomes) > 0
    assert all(count <= len(ITEMS) for count in outcomes)


@pytest.mark.parametrize(
    "name", ["mcap-zstd", "mcap-none", "mcap-unchunked", "mcap-no-summary", "bag", "bag-lz4"]
)
def test_truncated_file_gives_its_whole_messages_and_says_so(originals, tmp_path, name):
    data = originals[name]
    path = tmp_path / "cut"
    path.write_bytes(data[: int(len(data) * 0.4)])
    with open_recording([path]) as recording:
        times = [m.log_time_ns for m in recording.messages({t.name for t in recording.topics})]
        note = " ".join(recording.damage)
    assert 10 < len(times) < len(ITEMS)
    assert times == [item.log_ns for item in ITEMS[: len(times)]]
    assert f"after {len(times)} messages, {(times[-1] - times[0]) * 1e-9:.1f} s" in note
    assert "of " + str(path.stat().st_size) in note


def test_truncated_database_gives_rows_until_the_damage(originals, tmp_path):
    data = originals["bare-db3"]
    path = tmp_path / "cut"
    path.write_bytes(data[: int(len(data) * 0.7)])
    with open_recording([path]) as recording:
        count = sum(1 for _ in recording.messages({t.name for t in recording.topics}))
        note = " ".join(recording.damage)
    assert 0 < count < len(ITEMS)
    assert f"damaged; {count} messages in use could be read" in note


def test_truncated_part_is_compared_with_metadata(tmp_path):
    folder = r.write_bag2(tmp_path / "log", ITEMS)
    file = next(folder.glob("*.db3"))
    file.write_bytes(file.read_bytes()[: int(file.stat().st_size * 0.7)])
    with open_recording([folder]) as recording:
        read = sum(1 for _ in recording.messages(["/joint_states"]))
        assert f"/joint_states: metadata.yaml states 60 messages, {read} could be read" in recording.damage


def test_missing_part_is_named_and_the_rest_is_used(tmp_path):
    folder = r.write_bag2(tmp_path / "log", ITEMS)
    text = (folder / "metadata.yaml").read_text()
    (folder / "metadata.yaml").write_text(text.replace("- log.db3", "- gone.db3\n  - log.db3"))
    with open_recording([folder]) as recording:
        assert sum(1 for _ in recording.messages(["/ticks"])) == 60
        assert any("gone.db3: no such file" in note for note in recording.damage)


def test_damaged_metadata_is_done_without(tmp_path):
    folder = r.write_bag2(tmp_path / "log", ITEMS)
    (folder / "metadata.yaml").write_text("rosbag2_bagfile_information: {relative_file_paths: [")
    with open_recording([folder]) as recording:
        assert sum(1 for _ in recording.messages(["/ticks"])) == 60
        assert any("metadata.yaml: cannot be used" in note for note in recording.damage)


def test_one_damaged_chunk_costs_only_its_messages(originals, tmp_path):
    path = tmp_path / "flipped"
    path.write_bytes(originals["mcap-zstd"])
    with open_recording([path]) as recording:
        block = recording.parts[0].blocks[3]
        lost = sum(1 for _ in recording.parts[0].parse(recording.parts[0].load(block)))
    data = bytearray(path.read_bytes())
    data[block.offset + block.size // 2] ^= 255
    path.write_bytes(data)
    with open_recording([path]) as recording:
        count = sum(1 for _ in recording.messages({t.name for t in recording.topics}))
        notes = recording.damage
    assert count == len(ITEMS) - lost
    assert any(f"the chunk at byte {block.offset}" in note for note in notes)
    assert any("messages could be read" in note for note in notes)


def test_checksum_finds_a_flip_in_an_uncompressed_chunk(originals, tmp_path):
    path = tmp_path / "flipped"
    path.write_bytes(originals["mcap-none"])
    with open_recording([path]) as recording:
        block = recording.parts[0].blocks[3]
    data = bytearray(path.read_bytes())
    data[block.offset + block.size // 2] ^= 1
    path.write_bytes(data)
    with open_recording([path]) as recording:
        list(recording.messages({t.name for t in recording.topics}))
        assert any("checksum" in note for note in recording.damage)


def test_bag_without_index_reads_like_the_whole_one(originals, tmp_path):
    data = bytearray(originals["bag-lz4"])
    place = data.index(b"index_pos=") + len(b"index_pos=")
    data[place : place + 8] = bytes(8)
    path = tmp_path / "unindexed.bag"
    path.write_bytes(data)
    with open_recording([path]) as recording:
        assert sum(t.count or 0 for t in recording.topics) == len(ITEMS)
        assert sum(1 for _ in recording.messages({t.name for t in recording.topics})) == len(ITEMS)
        assert recording.damage == (
            "unindexed.bag: the bag has no usable index (the recorder was not stopped properly?); "
            f"a scan found {len(ITEMS)} messages",
        )


def test_write_ahead_log_of_a_killed_recorder_is_read_and_nothing_is_written(originals, tmp_path):
    source = tmp_path / "source.db3"
    source.write_bytes(originals["bare-db3"])
    connection = sqlite3.connect(source)
    connection.execute("PRAGMA journal_mode=WAL")
    connection.execute("PRAGMA wal_autocheckpoint=0")
    connection.execute(
        "INSERT INTO messages SELECT 9999, topic_id, timestamp + 1, data FROM messages WHERE id = 1"
    )
    connection.commit()
    folder = tmp_path / "killed"
    folder.mkdir()
    for file in tmp_path.glob("source.db3*"):
        if not file.name.endswith("-shm"):
            shutil.copy(file, folder)
    connection.close()
    with open_recording([folder / "source.db3"]) as recording:
        assert sum(1 for _ in recording.messages({t.name for t in recording.topics})) == len(ITEMS) + 1
    assert sorted(p.name for p in folder.iterdir()) == ["source.db3", "source.db3-wal"]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "empty"),
        (b"timestamp,left,right\n1,2,3\n", "not a recording"),
        (b"#ROSBAG V1.2\n" + bytes(50), "format 1.2; only 2.0 is read"),
        (b"#ROSBAG V2.0\n", "damaged beyond use"),
        (b"\x89MCAP0\r\n", "damaged beyond use"),
        (b"SQLite format 3\x00", "damaged beyond use"),
        (b"\x28\xb5\x2f\xfd", "empty"),
    ],
)
def test_what_is_no_recording_is_refused(tmp_path, content, message):
    path = tmp_path / "file"
    path.write_bytes(content)
    with pytest.raises(RecordingError, match=message) as caught:
        open_recording([path])
    assert caught.value.hint
    assert str(path) in caught.value.message


def test_nothing_named_missing_and_empty_directory_are_refused(tmp_path):
    with pytest.raises(RecordingError, match="no recording was named"):
        open_recording([])
    with pytest.raises(RecordingError, match="no such file or directory"):
        open_recording([tmp_path / "none.mcap"])
    with pytest.raises(RecordingError, match="a directory without a recording"):
        open_recording([tmp_path])


def test_other_database_is_refused(tmp_path):
    connection = sqlite3.connect(tmp_path / "photos.db")
    connection.execute("CREATE TABLE albums (id INTEGER)")
    connection.commit()
    connection.close()
    with pytest.raises(RecordingError, match="not a rosbag2 recording"):
        open_recording([tmp_path / "photos.db"])


def test_directory_of_several_recordings_is_refused(tmp_path):
    r.write_mcap(tmp_path / "a.mcap", ITEMS)
    r.write_mcap(tmp_path / "b.mcap", ITEMS)
    with pytest.raises(RecordingError, match=r"holds 2 recordings.*a\.mcap; b\.mcap"):
        open_recording([tmp_path])


def test_log_time_beyond_64_bits_is_left_out_and_counted(originals, tmp_path):
    data = bytearray(originals["mcap-unchunked"])
    time = ITEMS[20].log_ns.to_bytes(8, "little")
    place = data.index(time)
    data[place + 7] = 255
    path = tmp_path / "flipped"
    path.write_bytes(data)
    with open_recording([path]) as recording:
        assert sum(1 for _ in recording.messages({t.name for t in recording.topics})) == len(ITEMS) - 1
        assert any(f"{ITEMS[20].topic}: " in note and "could be read" in note for note in recording.damage)
