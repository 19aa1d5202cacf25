"""Recordings for the performance tables: simulated, transcoded, with an occluded board, and of any length."""

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from rosbags.typesys import Stores, get_typestore

from mobilecal_cli.simulate.record import simulate
from mobilecal_cli.simulate.scenario import Scenario
from tests.bench.pictures import empty
from tests.records import Record, records_of, written

_STORE = get_typestore(Stores.ROS2_HUMBLE)
_IMAGES = ("sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage")
_PERIOD_S, _HIDDEN_S, _PASSING_S = 12.0, 4.0, 0.5
_QUALITY = 90


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

    def changed() -> Iterator[Record]:
        start_ns = 0
        for number, record in enumerate(records_of(source)):
            start_ns = start_ns or record.time_ns
            if record.type == _IMAGES[0]:
                message: Any = _STORE.deserialize_cdr(record.data, record.type)
                picture = np.asarray(message.data).reshape(message.height, message.width)
                if hide:
                    picture = _with_somebody(picture, (record.time_ns - start_ns) / 1e9, number)
                name, definition, data = _encoded(picture, kind, message)
                record = replace(record, type=name, definition=definition, data=data)
            yield record

    return written(out, changed())


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

    def repeated() -> Iterator[Record]:
        for record in records_of(source):
            if record.topic == "/robot_description" or record.type.endswith("CameraInfo"):
                yield record
        for leg in range(int(np.ceil(minutes * 60e9 / (last - first)))):
            begin = first + leg * (last - first)
            forwards = leg % 2 == 0
            for record in stamped if forwards else reversed(stamped):
                passed = record.time_ns - first if forwards else last - record.time_ns
                # The turning point belongs to both directions.
                if not ((leg and not passed) or passed > minutes * 60e9 - (begin - first)):
                    time_ns = begin + passed
                    data = _restamped(record.data, time_ns)
                    yield replace(record, time_ns=time_ns, publish_ns=time_ns, data=data)

    return written(out, repeated())
