"""ROS 1 bags (format 2.0): with an index, without one, and truncated.

rosbags reads only intact bags and keeps an entry per message in memory, but a recorder that was killed leaves a bag
without an index. The format has few kinds of records, so this module reads them itself, as blocks, in the same way
for all bags. The tests compare the result with rosbags.
"""

from __future__ import annotations

import re
import struct
from collections import Counter
from collections.abc import Callable, Iterator

import numpy as np

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model import IntArray
from mobilecal_cli.readers.containers.blocks import Block, BlockStorage
from mobilecal_cli.readers.containers.storage import LATEST_NS, decompress
from mobilecal_cli.readers.messages import Channel, ros2_spelling
from mobilecal_cli.readers.messages.types import Payload

MAGIC = b"#ROSBAG V2.0\n"

_MESSAGE, _INDEX, _CHUNK, _CHUNK_INFO, _CONNECTION = 2, 4, 5, 6, 7
_U32 = struct.Struct("<I")
_U64 = struct.Struct("<Q")
_TIME = struct.Struct("<II")

_KINDS = re.compile(rb"\x04\x00\x00\x00op=[\x02\x05\x07]")
_CHUNKS = re.compile(rb"\x04\x00\x00\x00op=\x05")

Fields = dict[bytes, bytes]


def _u32(fields: Fields, name: bytes) -> int:
    return int(_U32.unpack(fields[name])[0])


def _time_ns(fields: Fields, name: bytes) -> int:
    seconds, nanoseconds = _TIME.unpack(fields[name])
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
        """Use the index if it is complete, otherwise scan the file."""
        fields, _, first = self._head(len(MAGIC))
        if fields.get(b"encryptor"):
            raise RecordingError(
                f"{self.path}: the bag is encrypted ({fields[b'encryptor'].decode(errors='replace')})",
                "decrypt it with rosbag decrypt first",
            )
        stated = int.from_bytes(fields.get(b"index_pos", b"")[: _U64.size], "little")
        if stated > self.size:
            self.note_share(stated)
        if not (stated and self._read_index(fields, stated)):
            self.channels.clear()
            self.blocks.clear()
            if not self.reindex(first, without_end=""):
                self.note(
                    f"the bag has no usable index (was the recorder stopped properly?); a scan found "
                    f"{self.counts.total()} messages"
                )

    def _head(self, at: int) -> tuple[Fields, int, int]:
        """Header fields of the record at byte `at` of the file, and begin and end of its data."""
        return _record(self.read_at, at)

    def _read_index(self, bag: Fields, at: int) -> bool:
        """Use the index that begins at byte `at`; False if any of it is missing or wrong."""
        try:
            for _ in range(_u32(bag, b"conn_count")):
                fields, body, end = self._head(at)
                self._define(fields, self.read_at(body, end - body))
                at = end
            counts, damaged = Counter[int](), list[str]()
            for _ in range(_u32(bag, b"chunk_count")):
                fields, body, end = self._head(at)
                trouble = self._index_chunk(fields, self.read_at(body, end - body), counts)
                damaged += [trouble] if trouble else []
                at = end
            if 2 * len(damaged) > len(damaged) + len(self.blocks):
                return False  # the index is wrong
        except Exception:  # a damaged index may raise anything; the scan does not need it
            return False
        for trouble in damaged:
            self.note(trouble)
        self.counts = counts
        return True

    def _index_chunk(self, fields: Fields, data: bytes, counts: Counter[int]) -> str:
        """Process an index entry; returns what is wrong with its chunk, "" for nothing."""
        position = int(_U64.unpack(fields[b"chunk_pos"])[0])
        numbers = frozenset(number for number, _ in struct.iter_unpack("<II", data))
        if not numbers <= self.channels.keys():
            raise ValueError("the index refers to an unknown connection")
        for number, messages in struct.iter_unpack("<II", data):
            counts[number] += messages
        start_ns, end_ns = _time_ns(fields, b"start_time"), _time_ns(fields, b"end_time")
        try:
            chunk, _, end = self._head(position)
            whole = chunk[b"op"] == bytes([_CHUNK]) and end <= self.size
        except Exception:  # damaged bytes may raise anything
            whole = False
        if not whole:
            return f"no chunk begins at byte {position} of {self.size}, although the index lists one; skipped"
        if numbers:
            self.blocks.append(Block(position, end - position, True, start_ns, end_ns, numbers))
        return ""

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
                yield _u32(fields, b"conn"), _time_ns(fields, b"time"), content
            elif kind == _CONNECTION:
                self._define(fields, bytes(content))
            at = end

    def index_of(self, block: Block) -> Iterator[tuple[int, IntArray]]:
        at = block.offset + block.size
        while at < self.size:
            fields, body, end = self._head(at)
            if fields[b"op"][0] != _INDEX:
                return
            seconds, nanoseconds, place = (
                np.frombuffer(self.read_at(body, end - body), "<u4").reshape(-1, 3).astype(np.int64).T
            )
            yield _u32(fields, b"conn"), np.stack([seconds * 10**9 + nanoseconds, place], axis=1)
            at = end

    def _define(self, fields: Fields, data: bytes) -> None:
        number = _u32(fields, b"conn")
        if number in self.channels:
            return
        inner = _fields(data)
        name, topic = ros2_spelling(inner[b"type"].decode()), fields[b"topic"].decode()
        self.channels[number] = Channel(topic, name, "ros1", inner.get(b"message_definition", b""), "msg")

    def record_at(self, at: int) -> tuple[int | None, Block | None]:
        fields, body, end = self._head(at)
        if end > self.size:
            raise EOFError("its data extends beyond the end of the file")
        kind = fields[b"op"][0]
        if kind == _CHUNK:
            # The index records give the channels. The times are only in the chunk, or in the index entries.
            return end, Block(at, end - at, True, LATEST_NS, 0, None)
        if kind == _MESSAGE:
            time_ns = _time_ns(fields, b"time")
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
        fields, _, end = self._head(at)
        return fields[b"op"][0] in (_CHUNK, _MESSAGE, _CONNECTION) and end <= self.size
