"""rosbag2 sqlite3 files (.db3), intact or damaged."""

from __future__ import annotations

import shutil
import sqlite3
import struct
from array import array
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from contextlib import ExitStack, closing, suppress
from functools import cached_property
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model import IntArray
from mobilecal_cli.readers.containers.compression import message_payload
from mobilecal_cli.readers.containers.steps import goes_back, steps_back
from mobilecal_cli.readers.containers.storage import EVERYTHING, SIZE_LIMIT, Extent, RawMessage, Storage
from mobilecal_cli.readers.messages.channels import Channel, ros2_spelling
from mobilecal_cli.readers.messages.definitions import DefinitionFormat
from mobilecal_cli.scratch import full_disk_told, scratch_directory

MAGIC = b"SQLite format 3\x00"

#: In the header of the file: bytes per page, change counter, number of pages, and the change that this number is of.
_HEADER = struct.Struct(">16xH6xII60xI")
#: Consecutive damaged or missing rows after which the search ends.
MOST_FAILURES = 10_000
#: Log time and row number: the position of a row in either order.
_Key = tuple[int, int]

_FORMATS: dict[str, DefinitionFormat] = {"ros2msg": "msg", "ros2idl": "idl"}


class SqliteStorage(Storage):
    """One .db3 file.

    The file is opened immutable, so nothing is written next to it. If a killed recorder left a write-ahead log, it
    contains messages: both files are then copied to a temporary directory and joined there.
    """

    container = "rosbag2 SQLite"

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._copies = ExitStack()
        self._connection: sqlite3.Connection | None = None
        #: Topic id → bytes of its messages, stored.
        self._bytes: dict[int, int] = {}
        #: Row, topic id and log time of each message, in the order of the table; None if it is damaged.
        self._log: tuple[IntArray, IntArray, IntArray] | None = None
        #: First row after each step of the recorder's clock, and the size of the step.
        self._steps: list[tuple[int, int]] = []
        try:
            self._connection = self._connect(path)
            # Otherwise SQLite refuses a file that is shorter than its header states.
            self._connection.execute("PRAGMA writable_schema=ON")
            self._read_topics(self._connection)
            self._check_size()
        except BaseException:
            self.close()
            raise
        self._scan(self._connection)

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
        connection.setlimit(sqlite3.SQLITE_LIMIT_LENGTH, SIZE_LIMIT)
        connection.execute("PRAGMA trusted_schema=OFF")
        connection.text_factory = lambda raw: raw.decode(errors="replace")
        return connection

    def _check_size(self) -> None:
        """Note a file that is shorter than the pages that its header states."""
        with self.opened.open("rb") as stream:
            header = stream.read(_HEADER.size)
        if len(header) == _HEADER.size:
            page, change, pages, counted_at = _HEADER.unpack(header)
            whole = (65536 if page == 1 else page) * pages
            if change == counted_at and self.path == self.opened and whole > self.path.stat().st_size:
                self.note_share(whole)

    def close(self) -> None:
        """Close the file."""
        if self._connection is not None:
            self._connection.close()
        self._copies.close()

    def _read_topics(self, connection: sqlite3.Connection) -> None:
        tables = {row[0] for row in connection.execute("SELECT name FROM sqlite_master WHERE type='table'")}
        if not {"topics", "messages"} <= tables:
            raise RecordingError(
                f"{self.path}: an SQLite database, but not a rosbag2 recording (no tables topics and messages)",
                "give the .db3 file that ros2 bag record wrote",
            )
        definitions: dict[str, tuple[str, str]] = {}
        if "message_definitions" in tables:
            try:
                rows = connection.execute(
                    "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
                )
                definitions = {str(name): (str(encoding), str(text)) for name, encoding, text in rows}
            except sqlite3.Error as error:
                self.note(
                    f"the message definitions cannot be read ({error}); the common definitions are used"
                )
        for number, topic, name, encoding in connection.execute(
            "SELECT id, name, type, serialization_format FROM topics ORDER BY id"
        ):
            if not isinstance(number, int):  # SQLite stores values of any type
                self.note(f"topic {topic!r} has the invalid id {number!r}; skipped")
                continue
            language, text = definitions.get(str(name), ("", ""))
            self.channels[number] = Channel(
                number,
                str(topic),
                ros2_spelling(str(name)),
                str(encoding),
                text,
                _FORMATS.get(language, ""),
            )

    def _scan(self, connection: sqlite3.Connection) -> None:
        """Message counts, sizes and log times; unknown if the table is damaged."""
        columns = [array("q") for _ in range(4)]
        counts: Counter[int] = Counter()
        try:
            # SQLite reads only the length of large messages.
            for row in connection.execute(
                "SELECT id, topic_id, timestamp, LENGTH(data) FROM messages ORDER BY id"
            ):
                _, topic, time_ns, _ = row
                if not isinstance(topic, int):  # SQLite stores values of any type
                    continue
                counts[topic] += 1
                if isinstance(time_ns, int):
                    for column, value in zip(columns, row, strict=True):
                        column.append(value or 0)
        except (sqlite3.Error, OverflowError):
            return  # noted when the messages are read
        rows, topics, log_ns, sizes = (np.array(column, dtype=np.int64) for column in columns)
        for number in np.unique(topics).tolist():
            self._bytes[number] = int(sizes[topics == number].sum())
        self.counts = dict(counts)
        steps = steps_back(topics, log_ns) if goes_back(topics, log_ns) else []
        for first, size_ns in steps:
            log_ns[first:] += size_ns
            self._steps.append((int(rows[first]), size_ns))
        self.note_steps([size_ns for _, size_ns in steps])
        self._log = rows, topics, log_ns
        if len(log_ns):
            self.start_ns, self.end_ns = int(log_ns.min()), int(log_ns.max())

    def _shift_ns(self, row: int) -> int:
        """What the log time of a row is later than stored, because the recorder's clock stepped back."""
        return sum(size_ns for first, size_ns in self._steps if first <= row)

    def raw(self, topics: Collection[str], extent: Extent = EVERYTHING) -> Iterator[RawMessage]:
        """Messages of the topics in order of log time, as far as the table can be read.

        Rows of other topics are not read, so a limit in bytes does not apply.
        """
        connection, wanted = self._connection, self._wanted(topics)
        if connection is None or not wanted:
            return
        seen: Counter[int] = Counter()
        last: _Key | None = None
        try:
            for row, number, time_ns, payload in self._rows(connection, "data", wanted, extent):
                if isinstance(time_ns, int):  # a damaged row may contain anything
                    last = (time_ns, row)
                    seen[number] += 1
                    yield self.channels[number], time_ns + self._shift_ns(row), self._payload(number, payload)
        except sqlite3.Error:
            for row, number, time_ns, payload in _row_by_row(connection, self._order, last):
                if number in wanted:
                    seen[number] += 1
                    yield self.channels[number], time_ns + self._shift_ns(row), self._payload(number, payload)
            self.note(
                f"the message table is damaged; {sum(seen.values())} messages of the topics in use could be read"
            )
        if extent.at_ns is None:
            self.compare_counts(topics, seen)

    def bytes_of(self, topics: Collection[str], extent: Extent = EVERYTHING) -> int:
        """Number of bytes that `raw` reads: the messages, or the whole file if the table is damaged."""
        wanted = self._wanted(topics)
        if self._connection is None or not wanted:
            return 0
        if self._log is None:
            return self.path.stat().st_size
        if extent.at_ns is None:
            return sum(self._bytes.get(number, 0) for number in wanted)
        return sum(size or 0 for *_, size in self._rows(self._connection, "LENGTH(data)", wanted, extent))

    def near(self, topics: Collection[str], times_ns: Sequence[int]) -> Iterator[RawMessage]:
        """First message of each topic at or after each time."""
        if self._connection is None or self._log is None:
            return
        rows, channel, log_ns = self._log
        own = [np.flatnonzero(channel == number) for number in self._wanted(topics)]
        for time_ns in times_ns:
            for places in own:
                later = places[log_ns[places] >= time_ns]
                if not len(later):
                    continue
                first = later[np.argmin(log_ns[later])]
                with suppress(sqlite3.Error):  # a damaged page
                    (payload,) = self._connection.execute(
                        "SELECT data FROM messages WHERE id = ?", (int(rows[first]),)
                    ).fetchone()
                    number = int(channel[first])
                    yield self.channels[number], int(log_ns[first]), self._payload(number, payload)

    def log_times(self) -> dict[int, IntArray]:
        """Topic id → (n,) log times in table order; empty if the table is damaged."""
        if self._log is None:
            return {}
        _, channel, log_ns = self._log
        return {number: log_ns[channel == number] for number in self._bytes}

    def _wanted(self, topics: Collection[str]) -> list[int]:
        return [number for number, channel in self.channels.items() if channel.topic in topics]

    def _payload(self, number: int, payload: object) -> bytes:
        data = payload if isinstance(payload, bytes) else str(payload).encode()
        if self.channels[number].encoding != "cdr":
            return data
        try:
            return bytes(message_payload(data))
        except Exception:  # a damaged frame; the message is reported as undecodable on use
            return data

    @cached_property
    def _order(self) -> str:
        """Order of rows: by time if an intact index gives it without sorting in memory, otherwise as written."""
        if self._connection is None or self.counts is None or self._steps:
            return "id"
        for _, name, *_ in self._connection.execute("PRAGMA index_list(messages)").fetchall():
            columns = [row[2] for row in self._connection.execute(f'PRAGMA index_info("{name}")')]
            if columns[:1] == ["timestamp"]:
                return "timestamp, id"
        return "id"

    def _rows(
        self, connection: sqlite3.Connection, what: str, wanted: Sequence[int], extent: Extent
    ) -> Iterator[tuple[Any, ...]]:
        """Row number, topic, time and another column of the rows of some topics, in order."""
        select = f"SELECT id, topic_id, timestamp, {what} FROM messages WHERE"
        if extent.at_ns is None or self._log is None:
            places = ",".join("?" * len(wanted))
            yield from connection.execute(f"{select} topic_id IN ({places}) ORDER BY {self._order}", wanted)
            return
        rows, channel, log_ns = self._log
        own = np.flatnonzero(np.isin(log_ns, extent.at_ns) & np.isin(channel, wanted))
        for row in rows[own[np.argsort(log_ns[own], kind="stable")]].tolist():
            yield from connection.execute(f"{select} id = ?", (row,))


def _row_by_row(
    connection: sqlite3.Connection, order: str, last: _Key | None
) -> Iterator[tuple[int, int, int, object]]:
    """Row number, topic, time and payload of the rows after `last`, each looked up by its number.

    A damaged page then costs only the rows on it, whatever the topics. The pass ends at the last row, or after many
    consecutive damaged rows if the number of the last row is also lost.
    """
    try:
        (end,) = connection.execute("SELECT MAX(id) FROM messages").fetchone()
    except sqlite3.Error:
        end = 2**63
    row = last[1] if last and order == "id" else 0
    failures = 0
    while row < end and failures < MOST_FAILURES:
        row += 1
        try:
            found = connection.execute(
                "SELECT id, topic_id, timestamp, data FROM messages WHERE id = ?", (row,)
            ).fetchone()
        except sqlite3.Error:
            found = None
        if found and not isinstance(found[2], int):
            found = None  # damage that the lookup did not detect
        failures = 0 if found else failures + 1
        if found and (last is None or order == "id" or (found[2], row) > last):
            yield found
