"""One small world, written into every container."""

import json
import shutil
import sqlite3
from collections.abc import Callable, Iterable
from contextlib import closing, suppress
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import zstandard
from mcap.writer import CompressionType, IndexType
from rosbags.rosbag1 import Writer as BagWriter
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Bag2Writer
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from mobilecal_cli import readers
from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model.rig import Sources, WheelSource
from mobilecal_cli.model.signals import PictureIndex
from mobilecal_cli.readers import read_signals
from mobilecal_cli.readers.messages import codec_of, stamp_of
from tests.records import Record, written

START_NS = 1_700_000_000_000_000_000
STEP_NS = 20_000_000

ROS1 = get_typestore(Stores.ROS1_NOETIC)
ROS2 = get_typestore(Stores.ROS2_JAZZY)

SOURCES = Sources(
    image={"left": "/left/image_raw", "right": "/right/image/compressed"},
    info={"left": "/left/camera_info", "right": "/right/camera_info"},
    joints={"pan": "/joint_states", "tilt": "/joint_states"},
    wheels={
        "left": WheelSource("/joint_states", joint="wheel_left"),
        "right": WheelSource("/ticks", field="data", ticks_per_revolution=1000, bits=16),
    },
)


@dataclass(frozen=True)
class Item:
    """One message to write; `make` builds it for a typestore."""

    topic: str
    log_ns: int
    make: Callable[[Typestore], Any]

    def message(self, store: Typestore) -> tuple[Any, str]:
        """The message, and its type."""
        made = self.make(store)
        return made, made.__msgtype__


def every(recording):
    """All messages of all topics."""
    return list(recording.messages({info.name for info in recording.topics}))


def one_log(recording, sources, *options, **more):
    """Signals of a recording without clock steps."""
    (signals,) = read_signals(recording, sources, *options, **more)
    return signals


def read_images(recording, image_topics, stamps, layout="separate"):
    """`readers.read_images`, by the stamps of each side's images."""
    found: dict[str, dict[int, tuple[int, bool]]] = {image_topics[side]: {} for side in stamps}
    for message in recording.messages(found):
        with suppress(RecordingError):
            decoded = message.decode()
            place = message.log_time_ns, codec_of(decoded) is not None
            found[message.topic].setdefault(stamp_of(decoded, message.log_time_ns), place)
    wanted = {}
    for side, some in stamps.items():
        places = found[image_topics[side]]
        stamp_ns = np.array(sorted(stamp for stamp in some if stamp in places), dtype=np.int64)
        log_ns = np.array([places[stamp][0] for stamp in stamp_ns.tolist()], dtype=np.int64)
        wanted[side] = PictureIndex(stamp_ns, stamp_ns, log_ns, any(video for _, video in places.values()))
    return readers.read_images(recording, Sources(image_topics, {}, {}, {}, layout=layout), wanted)


def header(store: Typestore, stamp_ns: int, frame: str = "") -> Any:
    time = store.types["builtin_interfaces/msg/Time"](stamp_ns // 10**9, stamp_ns % 10**9)
    kind = store.types["std_msgs/msg/Header"]
    return kind(0, time, frame) if store is ROS1 else kind(time, frame)


def joint_state(names: list[str], position: Iterable[float], velocity=(), stamp_ns=START_NS):
    def make(store: Typestore) -> Any:
        numbers = np.array(position, dtype=np.float64), np.array(velocity, dtype=np.float64), np.zeros(0)
        return store.types["sensor_msgs/msg/JointState"](header(store, stamp_ns), names, *numbers)

    return make


def number(kind: str, value: float):
    return lambda store: store.types[f"std_msgs/msg/{kind}"](value)


def image(pixels, encoding: str, stamp_ns=START_NS, frame="left_optical", **changes):
    def make(store: Typestore) -> Any:
        data = np.ascontiguousarray(pixels).view(np.uint8).ravel()
        height, width = pixels.shape[:2]
        fields = {"header": header(store, stamp_ns, frame), "height": height, "width": width}
        fields |= {"encoding": encoding, "is_bigendian": 0, "step": data.size // height, "data": data}
        return store.types["sensor_msgs/msg/Image"](**{**fields, **changes})

    return make


def compressed(pixels, extension: str, stamp_ns=START_NS, frame="right_optical"):
    data = cv2.imencode(extension, pixels)[1].ravel()

    def make(store: Typestore) -> Any:
        kind = store.types["sensor_msgs/msg/CompressedImage"]
        return kind(header(store, stamp_ns, frame), extension[1:], data)

    return make


def info(
    K,
    D=(),
    P=None,
    R=None,
    model="plumb_bob",
    size=(640, 480),
    binning=(0, 0),
    roi=(0, 0, 0, 0),
    stamp_ns=START_NS,
):
    def make(store: Typestore) -> Any:
        region = store.types["sensor_msgs/msg/RegionOfInterest"](roi[0], roi[1], roi[3], roi[2], False)
        rectified = np.eye(3) if R is None else R, np.hstack([K, np.zeros((3, 1))]) if P is None else P
        matrices = (np.array(D, float), *map(np.ravel, (K, *rectified)))
        kind, head = store.types["sensor_msgs/msg/CameraInfo"], header(store, stamp_ns, "left_optical")
        return kind(head, size[1], size[0], model, *matrices, *binning, region)

    return make


def picture(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return cv2.resize(rng.integers(0, 256, (6, 8), dtype=np.uint8), (64, 48), interpolation=cv2.INTER_CUBIC)


K_LEFT = np.array([[500.0, 0, 320], [0, 510, 240], [0, 0, 1]])
URDF = "<robot name='r'><link name='base_link'/></robot>"


def world(messages: int = 60) -> list[Item]:
    """Joints whose names change order, a tick counter that wraps, pictures of both sides, in log order."""
    items = [
        Item("/robot_description", START_NS, number("String", URDF)),
        Item("/left/camera_info", START_NS, info(K_LEFT, [0.1, 0, 0, 0, 0])),
        Item("/right/camera_info", START_NS, info(K_LEFT)),
    ]
    for k in range(messages):
        stamp = START_NS + k * STEP_NS
        log = stamp + 3_000_000
        names, values = ["pan", "tilt", "wheel_left"], [0.01 * k, -0.02 * k, 0.1 * k]
        if k % 3 == 1:
            names, values = names[::-1], values[::-1]
        state = joint_state(names, values, stamp_ns=stamp)
        items.append(Item("/joint_states", log, state))
        ticks = (65_500 + 16 * k) % 2**16
        items.append(Item("/ticks", log + 1, number("UInt16", ticks)))
        if k % 10 == 0:
            left, right = image(picture(k), "mono8", stamp), compressed(picture(k + 1), ".png", stamp)
            items.append(Item("/left/image_raw", log + 2, left))
            items.append(Item("/right/image/compressed", log + 3, right))
    return items


def _fill(writer, items: list[Item], store: Typestore, serialize: Callable) -> None:
    """Write a bag and close it."""
    with writer:
        connections = {}
        for item in items:
            message, kind = item.message(store)
            if item.topic not in connections:
                connections[item.topic] = writer.add_connection(item.topic, kind, typestore=store)
            writer.write(connections[item.topic], item.log_ns, serialize(message, kind))


def write_bag(path: Path, items: list[Item], compression: str = "") -> Path:
    writer = BagWriter(path)
    writer.chunk_threshold = 4096
    if compression:
        writer.set_compression(BagWriter.CompressionFormat[compression])
    _fill(writer, items, ROS1, ROS1.serialize_ros1)
    return path


def write_bag2(path: Path, items: list[Item], storage: str = "SQLITE3", compression: str = "") -> Path:
    writer = Bag2Writer(path, version=9, storage_plugin=StoragePlugin[storage])
    if compression:
        writer.set_compression(CompressionMode[compression], CompressionFormat.ZSTD)
    _fill(writer, items, ROS2, ROS2.serialize_cdr)
    return path


def in_sqlite(path: Path, *statements: str) -> Path:
    """A database after some statements; a new one if there is none."""
    with closing(sqlite3.connect(path)) as connection, connection:
        for statement in statements:
            connection.execute(statement)
    return path


@cache
def schema_of(store: Typestore, kind: str) -> dict[str, Any]:
    """What a `Record` states of the messages of a ROS type."""
    ros = 1 if store is ROS1 else 2
    definition = store.generate_msgdef(kind, ros_version=ros)[0].encode()
    name, encoding = (kind.replace("/msg/", "/"), "ros1") if ros == 1 else (kind, "cdr")
    return {"type": name, "definition": definition, "language": f"ros{ros}msg", "encoding": encoding}


#: What a `Record` states of messages in JSON.
JSON = {"language": "jsonschema", "encoding": "json"}


def write_json(path: Path, messages: Iterable[tuple[str, int, str, Any]]) -> Path:
    """An MCAP file of (topic, log time, schema name, object)."""
    records = (
        Record(topic, kind, b'{"type": "object"}', log_ns, json.dumps(fields).encode(), **JSON)
        for topic, log_ns, kind, fields in messages
    )
    return written(path, records, profile="")


def write_mcap(
    path: Path, items: list[Item], profile="ros2", ros1=False, pack=False, encoding=None, **options
) -> Path:
    store = ROS1 if ros1 else ROS2
    serialize = store.serialize_ros1 if ros1 else store.serialize_cdr

    def record(item: Item) -> Record:
        message, kind = item.message(store)
        data = bytes(serialize(message, kind))
        payload = zstandard.compress(data) if pack else data
        schema = schema_of(store, kind) | ({"encoding": encoding} if encoding else {})
        return Record(item.topic, time_ns=item.log_ns, data=payload, publish_ns=item.log_ns, **schema)

    options = {"chunk_size": 4096, "compression": CompressionType.ZSTD, **options}
    return written(path, map(record, items), profile, **options)


def _bare(path: Path, items: list[Item], suffix: str, storage: str) -> Path:
    folder = write_bag2(path.with_suffix(".d"), items, storage)
    found = next(folder.glob(f"*{suffix}"))
    return found.rename(path.with_suffix(suffix))


def _without_metadata(path: Path, items: list[Item]) -> Path:
    folder = write_bag2(path, items)
    (folder / "metadata.yaml").unlink()
    return folder


def _packed(path: Path, items: list[Item]) -> Path:
    source = _bare(path, items, ".db3", "SQLITE3")
    target = source.with_suffix(".db3.zstd")
    target.write_bytes(zstandard.compress(source.read_bytes()))
    return target


def _misnamed(path: Path, items: list[Item]) -> Path:
    return Path(shutil.move(write_mcap(path.with_suffix(".mcap"), items), path.with_suffix(".bag")))


NO_REPEATS = {"repeat_channels": False, "repeat_schemas": False}
NO_SUMMARY = {**NO_REPEATS, "use_statistics": False, "use_summary_offsets": False}
NO_SUMMARY["index_types"] = IndexType.MESSAGE
CONTAINERS: dict[str, Callable[[Path, list[Item]], Path]] = {
    "bag": lambda p, i: write_bag(p.with_suffix(".bag"), i),
    "bag-bz2": lambda p, i: write_bag(p.with_suffix(".bag"), i, "BZ2"),
    "bag-lz4": lambda p, i: write_bag(p.with_suffix(".bag"), i, "LZ4"),
    "rosbag2-sqlite3": write_bag2,
    "rosbag2-mcap": lambda p, i: write_bag2(p, i, "MCAP"),
    "rosbag2-sqlite3-file": lambda p, i: write_bag2(p, i, "SQLITE3", "FILE"),
    "rosbag2-sqlite3-message": lambda p, i: write_bag2(p, i, "SQLITE3", "MESSAGE"),
    "rosbag2-mcap-file": lambda p, i: write_bag2(p, i, "MCAP", "FILE"),
    "rosbag2-mcap-message": lambda p, i: write_bag2(p, i, "MCAP", "MESSAGE"),
    "rosbag2-mcap-storage": lambda p, i: write_bag2(p, i, "MCAP", "STORAGE"),
    "rosbag2-no-metadata": _without_metadata,
    "bare-db3": lambda p, i: _bare(p, i, ".db3", "SQLITE3"),
    "bare-db3-zstd": _packed,
    "bare-rosbag2-mcap": lambda p, i: _bare(p, i, ".mcap", "MCAP"),
    "mcap-zstd": lambda p, i: write_mcap(p, i),
    "mcap-lz4": lambda p, i: write_mcap(p, i, compression=CompressionType.LZ4),
    "mcap-none": lambda p, i: write_mcap(p, i, compression=CompressionType.NONE),
    "mcap-unchunked": lambda p, i: write_mcap(p, i, use_chunking=False),
    "mcap-unchunked-no-summary": lambda p, i: write_mcap(p, i, use_chunking=False, **NO_SUMMARY),
    "mcap-no-summary": lambda p, i: write_mcap(p, i, **NO_SUMMARY),
    "mcap-no-index-at-all": lambda p, i: write_mcap(p, i, **{**NO_SUMMARY, "index_types": IndexType.NONE}),
    "mcap-half-summary": lambda p, i: write_mcap(p, i, **NO_REPEATS),
    "mcap-ros1": lambda p, i: write_mcap(p, i, profile="", ros1=True),
    "mcap-message-zstd": lambda p, i: write_mcap(p, i, pack=True),
    "mcap-misnamed-as-bag": _misnamed,
}
