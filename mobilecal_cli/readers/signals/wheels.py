"""Rotation of a wheel: from joint states, a counter, or odometry."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model.arrays import BoolArray, FloatArray, IntArray
from mobilecal_cli.model.rig import Side, WheelGeometry, WheelSource
from mobilecal_cli.model.signals import TURNS_AT_REST, Track, pauses
from mobilecal_cli.model.text import listed
from mobilecal_cli.readers.messages.types import Decoded
from mobilecal_cli.readers.signals.joints import StatedJoint
from mobilecal_cli.readers.signals.series import Samples
from mobilecal_cli.readers.signals.sources import FieldSource, Source, Subscriptions

#: After a longer pause, a wheel may have turned by more than half the range of its readings.
PAUSE_S = 1.0
_TURN = 2 * math.pi
_SLACK = 1e-3  # of a turn, by which rounded positions leave it
#: Widths at which counters start again. They jump then by at least this many times their largest other step.
_WIDTHS, _JUMP = (8, 16, 32), 3
_MOST_BITS = 32  # no wheel turns by half the range of such a counter; wider ones start again there, too
_DRIVEN = 0.01  # m/s, rad/s: no noise of a twist
#: Steps between two readings that are no motion: they are few, larger than a turn, and so many times as fast as nearly
#: all others. No wheel accelerates like that from one reading to the next; a driver that starts again does.
_JUMP_SHARE, _JUMP_SPEED = 0.01, 20.0
_LEAST_INTERVAL_S = 0.01  # stamps of a burst of messages say nothing about the speed
#: Readings, rad or m, that are zero after a pause, and were not before it: a driver that started again.
_ZERO, _NOT_ZERO = 1e-3, 0.05


def from_positions(source: WheelSource, position: Samples, notes: list[str], zero: float = 0.0) -> Track:
    """A wheel's track from positions, rad, or from a counter, ticks.

    Args:
        zero: the reading of a driver that starts.

    Raises:
        RecordingError: readings do not fit the counter's width.
    """
    time_ns, readings = position.ordered(notes)
    value, turn = readings[:, 0], source.ticks_per_revolution or _TURN
    restarts = starts_again(time_ns, (readings - zero) * _scale(source))
    bits = source.bits
    if bits is not None:
        check_width(position.label, (value.min(), value.max()), bits)
    elif source.ticks_per_revolution is not None and (bits := wraps(value)[0]) is not None:
        notes.append(f"{position.label}: the counter starts again after 2^{bits} steps, which is undone")
    if bits is not None:
        value = unwrap(time_ns, value, 2.0**bits)
    elif jumps := _jumps_of_a_turn(time_ns, value, turn):
        notes.append(f"{position.label}: positions are wrapped to one turn; {jumps} jumps are undone")
        value = unwrap(time_ns, value, turn)
    return without_jumps(position.label, Track(time_ns, value * _scale(source)), notes, restarts)


def _scale(source: WheelSource) -> float:
    """Angle per unit of the readings, rad."""
    per_turn = source.ticks_per_revolution or _TURN
    return float(source.sign) * _TURN / per_turn


class JointWheel(StatedJoint):
    """The positions of a wheel in the joint states of one topic.

    Args:
        velocity: of the same joint, used if there are no positions.
    """

    def __init__(self, side: Side, source: WheelSource, velocity: JointWheelVelocity) -> None:
        super().__init__(source.topic, velocity.name)
        self._side, self._source, self._velocity = side, source, velocity

    def checked(self, notes: list[str]) -> Source:
        """Use the velocities if there are no positions, or if these never change while the velocities do.

        Raises:
            RecordingError: there are neither.
        """
        velocity = self._velocity
        if self.name not in self.present:
            raise RecordingError(
                f"no joint {self.name} on {self.topic}; joints present: {listed(self.present)}",
                f"correct wheels.{self._side}.joint in rig.yaml",
            )
        if not (len(self) or self.impossible or len(velocity)):
            raise RecordingError(
                f"{self.label}: neither positions nor velocities in its messages",
                "set another source for the wheel in rig.yaml",
            )
        if self.range or not len(velocity) or (len(self) and not velocity.range):
            return self
        if self.impossible and not len(self):
            notes.append(f"{self.label}: {self.impossible_words}")
        instead = "positions that never change" if len(self) else "no positions"
        notes.append(f"{self.label}: {instead}; velocities are integrated")
        return velocity

    def track(self, samples: Samples, notes: list[str]) -> Track:
        return from_positions(self._source, samples, notes)


class JointWheelVelocity(StatedJoint):
    """The velocities of a wheel in the joint states of one topic."""

    def __init__(self, source: WheelSource, joint: str) -> None:
        super().__init__(source.topic, joint, "velocity")
        self._source = source

    def track(self, samples: Samples, notes: list[str]) -> Track:
        """Rotation of the wheel, rad, starting at zero."""
        time_ns, rate = samples.ordered(notes)
        steps = np.diff(time_ns) * 1e-9 * (rate[1:, 0] + rate[:-1, 0]) / 2
        track = Track(time_ns, np.concatenate([[0.0], np.cumsum(steps)]) * _scale(self._source))
        return without_jumps(samples.label, track, notes)


class FieldWheel(FieldSource):
    """A wheel in a field of any message: an angle, or a counter.

    Readings are stored relative to the first one: exact for integers of 64 bits, which floats are not.
    """

    def __init__(self, side: Side, source: WheelSource, field: str) -> None:
        super().__init__(source.topic, field, f"{side} wheel", f"wheels.{side}.field")
        self._source = source
        self._first: float | None = None
        self._range: tuple[float, float] = (0, 0)

    def reading(self, value: float) -> float:
        """Ticks since the first reading, at most half the counter's range to either side."""
        if not math.isfinite(value):
            return value
        if self._first is None:
            self._first = value
        self._range = min(self._range[0], value), max(self._range[1], value)
        since = value - self._first
        half = 1 << ((self._source.bits or _MOST_BITS) - 1)
        return since if -half <= since < half else (since + half) % (2 * half) - half

    def checked(self, notes: list[str]) -> Source:
        """See `check_width`, and `FieldSource.checked`."""
        if self._source.bits is not None:
            check_width(self.label, self._range, self._source.bits)
        return super().checked(notes)

    def track(self, samples: Samples, notes: list[str]) -> Track:
        return from_positions(self._source, samples, notes, zero=self.reading(0.0))


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
    expected[pauses] = _at_mean_rate(step - span * np.round(step / span), seconds, pauses)
    turns = np.round((expected - step) / span)
    return np.asarray(value + span * np.concatenate([[0.0], np.cumsum(turns)]), dtype=np.float64)


def _at_mean_rate(step: FloatArray, seconds: FloatArray, unknown: IntArray) -> FloatArray:
    """Unknown steps, (len(unknown),), at the mean of the known rates just before and just after them."""
    known = np.setdiff1d(np.arange(len(step)), unknown)
    if not len(known):
        return np.zeros(len(unknown))
    place = np.searchsorted(known, unknown)
    ends = known[np.maximum(place - 1, 0)], known[np.minimum(place, len(known) - 1)]
    before, after = (step[each] / seconds[each] for each in ends)
    return np.asarray((before + after) / 2 * seconds[unknown], dtype=np.float64)


def starts_again(time_ns: IntArray, readings: FloatArray) -> BoolArray:
    """(n - 1,) over which pauses a driver starts again: its readings (n, k), rad or m, are zero after it."""
    size = np.abs(readings).max(axis=1)
    return np.asarray(pauses(time_ns) & (size[:-1] > _NOT_ZERO) & (size[1:] < _ZERO))


def without_jumps(label: str, track: Track, notes: list[str], known: BoolArray | None = None) -> Track:
    """The track of a wheel, rad, with the mean rate before and after in place of jumps; notes where they are.

    A driver that starts again jumps, and so does a position that is computed from a counter with an end.

    Args:
        known: (n - 1,) further steps that are jumps.
    """
    step, seconds = np.diff(track.value), np.diff(track.time_ns) * 1e-9
    speed = np.abs(step) / np.maximum(seconds, _LEAST_INTERVAL_S)
    fast = float(np.quantile(speed, 1 - _JUMP_SHARE, method="higher")) if len(speed) else 0.0
    too_fast = (speed > _JUMP_SPEED * fast) & (np.abs(step) > _TURN)
    jumps = np.flatnonzero(too_fast if known is None else too_fast | known)
    if fast == 0 or not len(jumps):
        return track
    first = jumps[0]
    at_s = (track.time_ns[first] - track.time_ns[0]) * 1e-9
    times = "once" if len(jumps) == 1 else f"{len(jumps)} times, first"
    how = f"{speed[first] / fast:.2g} times as fast as the wheel turns otherwise"
    if pauses(track.time_ns)[first] and not too_fast[first]:
        how = f"to zero in a pause of {seconds[first]:.1f} s"
    notes.append(
        f"{label}: the rotation jumps {times} by {step[first]:.4g} rad, {at_s:.1f} s after the start, {how} "
        "(a driver that started again?); the mean speed before and after is used there"
    )
    step[jumps] = _at_mean_rate(step, seconds, jumps)
    return Track(track.time_ns, track.value[0] + np.concatenate([[0.0], np.cumsum(step)]))


def _jumps_of_a_turn(time_ns: IntArray, value: FloatArray, turn: float) -> int:
    """Number of jumps in positions that a driver wraps to one turn; 0 for other positions.

    Positions (n,) are wrapped if they stay within one `turn`, in their unit, and jump, but always by more than three
    quarters of it. Changes over a pause tell nothing.
    """
    if np.ptp(value) > turn * (1 + _SLACK):
        return 0
    step = np.abs(np.diff(value)[np.diff(time_ns) <= PAUSE_S * 1e9])
    jumps = step[step > turn / 2]
    return 0 if np.any(jumps < 0.75 * turn) else len(jumps)


def wraps(ticks: FloatArray) -> tuple[int | None, int | None]:
    """How a counter starts again at its end, seen from jumps of nearly its whole range, but for one: a driver's start.

    Returns:
        Its width in bits, if the jumps fit one; else the size of its jumps, if there are any.
    """
    steps, spread = np.abs(np.diff(ticks)), np.ptp(ticks)
    jumps = steps > spread / 2
    usual = steps[~jumps].max(initial=0.0)
    if not jumps.any() or usual == 0 or steps[jumps].min() < _JUMP * usual:
        return None, None
    for bits in _WIDTHS:
        others = jumps & (steps <= 2**bits - 2 * usual - 1)
        if spread < 2**bits and others.sum() <= min(1, jumps.sum() - 1):
            return bits, None
    return None, int(steps[jumps].max()) if jumps.sum() > 1 else None


def gap_notes(label: str, track: Track) -> list[str]:
    """Notes on pauses during which a wheel turned, because its path in them is unknown."""
    gaps = track.gaps
    if not len(gaps):
        return []
    turned = np.abs(np.diff(track.value))
    worst = gaps[np.argmax(turned[gaps])]
    start_s, end_s = (track.time_ns[[worst, worst + 1]] - track.time_ns[0]) * 1e-9
    return [
        f"{label}: {len(gaps)} gap{'s' if len(gaps) > 1 else ''} during which the wheel turned; the worst lasts "
        f"{end_s - start_s:.2f} s from {start_s:.2f} s on, with {turned[worst]:.3f} rad"
    ]


_SMALL = 1e-6
#: No wheeled robot moves or turns this far from one message to the next: the driver was reset.
_JUMP_M, _JUMP_RAD = 0.5, 1.5
#: Odometry that moves sideways by this much, and by this share of its way ahead, is not of a differential drive.
_ASIDE_M, _ASIDE_SHARE = 0.1, 0.1
#: A step sideways is a jump, and no motion, if it is so many times as long as those before and after it, and at least
#: this share of the longest one.
_ALONE, _NOT_LEAST = 5.0, 0.1
#: The axle is elsewhere than the base frame if it is this far away.
_OFFSET_M = 0.01
#: No robot in front of a checkerboard drives so fast; one whose positions are in millimeters seems to.
_FAST_MPS = 20.0
#: A rest lasts so long. A gyro changes the heading in most messages, by more than rounding, and less than a base turns.
_REST_S, _MOSTLY, _LEAST_TURN, _SLOWLY_RADPS = 1.0, 0.5, 1e-9, 0.02
_FEW_RESTS = 3


@dataclass(frozen=True, eq=False)
class Odometry:
    """Poses of one topic of nav_msgs/Odometry.

    Attributes:
        topic: the topic, for messages.
        time_ns: (n,) stamps.
        pose: (n, 3) x, y (m), heading (rad), which may be wrapped.
    """

    topic: str
    time_ns: IntArray
    pose: FloatArray

    @cached_property
    def _steps(self) -> tuple[FloatArray, FloatArray, FloatArray, BoolArray]:
        """Turn, way ahead and way to the left between consecutive poses, (n - 1,) each, and which of them are jumps.

        Over a pause, only that of a driver that starts again is a jump.
        """
        turn = np.remainder(np.diff(self.pose[:, 2]) + math.pi, 2 * math.pi) - math.pi
        step = np.diff(self.pose[:, :2], axis=0)
        middle = self.pose[:-1, 2] + turn / 2
        ahead = step[:, 0] * np.cos(middle) + step[:, 1] * np.sin(middle)
        left = step[:, 1] * np.cos(middle) - step[:, 0] * np.sin(middle)
        far = (np.hypot(*step.T) > _JUMP_M) | (np.abs(turn) > _JUMP_RAD)
        return turn, ahead, left, far & ~pauses(self.time_ns) | starts_again(self.time_ns, self.pose)

    def check_forward(self) -> float:
        """Check that the base moves ahead and turns, as a differential drive does.

        Returns:
            How far the base frame is ahead of the axle, m; 0 if it is near.

        Raises:
            RecordingError: it moves sideways; the message says whether its poses jump, or a sign is wrong.
        """
        aside_m, path_m, offset_m = self._sideways()
        if not self._moves_sideways():
            return offset_m if abs(offset_m) >= _OFFSET_M else 0.0
        aside_m = np.abs(aside_m)
        beside_m = np.pad(aside_m, 1)
        alone = aside_m > _ALONE * np.maximum(beside_m[:-2], beside_m[2:])
        jumps = np.flatnonzero(alone & (aside_m > _NOT_LEAST * aside_m.max()))
        if not self._moves_sideways(jumps):
            first = jumps[0]
            by_m = math.dist(*self.pose[first : first + 2, :2])
            at_s = (self.time_ns[first + 1] - self.time_ns[0]) * 1e-9
            times = "once" if len(jumps) == 1 else f"{len(jumps)} times, first"
            raise RecordingError(
                f"{self.topic}: the odometry jumps sideways from one message to the next, {times} by {by_m:.2f} m "
                f"{at_s:.1f} s after the start: it does not follow the wheels alone",
                "record the odometry of the wheels alone, not one that a filter or a localization corrects, and do not "
                "reset it during the recording; if another topic has it, set wheels.odometry in rig.yaml",
            )
        what = (
            f"{self.topic}: the odometry moves sideways, by {aside_m.sum():.2f} m beside {path_m:.2f} m ahead"
        )
        if not np.ptp(self.pose[:, 2]):
            raise RecordingError(
                f"{what}, and its heading never changes",
                "have its driver publish the heading (pose.pose.orientation), or record wheel joints or counters",
            )
        if not replace(self, pose=self.pose * [1, -1, 1])._moves_sideways():
            raise RecordingError(
                f"{what}, but not with the sign of y reversed: the y axis of its positions points to the right (or "
                "the x axis backward, or the heading counts clockwise)",
                "correct the sign in the driver of the odometry (REP 103: x forward, y to the left, heading "
                "counterclockwise), and record again",
            )
        raise RecordingError(
            f"{what}: a differential drive cannot",
            "mecanum and other omnidirectional robots are not supported; name the odometry of the wheels, if this is "
            "another one",
        )

    def _sideways(self, jumping: IntArray | slice = slice(0)) -> tuple[FloatArray, float, float]:
        """Ways to the left, (n - 1,), way ahead in all, and how far the base frame is ahead of the axle, m.

        A base frame that is not midway between the wheels also moves sideways, but only where the base turns. Jumps
        count as no way, and so do pauses, in which the base may have driven any curve, and the steps `jumping`.
        """
        *steps, jumps = self._steps
        unknown = jumps | pauses(self.time_ns)
        unknown[jumping] = True
        turn, ahead, aside = (np.where(unknown, 0.0, values) for values in steps)
        offset_m = float(aside @ turn) / max(float(turn @ turn), 1e-12)
        return aside - offset_m * turn, float(np.abs(ahead).sum()), offset_m

    def _moves_sideways(self, jumping: IntArray | slice = slice(0)) -> bool:
        """Whether the ways sideways in each second add up: rounding changes its sign from one message to the next."""
        aside_m, path_m, _ = self._sideways(jumping)
        seconds = (self.time_ns[1:] - self.time_ns[0]) // 10**9
        in_seconds_m = np.bincount(np.unique(seconds, return_inverse=True)[1], aside_m)
        return float(np.abs(in_seconds_m).sum()) > max(_ASIDE_M, _ASIDE_SHARE * path_m)

    def turns_at_rest(self) -> list[str]:
        """A note on a heading that changes while the position does not, to the last bit: it is that of a gyro.

        Wheels that stand still change neither; those that turn the base in place turn it faster.
        """
        turn, time_ns = self._steps[0], self.time_ns
        slow = np.abs(turn) < _SLOWLY_RADPS * np.diff(time_ns) * 1e-9
        still = slow & np.all(np.diff(self.pose[:, :2], axis=0) == 0, axis=1)
        ends = np.flatnonzero(np.diff(still, prepend=False, append=False)).reshape(-1, 2)
        rest_s, turned, rests = 0.0, 0.0, 0
        for begin, end in ends.tolist():
            seconds = (time_ns[end] - time_ns[begin]) * 1e-9
            if seconds >= _REST_S and np.mean(np.abs(turn[begin:end]) > _LEAST_TURN) > _MOSTLY:
                rest_s, turned, rests = rest_s + seconds, turned + float(turn[begin:end].sum()), rests + 1
        if rests < _FEW_RESTS:
            return []
        return [
            f"{self.topic}: {TURNS_AT_REST}, by {math.degrees(turned) / rest_s * 60:.2g} degrees per minute"
        ]

    def check_speed(self) -> None:
        """Check that the base drives at the speed of a robot.

        Raises:
            RecordingError: usually, it is much too fast: its positions are in another unit.
        """
        step_m = np.hypot(*np.diff(self.pose[:, :2], axis=0).T)
        drives = step_m > _SMALL
        speed_mps = step_m[drives] / np.maximum(np.diff(self.time_ns)[drives] * 1e-9, _LEAST_INTERVAL_S)
        if len(speed_mps) and (usual := float(np.median(speed_mps))) > _FAST_MPS:
            raise RecordingError(
                f"{self.topic}: the odometry drives at {usual:.0f} m/s (limit {_FAST_MPS:.0f} m/s): "
                "its positions are not in meters",
                "correct the unit in the driver of the odometry (millimeters?), and record again",
            )

    def rotations(self, wheels: WheelGeometry) -> tuple[FloatArray, FloatArray, BoolArray]:
        """Wheel rotations that move a differential drive along the poses (inverse of the paper's eqs. 8-10).

        Between two poses the base moves along an arc of length chord * h / sin(h), where h is half the turn. It is
        assumed to do so over a pause, too, which `gap_notes` names.

        Returns:
            (n,) right and left rotation starting at zero, rad, and (n - 1,) which steps of them are jumps.
        """
        turn, chord, _, jumps = self._steps
        half = turn / 2
        small = np.abs(half) < _SMALL
        way = chord * np.where(small, 1.0, half / np.where(small, 1.0, np.sin(half)))
        ahead = turn * wheels.separation_m / 2
        right, left = (way + ahead) / wheels.radius_right_m, (way - ahead) / wheels.radius_left_m
        return np.concatenate([[0.0], np.cumsum(right)]), np.concatenate([[0.0], np.cumsum(left)]), jumps


class OdometryWheel(Source):
    """A wheel whose rotation follows from the poses (x, y, heading) of nav_msgs/Odometry.

    Args:
        wheels: with which the driver computed its poses, as the source states.

    Attributes:
        ahead_m: see `Odometry.check_forward`.
    """

    def __init__(self, side: Side, source: WheelSource, wheels: WheelGeometry) -> None:
        super().__init__(source.topic, f"pose on {source.topic}", width=3)
        self._side, self._source, self._wheels = side, source, wheels
        self.ahead_m, self._driven = 0.0, False

    def take(self, message: Decoded, time_ns: int, log_ns: int) -> None:
        position, turned = message.pose.pose.position, message.pose.pose.orientation
        if twist := getattr(message, "twist", None):
            self._driven |= max(abs(twist.twist.linear.x), abs(twist.twist.angular.z)) > _DRIVEN
        self.add(time_ns, log_ns, position.x, position.y, 2 * math.atan2(turned.z, turned.w))

    def checked(self, notes: list[str]) -> Source:
        """Check that the poses change as the robot drives.

        Raises:
            RecordingError: they do not, as those of a driver that publishes the twist alone.
        """
        if self._driven and not np.ptp(self.samples([]).value, axis=0).any():
            raise RecordingError(
                f"{self.topic}: all {len(self)} poses of the odometry are the same, though its twist says that the "
                "robot drives",
                "have the driver of the base publish the poses, not the twist alone",
            )
        return self

    def track(self, samples: Samples, notes: list[str]) -> Track:
        """Rotation of the wheel, rad, starting at zero."""
        odometry, wheels = Odometry(samples.topic, *samples.ordered(notes)), self._wheels
        odometry.check_speed()
        self.ahead_m = odometry.check_forward()
        if self.ahead_m:
            where = (
                f"{abs(self.ahead_m) * 1e3:.0f} mm {'ahead of' if self.ahead_m > 0 else 'behind'} the axle"
            )
            notes.append(
                f"{samples.topic}: the base frame of the odometry is {where}, about which the base turns"
            )
        notes += odometry.turns_at_rest()
        right, left, jumps = odometry.rotations(wheels)
        if self._source.assumed:
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
        track = Track(odometry.time_ns, right if self._side == "right" else left)
        return without_jumps(f"{self._side} wheel of the {samples.label}", track, notes, jumps)


def add_wheel(read: Subscriptions, side: Side, source: WheelSource) -> Source:
    """Read one wheel of a side.

    Raises:
        RecordingError: the topic is missing or has the wrong type, or the field is not a valid path.
    """
    if source.joint is not None:
        velocity = read.add(JointWheelVelocity(source, source.joint))
        return read.add(JointWheel(side, source, velocity))
    if source.baked_in is not None:
        return read.add(OdometryWheel(side, source, source.baked_in))
    assert source.field is not None  # a source has one of the three
    return read.add(FieldWheel(side, source, source.field))
