"""rosbag2's sqlite3 files (.db3), whole or damaged."""

from __future__ import annotations

import shutil
import sqlite3
from collections import Counter
from collections.abc import Collection, Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from urllib.parse import quote

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.readers.channels import Channel, DefinitionFormat, ros2_spelling
from mobilecal_cli.readers.compression import message_payload
from mobilecal_cli.readers.storage import RawMessage, Storage

MAGIC = b"SQLite format 3\x00"

#: Log time and row number: where a row stands in either order.
_Key = tuple[int, int]

_FORMATS: dict[str, DefinitionFormat] = {"ros2msg": "msg", "ros2idl": "idl"}


class SqliteStorage(Storage):
    """One .db3 file.

    The file is opened immutable, so nothing is ever written beside it. A write-ahead log that a killed recorder
    left behind holds messages: both are then copied to a temporary directory and read there.
    """

    def __init__(self, path: Path) -> None:
        super().__init__(path)
        self._copies: TemporaryDirectory[str] | None = None
        self._connection: sqlite3.Connection | None = None
        try:
            self._connection = self._connect(path)
            # Without it sqlite refuses a file that is shorter than its header says.
            self._connection.execute("PRAGMA writable_schema=ON")
            self._read_topics(self._connection)
        except BaseException:
            self.close()
            raise
        self._count(self._connection)

    def _connect(self, path: Path) -> sqlite3.Connection:
        log = path.with_name(f"{path.name}-wal")
        options = "immutable=1"
        if log.is_file() and log.stat().st_size > 0:
            self._copies = TemporaryDirectory(prefix="mobilecal-")
            folder = Path(self._copies.name)
            shutil.copyfile(path, folder / path.name)
            shutil.copyfile(log, folder / log.name)
            path, options = folder / path.name, "mode=rw"
        connection = sqlite3.connect(f"file:{quote(str(path.absolute()))}?{options}", uri=True)
        connection.text_factory = lambda raw: raw.decode(errors="replace")
        return connection

    def close(self) -> None:
        """Release the file."""
        if self._connection is not None:
            self._connection.close()
        if self._copies is not None:
            self._copies.cleanup()

    def _read_topics(self, connection: sqlite3.Connection) -> None:
        tables = {row[0] for row in connection.execute("SELECT name FROM sqlite_master WHERE type='table'")}
        if not {"topics", "messages"} <= tables:
            raise RecordingError(
                f"{self.path}: an SQLite database, but not a rosbag2 recording (no tables topics and messages)",
                "name the .db3 file that ros2 bag record wrote",
            )
        definitions: dict[str, tuple[str, str]] = {}
        if "message_definitions" in tables:
            try:
                rows = connection.execute(
                    "SELECT topic_type, encoding, encoded_message_definition FROM message_definitions"
                )
                definitions = {name: (encoding, text) for name, encoding, text in rows}
            except sqlite3.Error as error:
                self.note(f"the message definitions cannot be read ({error}); the common ones are used")
        for number, topic, name, encoding in connection.execute(
            "SELECT id, name, type, serialization_format FROM topics ORDER BY id"
        ):
            language, text = definitions.get(name, ("", ""))
            self.channels[number] = Channel(
                number,
                topic,
                ros2_spelling(name),
                encoding,
                text or "",
                _FORMATS.get(language, ""),
            )

    def _count(self, connection: sqlite3.Connection) -> None:
        """Counts and times; a damaged table leaves them unknown."""
        try:
            rows = connection.execute(
                "SELECT topic_id, COUNT(*), MIN(timestamp), MAX(timestamp) FROM messages GROUP BY topic_id"
            ).fetchall()
        except sqlite3.Error:
            return  # noted when the messages are read
        self.counts = {number: count for number, count, _, _ in rows}
        if rows:
            self.start_ns = min(row[2] for row in rows)
            self.end_ns = max(row[3] for row in rows)

    def raw(self, topics: Collection[str]) -> Iterator[RawMessage]:
        """Messages of the topics in order of log time, as far as the table can be read."""
        connection = self._connection
        wanted = [number for number, channel in self.channels.items() if channel.topic in topics]
        if connection is None or not wanted:
            return
        seen: Counter[int] = Counter()
        order = self._order(connection)
        among = f"topic_id IN ({','.join(map(str, wanted))})"  # integers from the file's own table
        last: _Key | None = None
        try:
            rows = connection.execute(
                f"SELECT id, topic_id, timestamp, data FROM messages WHERE {among} ORDER BY {order}"
            )
            for row, number, time_ns, payload in rows:
                last = (time_ns, row)
                seen[number] += 1
                yield self.channels[number], time_ns, self._payload(number, payload)
        except sqlite3.Error:
            for number, time_ns, payload in self._one_by_one(connection, among, order, last):
                seen[number] += 1
                yield self.channels[number], time_ns, self._payload(number, payload)
            self.note(f"the table of messages is damaged; {sum(seen.values())} messages in use could be read")
        self.compare_counts(topics, seen)

    def _one_by_one(
        self, connection: sqlite3.Connection, among: str, order: str, last: _Key | None
    ) -> Iterator[tuple[int, int, object]]:
        """The rows behind `last`, each by itself: a row whose payload is damaged costs only itself."""
        key = "id" if order == "id" else "(timestamp, id)"
        place = "?" if order == "id" else "(?, ?)"
        while True:
            after = f"AND {key} > {place}" if last else ""
            values = () if last is None else (last[1:] if order == "id" else last)
            try:
                found = connection.execute(
                    f"SELECT id, topic_id, timestamp FROM messages WHERE {among} {after} ORDER BY {order} LIMIT 1",
                    values,
                ).fetchone()
            except sqlite3.Error:
                return
            if found is None:
                return
            row, number, time_ns = found
            last = (time_ns, row)
            try:
                (payload,) = connection.execute("SELECT data FROM messages WHERE id = ?", (row,)).fetchone()
            except (sqlite3.Error, TypeError):
                continue
            yield number, time_ns, payload

    def _payload(self, number: int, payload: object) -> bytes:
        data = payload if isinstance(payload, bytes) else str(payload).encode()
        if self.channels[number].encoding != "cdr":
            return data
        try:
            return bytes(message_payload(data))
        except Exception:  # a damaged frame: the message is found undecodable where it is used
            return data

    def _order(self, connection: sqlite3.Connection) -> str:
        """By time where an index gives it without sorting in memory and is whole; else as written."""
        if self.counts is None:
            return "id"
        for _, name, *_ in connection.execute("PRAGMA index_list(messages)").fetchall():
            columns = [row[2] for row in connection.execute(f'PRAGMA index_info("{name}")')]
            if columns[:1] == ["timestamp"]:
                return "timestamp, id"
        return "id"
