"""Recordings that somebody made to do harm: refused, or read around, within bounded memory and time."""

import bz2
import os
import resource
import signal
import struct
import zlib
from contextlib import contextmanager, suppress
from pathlib import Path

import cv2
import lz4.frame
import numpy as np
import pytest
import zstandard
from google.protobuf import descriptor_pb2

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.readers import open_recording, read_description, sha256_of
from mobilecal_cli.readers.messages import Channel
from mobilecal_cli.readers.pictures import decode_image
from tests.readers import recordings as r
from tests.records import Record, written

MEMORY_BYTES = 2**30
SECONDS = 20  # on a busy machine; a few seconds on a quiet one
_SEPARATOR = "=" * 80 + "\n"


class Late(BaseException):
    """Nothing that the product catches."""


@contextmanager
def bounded():
    """The process may ask for no more than so much memory beyond what it has, and for no more processor time."""
    pages = int(Path("/proc/self/statm").read_text().split()[0])
    before = resource.getrlimit(resource.RLIMIT_AS)

    def late(*_: object) -> None:
        raise Late(f"still busy after {SECONDS} s")

    handler = signal.signal(signal.SIGPROF, late)
    resource.setrlimit(resource.RLIMIT_AS, (pages * resource.getpagesize() + MEMORY_BYTES, before[1]))
    signal.setitimer(signal.ITIMER_PROF, SECONDS)  # of this process alone, however busy the machine is
    try:
        yield
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0)
        signal.signal(signal.SIGPROF, handler)
        resource.setrlimit(resource.RLIMIT_AS, before)


def read(path: Path) -> tuple[int, tuple[str, ...]]:
    """Messages that can be had, and what is said of the rest."""
    with bounded(), open_recording([path]) as recording:
        read_description(recording)
        topics = [info.name for info in recording.topics]
        return sum(1 for _ in recording.messages(topics)), recording.damage


def record(opcode: int, body: bytes, claims: int | None = None) -> bytes:
    return struct.pack("<BQ", opcode, len(body) if claims is None else claims) + body


def text(value: str) -> bytes:
    return struct.pack("<I", len(value)) + value.encode()


MAGIC = b"\x89MCAP0\r\n"
HEADER = record(1, text("ros2") + text(""))


def chunk(method: str, stored: bytes, claims: int) -> bytes:
    head = struct.pack("<QQQI", 0, 10**9, claims, 0) + text(method)
    return record(6, head + struct.pack("<Q", len(stored)) + stored)


@pytest.fixture
def sound(tmp_path):
    """A recording with a message of each kind, as bytes."""
    return r.write_mcap(tmp_path / "sound.mcap", r.world(12)).read_bytes()


def records(data: bytes) -> list[tuple[int, int, int]]:
    """Opcode, beginning and end of every record."""
    found, at = [], len(MAGIC)
    while at + 9 <= len(data) - len(MAGIC):
        opcode, length = struct.unpack_from("<BQ", data, at)
        found.append((opcode, at, at + 9 + length))
        at += 9 + length
    return found


@pytest.mark.parametrize("opcode", [1, 3, 4, 5, 6, 7, 8, 9, 0x0B, 0x7F])
def test_a_record_of_petabytes(tmp_path, sound, opcode):
    path = tmp_path / "log.mcap"
    huge = record(opcode, b"x" * 100, 2**50)
    path.write_bytes(MAGIC + huge)
    with pytest.raises(RecordingError, match=r"nothing usable|damaged and unreadable"):
        read(path)
    # What lies before it is used, up to the last message index of the first chunk.
    end = next(end for kind, _, end in records(sound) if kind == 7)
    path.write_bytes(sound[:end] + huge)
    found, damage = read(path)
    assert found > 0
    assert "the rest is lost" in damage[0]


BOMBS = {
    "zstd": lambda size: zstandard.compress(bytes(size)),
    "lz4": lambda size: lz4.frame.compress(bytes(size), store_size=False),
}


@pytest.mark.parametrize(("method", "honest"), [("zstd", True), ("zstd", False), ("lz4", False)])
def test_a_chunk_that_decompresses_without_end(tmp_path, method, honest):
    size = 2**28
    stored = BOMBS[method](size)
    path = tmp_path / "log.mcap"
    bomb = chunk(method, stored, size if honest else 1000)
    path.write_bytes(MAGIC + HEADER + bomb + record(2, bytes(20)) + MAGIC)
    said = "states a decompressed size|states 1000 bytes|nothing usable"
    with pytest.raises(RecordingError, match=said) as caught:
        read(path)
    assert caught.value.hint


@pytest.mark.parametrize(
    "repeated",
    [
        record(0, b""),
        record(0x80, b""),
        record(4, struct.pack("<HH", 5, 0) + text("/t") + text("cdr") + struct.pack("<I", 0)),
        pytest.param(record(5, struct.pack("<HIQQ", 1, 0, 7, 7)), marks=pytest.mark.long),
    ],
    ids=["nothing", "unknown", "channels", "empty messages"],
)
def test_a_chunk_of_millions_of_tiny_records(tmp_path, repeated):
    """A hundredth of what it holds is stored; going through all of it would take minutes, or all memory."""
    channel = record(4, struct.pack("<HH", 1, 0) + text("/t") + text("cdr") + struct.pack("<I", 0))
    data = channel + repeated * (2**27 // len(repeated))
    stored = lz4.frame.compress(data, store_size=False)
    assert len(data) > 100 * len(stored)
    path = tmp_path / "log.mcap"
    path.write_bytes(MAGIC + HEADER + chunk("lz4", stored, len(data)) + record(2, bytes(20)) + MAGIC)
    if len(repeated) < 31:
        with pytest.raises(RecordingError, match="among its messages, or too many definitions"):
            read(path)
        return
    with bounded(), open_recording([path]) as recording:
        (storage,) = recording.parts
        assert sum(1 for _ in storage.messages({"/t"})) == 2**19
        assert "more than 524288 messages" in recording.damage[0]


def test_a_chunk_of_a_bag_that_decompresses_without_end(tmp_path):
    def field(name: str, value: bytes) -> bytes:
        return struct.pack("<I", len(name) + 1 + len(value)) + name.encode() + b"=" + value

    def bag_record(fields: bytes, data: bytes) -> bytes:
        return struct.pack("<I", len(fields)) + fields + struct.pack("<I", len(data)) + data

    stored = bz2.compress(bytes(2**26))
    size = field("size", struct.pack("<I", 2**26))
    bag = field("op", b"\x03") + field("index_pos", bytes(8)) + field("conn_count", bytes(4))
    data = bag_record(bag + field("chunk_count", bytes(4)), b" " * 4000)
    data += bag_record(field("op", b"\x05") + field("compression", b"bz2") + size, stored)
    path = tmp_path / "log.bag"
    path.write_bytes(b"#ROSBAG V2.0\n" + data)
    with pytest.raises(RecordingError):
        read(path)


def test_a_file_that_decompresses_without_end(tmp_path):
    path = tmp_path / "log.mcap.zstd"
    path.write_bytes(zstandard.compress(MAGIC + HEADER + bytes(2**28)))
    with pytest.raises(RecordingError, match="more than 1000 times their size"):
        read(path)


def test_a_message_that_decompresses_without_end(tmp_path):
    data = zstandard.compress(bytes(2**28))
    message = Record("/robot_description", "std_msgs/msg/String", b"string data", 1, data)
    path = written(tmp_path / "log.mcap", [message])
    _, damage = read(path)
    assert any("decompresses to more than" in note for note in damage)


def png(width: int, height: int) -> bytes:
    head = struct.pack(">IIBBBBB", width, height, 8, 0, 0, 0, 0)
    pieces = ((b"IHDR", head), (b"IDAT", zlib.compress(bytes(10**6))), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in pieces
    )


def jpeg(width: int, height: int) -> bytes:
    """A small picture whose frame header says that it is large."""
    data = bytearray(cv2.imencode(".jpg", np.zeros((16, 16), np.uint8))[1].tobytes())
    at = data.index(b"\xff\xc0")
    data[at + 5 : at + 9] = struct.pack(">HH", height, width)
    return bytes(data)


@pytest.mark.parametrize("make", [png, jpeg])
def test_a_compressed_picture_of_60000_by_60000(make):
    message = r.compressed(np.zeros((8, 8), np.uint8), ".png")(r.ROS2)
    message.data = np.frombuffer(make(60_000, 60_000), np.uint8)
    with bounded(), pytest.raises(RecordingError, match=r"invalid image size: .*3600000000 pixels"):
        decode_image(message)


def defined(*types: tuple[str, str]) -> str:
    (_, first), *others = types
    return first + "".join(f"{_SEPARATOR}MSG: {name}\n{body}" for name, body in others)


def chain_of(depth: int, line: str, last: str) -> str:
    bodies = [(f"a/T{i}", line.format(i + 1)) for i in range(depth)]
    return defined(*bodies, (f"a/T{depth}", last))


@pytest.mark.parametrize(
    ("definition", "payload"),
    [
        (defined(("a/T0", "a/T0 x\n")), bytes(1000)),
        (defined(("a/T0", "a/T1 x\n"), ("a/T1", "a/T0 x\n")), bytes(1000)),
        (chain_of(60, "a/T{0} x\na/T{0} y\n", ""), bytes(1000)),
        (chain_of(60, "a/T{0} x\na/T{0} y\n", "uint8 z\n"), bytes(1000)),
        (chain_of(5000, "a/T{0} x\n", "uint8 z\n"), bytes(1000)),
        (chain_of(6, "a/T{0}[1000] x\n", "uint8 z\n"), bytes(1000)),
        (defined(("a/T0", "a/E[] x\n"), ("a/E", "")), b"\xff\xff\xff\x7f" + bytes(100)),
        (defined(("a/T0", "a/E[99999999] x\n"), ("a/E", "uint8 z\n")), bytes(1000)),
        ("".join(f"uint8 x{i}\n" for i in range(100_000)), bytes(1000)),
        ("uint8[99999999999] x\n", bytes(1000)),
        ("float64[] x\nstring[] y\n", b"\xff\xff\xff\xff" * 100),
        ("uint8 x\n" + "#" * 10**6, b""),
        ("string x=" + "(" * 100_000 + "\n", bytes(100)),
    ],
)
@pytest.mark.parametrize("encoding", ["ros1", "cdr"])
def test_message_definitions_without_end(definition, payload, encoding):
    channel = Channel("/t", "a/msg/T0", encoding, definition.encode(), "msg")
    head = b"\x00\x01\x00\x00" if encoding == "cdr" else b""
    with bounded():
        try:
            channel.check()
        except RecordingError as error:
            assert error.hint  # noqa: PT017
            return
        # A definition that is harmless by itself: the payload does not fit it.
        with suppress(RecordingError):
            channel.decode(head + payload)


def test_a_protobuf_definition_in_a_chain_of_files():
    """Sorting them took time that grew with the square of their number."""
    definition = descriptor_pb2.FileDescriptorSet()
    for k in range(20_000):
        file = definition.file.add(name=f"f{k}", package=f"p{k}", syntax="proto3")
        file.message_type.add(name="M")
        file.dependency.extend([f"f{k - 1}"] if k else [])
    with bounded():
        Channel("/t", "p7.M", "protobuf", definition.SerializeToString(), "protobuf").check()


def test_json_that_is_deeper_than_the_stack(tmp_path):
    path = tmp_path / "log.mcap"
    deep = b'{"name": ' + b"[" * 10**6 + b"]" * 10**6 + b"}"
    payloads = (deep, b'{"name": ["pan"], "position": [1.0]}')
    kind = "sensor_msgs/JointState"
    written(path, (Record("/joint_states", kind, b"{}", k, p, **r.JSON) for k, p in enumerate(payloads, 1)))
    with bounded(), open_recording([path]) as recording:
        assert read_description(recording).joint_names == {"/joint_states": ("pan",)}


@pytest.fixture
def folder(tmp_path):
    """A rosbag2 directory without metadata."""
    made = tmp_path / "log"
    made.mkdir()
    r.write_mcap(made / "log.mcap", r.world(6))
    return made


def listed(folder, names):
    """Metadata that list some files."""
    (folder / "metadata.yaml").write_text(f"rosbag2_bagfile_information:\n  relative_file_paths: [{names}]\n")


@pytest.mark.parametrize("escape", ["../secret.mcap", "/etc/passwd", "sub/../../secret.mcap"])
def test_metadata_cannot_name_files_outside_its_directory(tmp_path, folder, escape):
    r.write_mcap(tmp_path / "secret.mcap", r.world(12))
    listed(folder, f"{escape}, log.mcap")
    with open_recording([folder]) as recording:
        assert [part.path for part in recording.parts] == [folder / "log.mcap"]
        assert "this part is skipped" in " ".join(recording.damage)


LAUGHS = "a0: &a0 [lol, lol]\n" + "".join(f"a{i}: &a{i} [*a{i - 1}, *a{i - 1}]\n" for i in range(1, 60))


@pytest.mark.parametrize(
    "metadata",
    [LAUGHS, "&a [*a]", "!!python/object/apply:os.system [touch pwned]", "[" * 3_000, "a: b\n" * 10**6],
)
def test_metadata_that_would_harm_is_done_without(tmp_path, folder, metadata):
    (folder / "metadata.yaml").write_text(metadata)
    with bounded(), open_recording([folder]) as recording:
        assert recording.topic("/joint_states").count == 6
        assert "cannot be used" in recording.damage[0]
    assert not (tmp_path / "pwned").exists()
    assert not Path("pwned").exists()


def test_a_database_that_computes_its_messages_is_refused(tmp_path):
    """A view in the place of the table of messages could run without end, or read other files."""
    path = r.in_sqlite(
        tmp_path / "log.db3",
        "CREATE TABLE topics (id INTEGER, name TEXT, type TEXT, serialization_format TEXT)",
        "CREATE VIEW messages AS WITH RECURSIVE n(id) AS (SELECT 1 UNION ALL SELECT id + 1 FROM n) "
        "SELECT id, 1 AS topic_id, id AS timestamp, x'00' AS data FROM n",
    )
    with bounded(), pytest.raises(RecordingError, match="no tables topics and messages"):
        open_recording([path])


def test_names_that_are_numbers_out_of_range(tmp_path, sound):
    """A log time beyond 64 signed bits, in the index as well as in the message."""
    path = tmp_path / "log.mcap"
    time = struct.pack("<Q", r.START_NS)
    path.write_bytes(sound.replace(time, b"\xff" * 8))
    with bounded(), open_recording([path]) as recording:
        r.one_log(recording, r.SOURCES)
        recording.log_times()


def test_a_database_of_other_types_than_it_says(tmp_path):
    """SQLite keeps whatever is written into a column: numbers for names, names for numbers."""
    path = r.in_sqlite(
        r.CONTAINERS["bare-db3"](tmp_path / "log", r.world(12)),
        "UPDATE topics SET name = x'35' WHERE id = 1",
        "UPDATE topics SET type = 7 WHERE id = 2",
        "UPDATE topics SET serialization_format = 1.5 WHERE id = 3",
        "UPDATE messages SET timestamp = 'late' WHERE id = (SELECT MAX(id) FROM messages)",
    )
    with bounded(), open_recording([path]) as recording:
        assert any("5" in info.name for info in recording.topics)
        assert recording.end_ns is not None
        assert sum(1 for part in recording.parts for _ in part.messages({"/ticks", "/left/image_raw"})) >= 12


def test_the_hash_of_no_recording(tmp_path):
    os.mkfifo(tmp_path / "log.mcap")
    with bounded(), pytest.raises(RecordingError, match="not a regular file"):
        sha256_of(tmp_path / "log.mcap")
