"""Containers that consist of chunks: MCAP and ROS 1 bags.

The blocks are found by a scan of the records' heads, in whole files as in damaged ones. A summary or an index at the
end of a file says no more, and may be missing.
"""

from __future__ import annotations

import heapq
from abc import abstractmethod
from array import array
from collections import Counter
from collections.abc import Callable, Collection, Iterator
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import chain, count, islice, repeat
from typing import Any, ClassVar

import numpy as np
from numpy.typing import NDArray

from mobilecal_cli.model.arrays import IntArray
from mobilecal_cli.readers.containers.storage import (
    EVERYTHING,
    LATEST_NS,
    LEAST_BACK_NS,
    WITHOUT_TIME,
    Extent,
    Message,
    Storage,
    goes_back,
)
from mobilecal_cli.readers.messages import SIZE_LIMIT
from mobilecal_cli.readers.messages.types import Payload

#: Maximum number of messages per block; empty ones could fill the memory from a few bytes.
_MOST_MESSAGES = 2**19
#: Bytes of the file that may be decompressed to find log times that are not in an index.
UNINDEXED_BYTES = 2**26
#: Bytes read at once where there are no chunks: of messages, and to search for the next record after damage.
_SPAN_BYTES = 2**22
_NO_SHIFT = np.zeros(1, dtype=np.int64)


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """Part of the file that is read at once: a chunk, or neighboring messages outside chunks.

    Attributes:
        offset: its first byte.
        size: its length in the file, bytes.
        is_chunk: whether it is a chunk record; otherwise it consists of plain records.
        start_ns, end_ns: log times of its messages.
        channels: ids of the channels with messages in it, None if unknown.
        shift_ns: (n,) what the log times of its messages are later than stored, because the recorder's clock stepped
            back; those of further ones like the last.
    """

    offset: int
    size: int
    is_chunk: bool
    start_ns: int
    end_ns: int
    channels: frozenset[int] | None
    shift_ns: IntArray = field(default_factory=lambda: _NO_SHIFT)

    def shifted(self, log_ns: IntArray) -> IntArray:
        """(n,) log times of its messages from those that are stored."""
        own = self.shift_ns[: len(log_ns)]
        return log_ns + np.pad(own, (0, len(log_ns) - len(own)), mode="edge")


class BlockStorage(Storage):
    """A container that consists of chunks: MCAP and ROS 1 bags.

    Only blocks with a requested channel are read. Messages are returned in order of log time: a message waits until no
    unread block can contain an earlier one. Memory therefore contains only blocks that overlap in time, for any length
    of the file.
    """

    #: Whether log times go back inside a block.
    _goes_back = False

    def read(self) -> None:
        self.blocks: list[Block] = []
        self._stream = self.files.enter_context(self.path.open("rb"))
        self.size = self.path.stat().st_size
        self.find_blocks()
        self._undo_steps()
        self.set_time_range()

    #: Bytes of the shortest record, and of the longest head by which `likely_records` recognizes one.
    SHORTEST_RECORD: ClassVar[int]
    LONGEST_HEAD: ClassVar[int]
    #: Where a file is truncated, with `{at}`, `{size}` and `{error}`.
    TRUNCATED: ClassVar[str]

    @abstractmethod
    def find_blocks(self) -> None:
        """Fill channels, blocks and counts, by `scan`."""

    @abstractmethod
    def record_at(self, at: int) -> tuple[int | None, Block | None]:
        """Where the record after the one at a byte begins, None at the end of the data; and its block.

        The block is a chunk, whose channels are not known yet, or a message outside chunks; None for other records.

        Raises:
            Exception: no complete record begins there; damaged bytes may raise anything.
        """

    @abstractmethod
    def likely_records(self, window: bytes, *, chunks: bool) -> Iterator[int]:
        """Places in some bytes where a chunk, or a record of any kind, may begin."""

    @abstractmethod
    def fits(self, at: int) -> bool:
        """Whether a complete record begins at a byte; damaged bytes may raise anything, which means that none does."""

    def load(self, block: Block) -> bytes:
        """Decompressed records of a block."""
        data = self.read_at(block.offset, block.size)
        return self.decompressed(data) if block.is_chunk else data

    @abstractmethod
    def decompressed(self, chunk: bytes) -> bytes:
        """The records in a chunk, whose checksum is verified if it has one; of a truncated chunk, the first ones."""

    @abstractmethod
    def parse(self, data: bytes) -> Iterator[tuple[int, int, Payload]]:
        """Channel id, log time and payload of every message; registers channels found on the way."""

    def read_at(self, offset: int, size: int) -> bytes:
        """Exactly `size` bytes from `offset`.

        Raises:
            EOFError: the file ends earlier.
        """
        if not 0 <= size <= SIZE_LIMIT:
            raise ValueError(f"a record states {size} bytes (limit {SIZE_LIMIT})")
        data = None
        if offset + size <= self.size:
            self._stream.seek(offset)
            data = self._stream.read(size)
        if data is None or len(data) != size:
            raise EOFError(
                f"the file ends at byte {self.size}, {size} bytes were expected from byte {offset}"
            )
        return data

    @abstractmethod
    def index_record(self, at: int) -> tuple[int, NDArray[np.integer[Any]], int] | None:
        """Channel id, (n, 2) log time and position of its messages in a chunk, and where the next record begins.

        None if the record at byte `at` is no index of a chunk.

        Raises:
            Exception: no complete record begins there; damaged bytes may raise anything.
        """

    def _blocks_of(self, topics: Collection[str], extent: Extent) -> list[Block]:
        """Blocks within the extent that may contain messages of the topics, in order of time."""
        wanted = self.channels_of(topics)
        blocks = [b for b in self.blocks if b.channels is None or not wanted.isdisjoint(b.channels)]
        blocks.sort(key=lambda block: (block.start_ns, block.offset))
        if extent.within_bytes is not None:
            blocks = _spread(blocks, extent.within_bytes)
        if extent.at_ns is not None:
            blocks = [b for b in blocks if _holds(b, extent.at_ns)]
        return blocks

    def bytes_of(self, topics: Collection[str], extent: Extent = EVERYTHING) -> int:
        return sum(block.size for block in self._blocks_of(topics, extent))

    def messages(self, topics: Collection[str], extent: Extent = EVERYTHING) -> Iterator[Message]:
        blocks = self._blocks_of(topics, extent)
        # A heap; the second is the number in reading order.
        waiting: list[tuple[int, int, Message]] = []
        order = count()
        read: Counter[int] = Counter()
        for place, block in enumerate(blocks, 1):
            following_ns = blocks[place].start_ns if place < len(blocks) else LATEST_NS
            for number, time_ns, payload in self._messages_of(block, self.note):
                channel = self.channels.get(number)
                if channel is None or channel.topic not in topics:
                    continue
                if time_ns >= LATEST_NS:
                    self.note(WITHOUT_TIME)
                else:
                    read[number] += 1
                    heapq.heappush(waiting, (time_ns, next(order), Message(channel, time_ns, payload)))
            while waiting and waiting[0][0] < following_ns:
                yield heapq.heappop(waiting)[-1]
        if len(blocks) == len(self._blocks_of(topics, EVERYTHING)):
            self.compare_counts(topics, read)

    def log_times(self) -> IntArray:
        return np.concatenate([np.zeros((2, 0), np.int64), *(self._times() or ())], axis=1)

    def _times(self) -> list[IntArray] | None:
        """(2, n) channel ids and log times of each block's messages; None if too much would be read for them."""
        every, unindexed = [], 0
        for block in self.blocks:
            channel, log_ns = self._index(block)[0]
            known = log_ns < LATEST_NS
            times = np.stack([channel[known], block.shifted(log_ns[known])])
            if not times.size:
                unindexed += block.size
                if unindexed > UNINDEXED_BYTES:
                    return None
                times = self._scanned(block, self.note)
            every.append(times)
        return every

    def _index(self, block: Block) -> tuple[IntArray, int]:
        """(2, n) channel ids and log times as stored in the index of a chunk, and where that ends.

        Without one, none and the end of the block.
        """
        entries, end = [], block.offset + block.size
        try:
            while block.is_chunk and (record := self.index_record(end)) is not None:
                number, some, end = record
                entries.append((number, some))
        except Exception:  # a damaged index may raise anything; the block itself is read
            entries, end = [], block.offset + block.size
        if not entries:
            return np.zeros((2, 0), dtype=np.int64), end
        channel = np.repeat([number for number, _ in entries], [len(some) for _, some in entries])
        log_ns, place = (
            np.minimum(np.concatenate([some for _, some in entries]), LATEST_NS).astype(np.int64).T
        )
        order = np.argsort(place, kind="stable")
        return np.stack([channel[order], log_ns[order]]), end

    def _scanned(self, block: Block, note: Callable[[str], None]) -> IntArray:
        """(2, n) channel ids and log times of a block's messages, up to the first damage, which `note` receives."""
        times = array("q")
        for number, time_ns, _ in self._messages_of(block, note):
            if time_ns < LATEST_NS:
                times.extend((number, time_ns))
        return np.array(times, dtype=np.int64).reshape(-1, 2).T

    def _undo_steps(self) -> None:
        """Let log times go on in the order of the file where the recorder's clock stepped back."""
        latest_ns, may_step = 0, self._goes_back
        for block in self.blocks:
            may_step |= block.start_ns < latest_ns - LEAST_BACK_NS
            latest_ns = max(latest_ns, block.end_ns)
        times = self._times() if may_step else None
        if times is None:
            return
        shift_ns = self.shifts_of(*np.concatenate(times, axis=1))
        if shift_ns.any():
            ends = np.cumsum([len(own.T) for own in times])[:-1]
            own_shifts = np.split(shift_ns, ends)
            self.blocks = [
                _shifted(block, log_ns + own_ns, own_ns)
                for block, (_, log_ns), own_ns in zip(self.blocks, times, own_shifts, strict=True)
                if len(own_ns)
            ]

    def delay(self, shift_ns: int) -> None:
        self.shift_ns += shift_ns
        self.blocks = [
            _shifted(b, np.array([b.start_ns, b.end_ns]) + shift_ns, b.shift_ns + shift_ns)
            for b in self.blocks
        ]
        self.set_time_range()

    def _messages_of(self, block: Block, note: Callable[[str], None]) -> Iterator[tuple[int, int, Payload]]:
        """Messages of a block up to the first damage, which `note` receives."""
        returned = 0
        *shifts_ns, last_ns = block.shift_ns.tolist()
        try:
            messages = self.parse(self.load(block))
            shifted = zip(messages, chain(shifts_ns, repeat(last_ns)), strict=False)
            for (number, time_ns, payload), shift_ns in islice(shifted, _MOST_MESSAGES):
                returned += 1
                yield number, time_ns + shift_ns, payload
            if next(messages, None) is not None:
                raise ValueError(f"more than {_MOST_MESSAGES} messages")
        except MemoryError:
            raise
        except Exception as error:  # damaged bytes may raise anything
            kept = f"its first {returned} messages are used" if returned else "its messages are skipped"
            note(
                f"the {'chunk' if block.is_chunk else 'block'} at byte {block.offset} of {self.size} is "
                f"damaged ({type(error).__name__}: {error}); {kept}"
            )

    def set_time_range(self) -> None:
        """Set start and end from the blocks, once all are known."""
        if self.blocks:
            self.start_ns = min(block.start_ns for block in self.blocks)
            self.end_ns = max(block.end_ns for block in self.blocks)

    def scan(self, at: int, without_end: str) -> str:
        """Fill blocks, channels and counts by the record headers from byte `at` on; note where the file is truncated.

        The index records after a chunk give its channels and counts. A chunk is decompressed only if they are missing,
        truncated, or refer to an unknown channel, whose definition is then in that chunk.

        Args:
            at: offset of the first record.
            without_end: what is wrong with a file whose records end without one that marks the end, "" for nothing.

        Returns:
            Where the file is truncated, "" if it is complete.
        """
        trouble = without_end
        while at + self.SHORTEST_RECORD <= self.size:
            try:
                end, block = self.record_at(at)
            except Exception as error:  # no complete record begins there: search for the next one
                head = self.read_at(at, min(self.LONGEST_HEAD, self.size - at))
                is_chunk = 0 in self.likely_records(head, chunks=True)
                if is_chunk and self._next_record(at + 1, chunks=True) is None:
                    self._add_chunk(Block(at, self.size - at, True, LATEST_NS, 0, None), truncated=True)
                    following = None
                else:
                    following = self._next_record(at + 1)
                if following is None:
                    trouble = self.TRUNCATED.format(at=at, size=self.size, error=error)
                    break
                self.note(f"{following - at} bytes from byte {at} on are not valid records; skipped")
                at = following
                continue
            if end is None:
                trouble = ""
                break
            at = end
            if block is not None and block.is_chunk:
                at = self._add_chunk(block)
            elif block is not None:
                self._add_message(block)
        if trouble:
            self.set_time_range()
            count, seconds = self.counts.total(), ((self.end_ns or 0) - (self.start_ns or 0)) * 1e-9
            found = f"{count} messages ({seconds:.1f} s)" if count else "no messages"
            self.note(f"{trouble}; {found} were found before it, the rest is lost")
        return trouble

    def _next_record(self, at: int, *, chunks: bool = False) -> int | None:
        """Offset of the next chunk, or record of any kind, from byte `at` on; None if there is none."""
        while at < self.size:
            window = self.read_at(at, min(_SPAN_BYTES, self.size - at))
            for place in self.likely_records(window, chunks=chunks):
                with suppress(Exception):  # damaged bytes may raise anything
                    if self.fits(at + place):
                        return at + place
            if at + len(window) == self.size:
                return None
            at += len(window) - self.LONGEST_HEAD
        return None

    def _add_message(self, block: Block) -> None:
        """Add a message outside chunks, which continues the block of the message directly before it."""
        self.counts.update(block.channels or ())
        last = self.blocks[-1] if self.blocks else block
        if last.is_chunk or last.offset + last.size != block.offset or last.size >= _SPAN_BYTES:
            self.blocks.append(block)
            return
        self._goes_back |= block.start_ns < last.end_ns - LEAST_BACK_NS
        self.blocks[-1] = replace(
            last,
            size=last.size + block.size,
            start_ns=min(last.start_ns, block.start_ns),
            end_ns=max(last.end_ns, block.end_ns),
            channels=(last.channels or frozenset()) | (block.channels or frozenset()),
        )

    def _add_chunk(self, block: Block, *, truncated: bool = False) -> int:
        """Add a chunk, completed by its index, or else by its messages; returns where the record after it begins."""
        damage: list[str] = []
        times, end = self._index(block)
        if truncated or not set(times[0].tolist()) <= self.channels.keys() or not times.size:
            times = self._scanned(block, damage.append)
        if not truncated:  # what is truncated is noted as such
            for sentence in damage:
                self.note(sentence)
        counts, known = Counter(times[0].tolist()), times[:, times[1] < LATEST_NS]
        self.counts.update(counts)
        if counts:
            start_ns, end_ns = int(known[1].min(initial=LATEST_NS)), int(known[1].max(initial=0))
            self._goes_back |= end_ns - start_ns > LEAST_BACK_NS and goes_back(*known)
            block = replace(block, start_ns=start_ns, end_ns=end_ns, channels=frozenset(counts))
        if counts or (damage and not truncated):  # not an empty chunk
            self.blocks.append(block)
        return end


def _shifted(block: Block, log_ns: IntArray, shift_ns: IntArray) -> Block:
    """A block with other log times."""
    return replace(block, start_ns=int(log_ns.min()), end_ns=int(log_ns.max()), shift_ns=shift_ns)


def _spread(blocks: list[Block], within_bytes: int) -> list[Block]:
    """Blocks at even distances, at least one, whose total size is within the limit."""
    total = sum(block.size for block in blocks)
    if total <= within_bytes:
        return blocks
    count = max(1, len(blocks) * within_bytes // total)
    return [blocks[i] for i in np.linspace(0, len(blocks) - 1, count).astype(int)]


def _holds(block: Block, at_ns: IntArray) -> bool:
    """Whether any of some increasing log times lies in a block."""
    first = int(np.searchsorted(at_ns, min(block.start_ns, LATEST_NS - 1)))
    return first < len(at_ns) and int(at_ns[first]) <= block.end_ns
