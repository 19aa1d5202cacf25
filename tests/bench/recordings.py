"""Recordings for the performance tables: simulated, transcoded, with an occluded board, and of any length."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_typestore

from mobilecal_cli.simulate.record import simulate
from mobilecal_cli.simulate.scenario import Scenario
from tests.bench.pictures import empty

_STORE = get_typestore(Stores.ROS2_HUMBLE)
_IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
_PERIOD_S, _HIDDEN_S, _PASSING_S = 12.0, 4.0, 0.5
_QUALITY = 90


@dataclass
class Record:
    """One message of an MCAP file.

    Attributes:
        topic, type: of its channel.
        definition: of its schema.
        time_ns: log time.
        data: its bytes (CDR).
    """

    topic: str
    type: str
    definition: bytes
    time_ns: int
    data: bytes


def records_of(path: Path) -> Iterator[Record]:
    """All messages in order of log time."""
    with path.open("rb") as stream:
        for schema, channel, message in make_reader(stream).iter_messages():
            assert schema is not None
            yield Record(channel.topic, schema.name, schema.data, message.log_time, message.data)


class Output:
    """An MCAP file that is written record by record, chunks not compressed, as a recorder would."""

    def __init__(self, path: Path) -> None:
        self._stream = path.open("wb")
        self._writer = Writer(self._stream, compression=CompressionType.NONE)
        self._writer.start(profile="ros2", library="mobilecal bench")
        self._channels: dict[tuple[str, str], int] = {}

    def write(self, record: Record) -> None:
        """Append a message."""
        key = (record.topic, record.type)
        if key not in self._channels:
            schema = self._writer.register_schema(record.type, "ros2msg", record.definition)
            self._channels[key] = self._writer.register_channel(record.topic, "cdr", schema)
        self._writer.add_message(self._channels[key], record.time_ns, record.data, record.time_ns)

    def close(self) -> None:
        """Finish the file."""
        self._writer.finish()  # type: ignore[no-untyped-call]
        self._stream.close()


def simulated(path: Path, stations: int) -> Path:
    """A moving log with the board always in view, three seconds a station, ten stereo pairs a second, mono8."""
    simulate(Scenario(motion="moving", stations=stations, pictures="mono8", seed=3), path, force=True)
    return path


@cache
def _walls() -> tuple[np.ndarray, ...]:
    return tuple(empty(seed) for seed in range(12))


def _with_somebody(picture: np.ndarray, time_s: float, number: int) -> np.ndarray:
    """For a third of the time a person occludes the board; entering and leaving take half a second each."""
    phase = time_s % _PERIOD_S
    if phase >= _HIDDEN_S:
        return picture
    hidden = picture.copy()
    share = min(phase, _HIDDEN_S - phase, _PASSING_S) / _PASSING_S
    wide = int(share * picture.shape[1])
    hidden[:, :wide] = _walls()[number % len(_walls())][:, :wide]
    return hidden


def _encoded(picture: np.ndarray, kind: str, template: Any) -> tuple[str, bytes, bytes]:
    """Type, definition and CDR bytes of a picture message with the template's header."""
    if kind == "mono8":
        name = _IMAGES[0]
        height, width = picture.shape
        message = _STORE.types[name](
            header=template.header, height=height, width=width, encoding="mono8", is_bigendian=0, step=width,
            data=picture.ravel(),
        )  # fmt: skip
    else:
        name = _IMAGES[1]
        options = [cv2.IMWRITE_JPEG_QUALITY, _QUALITY] if kind == "jpeg" else []
        data = cv2.imencode(f".{kind}".replace("jpeg", "jpg"), picture, options)[1]
        message = _STORE.types[name](header=template.header, format=kind, data=data)
    definition, _ = _STORE.generate_msgdef(name, ros_version=2)
    return name, definition.encode(), bytes(_STORE.serialize_cdr(message, name))


def transcoded(source: Path, out: Path, kind: str, hide: bool) -> Path:
    """The recording with its mono8 images stored as jpeg, png or mono8, the board occluded at times."""
    output, start_ns = Output(out), 0
    for number, record in enumerate(records_of(source)):
        start_ns = start_ns or record.time_ns
        if record.type == _IMAGES[0]:
            message: Any = _STORE.deserialize_cdr(record.data, record.type)
            picture = np.asarray(message.data).reshape(message.height, message.width)
            if hide:
                picture = _with_somebody(picture, (record.time_ns - start_ns) / 1e9, number)
            record.type, record.definition, record.data = _encoded(picture, kind, message)
        output.write(record)
    output.close()
    return out


def _restamped(data: bytes, time_ns: int) -> bytes:
    """A message whose header comes first, with another stamp: seconds and nanoseconds follow the encapsulation."""
    sec, nanosec = divmod(time_ns, 10**9)
    return data[:4] + sec.to_bytes(4, "little") + nanosec.to_bytes(4, "little") + data[12:]


def stretched(source: Path, out: Path, minutes: float) -> Path:
    """The recording repeated forwards and backwards until it has the given length.

    Backwards, all readings and images appear in opposite order, as if the robot drove back along its path.
    """
    once = [record for record in records_of(source) if record.topic != "/robot_description"]
    stamped = [record for record in once if record.type in (*_IMAGES, "sensor_msgs/msg/JointState")]
    first, last = stamped[0].time_ns, stamped[-1].time_ns
    output = Output(out)
    for record in records_of(source):
        if record.topic == "/robot_description" or record.type.endswith("CameraInfo"):
            output.write(record)
    for leg in range(int(np.ceil(minutes * 60e9 / (last - first)))):
        begin = first + leg * (last - first)
        forwards = leg % 2 == 0
        for record in stamped if forwards else reversed(stamped):
            passed = record.time_ns - first if forwards else last - record.time_ns
            time_ns = begin + passed
            # The turning point belongs to both directions.
            if (leg and not passed) or passed > minutes * 60e9 - (begin - first):
                continue
            output.write(
                Record(
                    record.topic, record.type, record.definition, time_ns, _restamped(record.data, time_ns)
                )
            )
    output.close()
    return out
