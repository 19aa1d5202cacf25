"""rosbag2 sqlite3 files (.db3), intact or damaged.

A damaged file is read page by page, whether or not other pages lead to those with the messages. A table's rows are on
leaf pages; interior pages lead to these. A database that grows gets interior pages late, at its end: a file that is cut
has all leaves before the cut, and nothing that leads to them. The format: https://www.sqlite.org/fileformat2.html,
sections 1.5, 1.6 and 2.1.
"""

from __future__ import annotations

import os
import shutil
import sqlite3
import struct
from array import array
from collections import Counter
from collections.abc import Collection, Iterable, Iterator
from contextlib import closing, suppress
from pathlib import Path
from typing import Any, BinaryIO, NamedTuple
from urllib.parse import quote

import numpy as np

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.files.scratch import full_disk_told, scratch_directory
from mobilecal_cli.model.arrays import IntArray
from mobilecal_cli.readers.containers.storage import (
    EVERYTHING,
    LATEST_NS,
    WITHOUT_TIME,
    Extent,
    Message,
    Storage,
)
from mobilecal_cli.readers.messages import SIZE_LIMIT, Channel, ros2_spelling
from mobilecal_cli.readers.messages.types import LANGUAGES

MAGIC = b"SQLite format 3\x00"

#: In the header of the file: bytes per page, those of them that are reserved, change counter, number of pages, and the
#: change that this number is of.
_HEADER = struct.Struct(">16xH2xB3xII60xI")


class _Log(NamedTuple):
    """(n,) row numbers, topic ids, log times and bytes of all messages, in the order of the table."""

    row: IntArray
    channel: IntArray
    log_ns: IntArray
    size: IntArray


def _listed(rows: Iterable[tuple[Any, ...]]) -> tuple[_Log, Counter[int]]:
    """The log of rows with their sizes, and topic id → number of messages."""
    log = array("q")
    counts: Counter[int] = Counter()
    for row in rows:
        _, topic, time_ns, _ = row
        if not isinstance(topic, int):  # SQLite stores values of any type
            continue
        counts[topic] += 1
        if isinstance(time_ns, int) and time_ns < LATEST_NS:
            log.extend(value or 0 for value in row)
    return _Log(*np.array(log, dtype=np.int64).reshape(-1, 4).T.copy()), counts


class SqliteStorage(Storage):
    """One .db3 file.

    The file is opened immutable, so nothing is written next to it. If a killed recorder left a write-ahead log, it
    contains messages: both files are then copied to a temporary directory and joined there.
    """

    container = "rosbag2 SQLite"

    _pages: LeafPages | None = None

    def read(self) -> None:
        self._connection = self._connect()
        self._read_topics()
        self._check_size()
        self._scan()

    def _connect(self) -> sqlite3.Connection:
        log, options = self.path.with_name(f"{self.path.name}-wal"), "immutable=1"
        if log.is_file() and log.stat().st_size > 0:
            self.opened = self.files.enter_context(scratch_directory()) / self.path.name
            with full_disk_told():
                shutil.copyfile(self.path, self.opened)
                log = Path(shutil.copyfile(log, self.opened.with_name(log.name)))
            with closing(sqlite3.connect(self.opened)) as copy, suppress(sqlite3.Error):
                copy.execute("PRAGMA journal_mode=DELETE")  # moves what the log contains into the file
            options = "mode=rw" if log.exists() else options
        connection = sqlite3.connect(f"file:{quote(str(self.opened.absolute()))}?{options}", uri=True)
        self.files.callback(connection.close)
        connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, SIZE_LIMIT)
        connection.execute("PRAGMA trusted_schema=OFF")
        # Otherwise SQLite refuses a file that is shorter than its header states.
        connection.execute("PRAGMA writable_schema=ON")
        connection.text_factory = lambda raw: raw.decode(errors="replace")
        return connection

    def _check_size(self) -> None:
        """Note a file that is shorter than the pages that its header states."""
        with self.opened.open("rb") as stream:
            page, _, change, pages, counted_at = _HEADER.unpack(stream.read(_HEADER.size))
        whole = (65536 if page == 1 else page) * pages
        if change == counted_at and self.path == self.opened and whole > self.path.stat().st_size:
            self.note_share(whole)

    def _read_topics(self) -> None:
        tables = {
            row[0] for row in self._connection.execute("SELECT name FROM sqlite_master WHERE type='table'")
        }
        if not {"topics", "messages"} <= tables:
            raise RecordingError(
                f"{self.path}: an SQLite database, but not a rosbag2 recording (no tables topics and messages)",
                "give the .db3 file that ros2 bag record wrote",
            )
        definitions: dict[str, tuple[str, str]] = {}
        if "message_definitions" in tables:
            try:
                rows = self._connection.execute(
                    "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
                )
                definitions = {str(name): (str(encoding), str(text)) for name, encoding, text in rows}
            except sqlite3.Error as error:
                self.note(
                    f"the message definitions cannot be read ({error}); the common definitions are used"
                )
        for number, topic, name, encoding in self._connection.execute(
            "SELECT id, name, type, serialization_format FROM topics ORDER BY id"
        ):
            if not isinstance(number, int):  # SQLite stores values of any type
                self.note(f"topic {topic!r} has the invalid id {number!r}; skipped")
                continue
            language, text = definitions.get(str(name), ("", ""))
            kind = ros2_spelling(str(name))
            self.channels[number] = Channel(
                str(topic), kind, str(encoding), text.encode(), LANGUAGES.get(language, "")
            )

    def _scan(self) -> None:
        """Message counts, sizes and log times; where the table is damaged, those of the rows on its pages."""
        # SQLite reads only the length of large messages.
        select = "SELECT rowid, topic_id, timestamp, LENGTH(data) FROM messages ORDER BY rowid"
        try:
            self._log, self.counts = _listed(self._connection.execute(select))
        except (sqlite3.Error, OverflowError):
            self._pages = self._leaf_pages()
            self._log = _Log(*self._pages.rows[:, :4].T.copy())
            self.counts = Counter(self._log.channel.tolist())
            self.note(f"the message table is damaged: {self.counts.total()} messages are left")
        if len(self._log.row) < self.counts.total():
            self.note(WITHOUT_TIME)
        self._log.log_ns[:] += self.shifts_of(self._log.channel, self._log.log_ns)
        self.delay(0)

    def delay(self, shift_ns: int) -> None:
        if len(self._log.row):
            self._log.log_ns[:] += shift_ns
            self.shift_ns += shift_ns
            self.start_ns, self.end_ns = int(self._log.log_ns.min()), int(self._log.log_ns.max())

    def messages(self, topics: Collection[str], extent: Extent = EVERYTHING) -> Iterator[Message]:
        # Rows of other topics are not read, so a limit in bytes does not apply.
        read: Counter[int] = Counter()
        damaged = False
        rows, channels, times_ns, _ = (column.tolist() for column in self._read_of(topics, extent))
        for number, channel_id, time_ns in zip(rows, channels, times_ns, strict=True):
            data = self._data(number)
            if data is None:
                damaged = True
                continue
            read[channel_id] += 1
            yield Message(self.channels[channel_id], time_ns, data)
        if damaged:
            self.note(f"the message table is damaged: {read.total()} messages of the topics in use are left")
        if extent.at_ns is None:
            self.compare_counts(topics, read)

    def bytes_of(self, topics: Collection[str], extent: Extent = EVERYTHING) -> int:
        return int(self._read_of(topics, extent).size.sum())

    def log_times(self) -> IntArray:
        return np.stack([self._log.channel, self._log.log_ns])

    def _read_of(self, topics: Collection[str], extent: Extent) -> _Log:
        """The log of the messages that are read, in order of time."""
        log = self._log
        own = np.isin(log.channel, list(self.channels_of(topics)))
        if extent.at_ns is not None:
            own &= np.isin(log.log_ns, extent.at_ns)
        places = np.flatnonzero(own)
        places = places[np.argsort(log.log_ns[places], kind="stable")]
        return _Log(*(column[places] for column in log))

    def _leaf_pages(self) -> LeafPages:
        return LeafPages(self.files.enter_context(self.opened.open("rb")))

    def _data(self, row: int) -> bytes | None:
        """Data of a row, None if it is damaged; what SQLite does not find is on the table's pages."""
        if self._pages is None:
            with suppress(sqlite3.Error):
                select = "SELECT data FROM messages WHERE rowid = ?"
                for (data,) in self._connection.execute(select, (row,)):
                    return data if isinstance(data, bytes) else str(data).encode()
            self._pages = self._leaf_pages()
        return self._pages.data(row)


_LEAF = 13
_HEAD = struct.Struct(">BxxH")  # of a page: its kind, and the number of its rows
_MOST_ROWS = 2**48  # larger numbers of rows are damage
_BLOB = 12  # types of values from this on are data, or text
#: Type of an integer → its bytes; two types are those of 0 and 1.
_INTEGERS = {1: 1, 2: 2, 3: 3, 4: 4, 5: 6, 6: 8, 8: 0, 9: 0}
#: Further pages of all rows, as a multiple of the file's; more are those of rows that share pages, made to take time.
_MOST_SHARED = 10
#: What a damaged row raises.
_DAMAGE = (IndexError, KeyError, ValueError)


class LeafRow(NamedTuple):
    """A row (id, topic_id, timestamp, data) of a table of messages.

    Attributes:
        row: its number.
        channel: id of the topic.
        log_ns: its time.
        size: bytes of its data.
        begin, end: where the data on the leaf is in the file; if there is more, the next 4 bytes name a page.
    """

    row: int
    channel: int
    log_ns: int
    size: int
    begin: int
    end: int


class LeafPages:
    """An SQLite file that is read page by page.

    Attributes:
        rows: (n, 6) those whose pages are all in the file, as `LeafRow`, by their numbers.
    """

    def __init__(self, stream: BinaryIO) -> None:
        self._file = stream.fileno()
        size, reserved, *_ = _HEADER.unpack(self._read(0, _HEADER.size))
        self._size: int = 65536 if size == 1 else size
        self._usable: int = self._size - reserved
        self._end = os.fstat(self._file).st_size
        self._most_further = _MOST_SHARED * self._end // self._size
        whole = array("q")
        for begin in range(0, self._end, self._size):
            for row in self._rows_on(begin):
                if self._is_whole(row):
                    whole.extend(row)
        every = np.array(whole, dtype=np.int64).reshape(-1, len(LeafRow._fields))
        self.rows = every[np.unique(every[:, 0], return_index=True)[1]]

    def _read(self, begin: int, end: int) -> bytes:
        return os.pread(self._file, end - begin, begin)

    def data(self, number: int) -> bytes | None:
        """Data of a row, None if it is not there."""
        place = int(np.searchsorted(self.rows[:, 0], number))
        if place == len(self.rows) or self.rows[place, 0] != number:
            return None
        row = LeafRow(*self.rows[place].tolist())
        pieces, left = [self._read(row.begin, row.end)], row.size - (row.end - row.begin)
        for page in self._further_pages(row):
            pieces.append(self._read(page + 4, page + min(left + 4, self._usable)))
            left -= len(pieces[-1])
        return b"".join(pieces)

    def _is_whole(self, row: LeafRow) -> bool:
        """Whether all pages of a row are in the file."""
        for page in self._further_pages(row):
            self._most_further -= 1
            if not 0 <= page <= self._end - self._size or self._most_further < 0:
                return False
        return True

    def _further_pages(self, row: LeafRow) -> Iterator[int]:
        """Where the pages begin that continue a row."""
        at, left = row.end, row.size - (row.end - row.begin)
        for _ in range(-(-left // (self._usable - 4))):
            at = (int.from_bytes(self._read(at, at + 4)) - 1) * self._size
            yield at

    def _rows_on(self, begin: int) -> Iterator[LeafRow]:
        """Messages on a leaf page that begins at a byte of the file; none on another table's."""
        page = self._read(begin, begin + self._size)
        with suppress(struct.error):  # the page is cut, or its number of rows is damaged
            kind, count = _HEAD.unpack_from(page)
            if kind != _LEAF:
                return
            for at in struct.unpack_from(f">{count}H", page, 8):
                with suppress(*_DAMAGE):
                    yield self._row(page, at, begin)

    def _row(self, page: bytes, at: int, begin: int) -> LeafRow:
        """The row at a place of a page.

        Raises:
            Exception: see `_DAMAGE`; or it is no message.
        """
        size, at = _number(page, at)
        row, record = _number(page, at)
        head, at = _number(page, record)
        types = []
        for _ in range(4):
            kind, at = _number(page, at)
            types.append(kind)
        of_row, topic, time, data = types
        at = record + head
        channel, at = _integer(page, at, topic)
        log_ns, at = _integer(page, at, time)
        length = record + size - at
        end = record + self._on_leaf(size)
        is_message = of_row == 0 and data >= _BLOB and length == (data - _BLOB) // 2
        if not (is_message and 0 < row < _MOST_ROWS and length <= SIZE_LIMIT and at <= end <= len(page)):
            raise ValueError("not a message")
        return LeafRow(row, channel, log_ns, length, begin + at, begin + end)

    def _on_leaf(self, size: int) -> int:
        """Bytes of a record that are on its leaf."""
        least, most = (self._usable - 12) * 32 // 255 - 23, self._usable - 35
        if size <= most:
            return size
        here = least + (size - least) % (self._usable - 4)
        return here if here <= most else least


def _number(page: bytes, at: int) -> tuple[int, int]:
    """A number of 1 to 9 bytes at a place of a page, and the place after it."""
    value = 0
    for _ in range(8):
        byte = page[at]
        at += 1
        value = value << 7 | byte & 0x7F
        if byte < 0x80:
            return value, at
    return value << 8 | page[at], at + 1


def _integer(page: bytes, at: int, kind: int) -> tuple[int, int]:
    """An integer of a type at a place of a page, and the place after it."""
    end = at + _INTEGERS[kind]
    return (int.from_bytes(page[at:end], signed=True) if end > at else kind - 8), end
