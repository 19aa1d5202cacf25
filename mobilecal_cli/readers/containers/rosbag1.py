"""ROS 1 bags (format 2.0), complete and truncated.

rosbags reads only intact bags and keeps an entry per message in memory, but a recorder that was killed leaves a bag
without an index. The format has few kinds of records, so this module reads them itself, as blocks, in the same way
for all bags. The tests compare the result with rosbags.
"""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Iterator

import numpy as np

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model.arrays import IntArray
from mobilecal_cli.readers.containers.blocks import Block, BlockStorage
from mobilecal_cli.readers.containers.storage import LATEST_NS, decompress
from mobilecal_cli.readers.messages import Channel, ros2_spelling
from mobilecal_cli.readers.messages.types import Payload

MAGIC = b"#ROSBAG V2.0\n"

_MESSAGE, _INDEX, _CHUNK, _CHUNK_INFO, _CONNECTION = 2, 4, 5, 6, 7
_U32 = struct.Struct("<I")
_TIME = struct.Struct("<II")

_KINDS = re.compile(rb"\x04\x00\x00\x00op=[\x02\x05\x07]")
_CHUNKS = re.compile(rb"\x04\x00\x00\x00op=\x05")

Fields = dict[bytes, bytes]


def _u32(fields: Fields, name: bytes) -> int:
    return int(_U32.unpack(fields[name])[0])


def _time_ns(fields: Fields) -> int:
    seconds, nanoseconds = _TIME.unpack(fields[b"time"])
    return int(seconds) * 10**9 + int(nanoseconds)


def _fields(header: Payload) -> Fields:
    """Fields name=value of a record header.

    Raises:
        ValueError: a field without "=".
        EOFError: a field extends beyond the header.
    """
    fields: Fields = {}
    at = 0
    while at < len(header):
        (size,) = _U32.unpack_from(header, at)
        at += _U32.size
        if at + size > len(header):
            raise EOFError("a header field extends beyond the header")
        name, separator, value = bytes(header[at : at + size]).partition(b"=")
        if not separator:
            raise ValueError("a header field without a value")
        fields[name] = value
        at += size
    return fields


def _record(read: Callable[[int, int], Payload], at: int) -> tuple[Fields, int, int]:
    """Header fields of the record at a byte, and begin and end of its data; `read` gives a number of bytes from one."""
    header = at + _U32.size
    (size,) = _U32.unpack(read(at, _U32.size))
    body = header + size + _U32.size
    (length,) = _U32.unpack(read(body - _U32.size, _U32.size))
    return _fields(read(header, size)), body, body + length


def _reads(data: bytes) -> Callable[[int, int], memoryview]:
    """What reads a number of bytes from one of `data`."""
    view = memoryview(data)

    def read(at: int, size: int) -> memoryview:
        if at + size > len(view):
            raise EOFError("a record extends beyond the end of the data")
        return view[at : at + size]

    return read


class BagStorage(BlockStorage):
    """One ROS 1 bag."""

    container = "ROS 1 bag"
    SHORTEST_RECORD, LONGEST_HEAD = 1, 256
    TRUNCATED = "the bag is truncated in the record at byte {at} of {size} ({error})"

    def find_blocks(self) -> None:
        """Scan the file. One with chunks and without an index at its end was not closed."""
        fields, _, first = _record(self.read_at, len(MAGIC))
        if fields.get(b"encryptor"):
            raise RecordingError(
                f"{self.path}: the bag is encrypted ({fields[b'encryptor'].decode(errors='replace')})",
                "decrypt it with rosbag decrypt first",
            )
        stated, chunks = (
            int.from_bytes(fields.get(name, b"")[:8], "little") for name in (b"index_pos", b"chunk_count")
        )
        if stated > self.size:
            self.note_share(stated)
        if not self.scan(first, without_end="") and not 0 < stated < self.size + (not chunks):
            self.note(
                f"the bag has no usable index (was the recorder stopped properly?); a scan found "
                f"{self.counts.total()} messages"
            )

    def decompressed(self, chunk: bytes) -> bytes:
        fields, body, end = _record(_reads(chunk), 0)
        data, method = chunk[body:end], fields[b"compression"].decode()
        return decompress(data, method, _u32(fields, b"size"), truncated=end > len(chunk))

    def parse(self, data: bytes) -> Iterator[tuple[int, int, Payload]]:
        read = _reads(data)
        at = 0
        while at < len(data):
            fields, body, end = _record(read, at)
            kind = fields[b"op"][0]
            content = read(body, end - body)
            if kind == _MESSAGE:
                yield _u32(fields, b"conn"), _time_ns(fields), content
            elif kind == _CONNECTION:
                self._define(fields, bytes(content))
            at = end

    def index_record(self, at: int) -> tuple[int, IntArray, int] | None:
        fields, body, end = _record(self.read_at, at)
        if fields[b"op"][0] != _INDEX:
            return None
        entries = np.frombuffer(self.read_at(body, end - body), "<u4").reshape(-1, 3).astype(np.int64)
        seconds, nanoseconds, place = entries.T
        return _u32(fields, b"conn"), np.stack([seconds * 10**9 + nanoseconds, place], axis=1), end

    def _define(self, fields: Fields, data: bytes) -> None:
        number = _u32(fields, b"conn")
        if number in self.channels:
            return
        inner = _fields(data)
        name, topic = ros2_spelling(inner[b"type"].decode()), fields[b"topic"].decode()
        self.channels[number] = Channel(topic, name, "ros1", inner.get(b"message_definition", b""), "msg")

    def record_at(self, at: int) -> tuple[int | None, Block | None]:
        fields, body, end = _record(self.read_at, at)
        if end > self.size:
            raise EOFError("its data extends beyond the end of the file")
        kind = fields[b"op"][0]
        if kind == _CHUNK:
            # The index records give the channels. The times are only in the chunk, or in the index entries.
            return end, Block(at, end - at, True, LATEST_NS, 0, None)
        if kind == _MESSAGE:
            time_ns = _time_ns(fields)
            return end, Block(at, end - at, False, time_ns, time_ns, frozenset({_u32(fields, b"conn")}))
        if kind == _CONNECTION:
            self._define(fields, self.read_at(body, end - body))
        elif kind not in (_INDEX, _CHUNK_INFO):
            raise ValueError(f"unknown record kind {kind}")
        return None if kind == _CHUNK_INFO else end, None

    def likely_records(self, window: bytes, *, chunks: bool) -> Iterator[int]:
        for match in (_CHUNKS if chunks else _KINDS).finditer(window):
            yield from range(match.start() - 4, max(match.start() - self.LONGEST_HEAD, -1), -1)

    def fits(self, at: int) -> bool:
        (head_size,) = _U32.unpack(self.read_at(at, _U32.size))
        if head_size > self.LONGEST_HEAD:
            return False
        fields, _, end = _record(self.read_at, at)
        return fields[b"op"][0] in (_CHUNK, _MESSAGE, _CONNECTION) and end <= self.size
