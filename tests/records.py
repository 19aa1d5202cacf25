"""MCAP recordings, message by message: written, read, and written again with changes."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer


@dataclass(frozen=True)
class Record:
    """One message of an MCAP file.

    Attributes:
        topic, type: of its channel.
        definition: of its schema.
        time_ns: log time.
        data: its bytes.
        publish_ns: publish time.
        language: of the definition.
        encoding: of the data.
    """

    topic: str
    type: str
    definition: bytes
    time_ns: int
    data: bytes
    publish_ns: int = 0
    language: str = "ros2msg"
    encoding: str = "cdr"


def records_of(path: Path) -> Iterator[Record]:
    """All messages in order of log time."""
    with path.open("rb") as stream:
        for schema, channel, m in make_reader(stream).iter_messages():
            assert schema is not None
            kinds = schema.encoding, channel.message_encoding
            yield Record(channel.topic, schema.name, schema.data, m.log_time, m.data, m.publish_time, *kinds)


def written(path: Path, records: Iterable[Record], profile: str = "ros2", **options: Any) -> Path:
    """A recording of some messages; `options` of the writer, whose chunks are not compressed by default."""
    with path.open("wb") as stream:
        writer = Writer(stream, **{"compression": CompressionType.NONE, **options})
        writer.start(profile)
        channels: dict[tuple[str, str], int] = {}
        for record in records:
            key = (record.topic, record.type)
            if key not in channels:
                schema = writer.register_schema(record.type, record.language, record.definition)
                channels[key] = writer.register_channel(record.topic, record.encoding, schema)
            writer.add_message(channels[key], record.time_ns, record.data, record.publish_ns)
        writer.finish()
    return path
