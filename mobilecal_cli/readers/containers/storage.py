"""What all containers share: channels, a time range, raw messages in order of log time, and limits."""

from __future__ import annotations

import bz2
from abc import ABC, abstractmethod
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO, ClassVar

import lz4.frame  # type: ignore[import-untyped]
import zstandard

from mobilecal_cli.model import IntArray
from mobilecal_cli.readers.messages import Channel, Payload

RawMessage = tuple[Channel, int, Payload]

#: Maximum size of a chunk, message or decompressed payload, because each must fit into memory.
SIZE_LIMIT = 2**29
#: Log times after the year 2262 are damage; times fit into 64 signed bits everywhere.
LATEST_NS = 2**63


@dataclass(frozen=True, slots=True, eq=False)
class Extent:
    """Part of a recording to read.

    Attributes:
        within_bytes: if the topics need more bytes of the file than this, only stretches spread evenly over it are
            read; None: no limit.
        at_ns: (n,) increasing log times: only their messages are needed, and others may be included; None: all times.
    """

    within_bytes: int | None = None
    at_ns: IntArray | None = None


EVERYTHING = Extent()


class Storage(ABC):
    """One file of a recording.

    Attributes:
        container: format of the file, for messages.
        path: the file, as given by the user or unpacked.
        opened: the file that is read: `path`, or a complete copy of it.
        channels: channel id → channel.
        counts: channel id → number of messages, stated in the file or counted; None if unknown.
        start_ns, end_ns: log time of the first and last message, None if unknown or empty.
        shift_ns: what the last log times are later than stored, because the recorder's clock stepped back.
        damage: data that was lost, as sentences; complete after a full pass.
    """

    container: ClassVar[str]
    path: Path
    opened: Path
    channels: dict[int, Channel]
    counts: dict[int, int] | None
    start_ns: int | None
    end_ns: int | None
    shift_ns: int

    def __init__(self, path: Path) -> None:
        self.path = self.opened = path
        self.channels = {}
        self.counts = None
        self.start_ns = None
        self.end_ns = None
        self.shift_ns = 0
        self._damage: dict[str, None] = {}

    @property
    def damage(self) -> tuple[str, ...]:
        """Each note once, in order of appearance."""
        return tuple(self._damage)

    def note(self, sentence: str) -> None:
        """Add a note on damage; a repeated one counts once."""
        self._damage[f"{self.path.name}: {sentence}"] = None

    def note_share(self, whole: int) -> None:
        """Note that the file is shorter than it states, with the share of its bytes that is left."""
        size = self.path.stat().st_size
        self.note(
            f"the file is truncated: {size} of {whole} bytes or more ({100 * size / whole:.0f} %) are left"
        )

    def note_steps(self, sizes_ns: Sequence[int]) -> None:
        """Note steps of the recorder's clock by their sizes."""
        for size_ns in sizes_ns:
            self.note(
                f"the recorder's clock steps back by {size_ns * 1e-9:.3f} s; messages are read in the order of the file"
            )

    @abstractmethod
    def raw(self, topics: Collection[str], extent: Extent = EVERYTHING) -> Iterator[RawMessage]:
        """Messages of the topics in order of log time, as far as the file is intact."""

    @abstractmethod
    def bytes_of(self, topics: Collection[str], extent: Extent = EVERYTHING) -> int:
        """Number of bytes that `raw` reads."""

    @abstractmethod
    def near(self, topics: Collection[str], times_ns: Sequence[int]) -> Iterator[RawMessage]:
        """First message of each topic at or after each time; only the few blocks that contain them are read."""

    @abstractmethod
    def log_times(self) -> dict[int, IntArray]:
        """Channel id → (n,) log times in file order; empty if they are not available without reading all."""

    @abstractmethod
    def delay(self, shift_ns: int) -> None:
        """Let all log times be later."""

    @abstractmethod
    def close(self) -> None:
        """Close the file."""

    def compare_counts(self, topics: Collection[str], read: Mapping[int, int]) -> None:
        """After a full pass, note topics with fewer messages than the file states."""
        if self.counts is None:
            return
        for number, channel in sorted(self.channels.items()):
            stated = self.counts.get(number, 0)
            if channel.topic in topics and read.get(number, 0) < stated:
                self.note(f"{channel.topic}: {read.get(number, 0)} of {stated} messages could be read")


ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"

#: A chunk may always decompress to this size; to more only within the ratio below.
ALWAYS_BYTES = 2**24
#: Images and readings never compress further; a higher ratio is made to fill memory or disk.
LARGEST_RATIO = 1000


def largest_size(stored: int) -> int:
    """Largest allowed size after decompression, bytes."""
    return min(SIZE_LIMIT, max(ALWAYS_BYTES, LARGEST_RATIO * stored))


def decompress(data: bytes, method: str, size: int) -> bytes:
    """Decompressed bytes of a chunk.

    Args:
        data: as stored.
        method: "", "none", "lz4", "zstd" or "bz2".
        size: length stated by the container, bytes.

    Raises:
        ValueError: unknown method, or the length differs from the stated one.
    """
    if not 0 <= size <= largest_size(len(data)):
        raise ValueError(f"a chunk of {len(data)} bytes states a decompressed size of {size}")
    if method in ("", "none"):
        whole = data
    elif method == "lz4":
        whole = lz4.frame.LZ4FrameDecompressor().decompress(data, max_length=size + 1)
    elif method == "bz2":
        whole = bz2.BZ2Decompressor().decompress(data, max_length=size + 1)
    elif method == "zstd":
        with zstandard.ZstdDecompressor().stream_reader(data) as reader:
            whole = reader.read(size + 1)
    else:
        raise ValueError(f"unknown compression {method!r}")
    if len(whole) != size:
        raise ValueError(f"a chunk states {size} bytes, but contains {len(whole)}")
    return whole


def message_payload(payload: Payload) -> Payload:
    """A CDR payload, decompressed if rosbag2 compressed each message separately (zstd).

    No CDR payload begins like a zstd frame, because its first byte is 0.

    Raises:
        ValueError: the frame is damaged or too large.
    """
    if bytes(payload[:4]) != ZSTD_MAGIC:
        return payload
    limit = largest_size(len(payload))
    with zstandard.ZstdDecompressor().stream_reader(payload) as reader:
        whole = reader.read(limit + 1)
    if not whole:
        raise ValueError("an empty zstd frame")
    if len(whole) > limit:
        raise ValueError(f"a message of {len(payload)} bytes decompresses to more than {limit} bytes")
    return whole


def expand(source: BinaryIO, target: Path) -> str:
    """Decompress a zstd file.

    Returns:
        "" if the file is complete, otherwise what is wrong; `target` then contains what could be decompressed.

    Raises:
        OSError: `target` cannot be written.
    """
    stored = source.seek(0, 2)
    source.seek(0)
    room = max(ALWAYS_BYTES, LARGEST_RATIO * stored)
    with target.open("wb") as sink, zstandard.ZstdDecompressor().stream_reader(source) as reader:
        while True:
            try:
                piece = reader.read(2**20)
            except zstandard.ZstdError as error:
                return str(error)
            if not piece:
                return ""
            room -= len(piece)
            if room < 0:
                return f"its {stored} bytes decompress to more than {LARGEST_RATIO} times their size"
            sink.write(piece)
