"""Rotation of each side: of a wheel from positions, velocities, a counter or odometry; of several wheels their mean."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

import numpy as np

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model import (
    SIDES,
    BoolArray,
    FloatArray,
    IntArray,
    Side,
    Track,
    WheelGeometry,
    WheelSource,
)
from mobilecal_cli.readers.signals.series import Samples, Series

#: A pause in a wheel's samples is a gap if it is this long and this many times the usual interval ...
GAP_S = 0.5
GAP_INTERVALS = 10
#: ... and is noted if the wheel turned by more than this during it.
GAP_RAD = 0.01
#: After a longer pause, a wheel may have turned by more than half the range of its readings.
PAUSE_S = 1.0
_TURN = 2 * math.pi
_SLACK = 1e-3


def from_positions(source: WheelSource, position: Samples, notes: list[str]) -> Track:
    """A wheel's track from positions, rad, or from a counter, ticks.

    Raises:
        RecordingError: readings do not fit the counter's width.
    """
    time_ns, readings = position.ordered(notes)
    value = readings[:, 0]
    if source.bits is not None:
        check_width(position.label, (value.min(), value.max()), source.bits)
        value = unwrap(time_ns, value, 2.0**source.bits)
    elif source.ticks_per_revolution is None and (jumps := _jumps_of_a_turn(time_ns, value)):
        notes.append(f"{position.label}: positions are wrapped to one turn; {jumps} jumps are undone")
        value = unwrap(time_ns, value, _TURN)
    return Track(time_ns, value * _scale(source))


def from_velocities(source: WheelSource, velocity: Samples, notes: list[str]) -> Track:
    """A wheel's track from velocities, rad/s or ticks/s, starting at zero."""
    time_ns, rate = velocity.ordered(notes)
    steps = np.diff(time_ns) * 1e-9 * (rate[1:, 0] + rate[:-1, 0]) / 2
    return Track(time_ns, np.concatenate([[0.0], np.cumsum(steps)]) * _scale(source))


def _scale(source: WheelSource) -> float:
    """Angle per unit of the readings, rad."""
    per_turn = source.ticks_per_revolution or _TURN
    return float(source.sign) * _TURN / per_turn


class Counter:
    """Readings of a counter relative to its first one: exact for integers of 64 bits, which floats are not.

    Args:
        label: name for messages.
        bits: width of a counter that wraps around; None: it does not wrap.
    """

    def __init__(self, label: str, bits: int | None) -> None:
        self._label, self._bits = label, bits
        self._first: float | None = None
        self._range: tuple[float, float] = (0, 0)

    def since_first(self, ticks: float) -> float:
        """Ticks since the first reading; of a counter that wraps, at most half its range to either side."""
        if not math.isfinite(ticks):
            return ticks
        if self._first is None:
            self._first = ticks
        self._range = min(self._range[0], ticks), max(self._range[1], ticks)
        since = ticks - self._first
        if self._bits is None:
            return since
        half = 1 << (self._bits - 1)
        return (since + half) % (2 * half) - half

    def check(self) -> None:
        """See `check_width`."""
        if self._bits is not None:
            check_width(self._label, self._range, self._bits)


def check_width(label: str, ticks: Iterable[float], bits: int) -> None:
    """Check that readings fit a counter's width, signed or not.

    Raises:
        RecordingError: one does not.
    """
    for reading in ticks:
        if not -(2 ** (bits - 1)) <= reading < 2**bits:
            raise RecordingError(
                f"{label}: a reading of {reading:.0f} does not fit a counter of {bits} bits",
                "correct the wheel's bits in rig.yaml",
            )


def unwrap(time_ns: IntArray, value: FloatArray, span: float) -> FloatArray:
    """Continuous values from readings that repeat after `span`: a counter, or an angle within one turn.

    Between two readings the value is expected to change by less than half of `span`; over a pause, by that much more or
    less than at the mean rate just before and after it.

    Args:
        time_ns: (n,) increasing.
        value: (n,) readings.
        span: 2 pi, or 2^bits.
    """
    step, seconds = np.diff(value), np.diff(time_ns) * 1e-9
    expected = np.zeros(len(step))
    pauses = np.flatnonzero(seconds > PAUSE_S)
    if len(pauses):
        rate = (step - span * np.round(step / span)) / seconds
        rate[pauses] = 0.0
        ends = np.maximum(pauses - 1, 0), np.minimum(pauses + 1, len(step) - 1)
        expected[pauses] = (rate[ends[0]] + rate[ends[1]]) / 2 * seconds[pauses]
    turns = np.round((expected - step) / span)
    return np.asarray(value + span * np.concatenate([[0.0], np.cumsum(turns)]), dtype=np.float64)


def _jumps_of_a_turn(time_ns: IntArray, value: FloatArray) -> int:
    """Number of jumps in positions that a driver wraps to one turn; 0 for other positions.

    Positions are wrapped if they never leave [-pi, pi] or [0, 2 pi], and jump, but always by more than three quarters
    of a turn. Changes over a pause tell nothing.
    """
    low, high = value.min(), value.max()
    turns = ((-math.pi, math.pi), (0.0, _TURN))
    if not any(low >= start - _SLACK and high <= end + _SLACK for start, end in turns):
        return 0
    step = np.abs(np.diff(value)[np.diff(time_ns) <= PAUSE_S * 1e9])
    jumps = step[step > math.pi]
    return 0 if np.any(jumps < 1.5 * math.pi) else len(jumps)


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


_SMALL = 1e-6
#: No wheeled robot moves or turns this far from one message to the next: the driver was reset.
_JUMP_M, _JUMP_RAD = 0.5, 1.5
#: Odometry that moves sideways by this much, and by this share of its way ahead, is not of a differential drive.
_ASIDE_M, _ASIDE_SHARE = 0.1, 0.1
#: The axle is elsewhere than the base frame if it is this far away.
_OFFSET_M = 0.01
#: No robot in front of a checkerboard drives so fast; one whose positions are in millimeters seems to.
_FAST_MPS = 20.0
_LEAST_INTERVAL_S = 0.01  # stamps of a burst of messages say nothing about the speed


class Odometry:
    """Poses of nav_msgs/Odometry on one topic.

    Args:
        baked_in: the wheels that the driver computed its poses with.
        assumed: these are assumed.

    Attributes:
        series: x, y and heading of each pose.
    """

    def __init__(self, topic: str, baked_in: WheelGeometry, *, assumed: bool = False) -> None:
        self.baked_in, self.assumed = baked_in, assumed
        self.series = Series(topic, f"pose on {topic}", width=3)

    def take(self, message: Any, time_ns: int, log_ns: int) -> None:  # noqa: ANN401 - the type is the recording's
        """Read one message."""
        position, turned = message.pose.pose.position, message.pose.pose.orientation
        self.series.add(time_ns, log_ns, position.x, position.y, 2 * math.atan2(turned.z, turned.w))

    def track(self, side: Side, samples: Samples, notes: list[str]) -> Track:
        """Rotation of a wheel, rad, starting at zero."""
        time_ns, pose = samples.ordered(notes)
        check_speed(samples.topic, time_ns, pose[:, :2])
        notes += check_forward(samples.topic, pose)
        right, left, jumps = rotations(pose[:, :2], pose[:, 2], self.baked_in)
        wheels = self.baked_in
        if self.assumed:
            notes.append(
                f"{samples.topic}: the poses of the odometry are used, its covariance is ignored; the result is the "
                "factors by which its distance and its rotation are wrong"
            )
        else:
            notes.append(
                f"{samples.topic}: wheel rotations are derived from odometry, assuming wheel radii of "
                f"{wheels.radius_left_m * 1e3:g} mm (left) and {wheels.radius_right_m * 1e3:g} mm (right) "
                f"and a separation of {wheels.separation_m * 1e3:g} mm; if the driver uses other values, the result "
                "has the same relative error; the covariance of the odometry is ignored"
            )
        if jumps:
            notes.append(
                f"{samples.topic}: the pose jumps {jumps} times; the wheels are assumed to stand still there"
            )
        return Track(time_ns, right if side == "right" else left)


def check_forward(topic: str, pose: FloatArray) -> list[str]:
    """Check that odometry moves ahead and turns, as a differential drive does.

    A base frame that is not midway between the wheels also moves sideways, but only where the base turns.

    Args:
        topic: the topic, for the message.
        pose: (n, 3) x, y, heading.

    Returns:
        A note on where the axle is, if it is not at the base frame.

    Raises:
        RecordingError: it moves sideways.
    """
    *steps, jumps = _steps(pose[:, :2], pose[:, 2])
    turn, ahead, aside = (values[~jumps] for values in steps)
    offset_m = float(aside @ turn) / max(float(turn @ turn), 1e-12)
    aside_m, path_m = float(np.abs(aside - offset_m * turn).sum()), float(np.abs(ahead).sum())
    if aside_m > _ASIDE_M and aside_m > _ASIDE_SHARE * path_m:
        raise RecordingError(
            f"{topic}: the odometry moves sideways, by {aside_m:.2f} m beside {path_m:.2f} m ahead: a differential "
            "drive cannot",
            "mecanum and other omnidirectional robots are not supported; name the odometry of the wheels, if this is "
            "another one",
        )
    if abs(offset_m) < _OFFSET_M:
        return []
    return [
        f"{topic}: the base frame of the odometry is {offset_m * 1e3:.0f} mm ahead of the axle, about which the base "
        "turns; camera poses are given against the axle"
    ]


def check_speed(topic: str, time_ns: IntArray, xy_m: FloatArray) -> None:
    """Check that odometry drives at the speed of a robot.

    Args:
        time_ns, xy_m: (n,) stamps and (n, 2) positions.

    Raises:
        RecordingError: usually, it is much too fast: its positions are in another unit.
    """
    step_m = np.hypot(*np.diff(xy_m, axis=0).T)
    drives = step_m > _SMALL
    speed_mps = step_m[drives] / np.maximum(np.diff(time_ns)[drives] * 1e-9, _LEAST_INTERVAL_S)
    if len(speed_mps) and (usual := float(np.median(speed_mps))) > _FAST_MPS:
        raise RecordingError(
            f"{topic}: the odometry drives at {usual:.0f} m/s (limit {_FAST_MPS:.0f} m/s): "
            "its positions are not in meters",
            "correct the unit in the driver of the odometry (millimeters?), and record again",
        )


def _steps(xy_m: FloatArray, heading_rad: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
    """Turn, way ahead and way to the left between consecutive poses, (n - 1,) each, and which of them are jumps."""
    turn = np.remainder(np.diff(heading_rad) + math.pi, 2 * math.pi) - math.pi
    step = np.diff(xy_m, axis=0)
    middle = heading_rad[:-1] + turn / 2
    ahead = step[:, 0] * np.cos(middle) + step[:, 1] * np.sin(middle)
    left = step[:, 1] * np.cos(middle) - step[:, 0] * np.sin(middle)
    return turn, ahead, left, (np.hypot(*step.T) > _JUMP_M) | (np.abs(turn) > _JUMP_RAD)


def rotations(
    xy_m: FloatArray, heading_rad: FloatArray, wheels: WheelGeometry
) -> tuple[FloatArray, FloatArray, int]:
    """Wheel rotations that move a differential drive along poses (inverse of the paper's eqs. 8-10).

    Between two poses the base moves along an arc of length chord * h / sin(h), where h is half the turn.

    Args:
        xy_m: (n, 2) positions.
        heading_rad: (n,) headings, wrapped or not.

    Returns:
        (n,) right and left rotation starting at zero, rad, and the number of jumps.
    """
    turn, chord, _, jumps = _steps(xy_m, heading_rad)
    half = turn / 2
    small = np.abs(half) < _SMALL
    way = chord * np.where(small, 1.0, half / np.where(small, 1.0, np.sin(half)))
    way, turn = np.where(jumps, 0.0, way), np.where(jumps, 0.0, turn)
    ahead = turn * wheels.separation_m / 2
    right, left = (way + ahead) / wheels.radius_right_m, (way - ahead) / wheels.radius_left_m
    return (
        np.concatenate([[0.0], np.cumsum(right)]),
        np.concatenate([[0.0], np.cumsum(left)]),
        int(jumps.sum()),
    )


#: Wheels are compared over windows of this length in which one of them turns by this much.
_WINDOW_S, _TURNS_RAD = 1.0, 0.2
#: Two wheels differ in a window by more than this, and by more than this share of the larger rotation ...
_DIFFER_RAD, _DIFFER_SHARE = 0.15, 0.1
#: ... and disagree if they do so in more than this share of the windows, or differ by this share over all of them.
_WINDOWS_SHARE, _TOTAL_SHARE = 0.1, 0.05
#: A wheel that turns by less than this share of the others' rotation stands still.
_STILL_SHARE = 0.01
#: Share of the windows in which the opposite side turns too: that side says that the robot moves.
_OPPOSITE_SHARE = 0.5


def _compared(turned_rad: FloatArray) -> tuple[BoolArray, BoolArray]:
    """In which windows two wheels of a side differ, (K, K, W), and whether they agree over the recording, (K, K).

    Args:
        turned_rad: (W, K) rotation of the wheels in each window with motion.
    """
    turned = turned_rad.T
    size = np.abs(turned)
    limit = np.maximum(_DIFFER_RAD, _DIFFER_SHARE * np.maximum(size[:, None], size))
    differ = np.abs(turned[:, None] - turned) > limit
    path = size.sum(axis=1)
    alike = np.minimum.outer(path, path) >= (1 - _TOTAL_SHARE) * np.maximum.outer(path, path)
    return differ, alike & (differ.sum(axis=2) <= _WINDOWS_SHARE * len(turned_rad))


def _stands(size: FloatArray, differ: BoolArray, opposite: BoolArray) -> bool:
    """Whether a wheel stands still in most windows in which it differs from another, and the robot moves there.

    Args:
        size: (2, W) absolute rotation of the wheel and of the other one.
        differ: (W,) windows in which they differ.
        opposite: (W,) windows in which the opposite side turns.
    """
    own, other = size[:, differ]
    still = own <= _STILL_SHARE * other
    return bool(still.mean() > 1 - _WINDOWS_SHARE and opposite[differ].mean() > _OPPOSITE_SHARE)


def sides_of(wheels: Mapping[Side, Sequence[tuple[str, Track]]], notes: list[str]) -> dict[Side, Track]:
    """One track for each side; notes name the wheels that are left out.

    Args:
        wheels: the wheels of each side, with a name for messages.
        notes: receives what is left out.

    Raises:
        RecordingError: the wheels of a side disagree, and the data does not show which of them is wrong.
    """
    if all(len(each) == 1 for each in wheels.values()):
        return {side: each[0][1] for side, each in wheels.items()}
    times_ns = _windows(wheels)
    turned = {
        side: np.stack([np.diff(track.at(times_ns)) for _, track in each], axis=1)
        for side, each in wheels.items()
    }
    tracks: dict[Side, Track] = {}
    for side, opposite in zip(SIDES, reversed(SIDES), strict=True):
        moves = np.abs(turned[side]).max(axis=1) > _TURNS_RAD
        also = np.abs(turned[opposite][moves]).max(axis=1, initial=0.0) > _TURNS_RAD
        kept = _kept(side, [name for name, _ in wheels[side]], turned[side][moves], also, notes)
        tracks[side] = _mean([wheels[side][k][1] for k in kept])
    return tracks


def _windows(wheels: Mapping[Side, Sequence[tuple[str, Track]]]) -> IntArray:
    """Ends of the windows, within the time of all wheels."""
    tracks = [track for each in wheels.values() for _, track in each]
    first, last = max(t.time_ns[0] for t in tracks), min(t.time_ns[-1] for t in tracks)
    if last <= first:
        raise RecordingError(
            "the wheels were not recorded at the same time", "record all wheels during the whole recording"
        )
    return np.linspace(first, last, max(2, round((last - first) * 1e-9 / _WINDOW_S) + 1)).astype(np.int64)


def _kept(
    side: Side, names: Sequence[str], turned_rad: FloatArray, opposite: BoolArray, notes: list[str]
) -> tuple[int, ...]:
    """Indices of the wheels that turn alike: more than half of those that do not stand still, or all of them.

    Args:
        names: of the wheels, for messages.
        turned_rad: (W, K) rotation of the wheels in each window with motion.
        opposite: (W,) whether the opposite side turns too.
        notes: receives what is left out.
    """
    every, size = range(len(names)), np.abs(turned_rad)
    differ, agree = _compared(turned_rad)
    stand = {
        a
        for a, b in itertools.permutations(every, 2)
        if not agree[a, b] and differ[a, b].any() and _stands(size.T[[a, b]], differ[a, b], opposite)
    }
    moving = [k for k in every if k not in stand]
    groups = (group for count in range(len(moving), 0, -1) for group in itertools.combinations(moving, count))
    kept = next((group for group in groups if agree[np.ix_(group, group)].all()), ())
    total, windows = size.sum(axis=0), len(turned_rad)
    if not kept or 2 * len(kept) <= len(moving):
        disagree = (pair for pair in itertools.combinations(moving or every, 2) if not agree[pair])
        a, b = next(disagree, (0, 0))
        x, y = turned_rad[:, [a, b]].T
        opposite_ways = float(x @ y) < -0.5 * float(np.linalg.norm(x) * np.linalg.norm(y))
        what = "turn in opposite directions" if opposite_ways else "do not turn alike"
        cure = "find out which is wrong"
        if opposite_ways:
            cure = f"set wheels.{side}.signs, with -1 for a wheel that counts backward"
        raise RecordingError(
            f"{names[a]} and {names[b]} {what}: they differ by more than 10 % in {int(differ[a, b].sum())} of "
            f"{windows} seconds with motion, and turn by {total[a]:.1f} and {total[b]:.1f} rad; the data does not "
            "show which of them is wrong",
            f"{cure}, or name the wheels to read in wheels.{side}.joints or wheels.{side}.fields; the wheels "
            "of mecanum and other omnidirectional robots differ always: they are not supported",
        )
    usual = float(np.median(total[list(kept)]))
    for k in every:
        if k not in kept:
            why = "stands still in" if k in stand else "differs by more than 10 % in"
            notes.append(
                f"{names[k]}: left out, it {why} {int(differ[k, kept[0]].sum())} of {windows} seconds with motion; "
                f"it turns by {total[k]:.1f} rad, the other {side} wheels by {usual:.1f} rad"
            )
    return kept


def _mean(tracks: Sequence[Track]) -> Track:
    """Mean rotation of some wheels, at the times of the one with most readings while all were recorded."""
    if len(tracks) == 1:
        return tracks[0]
    first, last = max(t.time_ns[0] for t in tracks), min(t.time_ns[-1] for t in tracks)
    times_ns = max((t.time_ns for t in tracks), key=len)
    times_ns = times_ns[(times_ns >= first) & (times_ns <= last)]
    return Track(times_ns, np.mean([track.at(times_ns) for track in tracks], axis=0))
