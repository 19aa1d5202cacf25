"""Channels: description of a message stream in a container, and decoding of its payloads."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model import JOINT_STATE
from mobilecal_cli.readers.messages.definitions import DefinitionFormat, ros_decoder
from mobilecal_cli.readers.messages.equivalents import (
    Decoder,
    json_decoder,
    like_ros,
    protobuf_decoder,
    ros_type,
)

Payload = bytes | memoryview

#: Exceptions raised by a message without the fields of its type: JSON may contain anything.
NOT_ITS_TYPE = (AttributeError, TypeError, ValueError, OverflowError)
#: Bytes of a joint state; ten thousand joints need a third. Longer names would fill the memory, and every message.
LARGEST_JOINT_STATE = 2**20
_ENCODINGS = ("cdr", "ros1", "protobuf", "json")


@dataclass(frozen=True, slots=True)
class Channel:
    """One message stream in one container.

    Attributes:
        id: number of the channel in the container.
        topic: the topic.
        type: message type; ROS's in ROS 2 spelling.
        encoding: "cdr" (ROS 2), "ros1", "protobuf", "json", or another value from the container.
        definition: message definition with its dependencies, "" if the container has none; bytes for protobuf.
        definition_format: language of the definition.
    """

    id: int
    topic: str
    type: str
    encoding: str
    definition: str | bytes = ""
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

    def decode(self, payload: Payload) -> Any:  # noqa: ANN401 - the type is the recording's, known at run time
        """The message as an object with the fields of its definition; arrays are views of the payload.

        Raises:
            RecordingError: the payload does not match the definition, or is a joint state that no robot has.
        """
        if self.type == JOINT_STATE and len(payload) > LARGEST_JOINT_STATE:
            raise RecordingError(
                f"{self.topic}: a joint state of {len(payload)} bytes (limit {LARGEST_JOINT_STATE})",
                "check the driver that publishes it",
            )
        decoder = _decoder(self.encoding, self.type, self.definition, self.definition_format)
        try:
            return decoder(payload)
        except MemoryError:
            raise
        except Exception as error:  # damaged payloads may raise anything
            raise RecordingError(
                f"{self.topic}: a message does not match its type {self.type}: {error}",
                "copy the recording again; if the error remains, record the topic with its current message definition",
            ) from error


def ros2_spelling(name: str) -> str:
    """A message type in ROS 2 spelling: "sensor_msgs/Image" becomes "sensor_msgs/msg/Image"."""
    package, _, rest = name.partition("/")
    return f"{package}/msg/{rest}" if rest and "/" not in rest else name


@lru_cache(maxsize=256)
def _decoder(
    encoding: str, type_name: str, definition: str | bytes, definition_format: DefinitionFormat
) -> Callable[[Payload], object]:
    if isinstance(definition, str) and encoding in ("cdr", "ros1"):
        decode = ros_decoder(encoding, type_name, definition, definition_format)
        if ros_type(type_name) == type_name:
            return decode
    elif encoding == "json":
        decode = json_decoder()
    else:
        decode = _protobuf_decoder(type_name, definition)
    return lambda payload: like_ros(decode(payload), type_name)


def _protobuf_decoder(type_name: str, definition: str | bytes) -> Decoder:
    try:
        return protobuf_decoder(definition.encode() if isinstance(definition, str) else definition, type_name)
    except MemoryError:
        raise
    except Exception as error:  # a damaged definition may raise anything
        raise RecordingError(
            f"the definition of the protobuf type {type_name} cannot be used: {error}",
            "copy the recording again; if the error remains, record it with all dependencies of the definition",
        ) from error
