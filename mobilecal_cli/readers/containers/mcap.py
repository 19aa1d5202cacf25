"""MCAP files, complete and truncated."""

from __future__ import annotations

import re
import struct
import zlib
from collections.abc import Iterator
from contextlib import suppress
from io import BytesIO

import numpy as np
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from numpy.typing import NDArray

from mobilecal_cli.readers.containers.blocks import Block, BlockStorage
from mobilecal_cli.readers.containers.storage import LATEST_NS, decompress
from mobilecal_cli.readers.messages import Channel, ros2_spelling
from mobilecal_cli.readers.messages.types import LANGUAGES, Payload

MAGIC = b"\x89MCAP0\r\n"

_HEAD = struct.Struct("<BQ")
_MESSAGE = struct.Struct("<HIQQ")
_CHUNK = struct.Struct("<QQQI")
#: A plain number, because comparing with an enum member is slow and happens for every message.
_MESSAGE_RECORD = int(Opcode.MESSAGE)
#: First bytes of a chunk, or of a message or chunk, whose length is at most 4 GB, as those of all records are.
_CHUNKS = re.compile(rb"\x06(?=.{4}\x00{4})", re.DOTALL)
_KINDS = re.compile(rb"[\x05\x06](?=.{4}\x00{4})", re.DOTALL)
#: Bytes of the footer and of what follows it.
_FOOTER = _HEAD.size + 20 + len(MAGIC)
#: Channels and schemas are limited to 65,535 each.
_MOST_DEFINITIONS = 2**17
_NO_SCHEMA = records.Schema(id=0, name="", encoding="", data=b"")


class McapStorage(BlockStorage):
    """One MCAP file."""

    container = "MCAP"
    SHORTEST_RECORD = LONGEST_HEAD = _HEAD.size
    TRUNCATED = "the file ends inside a {error} at byte {at} of {size}"

    def find_blocks(self) -> None:
        """Scan the file, with the channels in its summary, which chunks also define."""
        self._schemas: dict[int, records.Schema] = {}
        with suppress(Exception):  # damage may raise anything
            _, body, _ = self._head(self.size - _FOOTER)
            (at,) = struct.unpack("<Q", self.read_at(body, 8))
            while (record := self._head(at))[0] in (Opcode.SCHEMA, Opcode.CHANNEL):
                opcode, body, at = record
                self._define(opcode, self.read_at(body, at - body))
        self.scan(len(MAGIC), "the file ends without a footer (was the recorder stopped properly?)")

    def _head(self, at: int) -> tuple[int, int, int]:
        """Kind of the record at byte `at` of the file, and begin and end of its content."""
        opcode, length = _HEAD.unpack(self.read_at(at, _HEAD.size))
        body = at + _HEAD.size
        return opcode, body, body + length

    def decompressed(self, chunk: bytes) -> bytes:
        _, length = _HEAD.unpack_from(chunk)
        _, _, size, checksum = _CHUNK.unpack_from(chunk, _HEAD.size)
        name = _HEAD.size + _CHUNK.size + 4
        data = name + int.from_bytes(chunk[name - 4 : name], "little") + 8
        truncated = len(chunk) < _HEAD.size + length
        whole = decompress(chunk[data:], chunk[name : data - 8].decode(), size, truncated=truncated)
        if checksum and not truncated and zlib.crc32(whole) != checksum:
            raise ValueError("wrong checksum")
        return whole

    def parse(self, data: bytes) -> Iterator[tuple[int, int, Payload]]:
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
                yield number, time_ns, view[at + _MESSAGE.size : end]
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL) and definitions < _MOST_DEFINITIONS:
                definitions += 1
                self._define(opcode, bytes(view[at:end]))
            else:
                raise ValueError(f"a record of kind {opcode} among its messages, or too many definitions")
            at = end

    def index_record(self, at: int) -> tuple[int, NDArray[np.uint64], int] | None:
        opcode, body, end = self._head(at)
        if opcode != Opcode.MESSAGE_INDEX:
            return None
        content = self.read_at(body, end - body)
        (number,) = struct.unpack_from("<H", content)
        return number, np.frombuffer(content, "<u8", offset=6).reshape(-1, 2), end

    def _define(self, opcode: int, body: bytes) -> None:
        stream = ReadDataStream(BytesIO(body))
        if opcode == Opcode.SCHEMA:
            schema = records.Schema.read(stream)
            self._schemas.setdefault(schema.id, schema)
            return
        channel = records.Channel.read(stream)
        if channel.id not in self.channels:
            schema = self._schemas.get(channel.schema_id, _NO_SCHEMA)
            name, kind = ros2_spelling(schema.name), LANGUAGES.get(schema.encoding, "")
            own = Channel(channel.topic, name, channel.message_encoding, schema.data, kind)
            self.channels[channel.id] = own

    def record_at(self, at: int) -> tuple[int | None, Block | None]:
        opcode, body, end = self._head(at)
        block = None
        if opcode == 0 or end > self.size:
            raise EOFError("chunk" if opcode == Opcode.CHUNK else "record")
        if opcode in (Opcode.DATA_END, Opcode.FOOTER):
            return None, None
        try:
            if opcode == Opcode.MESSAGE:
                number, _, time_ns, _ = _MESSAGE.unpack(self.read_at(body, _MESSAGE.size))
                block = Block(at, end - at, False, time_ns, time_ns, frozenset({number}))
            elif opcode == Opcode.CHUNK:
                start_ns, end_ns, _, _ = _CHUNK.unpack(self.read_at(body, _CHUNK.size))
                block = Block(at, end - at, True, start_ns, end_ns, None)
            elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self._define(opcode, self.read_at(body, end - body))
        except Exception as error:  # one damaged record; the next one has its own header
            self.note(f"the record at byte {at} of {self.size} is damaged: {error}")
        return end, block

    def likely_records(self, window: bytes, *, chunks: bool) -> Iterator[int]:
        for match in (_CHUNKS if chunks else _KINDS).finditer(window):
            yield match.start()

    def fits(self, at: int) -> bool:
        """Whether a chunk or a message begins at a byte, judged by the length and time in its header."""
        opcode, body, end = self._head(at)
        length = end - body
        if end > self.size or length < (_MESSAGE.size if opcode == Opcode.MESSAGE else _CHUNK.size + 12):
            return False
        if opcode == Opcode.MESSAGE:
            number, _, time_ns, _ = _MESSAGE.unpack(self.read_at(body, _MESSAGE.size))
            goes_on = end == self.size or 0 < self.read_at(end, 1)[0] <= Opcode.DATA_END
            # Channels defined in chunks are not known here, but a message outside chunks follows its channel record.
            return number in self.channels and time_ns < LATEST_NS and goes_on
        start_ns, end_ns, _, _ = _CHUNK.unpack(self.read_at(body, _CHUNK.size))
        (name,) = struct.unpack("<I", self.read_at(body + _CHUNK.size, 4))
        if name > 8 or start_ns > end_ns or end_ns >= LATEST_NS:
            return False
        (stored,) = struct.unpack("<Q", self.read_at(body + _CHUNK.size + 4 + name, 8))
        return bool(_CHUNK.size + 4 + name + 8 + stored == length)
