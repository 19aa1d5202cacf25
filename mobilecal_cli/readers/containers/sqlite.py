"""rosbag2 sqlite3 files (.db3), intact or damaged."""

from __future__ import annotations

import shutil
import sqlite3
import struct
from array import array
from bisect import bisect_right
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Sequence
from contextlib import ExitStack, closing, suppress
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import quote

import numpy as np

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.files.scratch import enter_scratch, full_disk_told
from mobilecal_cli.model import IntArray
from mobilecal_cli.readers.containers.sqlite_tree import Leaf, link, message_leaves
from mobilecal_cli.readers.containers.storage import (
    EVERYTHING,
    SIZE_LIMIT,
    ZSTD_MAGIC,
    Extent,
    Message,
    Storage,
    message_payload,
)
from mobilecal_cli.readers.messages import Channel, ros2_spelling
from mobilecal_cli.readers.messages.types import LANGUAGES

MAGIC = b"SQLite format 3\x00"

#: In the header of the file: bytes per page, change counter, number of pages, and the change that this number is of.
_HEADER = struct.Struct(">16xH6xII60xI")
#: Consecutive damaged or missing rows after which the search ends.
MOST_FAILURES = 10_000
#: Rows per query; older versions of SQLite accept 999 values at most.
_BATCH = 500
_SELECT = "SELECT id, topic_id, timestamp, {} FROM messages"


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
        if isinstance(time_ns, int):
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
            self.opened = enter_scratch(self._copies) / path.name
            with full_disk_told():
                shutil.copyfile(path, self.opened)
                log = Path(shutil.copyfile(log, self.opened.with_name(log.name)))
            with closing(sqlite3.connect(self.opened)) as copy, suppress(sqlite3.Error):
                copy.execute("PRAGMA journal_mode=DELETE")  # moves what the log contains into the file
            options = "mode=rw" if log.exists() else options
        return self._open(options)

    def _open(self, options: str) -> sqlite3.Connection:
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
        """Message counts, sizes and log times; of the rows that can be read one by one if the table is damaged."""
        select = _SELECT.format("LENGTH(data)")  # SQLite reads only the length of large messages
        try:
            log, counts = _listed(self._connection.execute(f"{select} ORDER BY id"))
        except (sqlite3.Error, OverflowError):
            leaves, cut = message_leaves(self.opened)
            # SQLite reads what is missing of a page that is cut as zeros.
            last = leaves[-1].last_row if leaves and cut else None
            log, counts = self._of_readable(select, last)
            if sum(leaf.rows for leaf in leaves) > counts.total():
                self._relink(leaves)
                log, counts = self._of_readable(select, last)
            self.note(f"the message table is damaged; {counts.total()} messages could be read")
        self.counts = counts
        log.log_ns[:] += self.shifts_of(log.channel, log.log_ns)
        self._log = log
        self.delay(0)

    def _of_readable(self, select: str, last: int | None) -> tuple[_Log, Counter[int]]:
        """See `_listed`; of the rows of a damaged table that can be read one by one, up to the last whole one."""
        rows = self._rows(self._every_row(), select)
        return _listed(row for row in rows if row is not None and (last is None or row[0] <= last))

    def _relink(self, leaves: Sequence[Leaf]) -> None:
        """Go on with a copy of a file that has leaves which its tree does not reach."""
        (root,) = self._connection.execute(
            "SELECT rootpage FROM sqlite_master WHERE type='table' AND name='messages'"
        ).fetchone()
        copy = enter_scratch(self._copies) / self.path.name
        with full_disk_told():
            shutil.copyfile(self.opened, copy)
            link(copy, root, leaves)
        self._connection.close()
        self.opened = copy
        self._connection = self._open("immutable=1")

    def delay(self, shift_ns: int) -> None:
        if len(self._log.row):
            self._log.log_ns[:] += shift_ns
            self.shift_ns += shift_ns
            self.start_ns, self.end_ns = int(self._log.log_ns.min()), int(self._log.log_ns.max())

    def messages(self, topics: Collection[str], extent: Extent = EVERYTHING) -> Iterator[Message]:
        # Rows of other topics are not read, so a limit in bytes does not apply.
        read: Counter[int] = Counter()
        damaged = False
        wanted = self.channels_of(topics)
        for fetched in self._rows(self._batches(wanted, extent), _SELECT.format("data")):
            if fetched is None:
                damaged = True
                continue
            row, number, time_ns, payload = fetched
            if number in wanted and isinstance(time_ns, int):
                read[number] += 1
                channel = self.channels[number]
                data = payload if isinstance(payload, bytes) else str(payload).encode()
                if channel.encoding == "cdr" and data.startswith(ZSTD_MAGIC):
                    # A damaged frame: the message is reported as undecodable on use.
                    with suppress(Exception):
                        data = message_payload(data)
                # With the steps of the recorder's clock undone.
                yield Message(channel, int(self._log.log_ns[np.searchsorted(self._log.row, row)]), data)
        if damaged:
            self.note(
                f"the message table is damaged; {read.total()} messages of the topics in use could be read"
            )
        if extent.at_ns is None:
            self.compare_counts(topics, read)

    def bytes_of(self, topics: Collection[str], extent: Extent = EVERYTHING) -> int:
        return int(self._log.size[self._places(self.channels_of(topics), extent)].sum())

    def log_times(self) -> IntArray:
        return np.stack([self._log.channel, self._log.log_ns])

    def _places(self, wanted: set[int], extent: Extent) -> IntArray:
        """Places in the log of the messages that are read, in order of time."""
        log = self._log
        own = np.isin(log.channel, list(wanted))
        if extent.at_ns is not None:
            own &= np.isin(log.log_ns, extent.at_ns)
        places = np.flatnonzero(own)
        return np.asarray(places[np.argsort(log.log_ns[places], kind="stable")])

    def _every_row(self) -> Iterator[list[int]]:
        """Increasing row numbers of all rows that a damaged table may have."""
        try:
            (end,) = self._connection.execute("SELECT MAX(id) FROM messages").fetchone()
        except sqlite3.Error:
            end = 2**62
        every = range(1, (end or 0) + 1)
        yield from (list(every[at : at + _BATCH]) for at in range(0, len(every), _BATCH))

    def _batches(self, wanted: set[int], extent: Extent) -> Iterator[list[int]]:
        """Increasing row numbers in the order of reading."""
        rows = self._log.row[self._places(wanted, extent)]
        for run in np.split(rows, np.flatnonzero(np.diff(rows) < 0) + 1):
            yield from (run[at : at + _BATCH].tolist() for at in range(0, len(run), _BATCH))

    def _rows(self, batches: Iterable[list[int]], select: str) -> Iterator[tuple[Any, ...] | None]:
        """What is selected of the rows that can be read; None for a damaged one.

        A damaged page costs only the rows on it. The pass ends after many consecutive damaged or missing rows.
        """
        failures = 0
        for batch in batches:
            left = batch
            try:
                places = ",".join("?" * len(batch))
                for row in self._connection.execute(f"{select} WHERE id IN ({places}) ORDER BY id", batch):
                    yield row
                    left = batch[bisect_right(batch, row[0]) :]
                failures = failures + len(left) if left is batch else 0
            except sqlite3.Error:
                for number in left:
                    fetched = None
                    with suppress(sqlite3.Error):
                        fetched = self._connection.execute(f"{select} WHERE id = ?", (number,)).fetchone()
                    yield fetched
                    failures = 0 if fetched else failures + 1
            if failures >= MOST_FAILURES:
                return
