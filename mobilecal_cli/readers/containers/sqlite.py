"""rosbag2 sqlite3 files (.db3), intact or damaged."""

from __future__ import annotations

import shutil
import sqlite3
import struct
from array import array
from collections import Counter
from collections.abc import Collection, Iterator, Sequence
from contextlib import ExitStack, closing, suppress
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model import IntArray
from mobilecal_cli.readers.containers.compression import message_payload
from mobilecal_cli.readers.containers.storage import EVERYTHING, SIZE_LIMIT, Extent, RawMessage, Storage
from mobilecal_cli.readers.messages.channels import Channel, ros2_spelling
from mobilecal_cli.readers.messages.definitions import DefinitionFormat
from mobilecal_cli.scratch import full_disk_told, scratch_directory

MAGIC = b"SQLite format 3\x00"

#: In the header of the file: bytes per page, change counter, number of pages, and the change that this number is of.
_HEADER = struct.Struct(">16xH6xII60xI")
#: Consecutive damaged or missing rows after which the search ends.
MOST_FAILURES = 10_000
#: Log times per query; older versions of SQLite accept 999 values at most.
_TIMES_AT_ONCE = 500
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
        self._size_of: dict[int, int] | None = None
        try:
            self._connection = self._connect(path)
            # Otherwise SQLite refuses a file that is shorter than its header states.
            self._connection.execute("PRAGMA writable_schema=ON")
            self._read_topics(self._connection)
            self._check_size()
        except BaseException:
            self.close()
            raise
        self._count(self._connection)

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

    def _count(self, connection: sqlite3.Connection) -> None:
        """Message counts and times; unknown if the table is damaged."""
        try:
            rows = connection.execute(
                "SELECT topic_id, COUNT(*), MIN(timestamp), MAX(timestamp) FROM messages GROUP BY topic_id"
            ).fetchall()
        except sqlite3.Error:
            return  # noted when the messages are read
        self.counts = {number: count for number, count, _, _ in rows}
        times = [
            time_ns for _, _, first, last in rows for time_ns in (first, last) if isinstance(time_ns, int)
        ]
        if times:
            self.start_ns, self.end_ns = min(times), max(times)

    def raw(self, topics: Collection[str], extent: Extent = EVERYTHING) -> Iterator[RawMessage]:
        """Messages of the topics in order of log time, as far as the table can be read.

        Rows of other topics are not read, so a limit in bytes does not apply. Log times are looked up in the index, if
        there is one; damage to it may go unnoticed.
        """
        connection = self._connection
        wanted = [number for number, channel in self.channels.items() if channel.topic in topics]
        if connection is None or not wanted:
            return
        seen: Counter[int] = Counter()
        order = self._order(connection)
        last: _Key | None = None
        try:
            for row, number, time_ns, payload in _rows(connection, "data", wanted, order, extent):
                if isinstance(time_ns, int):  # a damaged row may contain anything
                    last = (time_ns, row)
                    seen[number] += 1
                    yield self.channels[number], time_ns, self._payload(number, payload)
        except sqlite3.Error:
            for number, time_ns, payload in _row_by_row(connection, order, last):
                if number in wanted:
                    seen[number] += 1
                    yield self.channels[number], time_ns, self._payload(number, payload)
            self.note(
                f"the message table is damaged; {sum(seen.values())} messages of the topics in use could be read"
            )
        if extent.at_ns is None:
            self.compare_counts(topics, seen)

    def bytes_of(self, topics: Collection[str], extent: Extent = EVERYTHING) -> int:
        """Number of bytes that `raw` reads: the messages, or the whole file if the table is damaged."""
        connection = self._connection
        wanted = [number for number, channel in self.channels.items() if channel.topic in topics]
        if connection is None or not wanted:
            return 0
        try:
            if extent.at_ns is None:
                return sum(self._sizes(connection).get(number, 0) for number in wanted)
            rows = _rows(connection, "LENGTH(data)", wanted, self._order(connection), extent)
            return sum(size or 0 for *_, size in rows)
        except sqlite3.Error:
            return self.path.stat().st_size

    def _sizes(self, connection: sqlite3.Connection) -> dict[int, int]:
        """Topic id → bytes of its messages, stored. SQLite reads only the length of large ones."""
        if self._size_of is None:
            # Summed here, because SQLite would load whole messages to group them.
            found: Counter[int] = Counter()
            for number, size in connection.execute("SELECT topic_id, LENGTH(data) FROM messages"):
                found[number] += size or 0
            self._size_of = dict(found)
        return self._size_of

    def near(self, topics: Collection[str], times_ns: Sequence[int]) -> Iterator[RawMessage]:
        """First message of each topic at or after each time."""
        connection = self._connection
        if connection is None:
            return
        order = self._order(connection)
        for time_ns in times_ns:
            for number in [number for number, channel in self.channels.items() if channel.topic in topics]:
                try:
                    found = connection.execute(
                        "SELECT timestamp, data FROM messages WHERE topic_id = ? AND timestamp >= ? "
                        f"ORDER BY {order} LIMIT 1",
                        (number, time_ns),
                    ).fetchone()
                except sqlite3.Error:  # a damaged page
                    continue
                if found is not None and isinstance(found[0], int):
                    yield self.channels[number], found[0], self._payload(number, found[1])

    def log_times(self) -> dict[int, IntArray]:
        """Topic id → (n,) log times in table order; empty if the table is damaged."""
        times: dict[int, array[int]] = {}
        if self._connection is None:
            return {}
        try:
            for number, time_ns in self._connection.execute(
                "SELECT topic_id, timestamp FROM messages ORDER BY id"
            ):
                times.setdefault(number, array("q")).append(time_ns)
        except (sqlite3.Error, TypeError, OverflowError):
            return {}
        return {number: np.array(values, dtype=np.int64) for number, values in times.items()}

    def _payload(self, number: int, payload: object) -> bytes:
        data = payload if isinstance(payload, bytes) else str(payload).encode()
        if self.channels[number].encoding != "cdr":
            return data
        try:
            return bytes(message_payload(data))
        except Exception:  # a damaged frame; the message is reported as undecodable on use
            return data

    def _order(self, connection: sqlite3.Connection) -> str:
        """Order of rows: by time if an intact index gives it without sorting in memory, otherwise as written."""
        if self.counts is None:
            return "id"
        for _, name, *_ in connection.execute("PRAGMA index_list(messages)").fetchall():
            columns = [row[2] for row in connection.execute(f'PRAGMA index_info("{name}")')]
            if columns[:1] == ["timestamp"]:
                return "timestamp, id"
        return "id"


def _rows(
    connection: sqlite3.Connection, what: str, wanted: Sequence[int], order: str, extent: Extent
) -> Iterator[tuple[Any, ...]]:
    """Row number, topic, time and another column of the rows of some topics, in order."""
    select = (
        f"SELECT id, topic_id, timestamp, {what} FROM messages WHERE topic_id IN ({_places(len(wanted))})"
    )
    if extent.at_ns is None or order == "id":
        yield from connection.execute(f"{select} ORDER BY {order}", wanted)
        return
    for begin in range(0, len(extent.at_ns), _TIMES_AT_ONCE):
        times = extent.at_ns[begin : begin + _TIMES_AT_ONCE].tolist()
        at_times = f"{select} AND timestamp IN ({_places(len(times))}) ORDER BY {order}"
        yield from connection.execute(at_times, [*wanted, *times])


def _places(count: int) -> str:
    return ",".join("?" * count)


def _row_by_row(
    connection: sqlite3.Connection, order: str, last: _Key | None
) -> Iterator[tuple[int, int, object]]:
    """Topic, time and payload of the rows after `last`, each looked up by its number.

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
                "SELECT topic_id, timestamp, data FROM messages WHERE id = ?", (row,)
            ).fetchone()
        except sqlite3.Error:
            found = None
        if found and not isinstance(found[1], int):
            found = None  # damage that the lookup did not detect
        failures = 0 if found else failures + 1
        if found and (last is None or order == "id" or (found[1], row) > last):
            yield found
