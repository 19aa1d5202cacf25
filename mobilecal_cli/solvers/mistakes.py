"""Mistakes in a robot's description, and readings that stop: each with what gives the recording without it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mobilecal_cli.model import Extraction, FloatArray, HeadChain, IntArray, Observation, WheelTrack

STILL, MOVED = 1e-4, 0.05  # rad or m: a reading that stays the same, and one that changes
_FEWEST = 4  # stations with the same reading: fewer are no interruption
#: Delays of the wheels that are tried, their step, and how many of those at which the wheels stand still.
_LONGEST_DELAY_S, _DELAY_STEP_S, _DELAYS = 20.0, 0.25, 4
_MOSTLY_STILL = 0.1  # share of stations that may be left out of a delay's stop
_REVERSALS = 24  # stations of a recording at which a wheel's sign may change
_AROUND_NS = 100_000_000

Correction = Callable[[Extraction], Extraction]


@dataclass(frozen=True, slots=True, eq=False)
class Mistake:
    """A mistake in the description, and what gives the recording without it."""

    cause: str
    cure: str
    corrected: Correction


def _with_joints(scale: FloatArray | float, order: IntArray | None = None) -> Correction:
    """A correction of all joint readings: (..., J) in another order, and scaled."""

    def corrected(extraction: Extraction) -> Extraction:
        observations = tuple(
            replace(o, joints=scale * (o.joints if order is None else o.joints[order]))
            for o in extraction.observations
        )
        return replace(extraction, observations=observations, joint_tracks=())

    return corrected


def _with_wheels(right: float, left: float, swapped: bool = False) -> Correction:
    """A correction of both wheels: swapped first, then scaled."""

    def corrected(extraction: Extraction) -> Extraction:
        wheels = []
        for track in extraction.wheels:
            of_right, of_left = (track.left, track.right) if swapped else (track.right, track.left)
            scaled = (
                replace(of_right, value=right * of_right.value),
                replace(of_left, value=left * of_left.value),
            )
            wheels.append(WheelTrack(*scaled))
        return replace(extraction, wheels=tuple(wheels))

    return corrected


def joint_mistakes(chain: HeadChain) -> Iterator[Mistake]:
    """Signs, order and units of the head joints' readings."""
    joints = chain.joints
    for column, name in enumerate(joints):
        yield Mistake(
            f"the sign of joint {name} is reversed",
            f"reverse the axis of {name} in head.chain or in the URDF, or the sign of its readings",
            _with_joints(np.where(np.arange(len(joints)) == column, -1.0, 1.0)),
        )
    if len(joints) > 1:
        yield Mistake(
            "the signs of all head joints are reversed",
            "reverse the axes of the head joints in head.chain or in the URDF, or the signs of their readings",
            _with_joints(-1.0),
        )
    if chain.pan in joints and chain.tilt in joints and chain.pan != chain.tilt:
        order = np.arange(len(joints))
        pan, tilt = joints.index(chain.pan), joints.index(chain.tilt)
        order[[pan, tilt]] = tilt, pan
        yield Mistake(
            f"the readings of {chain.pan} and {chain.tilt} are exchanged",
            "exchange joints.pan and joints.tilt in rig.yaml, or the names in the recording",
            _with_joints(1.0, order),
        )
    for unit, factor in (("degrees", math.pi / 180), ("radians, but were taken for degrees", 180 / math.pi)):
        cure = "set the unit in joints.fields in rig.yaml, or correct the recording"
        yield Mistake(f"the joint readings are in {unit}", cure, _with_joints(factor))
        for column, name in enumerate(joints if len(joints) > 1 else ()):
            only = np.where(np.arange(len(joints)) == column, factor, 1.0)
            yield Mistake(f"the readings of {name} are in {unit}", cure, _with_joints(only))


def wheel_mistakes() -> Iterator[Mistake]:
    """Signs, sides and units of the wheels' readings."""
    swap, negate = "exchange wheels.left and wheels.right in rig.yaml", "negate wheels.{}.sign in rig.yaml"
    for swapped in (False, True):
        for right, left, sides in (
            (1, 1, ()),
            (-1, 1, ("right",)),
            (1, -1, ("left",)),
            (-1, -1, ("right", "left")),
        ):
            if not swapped and not sides:
                continue
            causes = ["the left and right wheels are swapped"] * swapped
            causes += [f"the {side} wheel's encoder has the wrong sign" for side in sides]
            cures = [swap] * swapped + [negate.format(side) for side in sides]
            yield Mistake(" and ".join(causes), ", then ".join(cures), _with_wheels(right, left, swapped))
    yield Mistake(
        "the wheel readings are in degrees",
        "convert them to rad, or state ticks_per_revolution: 360 in rig.yaml",
        _with_wheels(math.pi / 180, math.pi / 180),
    )


def delays(extraction: Extraction) -> Iterator[Mistake]:
    """Stamps of the wheels that are late or early by so much that the wheels turn while the images show a stop.

    A delay is tried if the wheels stand still at nearly all stations without it, and both still have readings of at
    least half the recording.
    """
    shortest_s = min((float(np.ptp(track.time_ns)) * 1e-9 for track in extraction.wheels), default=0.0)
    most = int(min(_LONGEST_DELAY_S, shortest_s / 2) / _DELAY_STEP_S)
    shifts_s = _DELAY_STEP_S * np.arange(-most, most + 1)
    for causes, sides in (
        ("readings of both wheels are", (0, 1)),
        ("readings of the right wheel are", (0,)),
        ("readings of the left wheel are", (1,)),
    ):
        moving = np.array([_moving_share(extraction, sides, shift_s) for shift_s in shifts_s])
        if moving[len(moving) // 2] < _MOSTLY_STILL:
            continue  # they stand still as stamped
        edges = np.diff(np.concatenate([[False], moving < _MOSTLY_STILL, [False]]).astype(int))
        runs = [*zip(np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1, strict=True)]
        for first, last in sorted(runs, key=lambda run: abs(float(shifts_s[run[0]] + shifts_s[run[1]])))[
            :_DELAYS
        ]:
            delay_s = float(shifts_s[first] + shifts_s[last]) / 2
            yield Mistake(
                f"the {causes} about {abs(delay_s):.1f} s {'late' if delay_s > 0 else 'early'}",
                "correct the clock that stamps them, and record again",
                _with_delay(sides, round(delay_s * 1e9)),
            )


def _moving_share(extraction: Extraction, sides: Sequence[int], shift_s: float) -> float:
    """Share of the stations at which some wheels turn, if their readings are later than they should be."""
    turning = total = 0
    for log, track in enumerate(extraction.wheels):
        at_ns = np.array([o.time_ns for o in extraction.observations if o.log == log]) + round(shift_s * 1e9)
        if not len(at_ns):
            continue
        turned = np.zeros(len(at_ns), dtype=np.bool_)
        for side in sides:
            one = (track.right, track.left)[side]
            turned |= np.abs(one.at(at_ns + _AROUND_NS) - one.at(at_ns - _AROUND_NS)) > STILL
        turning, total = turning + int(turned.sum()), total + len(at_ns)
    return turning / max(total, 1)


def _with_delay(sides: Sequence[int], delay_ns: int) -> Correction:
    """A correction that moves the readings of some wheels to earlier times."""

    def corrected(extraction: Extraction) -> Extraction:
        wheels = []
        for track in extraction.wheels:
            both = [track.right, track.left]
            for side in sides:
                both[side] = replace(both[side], time_ns=both[side].time_ns - delay_ns)
            wheels.append(WheelTrack(*both))
        return replace(extraction, wheels=tuple(wheels))

    return corrected


def reversals(extraction: Extraction) -> Iterator[Mistake]:
    """A wheel whose readings change their sign at one of the stations."""
    cure = "check the cable and the driver of this encoder, and record again, or leave this stretch out"
    for log, track in enumerate(extraction.wheels):
        times = [o.time_ns for o in extraction.observations if o.log == log][_FEWEST - 1 : 1 - _FEWEST]
        for at_ns in times[:: 1 + len(times) // _REVERSALS]:
            for side, name in enumerate(("right", "left")):
                yield Mistake(
                    f"the sign of the {name} wheel's readings changes at {_at_s(track, at_ns)} s",
                    cure,
                    _with_reversal(log, side, at_ns),
                )


def _with_reversal(log: int, side: int, at_ns: int) -> Correction:
    """A correction that reverses one wheel of a recording from some time on."""

    def corrected(extraction: Extraction) -> Extraction:
        wheels = list(extraction.wheels)
        both = [wheels[log].right, wheels[log].left]
        one = both[side]
        start = float(one.at(np.array([at_ns]))[0])
        both[side] = replace(one, value=np.where(one.time_ns > at_ns, 2 * start - one.value, one.value))
        wheels[log] = WheelTrack(*both)
        return replace(extraction, wheels=tuple(wheels))

    return corrected


def exchanged_stations() -> Iterator[Mistake]:
    """Images or joint readings that belong to the station before or after."""
    cure = "check the clock that stamps them, and that the driver sends each one at once, and record again"
    for by, which in ((1, "previous"), (-1, "next")):
        yield Mistake(f"the images are those of the {which} station", cure, _with_images_of(by))
        yield Mistake(f"the joint readings are those of the {which} station", cure, _with_joints_of(by))


def _neighbors(extraction: Extraction, by: int) -> Iterator[tuple[Observation, Observation]]:
    """Each station, and the one that is so many stations before it in the same recording."""
    seen = extraction.observations
    for k in range(max(by, 0), len(seen) + min(by, 0)):
        if seen[k].log == seen[k - by].log:
            yield seen[k], seen[k - by]


def _with_images_of(by: int) -> Correction:
    def corrected(extraction: Extraction) -> Extraction:
        observations = tuple(
            replace(own, station=other.station, time_ns=other.time_ns, joints=other.joints)
            for own, other in _neighbors(extraction, by)
        )
        return replace(extraction, observations=observations, joint_tracks=())

    return corrected


def _with_joints_of(by: int) -> Correction:
    def corrected(extraction: Extraction) -> Extraction:
        observations = tuple(replace(own, joints=other.joints) for own, other in _neighbors(extraction, -by))
        return replace(extraction, observations=observations, joint_tracks=())

    return corrected


def interruptions(extraction: Extraction) -> Iterator[Mistake]:
    """Stretches of stations in which one reading stays the same while another changes, or both wheels; left out."""
    cure = "check the cable and the driver, and record again, or leave this stretch out"
    for log, track in enumerate(extraction.wheels):
        mine = np.array([k for k, o in enumerate(extraction.observations) if o.log == log])
        if len(mine) <= _FEWEST:
            continue
        seen = [extraction.observations[k] for k in mine]
        times = np.array([o.time_ns for o in seen])

        def stretch(first: int, last: int, track: WheelTrack = track, times: IntArray = times) -> str:
            return f"between {_at_s(track, times[first])} and {_at_s(track, times[last])} s"

        readings = np.stack([o.joints for o in seen])
        for column, name in enumerate(extraction.rig.chain.joints):
            others = np.delete(readings, column, axis=1)
            for first, last in _still(readings[:, [column]], others):
                cause = f"the reading of joint {name} does not change {stretch(first, last)}"
                yield Mistake(cause, cure, _without(mine[first + 1 if first else 0 : last + 1]))
        turned = np.stack([side.at(times) for side in (track.right, track.left)], axis=1)
        for columns, cause in (
            ([0], "the reading of the right wheel does not change"),
            ([1], "the reading of the left wheel does not change"),
            ([0, 1], "the readings of both wheels do not change"),
        ):
            for first, last in _still(turned[:, columns], np.delete(turned, columns, axis=1)):
                if first and last < len(mine) - 1:
                    continue  # the leg across would be wrong
                lost = _without(mine[first + 1 if first else 0 : last + 1])
                yield Mistake(f"{cause} {stretch(first, last)}", cure, lost)


def _still(readings: FloatArray, others: FloatArray) -> Iterator[tuple[int, int]]:
    """First and last row of stretches in which readings (n, k) stay the same while the others (n, m) change, if any."""
    same = np.all(np.abs(np.diff(readings, axis=0)) < STILL, axis=1)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], same, [False]]).astype(int)))
    for first, last in edges.reshape(-1, 2).tolist():
        moved = np.ptp(others[first : last + 1], axis=0)
        if _FEWEST <= last - first + 1 < len(readings) and (not len(moved) or moved.max() > MOVED):
            yield first, last


def _at_s(track: WheelTrack, time_ns: int) -> str:
    """Time from the beginning of a recording."""
    return f"{(time_ns - int(track.time_ns[0])) / 1e9:.1f}"


def _without(stations: IntArray) -> Correction:
    """A correction that leaves out some observations."""

    def corrected(extraction: Extraction) -> Extraction:
        kept = (o for k, o in enumerate(extraction.observations) if k not in stations)
        return replace(extraction, observations=tuple(kept))

    return corrected
