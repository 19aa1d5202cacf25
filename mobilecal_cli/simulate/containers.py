"""Writers for every recording container."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from mcap.writer import CompressionType
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as BagWriter
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Rosbag2Writer

from mobilecal_cli.simulate.messages import Published, Publisher, Ros
from mobilecal_cli.simulate.scenario import Container

Write = Callable[[Path, Iterable[Published], Publisher], None]


def ros_of(container: Container) -> Ros:
    """ROS version of a container's messages."""
    return 1 if container.startswith("bag") or container == "mcap-ros1" else 2


def _serialized(publisher: Publisher, published: Published) -> bytes:
    serialize = publisher.store.serialize_ros1 if publisher.ros == 1 else publisher.store.serialize_cdr
    return bytes(serialize(published.message, published.type))


def _mcap(compression: CompressionType) -> Write:
    def write(path: Path, messages: Iterable[Published], publisher: Publisher) -> None:
        profile, encoding = ("ros1", "ros1") if publisher.ros == 1 else ("ros2", "cdr")
        with path.open("wb") as stream:
            writer = McapWriter(stream, compression=compression)
            writer.start(profile=profile, library="mobilecal simulate")
            channels: dict[str, int] = {}
            for published in messages:
                if published.topic not in channels:
                    definition, _ = publisher.store.generate_msgdef(published.type, ros_version=publisher.ros)
                    name = published.type.replace("/msg/", "/") if publisher.ros == 1 else published.type
                    schema = writer.register_schema(name, f"{profile}msg", definition.encode())
                    channels[published.topic] = writer.register_channel(published.topic, encoding, schema)
                time_ns = published.time_ns
                data = _serialized(publisher, published)
                writer.add_message(channels[published.topic], time_ns, data, time_ns)
            writer.finish()  # type: ignore[no-untyped-call]

    return write


def _connected(writer: Any, messages: Iterable[Published], publisher: Publisher) -> None:  # noqa: ANN401
    connections: dict[str, Any] = {}
    for published in messages:
        topic = published.topic
        if topic not in connections:
            connections[topic] = writer.add_connection(topic, published.type, typestore=publisher.store)
        writer.write(connections[topic], published.time_ns, _serialized(publisher, published))


def _rosbag2(plugin: StoragePlugin) -> Write:
    def write(path: Path, messages: Iterable[Published], publisher: Publisher) -> None:
        with Rosbag2Writer(path, version=9, storage_plugin=plugin) as writer:
            _connected(writer, messages, publisher)

    return write


def _bag(compression: BagWriter.CompressionFormat | None) -> Write:
    def write(path: Path, messages: Iterable[Published], publisher: Publisher) -> None:
        writer = BagWriter(path)
        if compression is not None:
            writer.set_compression(compression)
        with writer:
            _connected(writer, messages, publisher)

    return write


WRITERS: dict[Container, Write] = {
    "mcap": _mcap(CompressionType.NONE),
    "mcap-lz4": _mcap(CompressionType.LZ4),
    "mcap-zstd": _mcap(CompressionType.ZSTD),
    "mcap-ros1": _mcap(CompressionType.NONE),
    "rosbag2": _rosbag2(StoragePlugin.SQLITE3),
    "rosbag2-mcap": _rosbag2(StoragePlugin.MCAP),
    "bag": _bag(None),
    "bag-lz4": _bag(BagWriter.CompressionFormat.LZ4),
    "bag-bz2": _bag(BagWriter.CompressionFormat.BZ2),
}
