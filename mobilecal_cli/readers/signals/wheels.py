"""Rotation of each side: of a wheel from positions, velocities, a counter or odometry; of several wheels their mean."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
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
    turn = np.remainder(np.diff(pose[:, 2]) + math.pi, 2 * math.pi) - math.pi
    step = np.diff(pose[:, :2], axis=0)
    sound = (np.hypot(*step.T) < _JUMP_M) & (np.abs(turn) < _JUMP_RAD)
    middle = pose[:-1, 2] + turn / 2
    ahead = (step[:, 0] * np.cos(middle) + step[:, 1] * np.sin(middle))[sound]
    aside = (step[:, 1] * np.cos(middle) - step[:, 0] * np.sin(middle))[sound]
    turn = turn[sound]
    offset_m = float(aside @ turn / max(turn @ turn, 1e-12))
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
    turn = np.remainder(np.diff(heading_rad) + math.pi, 2 * math.pi) - math.pi
    step = np.diff(xy_m, axis=0)
    half = turn / 2
    middle = heading_rad[:-1] + half
    forward = step[:, 0] * np.cos(middle) + step[:, 1] * np.sin(middle)
    small = np.abs(half) < _SMALL
    way = forward * np.where(small, 1.0, half / np.where(small, 1.0, np.sin(half)))
    jumps = (np.hypot(*step.T) > _JUMP_M) | (np.abs(turn) > _JUMP_RAD)
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


@dataclass(frozen=True, slots=True, eq=False)
class _Windows:
    """Rotation of the wheels of one side in each window with motion.

    Attributes:
        turned_rad: (W, K).
        opposite: (W,) whether the opposite side turns too.
    """

    turned_rad: FloatArray
    opposite: BoolArray

    def differ(self, a: int, b: int) -> BoolArray:
        """(W,) windows in which two wheels differ."""
        x, y = self.turned_rad[:, a], self.turned_rad[:, b]
        limit = np.maximum(_DIFFER_RAD, _DIFFER_SHARE * np.maximum(np.abs(x), np.abs(y)))
        return np.asarray(np.abs(x - y) > limit)

    def agree(self, a: int, b: int) -> bool:
        """Whether two wheels turn alike over the recording."""
        if not len(self.turned_rad):
            return True
        path = np.abs(self.turned_rad[:, [a, b]]).sum(axis=0)
        alike = float(path.min()) >= (1 - _TOTAL_SHARE) * float(path.max())
        return alike and bool(self.differ(a, b).mean() <= _WINDOWS_SHARE)

    def stands(self, wheel: int) -> bool:
        """Whether a wheel stands still in most windows in which it differs from another, and the robot moves there."""
        for other in range(self.turned_rad.shape[1]):
            differ = self.differ(wheel, other)
            turned = np.abs(self.turned_rad[differ])
            if self.agree(wheel, other) or not len(turned):
                continue
            still = turned[:, wheel] <= _STILL_SHARE * turned[:, other]
            if still.mean() > 1 - _WINDOWS_SHARE and self.opposite[differ].mean() > _OPPOSITE_SHARE:
                return True
        return False


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
        kept = _kept(side, wheels[side], _Windows(turned[side][moves], also), notes)
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
    side: Side, wheels: Sequence[tuple[str, Track]], windows: _Windows, notes: list[str]
) -> tuple[int, ...]:
    """Indices of the wheels that turn alike: more than half of those that do not stand still, or all of them."""
    stand = [k for k in range(len(wheels)) if windows.stands(k)]
    moving = [k for k in range(len(wheels)) if k not in stand]
    groups = (group for size in range(len(moving), 0, -1) for group in itertools.combinations(moving, size))
    kept = next(
        (group for group in groups if all(windows.agree(a, b) for a, b in itertools.combinations(group, 2))),
        (),
    )
    if not kept or 2 * len(kept) <= len(moving):
        raise _disagreement(side, wheels, windows, moving or list(range(len(wheels))))
    total = np.abs(windows.turned_rad).sum(axis=0)
    usual = float(np.median(total[list(kept)]))
    for k, (name, _) in enumerate(wheels):
        if k not in kept:
            differ = windows.differ(k, kept[0])
            why = "stands still in" if k in stand else "differs by more than 10 % in"
            notes.append(
                f"{name}: left out, it {why} {int(differ.sum())} of {len(differ)} seconds with motion; it turns by "
                f"{total[k]:.1f} rad, the other {side} wheels by {usual:.1f} rad"
            )
    return kept


def _disagreement(
    side: Side, wheels: Sequence[tuple[str, Track]], windows: _Windows, moving: Sequence[int]
) -> RecordingError:
    a, b = next(
        (pair for pair in itertools.combinations(moving, 2) if not windows.agree(*pair)),
        (moving[0], moving[0]),
    )
    total = np.abs(windows.turned_rad).sum(axis=0)
    x, y = windows.turned_rad[:, [a, b]].T
    opposite = float(x @ y) < -0.5 * float(np.linalg.norm(x) * np.linalg.norm(y))
    differ = windows.differ(a, b)
    names = f"{wheels[a][0]} and {wheels[b][0]}"
    what = "turn in opposite directions" if opposite else "do not turn alike"
    cure = (
        f"set wheels.{side}.signs, with -1 for a wheel that counts backward"
        if opposite
        else "find out which is wrong"
    )
    return RecordingError(
        f"{names} {what}: they differ by more than 10 % in {int(differ.sum())} of {len(differ)} seconds with motion, "
        f"and turn by {total[a]:.1f} and {total[b]:.1f} rad; the data does not show which of them is wrong",
        f"{cure}, or name the wheels to read in wheels.{side}.joints or wheels.{side}.fields; the wheels "
        "of mecanum and other omnidirectional robots differ always: they are not supported",
    )


def _mean(tracks: Sequence[Track]) -> Track:
    """Mean rotation of some wheels, at the times of the one with most readings while all were recorded."""
    if len(tracks) == 1:
        return tracks[0]
    first, last = max(t.time_ns[0] for t in tracks), min(t.time_ns[-1] for t in tracks)
    times_ns = max((t.time_ns for t in tracks), key=len)
    times_ns = times_ns[(times_ns >= first) & (times_ns <= last)]
    return Track(times_ns, np.mean([track.at(times_ns) for track in tracks], axis=0))
