"""Byte layouts of JointState payloads, to read the numbers of many messages at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model import JOINT_STATE, FloatArray, IntArray
from mobilecal_cli.readers.channels import Channel

#: Encodings in which equal lengths and names imply equal positions of the fields.
ENCODINGS = ("cdr", "ros1")
#: The stamp follows the encapsulation (CDR) or the sequence number (ROS 1), 4 bytes each.
_STAMP, _STAMP_END = 4, 12
_LITTLE_ENDIAN = b"\x00\x01"
_WORD = 8

Rows = NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False)
class Layout:
    """Common structure of one publisher's payloads.

    Attributes:
        kind: message type, encoding and length, bytes.
        template: (words,) uint64: one of the payloads.
        fixed: (words,) uint64: mask of the bits equal in all: all but stamp, sequence number, padding and numbers.
        names: the joints, in order.
        numbers: field ("position", "velocity", "effort") → offset of its first number, bytes, and number of elements.
    """

    kind: tuple[str, str, int]
    template: NDArray[np.uint64]
    fixed: NDArray[np.uint64]
    names: tuple[str, ...]
    numbers: dict[str, tuple[int, int]]

    def fits(self, rows: Rows) -> NDArray[np.bool_]:
        """(n,) which payloads have this layout; rows as returned by `gathered`."""
        different = (rows.view(np.uint64) ^ self.template) & self.fixed
        return np.asarray(~different.any(axis=1))

    def stamps(self, rows: Rows) -> tuple[IntArray, IntArray]:
        """Seconds (n,) and nanoseconds (n,) of the header stamps."""
        stamp = np.ascontiguousarray(rows[:, _STAMP:_STAMP_END])
        return stamp.view("<i4")[:, 0].astype(np.int64), stamp.view("<u4")[:, 1].astype(np.int64)

    def column(self, rows: Rows, field: str, place: int) -> FloatArray | None:
        """(n,) one element of a field; None if the field is shorter."""
        begin, count = self.numbers[field]
        if place >= count:
            return None
        at = begin + 8 * place
        column: FloatArray = np.ascontiguousarray(rows[:, at : at + 8]).view("<f8")[:, 0]
        return column


def gathered(payloads: Sequence[bytes]) -> Rows:
    """(n, size) uint8 of payloads of equal length, padded to whole words of 8 bytes."""
    size = len(payloads[0])
    gap = bytes(-size % _WORD)
    return np.frombuffer(gap.join(payloads) + gap, np.uint8).reshape(len(payloads), size + len(gap))


def layout_of(channel: Channel, payload: bytes) -> Layout | None:
    """Layout of a payload; None if it is damaged, or not a JointState in one of the encodings.

    The layout is verified: the decoder must find the numbers at the same positions.
    """
    if channel.type != JOINT_STATE or channel.encoding not in ENCODINGS:
        return None
    aligned = channel.encoding == "cdr"
    if aligned and not payload.startswith(_LITTLE_ENDIAN):
        return None
    try:
        message = channel.decode(memoryview(payload))
        walk = _Walk(payload, aligned)
    except (RecordingError, ValueError):
        return None
    if any(_place(payload, getattr(message, field)) != place for field, place in walk.numbers.items()):
        return None
    template, fixed = (gathered([bytes(row)]).view(np.uint64)[0] for row in (payload, walk.fixed))
    kind = (channel.type, channel.encoding, len(payload))
    return Layout(kind, template, fixed, tuple(message.name), walk.numbers)


class _Walk:
    """Parses a JointState once.

    Attributes:
        fixed: 255 for each byte that belongs to the layout, 0 for the others.
        numbers: see `Layout`.
    """

    def __init__(self, payload: bytes, aligned: bool) -> None:
        self._payload, self._aligned = payload, aligned
        self._at = _STAMP_END
        self.fixed = bytearray(len(payload))
        if aligned:
            self._fix(0, _STAMP)
        self._text()  # the frame
        for _ in range(self._word()):
            self._text()
        self.numbers = {field: self._numbers() for field in ("position", "velocity", "effort")}

    def _fix(self, begin: int, end: int) -> None:
        if end > len(self._payload):
            raise ValueError("a field extends beyond the end of the message")
        self.fixed[begin:end] = b"\xff" * (end - begin)

    def _align(self, size: int) -> None:
        if self._aligned:  # counted from the end of the encapsulation
            self._at += (_STAMP - self._at) % size

    def _word(self) -> int:
        self._align(4)
        begin = self._at
        self._at += 4
        self._fix(begin, self._at)
        return int.from_bytes(self._payload[begin : self._at], "little")

    def _text(self) -> None:
        size = self._word()
        self._fix(self._at, self._at + size)
        self._at += size

    def _numbers(self) -> tuple[int, int]:
        count = self._word()
        if not count:
            return 0, 0
        self._align(8)
        begin = self._at
        self._at += 8 * count
        return begin, count


def _place(payload: bytes, numbers: Any) -> tuple[int, int] | None:  # noqa: ANN401 - what the decoder gives
    """Offset and length of a decoded array in its payload; None if it is not a view of it."""
    if not isinstance(numbers, np.ndarray) or numbers.dtype != np.dtype("<f8") or numbers.ndim != 1:
        return None
    if not len(numbers):
        return 0, 0
    at = _address(numbers) - _address(np.frombuffer(payload, np.uint8))
    return (at, len(numbers)) if 0 <= at <= len(payload) - numbers.nbytes else None


def _address(array: NDArray[Any]) -> int:
    return int(array.__array_interface__["data"][0])
