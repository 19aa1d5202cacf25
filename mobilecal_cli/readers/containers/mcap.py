"""MCAP files: with an index, with part of one, without one, and truncated."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Iterator, Sequence
from io import BytesIO
from pathlib import Path

import numpy as np
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.reader import SeekingReader
from mcap.summary import Summary

from mobilecal_cli.model import IntArray
from mobilecal_cli.readers.containers.blocks import Block, BlockStorage, Reindex
from mobilecal_cli.readers.containers.storage import (
    LATEST_NS,
    SIZE_LIMIT,
    ZSTD_MAGIC,
    decompress,
    message_payload,
)
from mobilecal_cli.readers.messages import Channel, Payload, ros2_spelling
from mobilecal_cli.readers.messages.types import DefinitionFormat

MAGIC = b"\x89MCAP0\r\n"

_HEAD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_CHUNK = struct.Struct("<QQQI")
#: A plain number, because comparing with an enum member is slow and happens for every message.
_MESSAGE_RECORD = int(Opcode.MESSAGE)
#: Records that are searched for after damage.
_CHUNKS, _RECORDS = (Opcode.CHUNK,), (Opcode.MESSAGE, Opcode.CHUNK)
#: Bytes searched at once for the next record after damage.
_WINDOW = 2**22
#: Channels and schemas are limited to 65,535 each.
_MOST_DEFINITIONS = 2**17
_FORMATS: dict[str, DefinitionFormat] = {
    "ros1msg": "msg",
    "ros2msg": "msg",
    "ros2idl": "idl",
    "omgidl": "idl",
    "protobuf": "protobuf",
}


class McapStorage(BlockStorage):
    """One MCAP file.

    A complete summary is used as the index. If it is missing or incomplete, the record headers of the file are scanned
    once, without payloads. The message indexes after the chunks give channels and counts. Only chunks without them, or
    with an unknown channel, are decompressed.
    """

    container = "MCAP"

    def __init__(self, path: Path) -> None:
        self._schemas: dict[int, records.Schema] = {}
        self._profile = ""
        #: Channels whose messages rosbag2 may have compressed separately.
        self._packable: set[int] = set()
        super().__init__(path)

    def find_blocks(self) -> None:
        """Use the summary if it is complete, otherwise scan the file."""
        self._profile = self._read_profile()
        summary = self._complete_summary()
        if summary is not None:
            self._use(summary)
        else:
            _Reindex(self).run()

    def _read_profile(self) -> str:
        opcode, length = _HEAD.unpack(self.read_at(len(MAGIC), _HEAD.size))
        if opcode != Opcode.HEADER:
            return ""
        header = records.Header.read(_stream(self.read_at(len(MAGIC) + _HEAD.size, length)))
        return str(header.profile)

    def _complete_summary(self) -> Summary | None:
        """The summary, if its index is reliable: most chunks are where it says, and every channel is known."""
        try:
            summary = SeekingReader(self._stream, record_size_limit=min(SIZE_LIMIT, self.size)).get_summary()
        except Exception:  # damage may raise anything; the scan does not need a summary
            return None
        if summary is None or not summary.chunk_indexes:
            return None
        statistics = summary.statistics
        if statistics is not None and statistics.chunk_count != len(summary.chunk_indexes):
            return None
        named = {number for index in summary.chunk_indexes for number in index.message_index_offsets}
        if not named or not named <= summary.channels.keys():
            return None
        schemas = {channel.schema_id for channel in summary.channels.values()} - {0}
        if not schemas <= summary.schemas.keys():
            return None
        misplaced = sum(not self._is_chunk(index) for index in summary.chunk_indexes)
        if 2 * misplaced > len(summary.chunk_indexes):
            return None  # the index is wrong; a few damaged chunk headers are found on reading
        return summary

    def _is_chunk(self, index: records.ChunkIndex) -> bool:
        try:
            head = _HEAD.unpack(self.read_at(index.chunk_start_offset, _HEAD.size))
        except (EOFError, ValueError):
            return False
        return bool(head == (Opcode.CHUNK, index.chunk_length - _HEAD.size))

    def _use(self, summary: Summary) -> None:
        self._schemas.update(summary.schemas)
        for channel in summary.channels.values():
            self._register(channel)
        if summary.statistics is not None:
            self.counts = dict(summary.statistics.channel_message_counts)
        for index in summary.chunk_indexes:
            ids = frozenset(index.message_index_offsets)
            if not ids and index.message_end_time == 0:
                continue
            self.blocks.append(
                Block(
                    index.chunk_start_offset,
                    index.chunk_length,
                    True,
                    index.message_start_time,
                    index.message_end_time,
                    ids or None,
                )
            )

    def load(self, block: Block) -> bytes:
        """Decompressed records of a block, checksum verified."""
        data = self.read_at(block.offset, block.size)
        if not block.is_chunk:
            return data
        if data[:1] != bytes([Opcode.CHUNK]):
            raise ValueError("no chunk begins there")
        at = _HEAD.size
        _, _, full_size, checksum = _CHUNK.unpack_from(data, at)
        at += _CHUNK.size
        (length,) = struct.unpack_from("<I", data, at)
        method = data[at + 4 : at + 4 + length].decode()
        at += 4 + length
        (stored,) = struct.unpack_from("<Q", data, at)
        whole = decompress(data[at + 8 : at + 8 + stored], method, full_size)
        if checksum and zlib.crc32(whole) != checksum:
            raise ValueError("wrong checksum")
        return whole

    def parse(self, data: bytes) -> Iterator[tuple[int, int, Payload]]:
        """Channel id, log time and payload of every message; registers channels found on the way."""
        view = memoryview(data)
        at = definitions = 0
        while at < len(data):
            opcode, length = _HEAD.unpack_from(data, at)
            at += _HEAD.size
            end = at + length
            if end > len(data):
                raise EOFError("a record extends beyond the end of the data")
            if opcode == _MESSAGE_RECORD:
                number, _, time_ns, _ = _MESSAGE.unpack_from(data, at)
                payload: Payload = view[at + _MESSAGE.size : end]
                if number in self._packable and data.startswith(ZSTD_MAGIC, at + _MESSAGE.size):
                    payload = message_payload(payload)
                yield number, time_ns, payload
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL) and definitions < _MOST_DEFINITIONS:
                definitions += 1
                self.define(opcode, bytes(view[at:end]))
            else:
                raise ValueError(f"a record of kind {opcode} among its messages, or too many definitions")
            at = end

    def index_of(self, block: Block) -> Iterator[tuple[int, IntArray]]:
        """Channel id, and (n, 2) log time and position of its messages, from the message indexes after a chunk."""
        at = block.offset + block.size
        while at + _HEAD.size <= self.size:
            opcode, length = _HEAD.unpack(self.read_at(at, _HEAD.size))
            if opcode != Opcode.MESSAGE_INDEX:
                return
            body = self.read_at(at + _HEAD.size, length)
            (number,) = struct.unpack_from("<H", body)
            entries = np.frombuffer(body, "<u8", offset=6).reshape(-1, 2)
            yield number, entries[entries[:, 0] < LATEST_NS].astype(np.int64)
            at += _HEAD.size + length

    def define(self, opcode: int, body: bytes) -> None:
        """Register a schema or channel record."""
        if opcode == Opcode.SCHEMA:
            schema = records.Schema.read(_stream(body))
            self._schemas.setdefault(schema.id, schema)
        else:
            self._register(records.Channel.read(_stream(body)))

    def _register(self, channel: records.Channel) -> None:
        if channel.id in self.channels:
            return
        schema = self._schemas.get(channel.schema_id)
        kind = _FORMATS.get(schema.encoding, "") if schema else ""
        definition: str | bytes = schema.data if schema else ""
        if isinstance(definition, bytes) and kind != "protobuf":
            definition = definition.decode(errors="replace")
        encoding = channel.message_encoding or {"ros2": "cdr", "ros1": "ros1"}.get(self._profile, "")
        if encoding == "cdr":
            self._packable.add(channel.id)
        self.channels[channel.id] = Channel(
            channel.id,
            channel.topic,
            ros2_spelling(schema.name) if schema else "",
            encoding,
            definition,
            kind,
        )


class _Reindex(Reindex):
    """Finds the blocks of a file without an index by reading record headers only."""

    def __init__(self, storage: McapStorage) -> None:
        super().__init__(storage)
        self._storage = storage

    def run(self) -> None:
        """Fill the storage's blocks, channels and counts; note where the file is truncated."""
        storage = self._storage
        at, trouble = len(MAGIC), "the file ends without a footer (was the recorder stopped properly?)"
        while at + _HEAD.size <= storage.size:
            opcode, length = _HEAD.unpack(storage.read_at(at, _HEAD.size))
            end = at + _HEAD.size + length
            if opcode == 0 or end > storage.size:
                cut = None
                if opcode == Opcode.CHUNK:
                    self.other()  # gives the channels, by which messages are recognized
                    cut = self._cut_chunk(at) if self._next_record(at + 1, _CHUNKS) is None else None
                found = self._next_record(at + 1, _RECORDS) if cut is None else None
                if found is None:
                    if cut is not None:
                        self.chunk(cut)
                    what = "chunk" if opcode == Opcode.CHUNK else "record"
                    trouble = f"the file ends inside a {what} at byte {at} of {storage.size}"
                    break
                at = self.skip(at, found)
                continue
            if opcode in (Opcode.DATA_END, Opcode.FOOTER):
                trouble = ""
                break
            try:
                self._visit(opcode, at, length)
            except Exception as error:  # one damaged record; the next one has its own header
                storage.note(f"the record at byte {at} of {storage.size} is damaged: {error}")
            at = end
        self.finish(trouble)

    def _cut_chunk(self, at: int) -> Block | None:
        """The part of an uncompressed chunk before the end of a truncated file: its first messages are intact."""
        storage, body = self._storage, at + _HEAD.size + _CHUNK.size + 12
        if body >= storage.size or storage.read_at(body - 12, 4) != bytes(4):
            return None
        return Block(body, storage.size - body, False, 2**63 - 1, 0, None)

    def _next_record(self, at: int, kinds: Sequence[int]) -> int | None:
        """Offset of the next record of some kinds with consistent lengths from byte `at` on, None if there is none."""
        storage = self._storage
        while at + _HEAD.size < storage.size:
            window = np.frombuffer(storage.read_at(at, min(_WINDOW, storage.size - at)), np.uint8)
            if len(window) <= _HEAD.size:
                return None
            starts = len(window) - _HEAD.size
            likely = np.isin(window[:starts], kinds)
            for byte in range(5, 9):  # no record is longer than 4 GB
                likely &= window[byte : byte + starts] == 0
            for place in np.flatnonzero(likely):
                if self._fits(at + int(place)):
                    return at + int(place)
            at += starts
        return None

    def _fits(self, at: int) -> bool:
        """Whether a chunk or a message begins at a byte, judged by the length and time in its header."""
        storage, body = self._storage, at + _HEAD.size
        opcode, length = _HEAD.unpack(storage.read_at(at, _HEAD.size))
        if body + length > storage.size:
            return False
        if opcode == Opcode.MESSAGE:
            if length < _MESSAGE.size:
                return False
            number, _, time_ns, _ = _MESSAGE.unpack(storage.read_at(body, _MESSAGE.size))
            # Channels defined in chunks are not known here, but a message outside chunks follows its channel record.
            return number in storage.channels and time_ns < LATEST_NS and self._goes_on(body + length)
        if length < _CHUNK.size + 12:
            return False
        start_ns, end_ns, _, _ = _CHUNK.unpack(storage.read_at(body, _CHUNK.size))
        (name,) = struct.unpack("<I", storage.read_at(body + _CHUNK.size, 4))
        if name > 8 or start_ns > end_ns or end_ns >= LATEST_NS:
            return False
        (stored,) = struct.unpack("<Q", storage.read_at(body + _CHUNK.size + 4 + name, 8))
        return bool(_CHUNK.size + 4 + name + 8 + stored == length)

    def _goes_on(self, at: int) -> bool:
        """Whether the file ends at a byte, or a record of a known kind begins there."""
        if at >= self._storage.size:
            return at == self._storage.size
        return 0 < self._storage.read_at(at, 1)[0] <= Opcode.DATA_END

    def _visit(self, opcode: int, at: int, length: int) -> None:
        storage, body = self._storage, at + _HEAD.size
        if opcode == Opcode.MESSAGE_INDEX:
            index = records.MessageIndex.read(_stream(storage.read_at(body, length)))
            self.index(index.channel_id, len(index.records))
        elif opcode == Opcode.MESSAGE:
            number, _, time_ns, _ = _MESSAGE.unpack(storage.read_at(body, _MESSAGE.size))
            self.message(at, body + length, number, time_ns)
        elif opcode == Opcode.CHUNK:
            start_ns, end_ns, _, _ = _CHUNK.unpack(storage.read_at(body, _CHUNK.size))
            self.chunk(Block(at, _HEAD.size + length, True, start_ns, end_ns, None))
        else:
            self.other()
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                storage.define(opcode, storage.read_at(body, length))


def _stream(body: bytes) -> ReadDataStream:
    return ReadDataStream(BytesIO(body))
