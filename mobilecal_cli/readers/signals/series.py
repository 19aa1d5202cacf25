"""Readings over time: collected during the pass, put in order after it."""

from __future__ import annotations

from array import array
from dataclasses import dataclass, replace

import numpy as np

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model import BoolArray, FloatArray, IntArray
from mobilecal_cli.ranges import READING
from mobilecal_cli.readers.signals.clocks import in_order


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Readings of one quantity, in order of arrival.

    Attributes:
        topic: where they come from.
        label: name for messages.
        stamp_ns, log_ns: (n,) stamps, and log times.
        value: (n, width) readings, finite.
        shift_ns: what the time of a reading is later than its stamp, because its clock stepped.
    """

    topic: str
    label: str
    stamp_ns: IntArray
    log_ns: IntArray
    value: FloatArray
    shift_ns: int = 0

    def __len__(self) -> int:
        return len(self.stamp_ns)

    @property
    def time_ns(self) -> IntArray:
        """(n,) times of the readings."""
        return self.stamp_ns + self.shift_ns

    def part(self, begin: int, end: int, shift_ns: int) -> Samples:
        """The readings from one index to another."""
        rows = slice(begin, end)
        stamp_ns, log_ns, value = self.stamp_ns[rows], self.log_ns[rows], self.value[rows]
        return replace(self, stamp_ns=stamp_ns, log_ns=log_ns, value=value, shift_ns=shift_ns)

    def ordered(self, notes: list[str]) -> tuple[IntArray, FloatArray]:
        """Strictly increasing times (n,), and values (n, width); notes what is dropped."""
        keep, found = order_notes(self.label, self.stamp_ns)
        notes += found
        return self.time_ns[keep], self.value[keep]


class Series:
    """Readings while they are collected, 16 bytes each and 8 for each number.

    Args:
        topic: where they come from.
        label: name for messages ("joint head_pan_joint on /joint_states").
        width: numbers of one reading; 0 for events without a value.
    """

    def __init__(self, topic: str, label: str, width: int = 1) -> None:
        self.topic, self.label = topic, label
        self._width = width
        self._stamp_ns, self._log_ns, self._value = array("q"), array("q"), array("d")
        self.not_finite = 0

    def __len__(self) -> int:
        return len(self._stamp_ns)

    def add(self, stamp_ns: int, log_ns: int, *value: float) -> None:
        """Append a reading; one that is not finite or impossibly large is counted and dropped."""
        for number in value:
            if number not in READING:
                self.not_finite += 1
                return
        self._stamp_ns.append(stamp_ns)
        self._log_ns.append(log_ns)
        self._value.extend(value)

    def samples(self, notes: list[str]) -> Samples:
        """All finite readings; notes how many are not.

        Raises:
            RecordingError: there are readings, but none is finite.
        """
        if self.not_finite:
            total = self.not_finite + len(self)
            if not len(self):
                raise RecordingError(
                    f"{self.label}: all {total} readings are NaN or infinite",
                    "check the driver that publishes them",
                )
            notes.append(f"{self.label}: {self.not_finite} of {total} readings are NaN or infinite; dropped")
        stamp_ns, log_ns = (np.array(times, dtype=np.int64) for times in (self._stamp_ns, self._log_ns))
        value = np.array(self._value, dtype=np.float64).reshape(len(stamp_ns), self._width)
        return Samples(self.topic, self.label, stamp_ns, log_ns, value)


def order_notes(label: str, time_ns: IntArray) -> tuple[BoolArray, list[str]]:
    """`in_order`, and notes on what it drops."""
    keep, duplicates, dropped, back_s = in_order(time_ns)
    notes = []
    if duplicates:
        notes.append(f"{label}: {duplicates} of {len(time_ns)} stamps occur twice; the first is kept")
    if dropped:
        notes.append(
            f"{label}: the clock steps back by up to {back_s:.3f} s; {dropped} of {len(time_ns)} samples "
            "are out of order and dropped"
        )
    return keep, notes
