"""MCAP recordings of ROS 2, message by message: read, and written again with changes."""

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer


@dataclass(frozen=True)
class Record:
    """One message of an MCAP file.

    Attributes:
        topic, type: of its channel.
        definition: of its schema.
        time_ns: log time.
        data: its bytes (CDR).
        publish_ns: publish time.
    """

    topic: str
    type: str
    definition: bytes
    time_ns: int
    data: bytes
    publish_ns: int = 0


def records_of(path: Path) -> Iterator[Record]:
    """All messages in order of log time."""
    with path.open("rb") as stream:
        for schema, channel, m in make_reader(stream).iter_messages():
            assert schema is not None
            yield Record(channel.topic, schema.name, schema.data, m.log_time, m.data, m.publish_time)


def written(path: Path, records: Iterable[Record]) -> Path:
    """A recording of some messages, chunks not compressed, as a recorder would write it."""
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.NONE)
        writer.start(profile="ros2")
        channels: dict[tuple[str, str], int] = {}
        for record in records:
            key = (record.topic, record.type)
            if key not in channels:
                schema = writer.register_schema(record.type, "ros2msg", record.definition)
                channels[key] = writer.register_channel(record.topic, "cdr", schema)
            writer.add_message(channels[key], record.time_ns, record.data, record.publish_ns)
        writer.finish()
    return path
