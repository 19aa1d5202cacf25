"""rosbag2 sqlite3 files (.db3), intact or damaged."""

from __future__ import annotations

import shutil
import sqlite3
import struct
from array import array
from collections import Counter
from collections.abc import Collection, Iterable, Iterator
from contextlib import ExitStack, closing, suppress
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote

import numpy as np

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.files.scratch import full_disk_told, scratch_directory
from mobilecal_cli.model import IntArray
from mobilecal_cli.readers.containers.sqlite_pages import LeafPages
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

#: In the header of the file: bytes per page, change counter, number of pages, and the change that this number is of.
_HEADER = struct.Struct(">16xH6xII60xI")


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

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._copies = ExitStack()
        self._pages: LeafPages | None = None
        try:
            self._connection = self._connect(path)
            self._read_topics()
            self._check_size()
        except BaseException:
            self.close()
            raise
        self._scan()

    def _connect(self, path: Path) -> sqlite3.Connection:
        log, options = path.with_name(f"{path.name}-wal"), "immutable=1"
        if log.is_file() and log.stat().st_size > 0:
            self.opened = self._copies.enter_context(scratch_directory()) / path.name
            with full_disk_told():
                shutil.copyfile(path, self.opened)
                log = Path(shutil.copyfile(log, self.opened.with_name(log.name)))
            with closing(sqlite3.connect(self.opened)) as copy, suppress(sqlite3.Error):
                copy.execute("PRAGMA journal_mode=DELETE")  # moves what the log contains into the file
            options = "mode=rw" if log.exists() else options
        connection = sqlite3.connect(f"file:{quote(str(self.opened.absolute()))}?{options}", uri=True)
        self._copies.callback(connection.close)
        connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, SIZE_LIMIT)
        connection.execute("PRAGMA trusted_schema=OFF")
        # Otherwise SQLite refuses a file that is shorter than its header states.
        connection.execute("PRAGMA writable_schema=ON")
        connection.text_factory = lambda raw: raw.decode(errors="replace")
        return connection

    def _check_size(self) -> None:
        """Note a file that is shorter than the pages that its header states."""
        with self.opened.open("rb") as stream:
            page, change, pages, counted_at = _HEADER.unpack(stream.read(_HEADER.size))
        whole = (65536 if page == 1 else page) * pages
        if change == counted_at and self.path == self.opened and whole > self.path.stat().st_size:
            self.note_share(whole)

    def close(self) -> None:
        self._copies.close()

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
        return LeafPages(self._copies.enter_context(self.opened.open("rb")))

    def _data(self, row: int) -> bytes | None:
        """Data of a row, None if it is damaged; what SQLite does not find is on the table's pages."""
        if self._pages is None:
            with suppress(sqlite3.Error):
                select = "SELECT data FROM messages WHERE rowid = ?"
                for (data,) in self._connection.execute(select, (row,)):
                    return data if isinstance(data, bytes) else str(data).encode()
            self._pages = self._leaf_pages()
        return self._pages.data(row)
