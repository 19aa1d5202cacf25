"""Joint states, of which most are read without their message definition."""

from __future__ import annotations

import struct
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass

import numpy as np

from mobilecal_cli.model import JOINT_STATE
from mobilecal_cli.readers.messages.channels import Channel, Payload
from mobilecal_cli.readers.messages.stamps import header_stamp_ns

#: The stamp follows the encapsulation (CDR) or the sequence number (ROS 1), 4 bytes each.
_STAMP, _STAMP_END = struct.Struct("<iI"), 12
_COUNT = struct.Struct("<I")
_LITTLE_ENDIAN = b"\x00\x01"
#: Publishers that share a topic have messages of different lengths; where more lengths occur, the names change.
_MOST_KNOWN = 64


@dataclass(frozen=True, slots=True)
class JointReading:
    """One message of joint states.

    Attributes:
        stamp_ns: header stamp, 0 if it is zero, None without a header.
        names: the joints.
        position, velocity: a number for each joint; either may be shorter, or empty.
    """

    stamp_ns: int | None
    names: Sequence[str]
    position: Sequence[float]
    velocity: Sequence[float]


class JointStateDecoder:
    """Decoder of the joint states of one channel.

    Most messages of a publisher have the frame and names of the one before. Then only the stamp and the numbers are
    read, three times faster than by the message definition.
    """

    def __init__(self, channel: Channel) -> None:
        self._channel = channel
        self._aligned = channel.encoding == "cdr"
        self._repeats = channel.type == JOINT_STATE and channel.encoding in ("cdr", "ros1")
        #: Length of a message → bytes between stamp and positions, and the names in them.
        self._known: dict[int, tuple[bytes, Sequence[str]]] = {}

    def __call__(self, payload: Payload) -> JointReading:
        """Decode a message.

        Raises:
            RecordingError: it does not match its type.
        """
        head, names = self._known.get(len(payload), (b"", ()))
        if head and payload[_STAMP_END : _STAMP_END + len(head)] == head:
            with suppress(struct.error):  # truncated: the other way states what is wrong
                return self._numbers(payload, _STAMP_END + len(head), names)
        message = self._channel.decode(payload)
        position, velocity = (getattr(message, field, ()) for field in ("position", "velocity"))
        reading = JointReading(header_stamp_ns(message), tuple(message.name), position, velocity)
        if self._repeats:
            self._learn(payload, str(message.header.frame_id), reading)
        return reading

    def _learn(self, payload: Payload, frame: str, reading: JointReading) -> None:
        """Store the bytes of frame and names, if the numbers are found after them."""
        if self._aligned and payload[:2] != _LITTLE_ENDIAN:
            return
        at = self._align(_STAMP_END, 4) + 4 + len(frame.encode()) + self._aligned  # CDR counts a final zero
        at = self._align(at, 4) + 4
        for name in reading.names:
            at = self._align(at, 4) + 4 + len(name.encode()) + self._aligned
        with suppress(struct.error):
            again = self._numbers(payload, at, reading.names)
            if (again.stamp_ns, *map(_bytes, (again.position, again.velocity))) == (
                reading.stamp_ns,
                *map(_bytes, (reading.position, reading.velocity)),
            ):
                self._repeats = len(self._known) < _MOST_KNOWN
                self._known[len(payload)] = bytes(payload[_STAMP_END:at]), reading.names

    def _numbers(self, payload: Payload, at: int, names: Sequence[str]) -> JointReading:
        seconds, nanoseconds = _STAMP.unpack_from(payload, 4)
        position, at = self._list(payload, at)
        velocity, at = self._list(payload, at)
        _COUNT.unpack_from(payload, self._align(at, 4))  # of the efforts, whose numbers are not used
        return JointReading(seconds * 10**9 + nanoseconds, names, position, velocity)

    def _list(self, payload: Payload, at: int) -> tuple[tuple[float, ...], int]:
        """A list of numbers, and the byte after it."""
        at = self._align(at, 4)
        (count,) = _COUNT.unpack_from(payload, at)
        at += 4
        if not count:
            return (), at
        at = self._align(at, 8)
        return struct.unpack_from(f"<{count}d", payload, at), at + 8 * count

    def _align(self, at: int, size: int) -> int:
        """The next byte at which a number of some size may begin, counted from the end of the encapsulation."""
        return at + (4 - at) % size if self._aligned else at


def _bytes(numbers: Sequence[float]) -> bytes:
    return np.asarray(numbers, dtype=np.float64).tobytes()
