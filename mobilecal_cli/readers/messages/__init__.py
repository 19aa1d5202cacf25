"""Channels of a container: decoding of their messages, and what every message has."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from datetime import datetime
from functools import lru_cache
from graphlib import TopologicalSorter
from types import SimpleNamespace
from typing import Any

import numpy as np
import zstandard

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model.signals import JOINT_STATE
from mobilecal_cli.model.text import listed
from mobilecal_cli.readers.messages.types import (
    Decoded,
    Decoder,
    DefinitionFormat,
    Payload,
    leaves_of,
    like_ros,
    ros_decoder,
    ros_type,
)

#: Exceptions raised by a message without the fields of its type: JSON may contain anything.
NOT_ITS_TYPE = (AttributeError, TypeError, ValueError, OverflowError)
#: Bytes of a joint state; ten thousand joints need a third. Longer names would fill the memory, and every message.
LARGEST_JOINT_STATE = 2**20
_ENCODINGS = ("cdr", "ros1", "protobuf", "json")
ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
#: Maximum size of a chunk, message or decompressed payload, because each must fit into memory.
SIZE_LIMIT = 2**29
#: A chunk may always decompress to this size; to more only within the ratio below.
ALWAYS_BYTES = 2**24
#: Images and readings never compress further; a higher ratio is made to fill memory or disk.
LARGEST_RATIO = 1000


@dataclass(frozen=True, slots=True)
class Channel:
    """One message stream in one container.

    Attributes:
        topic: the topic.
        type: message type; ROS's in ROS 2 spelling.
        encoding: "cdr" (ROS 2), "ros1", "protobuf", "json", or another value from the container.
        definition: message definition with its dependencies, as stored; empty if the container has none.
        definition_format: language of the definition.
    """

    topic: str
    type: str
    encoding: str
    definition: bytes = b""
    definition_format: DefinitionFormat = ""

    @property
    def ros_type(self) -> str:
        """ROS type that the messages are read as; the type's own name if no ROS type is equivalent."""
        return ros_type(self.type)

    def check(self) -> None:
        """Check that payloads can be decoded.

        Raises:
            RecordingError: unknown encoding, or no definition of the message type.
        """
        if self.encoding not in _ENCODINGS:
            raise RecordingError(
                f"{self.topic}: messages of type {self.type or '(none)'} are encoded as "
                f"{self.encoding or '(nothing stated)'!r}; supported encodings: {', '.join(_ENCODINGS)}",
                "record the topic with ROS, or set another topic in rig.yaml",
            )
        try:
            _decoder(self.encoding, self.type, self.definition, self.definition_format)
        except RecordingError as error:
            raise RecordingError(f"{self.topic}: {error.message}", error.hint) from error

    def decode(self, payload: Payload) -> Decoded:
        """The message as an object with the fields of its definition; arrays are views of the payload.

        Raises:
            RecordingError: the payload does not match the definition, or is a joint state that no robot has.
        """
        decoder = _decoder(self.encoding, self.type, self.definition, self.definition_format)
        try:
            whole = _decompressed(payload) if self.encoding == "cdr" else payload
            if len(whole) <= LARGEST_JOINT_STATE or self.ros_type != JOINT_STATE:
                return decoder(whole)
        except MemoryError:
            raise
        except Exception as error:  # damaged payloads may raise anything
            raise RecordingError(
                f"{self.topic}: a message does not match its type {self.type}: {error}",
                "copy the recording again; if the error remains, record the topic with its current message definition",
            ) from error
        raise RecordingError(
            f"{self.topic}: a joint state of {len(whole)} bytes (limit {LARGEST_JOINT_STATE})",
            "check the driver that publishes it",
        )


def largest_size(stored: int) -> int:
    """Largest allowed size after decompression, bytes."""
    return min(SIZE_LIMIT, max(ALWAYS_BYTES, LARGEST_RATIO * stored))


def _decompressed(payload: Payload) -> Payload:
    """A CDR payload; rosbag2 may have compressed it separately: it then begins with `ZSTD_MAGIC`, as no other does.

    Raises:
        ValueError: the frame is damaged or too large.
    """
    if payload[: len(ZSTD_MAGIC)] != ZSTD_MAGIC:
        return payload
    limit = largest_size(len(payload))
    with zstandard.ZstdDecompressor().stream_reader(payload) as reader:
        whole = reader.read(limit + 1)
    if not whole:
        raise ValueError("an empty zstd frame")
    if len(whole) > limit:
        raise ValueError(f"a message of {len(payload)} bytes decompresses to more than {limit} bytes")
    return whole


def ros2_spelling(name: str) -> str:
    """A message type in ROS 2 spelling: "sensor_msgs/Image" becomes "sensor_msgs/msg/Image"."""
    package, _, rest = name.partition("/")
    return f"{package}/msg/{rest}" if rest and "/" not in rest else name


@lru_cache(maxsize=256)
def _decoder(
    encoding: str, type_name: str, definition: bytes, definition_format: DefinitionFormat
) -> Decoder:
    if encoding in ("cdr", "ros1") and definition_format != "protobuf":
        decode = ros_decoder(encoding, type_name, definition.decode(errors="replace"), definition_format)
        if ros_type(type_name) == type_name:
            return decode
    elif encoding == "json":
        decode = _from_json
    else:
        decode = _protobuf_decoder(type_name, definition)
    return like_ros(decode, type_name)


def _protobuf_decoder(type_name: str, definition: bytes) -> Decoder:
    """Decoder of messages of one type in a `FileDescriptorSet`.

    Raises:
        RecordingError: the set is damaged or lacks the type.
    """
    from google.protobuf import descriptor_pb2, descriptor_pool, message_factory

    try:
        pool = descriptor_pool.DescriptorPool()
        files = {file.name: file for file in descriptor_pb2.FileDescriptorSet.FromString(definition).file}
        needed = {name: files.keys() & set(file.dependency) for name, file in files.items()}
        for name in TopologicalSorter(needed).static_order():
            pool.Add(files[name])
        kind = message_factory.GetMessageClass(pool.FindMessageTypeByName(type_name))
    except MemoryError:
        raise
    except Exception as error:  # a damaged definition may raise anything
        raise RecordingError(
            f"the definition of the protobuf type {type_name} cannot be used: {error}",
            "copy the recording again; if the error remains, record it with all dependencies of the definition",
        ) from error
    return lambda payload: _from_protobuf(kind.FromString(bytes(payload)))


def _from_protobuf(message: Decoded) -> Decoded:
    if message.DESCRIPTOR.full_name in ("google.protobuf.Timestamp", "google.protobuf.Duration"):
        return SimpleNamespace(sec=message.seconds, nanosec=message.nanos)
    result = SimpleNamespace()
    for field in message.DESCRIPTOR.fields:
        value = getattr(message, field.name)
        if field.message_type is None:
            value = list(value) if field.is_repeated else value
        elif field.message_type.GetOptions().map_entry:
            value = None  # no reader uses a map
        elif field.is_repeated:
            value = [_from_protobuf(item) for item in value]
        else:
            value = _from_protobuf(value) if message.HasField(field.name) else None
        setattr(result, field.name, value)
    return result


#: A time as text: seconds, or a date and a time of day with its zone (UTC without one); and the digits of a fraction.
_TIME = re.compile(r"(\d{1,12}|\d{4}-\d\d-\d\d[T ]\d\d:\d\d:\d\d)(?:[.,](\d{1,9}))?(Z|[+-]\d\d:?\d\d)?")


def _time_of(text: str) -> SimpleNamespace | str:
    """A time with sec and nanosec from a text such as "2026-01-31T12:00:00.5Z" or "1700000000.020000000"."""
    match = _TIME.fullmatch(text.strip())
    if match is None:
        return text
    whole, fraction, zone = match[1], match[2] or "", match[3] or "Z"
    sec = int(whole) if whole.isdigit() else int(datetime.fromisoformat(whole + zone).timestamp())
    return SimpleNamespace(sec=sec, nanosec=int(fraction.ljust(9, "0")))


def _json_object(fields: dict[str, Any]) -> SimpleNamespace:
    for key in ("stamp", "timestamp"):
        if isinstance(fields.get(key), str):
            fields[key] = _time_of(fields[key])
    return SimpleNamespace(**fields)


def _from_json(payload: Payload) -> Decoded:
    """A JSON object; NaN and Infinity are allowed."""
    value = json.loads(bytes(payload), object_hook=_json_object)
    if not isinstance(value, SimpleNamespace):
        raise TypeError(f"expected a JSON object, got {type(value).__name__}")
    return value


def header_stamp_ns(message: Decoded) -> int | None:
    """Header stamp of a message, ns; of a TFMessage, that of its first transform. None without a header."""
    if getattr(message, "transforms", None):
        message = message.transforms[0]
    stamp = getattr(getattr(message, "header", None), "stamp", None)
    return None if stamp is None else int(stamp.sec) * 10**9 + int(stamp.nanosec)


def stamp_of(message: Decoded, log_ns: int) -> int:
    """Header stamp of a message, ns; the log time if there is no header or its stamp is zero."""
    return header_stamp_ns(message) or log_ns


def frame_of(header: Decoded) -> str:
    """Frame of a header, without the slash at its front that tf ignores."""
    return str(header.frame_id).lstrip("/")


#: Formats as stated in messages → name of the codec.
CODECS = {"h264": "h264", "h.264": "h264", "avc": "h264", "h265": "hevc", "h.265": "hevc", "hevc": "hevc"}


def codec_of(message: Decoded) -> str | None:
    """Codec of a message's image, None if it is not video."""
    return CODECS.get(str(getattr(message, "format", "")).strip().lower())


def content_of(message: Decoded) -> bytes:
    """Pixels of an image message, as encoded; b"" without any."""
    try:
        return bytes(memoryview(message.data))
    except (AttributeError, TypeError):  # no data, or not bytes
        return b""


_STEP = re.compile(r"([A-Za-z_][A-Za-z0-9_]*)((?:\[\d+\])*)")


class FieldPath:
    """The path of a number in messages.

    Args:
        text: names of fields, with dots between them and indices of lists in brackets.

    Raises:
        RecordingError: not a valid path.
    """

    def __init__(self, text: str) -> None:
        self.text = text
        self._steps: list[str | int] = []
        for part in text.split("."):
            match = _STEP.fullmatch(part.strip())
            if match is None:
                raise RecordingError(
                    f"{text!r} is not a field path", 'use a path such as "data", "left.ticks" or "values[0]"'
                )
            self._steps += [match[1], *map(int, re.findall(r"\[(\d+)\]", match[2]))]

    def number(self, message: Decoded, topic: str, setting: str) -> int | float:
        """The number at the path.

        Args:
            topic, setting: topic of the message and key in rig.yaml, for error messages.

        Raises:
            RecordingError: a step is missing, or the value is not a number; the message lists the fields present.
        """
        value = message
        for step in self._steps:
            try:
                value = value[step] if isinstance(step, int) else getattr(value, step)
            except (AttributeError, IndexError, TypeError, KeyError) as error:
                raise RecordingError(
                    f"{topic}: no field {self.text} ({step!r} is missing); "
                    f"fields present: {listed(_field_names(message))}",
                    f"correct {setting} in rig.yaml",
                ) from error
        if isinstance(value, (bool, int, np.integer)):
            return int(value)
        if isinstance(value, (float, np.floating)):
            return float(value)
        raise RecordingError(
            f"{topic}: field {self.text} is a {type(value).__name__}, not a number; "
            f"fields present: {listed(_field_names(message))}",
            f"correct {setting} in rig.yaml",
        )


def _field_names(message: Decoded) -> list[str]:
    """Paths to the numbers and lists in a message."""
    paths: list[str] = []
    for path, value in leaves_of(message):
        if isinstance(value, (list, np.ndarray)):
            paths.append(f"{path}[0..{len(value) - 1}]" if len(value) else f"{path}[] (empty)")
        elif isinstance(value, (int, float, np.number)):
            paths.append(path)
    return paths
