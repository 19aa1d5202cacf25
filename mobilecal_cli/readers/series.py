"""Time series of readings, and the tracks made from them."""

from __future__ import annotations

import math
from array import array

import numpy as np

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model import BoolArray, FloatArray, IntArray, Track, WheelSource
from mobilecal_cli.readers.stamps import in_order

#: A pause in a wheel's samples is a gap if it is this long and this many times the usual interval ...
GAP_S = 0.5
GAP_INTERVALS = 10
#: ... and is noted if the wheel turned by more than this during it.
GAP_RAD = 0.01
#: Positions wrapped to one turn jump by almost a turn within this time.
WRAP_S = 1.0


class Series:
    """Readings of one quantity, 16 bytes each.

    Args:
        label: name for messages ("joint head_pan_joint on /joint_states").
    """

    def __init__(self, label: str) -> None:
        self.label = label
        self._time_ns = array("q")
        self._value = array("d")
        self.not_finite = 0

    def __len__(self) -> int:
        return len(self._time_ns)

    def add(self, time_ns: int, value: float) -> None:
        """Append a reading; one that is not finite is counted and dropped."""
        if math.isfinite(value):
            self._time_ns.append(time_ns)
            self._value.append(value)
        else:
            self.not_finite += 1

    def extend(self, time_ns: IntArray, value: FloatArray) -> None:
        """Append (n,) readings."""
        finite = np.isfinite(value)
        self.not_finite += len(value) - int(finite.sum())
        self._time_ns.frombytes(time_ns[finite].tobytes())
        self._value.frombytes(value[finite].tobytes())

    def ordered(self, notes: list[str]) -> tuple[IntArray, FloatArray]:
        """Strictly increasing times, and values; notes what is dropped.

        Raises:
            RecordingError: no finite reading.
        """
        if self.not_finite:
            total = self.not_finite + len(self)
            if not len(self):
                raise RecordingError(
                    f"{self.label}: all {total} readings are NaN or infinite",
                    "check the driver that publishes them",
                )
            notes.append(f"{self.label}: {self.not_finite} of {total} readings are NaN or infinite; dropped")
        time_ns = np.array(self._time_ns, dtype=np.int64)
        keep, found = order_notes(self.label, time_ns)
        notes += found
        return time_ns[keep], np.array(self._value, dtype=np.float64)[keep]


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


class TickCounter:
    """Converts readings of a counter to a continuous angle that starts at zero.

    A counter of `bits` bits wraps around. Differences are assumed to be less than half its range, so they are the same
    for signed and unsigned counters.

    Args:
        series: receives the angles, rad.
        source: scale, width and sign.
    """

    def __init__(self, series: Series, source: WheelSource) -> None:
        self.series = series
        self._range = None if source.bits is None else 2**source.bits
        self._scale = source.sign * (2 * math.pi / (source.ticks_per_revolution or 2 * math.pi))
        self._last: float | None = None
        self._total: float = 0

    def add(self, time_ns: int, ticks: float) -> None:
        """Take a reading.

        Raises:
            RecordingError: the reading does not fit the counter's width.
        """
        if not math.isfinite(ticks):
            self.series.add(time_ns, ticks)
            return
        if self._range is not None and not -self._range // 2 <= ticks < self._range:
            raise RecordingError(
                f"{self.series.label}: a reading of {ticks} does not fit a counter of "
                f"{self._range.bit_length() - 1} bits",
                "correct the wheel's bits in rig.yaml",
            )
        if self._last is not None:
            step = ticks - self._last
            if self._range is not None:
                step %= self._range
                if step >= self._range / 2:
                    step -= self._range
            self._total += step
        self._last = ticks
        self.series.add(time_ns, self._total * self._scale)


def wheel_track(position: Series, velocity: Series, source: WheelSource, notes: list[str]) -> Track:
    """A wheel's track from joint states: positions, or integrated velocities if there are none.

    Args:
        position: rad (or ticks, with `source.ticks_per_revolution`).
        velocity: rad/s (or ticks/s).
        source: scale and sign.
        notes: receives remarks.

    Raises:
        RecordingError: no finite reading of either.
    """
    scale = source.sign * (2 * math.pi / (source.ticks_per_revolution or 2 * math.pi))
    if len(position) or not len(velocity):
        if not len(position) and not position.not_finite:
            raise RecordingError(
                f"{position.label}: neither positions nor velocities in its messages",
                "set another source for the wheel in rig.yaml",
            )
        time_ns, value = position.ordered(notes)
        if source.ticks_per_revolution is None:
            value = _unwrapped(position.label, time_ns, value, notes)
        return Track(time_ns, value * scale)
    if position.not_finite:
        notes.append(f"{position.label}: all {position.not_finite} positions are NaN or infinite")
    time_ns, rate = velocity.ordered(notes)
    notes.append(f"{position.label}: no positions; velocities are integrated")
    steps = np.diff(time_ns) * 1e-9 * (rate[1:] + rate[:-1]) / 2
    return Track(time_ns, np.concatenate([[0.0], np.cumsum(steps)]) * scale)


def _unwrapped(label: str, time_ns: IntArray, value: FloatArray, notes: list[str]) -> FloatArray:
    """Unwrap positions that a driver wraps to one turn; other positions are returned unchanged.

    Positions are wrapped if they never leave [-pi, pi] or [0, 2 pi], and jump by more than three quarters of a turn,
    each time within a second.
    """
    slack = 1e-3
    low, high = value.min(), value.max()
    in_turn = low >= -math.pi - slack and high <= math.pi + slack
    if not (in_turn or (low >= -slack and high <= 2 * math.pi + slack)):
        return value
    step = np.abs(np.diff(value))
    jumps = step > math.pi
    if not jumps.any():
        return value
    if np.any(step[jumps] < 1.5 * math.pi) or np.any(np.diff(time_ns)[jumps] > WRAP_S * 1e9):
        return value
    notes.append(f"{label}: positions are wrapped to one turn; {int(jumps.sum())} jumps are undone")
    return np.unwrap(value)


def gap_notes(label: str, track: Track) -> list[str]:
    """Notes on pauses during which a wheel turned, because its path in them is unknown."""
    if len(track.time_ns) < 3:
        return []
    pauses_s = np.diff(track.time_ns) * 1e-9
    turned = np.abs(np.diff(track.value))
    limit_s = max(GAP_S, GAP_INTERVALS * float(np.median(pauses_s)))
    gaps = np.flatnonzero((pauses_s > limit_s) & (turned > GAP_RAD))
    if not len(gaps):
        return []
    worst = gaps[np.argmax(turned[gaps])]
    start_s = (track.time_ns[worst] - track.time_ns[0]) * 1e-9
    return [
        f"{label}: {len(gaps)} gap{'s' if len(gaps) > 1 else ''} during which the wheel turned; the worst lasts "
        f"{pauses_s[worst]:.2f} s from {start_s:.2f} s on, with {turned[worst]:.3f} rad"
    ]
