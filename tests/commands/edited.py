"""Copies of a sample log with something wrong in them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_HUMBLE)
Edit = Callable[[str, Any], Any]


def edited(source: Path, target: Path, edit: Edit) -> Path:
    """Copy an MCAP, each decoded message through `edit(topic, message)`; None drops it."""
    with source.open("rb") as stream, target.open("wb") as out:
        writer = Writer(out, compression=CompressionType.NONE)
        writer.start(profile="ros2")
        channels: dict[int, int] = {}
        for schema, channel, message in make_reader(stream).iter_messages():
            assert schema is not None
            decoded = edit(channel.topic, STORE.deserialize_cdr(message.data, schema.name))
            if decoded is None:
                continue
            if channel.id not in channels:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(channel.topic, "cdr", number)
            data = bytes(STORE.serialize_cdr(decoded, schema.name))
            writer.add_message(channels[channel.id], message.log_time, data, message.publish_time)
        writer.finish()
    return target
