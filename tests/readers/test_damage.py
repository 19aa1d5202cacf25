"""Damaged files: what is whole is used and counted, and only RecordingError escapes."""

import re
import shutil
import sqlite3
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from mcap.writer import CompressionType

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.readers import open_recording, read_description
from mobilecal_cli.readers.messages import ZSTD_MAGIC

from . import recordings as r

ITEMS = r.world()
WHOLE = sorted((item.topic, item.log_ns) for item in ITEMS)
#: Containers that are one file, and so can be cut and flipped.
FILES = [
    *("bag", "bag-bz2", "bag-lz4", "bare-db3", "bare-db3-zstd", "mcap-zstd", "mcap-lz4", "mcap-none"),
    *("mcap-unchunked", "mcap-no-summary", "mcap-no-index-at-all", "mcap-message-zstd"),
]


@pytest.fixture(scope="module")
def originals(in_container) -> dict[str, bytes]:
    return {name: in_container(name).read_bytes() for name in FILES}


def written(folder: Path, data: bytes, name: str = "damaged") -> Path:
    path = folder / name
    path.write_bytes(data)
    return path


@pytest.mark.parametrize("method", list(CompressionType))
@pytest.mark.parametrize("chunk", [0, 1])
def test_a_truncated_chunk_of_an_mcap_gives_its_whole_messages(tmp_path, chunk, method):
    noise = np.random.default_rng(0).integers(0, 256, (400, 64, 64), dtype=np.uint8)
    items = [r.Item(f"/n{k % 3}", r.START_NS + k, r.image(noise[k], "mono8")) for k in range(400)]
    path = r.write_mcap(tmp_path / "log.mcap", items, compression=method, chunk_size=2**19)
    with open_recording([path]) as recording:
        (part,) = recording.parts
        *before, cut = sorted(part.blocks, key=lambda block: block.offset)[: chunk + 1]
        whole = [len(list(part.parse(part.load(block)))) for block in (*before, cut)]
    with path.open("r+b") as stream:
        stream.truncate(cut.offset + cut.size * 3 // 4)
    with open_recording([path]) as recording:
        found = [m.log_time_ns - r.START_NS for m in r.every(recording)]
        assert found == list(range(len(found)))
        assert sum(whole[:-1]) + 0.4 * whole[-1] < len(found) < sum(whole)
        note, *_ = recording.damage
        assert f"the file ends inside a chunk at byte {cut.offset} of" in note
        assert f"; {len(found)} messages" in note


def test_truncated_database_gives_rows_until_the_damage(originals, tmp_path):
    data = originals["bare-db3"]
    path = written(tmp_path, data[: int(len(data) * 0.7)])
    with open_recording([path]) as recording:
        count = len(r.every(recording))
        note = " ".join(recording.damage)
        times, counts = recording.log_times(), {info.name: info.count for info in recording.topics}
        span = recording.start_ns, recording.end_ns
    assert 0 < count < len(ITEMS)
    assert f"damaged: {count} messages are left" in note
    assert sum(counts.values()) == count
    assert {name: len(known) for name, known in times.items()} == {n: k for n, k in counts.items() if k}
    assert span == (min(map(np.min, times.values())), max(map(np.max, times.values())))
    assert f"truncated: {path.stat().st_size} of {len(data)} bytes or more (70 %) are left" in note


@pytest.mark.parametrize(("name", "flip", "said"), [("mcap-zstd", 255, ""), ("mcap-none", 1, "checksum")])
def test_one_damaged_chunk_costs_only_its_messages(originals, tmp_path, name, flip, said):
    path = written(tmp_path, originals[name])
    with open_recording([path]) as recording:
        block = recording.parts[0].blocks[3]
    lost = in_block(path, block.offset, block.size)
    data = bytearray(path.read_bytes())
    data[block.offset + block.size // 2] ^= flip
    path.write_bytes(data)
    found, notes = messages_of(path)
    assert len(found) == len(ITEMS) - lost
    assert any(f"the chunk at byte {block.offset}" in note and said in note for note in notes)
    assert any("messages could be read" in note for note in notes)


def test_one_damaged_message_that_was_compressed_separately_costs_only_itself(tmp_path):
    path = r.write_mcap(
        tmp_path / "log.mcap", ITEMS, pack=True, compression=CompressionType.NONE, enable_crcs=False
    )
    data = bytearray(path.read_bytes())
    frame = data.index(ZSTD_MAGIC, len(data) // 3)
    data[frame + 4] ^= 0xFF
    path.write_bytes(data)
    broken = 0
    with open_recording([path]) as recording:
        messages = r.every(recording)
        for message in messages:
            try:
                message.decode()
            except RecordingError:
                broken += 1
    assert (len(messages), broken) == (len(ITEMS), 1)


def test_bag_without_index_reads_like_the_whole_one(originals, tmp_path):
    data = bytearray(originals["bag-lz4"])
    place = data.index(b"index_pos=") + len(b"index_pos=")
    data[place : place + 8] = bytes(8)
    path = written(tmp_path, data, "unindexed.bag")
    with open_recording([path]) as recording:
        assert sum(t.count for t in recording.topics) == len(ITEMS)
        assert len(r.every(recording)) == len(ITEMS)
        assert recording.damage == (
            "unindexed.bag: the bag has no usable index (was the recorder stopped properly?); "
            f"a scan found {len(ITEMS)} messages",
        )


def test_write_ahead_log_of_a_killed_recorder_is_read_and_nothing_is_written(originals, tmp_path):
    source = written(tmp_path, originals["bare-db3"], "source.db3")
    connection = sqlite3.connect(source)
    connection.execute("PRAGMA journal_mode=WAL")
    connection.execute("PRAGMA wal_autocheckpoint=0")
    copied = "SELECT 9999, topic_id, timestamp + 1, data FROM messages WHERE id = 1"
    connection.execute(f"INSERT INTO messages {copied}")
    connection.commit()
    folder = tmp_path / "killed"
    folder.mkdir()
    for file in tmp_path.glob("source.db3*"):
        if not file.name.endswith("-shm"):
            shutil.copy(file, folder)
    connection.close()
    with open_recording([folder / "source.db3"]) as recording:
        topics = {t.name for t in recording.topics}
        assert sum(1 for _ in recording.messages(topics)) == len(ITEMS) + 1
        (part,) = recording.parts
        with open_recording([part.opened]) as again:  # as a worker process does
            assert sum(1 for _ in again.messages(topics)) == len(ITEMS) + 1
            assert again.parts[0].opened == part.opened  # not copied once more
    assert not part.opened.exists()
    assert sorted(p.name for p in folder.iterdir()) == ["source.db3", "source.db3-wal"]


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"", "empty"),
        (b"timestamp,left,right\n1,2,3\n", "not a recording"),
        (b"#ROSBAG V1.2\n" + bytes(50), "format 1.2, only 2.0 is supported"),
        (b"#ROSBAG V2.0\n", "damaged and unreadable"),
        (b"\x89MCAP0\r\n", "nothing usable is left"),
        (b"SQLite format 3\x00", "damaged and unreadable"),
        (b"\x28\xb5\x2f\xfd", "empty"),
    ],
)
def test_what_is_no_recording_is_refused(tmp_path, content, message):
    path = written(tmp_path, content)
    with pytest.raises(RecordingError, match=message) as caught:
        open_recording([path])
    assert caught.value.hint
    assert str(path) in caught.value.message


def test_nothing_named_missing_and_empty_directory_are_refused(tmp_path):
    with pytest.raises(RecordingError, match="no recording given"):
        open_recording([])
    with pytest.raises(RecordingError, match="no such file or directory"):
        open_recording([tmp_path / "none.mcap"])
    with pytest.raises(RecordingError, match="no recording in this directory"):
        open_recording([tmp_path])
    path = r.in_sqlite(tmp_path / "photos.db", "CREATE TABLE albums (id INTEGER)")
    with pytest.raises(RecordingError, match="not a rosbag2 recording"):
        open_recording([path])


def test_an_unreadable_file_in_a_directory_is_named(tmp_path):
    """The directory was read as if it were not there."""
    path = tmp_path / "a_0.mcap"
    path.write_bytes(b"")
    said = f"{path}: not a recording, or empty; it is skipped"
    with pytest.raises(RecordingError, match=f"no recording in this directory; {re.escape(said)}"):
        open_recording([tmp_path])
    r.write_mcap(tmp_path / "a_1.mcap", ITEMS)
    with open_recording([tmp_path]) as recording:
        assert recording.damage == (said,)


@pytest.mark.parametrize(
    ("name", "why"),
    [("mcap-none", "wrong checksum"), ("mcap-none", "2116"), ("rosbag2-sqlite3-file", "2116")],
)
def test_what_is_lost_of_all_messages_is_said_of_a_camera_info(tmp_path, name, why):
    late = [replace(item, log_ns=item.log_ns + 2**62) for item in ITEMS]
    path = r.CONTAINERS[name](tmp_path / "log", late if why == "2116" else ITEMS)
    if why != "2116":
        with open_recording([path]) as recording:
            places = [block.offset + block.size // 2 for block in recording.parts[0].blocks]
        data = bytearray(path.read_bytes())
        for place in places:
            data[place] ^= 1
        path.write_bytes(data)
    with open_recording([path]) as recording:
        error = read_description(recording).unusable["/left/camera_info"]
    assert error.message.startswith("/left/camera_info: none of its 1 messages can be read (")
    assert why in error.message


def test_log_time_beyond_64_bits_is_left_out_and_counted(originals, tmp_path):
    data = bytearray(originals["mcap-unchunked"])
    time = ITEMS[20].log_ns.to_bytes(8, "little")
    place = data.index(time)
    data[place + 7] = 255
    path = written(tmp_path, data)
    with open_recording([path]) as recording:
        assert len(r.every(recording)) == len(ITEMS) - 1
        assert any(f"{ITEMS[20].topic}: " in note and "could be read" in note for note in recording.damage)


TOPICS = {item.topic for item in ITEMS}
CHUNKED = ["mcap-zstd", "mcap-none", "mcap-no-summary", "mcap-no-index-at-all", "bag", "bag-lz4"]


def messages_of(path):
    """What can be read, in order, and what is said of the rest."""
    with open_recording([path]) as recording:
        present = TOPICS & {info.name for info in recording.topics}
        found = [(m.topic, m.log_time_ns) for m in recording.messages(present)]
        return found, recording.damage


def in_block(path, offset, size):
    """How many messages the blocks hold that a stretch of the file touches."""
    with open_recording([path]) as recording:
        (part,) = recording.parts
        touched = (b for b in part.blocks if b.offset < offset + size and offset < b.offset + b.size)
        return sum(len(list(part.parse(part.load(block)))) for block in touched)


@pytest.fixture(params=CHUNKED)
def whole(request, originals, tmp_path):
    """A recording without an index as the recorder's death leaves it, or with one."""
    return written(tmp_path, originals[request.param], "whole")


@pytest.mark.parametrize("share", [0.3, 0.5, 0.7])
def test_a_zeroed_block_costs_only_what_was_in_it(whole, tmp_path, share):
    data = bytearray(whole.read_bytes())
    at = int(len(data) * share)
    lost = in_block(whole, at, 512)
    data[at : at + 512] = bytes(512)
    path = written(tmp_path, data)
    found, damage = messages_of(path)
    # A picture in an uncompressed chunk without a checksum may hold zeros and still be a message.
    assert len(ITEMS) - lost <= len(found) <= len(ITEMS)
    assert set(found) <= set(WHOLE)
    assert damage or len(found) == len(ITEMS)


@pytest.mark.parametrize("size", [1, 7, 300, 5000])
def test_garbage_between_records_costs_nothing(whole, tmp_path, size):
    data = whole.read_bytes()
    with open_recording([whole]) as recording:
        at = recording.parts[0].blocks[len(recording.parts[0].blocks) // 2].offset
    garbage = np.random.default_rng(size).integers(0, 256, size, dtype=np.uint8).tobytes()
    path = written(tmp_path, data[:at] + garbage + data[at:])
    found, damage = messages_of(path)
    assert sorted(found) == WHOLE
    assert any("are not valid records; skipped" in note for note in damage)


def test_bytes_like_a_chunk_whose_content_would_go_beyond_the_end_cost_nothing(originals, tmp_path):
    data = originals["mcap-no-index-at-all"]
    with open_recording([written(tmp_path, data, "whole")]) as recording:
        end = max(block.offset + block.size for block in recording.parts[0].blocks)
    like_a_chunk = struct.pack("<BQQQQII", 6, 40, 1, 2, 3, 0, 8) + bytes(8)
    found, damage = messages_of(written(tmp_path, data[:end] + bytes(9) + like_a_chunk))
    assert len(found) == len(ITEMS)
    assert "the file ends inside a record at byte" in " ".join(damage)


@pytest.mark.parametrize("name", ["mcap-zstd", "bag"])
def test_an_index_that_lies_is_done_without(originals, tmp_path, name):
    data = originals[name]
    with open_recording([written(tmp_path, data, "whole")]) as recording:
        offsets = [block.offset for block in recording.parts[0].blocks]
    for offset in offsets:
        stated = struct.pack("<Q", offset)
        assert stated in data
        data = data.replace(stated, struct.pack("<Q", offset + 3))
    path = written(tmp_path, data)
    assert sorted(messages_of(path)[0]) == WHOLE


@pytest.mark.parametrize(
    "name",
    ["mcap-zstd", "mcap-none", "mcap-unchunked", "mcap-no-summary", "mcap-message-zstd", "bag", "bag-lz4"],
)
def test_a_file_cut_off_at_any_byte_gives_its_whole_messages_and_says_so(originals, tmp_path, name):
    data, sound = originals[name], [(item.topic, item.log_ns) for item in ITEMS]
    path, most = tmp_path / "cut", 0
    for end in np.linspace(1, len(data) - 1, 80).astype(int):
        path.write_bytes(data[:end])
        try:
            found, damage = messages_of(path)
        except RecordingError as error:
            assert error.hint  # noqa: PT017
            assert " (-" not in error.message  # a negative duration of no messages  # noqa: PT017
            assert most == 0
            continue
        assert found == sound[: len(found)]
        assert len(found) >= most
        note = " ".join(damage)
        if "lost" in note and "skipped" not in note:
            seconds = (found[-1][1] - found[0][1]) * 1e-9
            assert f"{len(found)} messages ({seconds:.1f} s) were found before it, the rest is lost" in note
            assert f"of {end}" in note or "without a footer" in note
        assert damage or len(found) == len(sound)
        most = len(found)
    assert most > 0.9 * len(sound)
