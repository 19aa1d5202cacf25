"""The table of mistakes: what each is, what to do about it, and what gives the readings without it.

A family yields the mistakes of one kind that a recording may have. Families are tried in stages: those of a later stage
have more freedom.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import combinations

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from mobilecal_cli import se3
from mobilecal_cli.kinematics import head_pose
from mobilecal_cli.likelihood.measurements import heading_of, planar_pose
from mobilecal_cli.model.arrays import BoolArray, FloatArray, IntArray
from mobilecal_cli.model.observations import WheelTrack
from mobilecal_cli.model.rig import Rig, WheelGeometry
from mobilecal_cli.model.signals import Track, sampled
from mobilecal_cli.solvers.readings import FEWEST_STATIONS, Readings
from mobilecal_cli.solvers.transfer import dead_reckoned

SIDES = ("right", "left")
STILL, MOVED = 1e-4, 0.05  # rad or m: a reading that stays the same, and one that changes
_LONGEST_DELAY_S, _DELAY_STEP_S, _DELAYS = 20.0, 0.25, 4  # delays that are tried, and how many of them
_USUAL_DELAYS_S = (0.04, -0.04, 0.1, -0.1)  # which images in motion show; negative where the images are late
_MOSTLY_STILL = 0.1  # share of stations that may be left out of a delay's stop
_IMAGES = "images are"
_AROUND_NS = 100_000_000  # before and after a station: at a stop, nothing moves by then
_AT_REST = 0.2  # quantile of the changes around all times: noise, if the robot rests for at least so much of the time
_NOISE = 6.0  # times this quantile: noise changes by more at no station
_FREE_STATIONS = 40  # at which a free part is estimated: each has an unknown of its own, or three
_FREE_STEPS = 30  # of this estimate
_SPREAD = 0.01  # of the board's corners over the distance: stations beyond count less in this estimate
# Prior sigmas, rad and m, of the nominal head-eye transform in this estimate, and of one along the head's axes
_NOMINAL_MOUNT, _ANY_MOUNT = np.repeat([0.2, 0.05], 3), np.repeat([0.6, 0.2], 3)
_LEAST_SHARE, _TINY = 0.02, 1e-12  # of a leg, by which the wheels are late; and of a square
_NOT_WRAPPED = 2.5  # rad: a heading that nominal wheels say is smaller is not a full turn off
_SCOUT_STATIONS, _SCOUT_STEPS = 12, 10  # with which the latter is chosen
#: With which readings of wheels are made where none are nominal.
ANY_WHEELS = WheelGeometry(0.1, 0.1, 0.4)


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """A mistake, what to do about it, and what gives the readings without it."""

    cause: str
    cure: str
    transform: Callable[[Readings], Readings]


Stages = tuple[tuple[Callable[[Readings], Iterator[Hypothesis]], ...], ...]


# -- stage 1: signs, sides and units, and readings that stop -----------------------------------------


def _joints_times(
    readings: Readings, factor: float, columns: Sequence[int] | slice = slice(None)
) -> Readings:
    joints = readings.joints.copy()
    joints[:, columns] *= factor
    return replace(readings, joints=joints)


def _wheels_times(
    readings: Readings, factor: float, sides: Sequence[str] = SIDES, swapped: bool = False
) -> Readings:
    """Multiply the readings of the wheels on some sides, after their exchange."""
    if swapped:
        readings = replace(readings, wheels=tuple(WheelTrack(t.left, t.right) for t in readings.wheels))
    return _with_wheels(readings, sides, lambda track: replace(track, value=factor * track.value))


def _with_wheels(readings: Readings, sides: Sequence[str], change: Callable[[Track], Track]) -> Readings:
    tracks = [replace(t, **{side: change(getattr(t, side)) for side in sides}) for t in readings.wheels]
    return replace(readings, wheels=tuple(tracks))


def _joints(readings: Readings) -> Iterator[Hypothesis]:
    """Signs, order and units of the head joints' readings."""
    chain = readings.rig.chain
    joints = chain.joints
    if not joints:
        return
    signs = [
        (f"the sign of joint {name} is", f"axis of {name}", "sign of its", [column])
        for column, name in enumerate(joints)
    ]
    if len(joints) > 1:
        everything = list(range(len(joints)))
        signs.append(
            ("the signs of all head joints are", "axes of the head joints", "signs of their", everything)
        )
    for cause, axes, sign, columns in signs:
        yield Hypothesis(
            f"{cause} reversed",
            f"reverse the {axes} in head.chain or in the URDF, or the {sign} readings",
            partial(_joints_times, factor=-1.0, columns=columns),
        )
    if chain.pan in joints and chain.tilt in joints and chain.pan != chain.tilt:
        order = np.arange(len(joints))
        pan, tilt = joints.index(chain.pan), joints.index(chain.tilt)
        order[[pan, tilt]] = tilt, pan
        yield Hypothesis(
            f"the readings of {chain.pan} and {chain.tilt} are exchanged",
            "exchange the names of the two joints in head.chain, in the URDF or in joints.fields, or in the recording",
            lambda r: replace(r, joints=r.joints[:, order]),
        )
    for unit, factor in (("degrees", math.pi / 180), ("radians, but were taken for degrees", 180 / math.pi)):
        cure = "set the unit in joints.fields in rig.yaml, or correct the recording"
        yield Hypothesis(f"the joint readings are in {unit}", cure, partial(_joints_times, factor=factor))
        for column, name in enumerate(joints if len(joints) > 1 else ()):
            only = partial(_joints_times, factor=factor, columns=[column])
            yield Hypothesis(f"the readings of {name} are in {unit}", cure, only)


def of_sides(rig: Rig, swapped: bool, sides: Sequence[str]) -> tuple[str, str]:
    """Cause and cure where the wheels are exchanged, and some then count backwards, or what that is for odometry."""
    if rig.sources.assumed_odometry is not None:
        backward = bool(sides)
        what = ["distance"] * backward + ["rotation"] * (swapped != backward)
        return (
            f"the {' and the '.join(what)} of the odometry {'has' if len(what) == 1 else 'have'} the wrong sign",
            "correct it in the driver of the odometry: x points forward and y to the left in its child frame",
        )
    causes = ["the left and right wheels are swapped"] * swapped
    cures = ["exchange wheels.left and wheels.right in rig.yaml"] * swapped
    if sides:
        of = "the encoders of both wheels have" if len(sides) > 1 else f"the {sides[0]} wheel's encoder has"
        causes.append(f"{of} the wrong sign")
        cures.append(f"negate {' and '.join(f'wheels.{side}.sign' for side in sides)} in rig.yaml")
    return " and ".join(causes), ", then ".join(cures)


def _wheels(readings: Readings) -> Iterator[Hypothesis]:
    """Signs, sides and units of the wheels' readings."""
    odometry = readings.rig.sources.assumed_odometry is not None
    for swapped in (False, True):
        for sides in ((), SIDES) if odometry else ((), ("right",), ("left",), SIDES):
            if swapped or sides:
                transform = partial(_wheels_times, factor=-1.0, sides=sides, swapped=swapped)
                yield Hypothesis(*of_sides(readings.rig, swapped, sides), transform)
    if not odometry:
        yield Hypothesis(
            "the wheel readings are in degrees",
            "convert them to rad, or state ticks_per_revolution: 360 in rig.yaml",
            partial(_wheels_times, factor=math.pi / 180),
        )


def of_one_recording(readings: Readings) -> Iterator[Hypothesis]:
    """Mistakes of the wheels in one of several recordings: with a camera on the base, each may fit by itself."""
    for log in range(len(readings.wheels)):
        for row in _wheels(readings):
            cause = f"recording {log + 1} of {len(readings.wheels)}: {row.cause}"
            transform = partial(_in_recording, log=log, transform=row.transform)
            yield Hypothesis(cause, f"{row.cure}, for this recording only", transform)


def _in_recording(readings: Readings, log: int, transform: Callable[[Readings], Readings]) -> Readings:
    there = transform(readings).wheels[log]
    return replace(readings, wheels=(*readings.wheels[:log], there, *readings.wheels[log + 1 :]))


def _poses(readings: Readings) -> Iterator[Hypothesis]:
    """The other direction of measured poses, and the mirrored images of one camera; those of a pair contradict it."""
    if not readings.measured and len(readings.rig.cameras.names) == 1:
        mirror = np.diag([-1.0, 1.0, 1.0, 1.0])
        yield Hypothesis(
            "the images are mirrored",
            "turn off mirroring in the driver of the camera, and record again",
            lambda r: replace(r, T_c_k=mirror @ r.T_c_k @ mirror),
        )
    if readings.measured:
        yield Hypothesis(
            "the measured poses are inverted: they take sensor coordinates to target coordinates",
            "give T_c_k, which takes target coordinates to sensor coordinates",
            lambda r: replace(r, T_c_k=se3.inverse(r.T_c_k)),
        )
    if readings.measured and readings.rig.chain.joints:
        yield Hypothesis(
            "the measured poses are those in the frame of the base, not of the sensor",
            "give T_c_k, which takes target coordinates to coordinates of a sensor on the head",
            lambda r: replace(r, T_c_k=se3.inverse(head_pose(r.rig.chain, r.joints)) @ r.T_c_k),
        )


def _motions(readings: Readings) -> Iterator[Hypothesis]:
    """Units, signs, frames and times of the motions of a planar sensor."""
    for cause, cure, change in _OF_MOTIONS:
        right = partial(Readings.with_motions, motions=change(readings.motions))
        yield Hypothesis(f"the motions {cause}", f"give {cure}", right)
    motions, turned = readings.motions, readings.pairs.steps.totals_rad
    again = np.append(False, np.all(motions[1:] == motions[:-1], axis=1))
    again[1:] &= np.abs(np.diff(turned, axis=0)).max(axis=1) > MOVED
    if again.any():
        yield Hypothesis(
            f"{again.sum()} of {len(again)} motions repeat that of the leg before, but the wheels turn otherwise",
            "give each motion once: check that the sensor measures one in each leg",
            partial(Readings.of, stations=~again[readings.log]),
        )


def _late_wheels(readings: Readings) -> Iterator[Hypothesis]:
    """Rotations of the wheels that begin and end late or early, on legs that follow one another and take as long."""
    motions, turned = readings.motions, readings.pairs.steps.totals_rad
    wheels = readings.nominal.wheels or ANY_WHEELS
    turns_rad = turned @ [wheels.radius_right_m, -wheels.radius_left_m] / wheels.separation_m
    for by, when in ((1, "late"), (-1, "early")):
        before = np.roll(motions, by, axis=0)
        # The share of a leg with which the wheels' rotations explain the headings best; one leg has none before it.
        own = np.maximum(np.abs(turns_rad), np.abs(np.roll(turns_rad, by))) < _NOT_WRAPPED
        own[0 if by > 0 else -1] = False
        free = np.eye(int(own.sum())) - turned[own] @ np.linalg.pinv(turned[own])
        other = free @ (before - motions)[own, 2]
        share = -float(other @ motions[own, 2]) / max(float(other @ other), _TINY)
        for late in (share, 1.0) if share > _LEAST_SHARE else (1.0,):
            yield Hypothesis(
                f"the rotations of the wheels are those of about {100 * late:.0f} % of a leg too {when}",
                "give motions and rotations between the same times",
                partial(Readings.with_motions, motions=_moved_on(before, motions, late, by)),
            )


def _moved_on(before: FloatArray, motions: FloatArray, share: float, by: int) -> FloatArray:
    """(L, 3) motions of which a share is that of the leg before, or after, at even speed."""
    parts = (planar_pose(motions), 1 - share), (planar_pose(before), share)
    first, last = (se3.exp(part * se3.log(T)) for T, part in parts[::-by])
    return _planar(first @ last)


def _relative(motions: FloatArray, back: FloatArray) -> FloatArray:
    """(L, 3) motions in the frame at their start, from those in one that is turned back by angles (L,)."""
    turned = planar_pose(np.column_stack([np.zeros((len(back), 2)), -back])) @ planar_pose(motions)
    return np.column_stack([turned[:, :2, 3], motions[:, 2]])


def _differences(motions: FloatArray) -> FloatArray:
    """(L, 3) motions between poses (L, 3) that follow one another, from the first frame on."""
    T = planar_pose(np.concatenate([np.zeros((1, 3)), motions]))
    return _planar(se3.inverse(T[:-1]) @ T[1:])


def _planar(T: FloatArray) -> FloatArray:
    """(n, 3) x, y and heading of poses (n, 4, 4)."""
    return np.column_stack([T[:, :2, 3], heading_of(T)])


def _after_turns(motions: FloatArray, first_rad: float) -> FloatArray:
    return _relative(motions, first_rad + np.cumsum(motions[:, 2]) - motions[:, 2])


_TO_SENSOR = "motions of the sensor in its own frame at the start of each leg"
#: What is wrong with motions, what to give, and what makes motions (L, 3) right.
_OF_MOTIONS: tuple[tuple[str, str, Callable[[FloatArray], FloatArray]], ...] = (
    ("have headings in degrees", "headings in rad", lambda m: m * [1, 1, math.pi / 180]),
    ("have x and y exchanged", "x and y in this order", lambda m: m[:, [1, 0, 2]]),
    (
        "are inverted",
        "the pose of the sensor at the end in its frame at the start",
        lambda m: _planar(se3.inverse(planar_pose(m))),
    ),
    ("are poses since the first leg", _TO_SENSOR, _differences),
    *(
        (
            "are differences of coordinates in a fixed frame",
            _TO_SENSOR,
            partial(_after_turns, first_rad=turn_rad),
        )
        for turn_rad in (0.0, 2.0, -2.0)
    ),
    (
        "are those of a sensor whose z points the other way than T_v_c says",
        "T_v_c of the frame of the motions, or y and heading with the other sign",
        lambda m: m * [1, -1, -1],
    ),
    ("have the wrong sign of y", "y to the left of x", lambda m: m * [1, -1, 1]),
    ("have the wrong sign of x", "x and y of one right-handed frame with z up", lambda m: m * [-1, 1, 1]),
    ("have the wrong sign of heading", "headings that increase counterclockwise", lambda m: m * [1, 1, -1]),
)


def interruptions(readings: Readings) -> Iterator[Hypothesis]:
    """Stretches of stations in which one reading stays the same while another changes, or both wheels; left out."""
    for log, track in enumerate(readings.wheels):
        mine = np.flatnonzero(readings.log == log)
        if len(mine) < FEWEST_STATIONS:
            continue
        where = f"recording {log + 1} of {len(readings.wheels)}: " if len(readings.wheels) > 1 else ""
        joints, turned = readings.joints[mine], sampled((track.right, track.left), readings.time_ns[mine])
        of_joints = [
            (f"the reading of joint {name} does not change", joints[:, [j]], np.delete(joints, j, axis=1))
            for j, name in enumerate(readings.rig.chain.joints)
        ]
        of_wheels = [
            (f"the reading of the {side} wheel does not change", turned[:, [j]], turned[:, [1 - j]])
            for j, side in enumerate(SIDES)
        ] + [("the readings of both wheels do not change", turned, turned[:, :0])]
        for number, (cause, values, others) in enumerate(of_joints + of_wheels):
            for first, last in _still(values, others):
                if first and last < len(mine) - 1 and number >= len(of_joints):
                    continue  # the leg across would be wrong
                kept = np.delete(np.arange(len(readings.log)), mine[first : last + 1])
                yield Hypothesis(
                    f"{where}{cause} between {readings.at_s(mine[first])} and {readings.at_s(mine[last])} s",
                    "check the cable and the driver, and record again, or leave this stretch out",
                    partial(Readings.of, stations=kept),
                )


def _still(values: FloatArray, others: FloatArray) -> Iterator[tuple[int, int]]:
    """First and last row of stretches in which readings (n, k) stay the same while the others (n, m) change, if any."""
    for first, last in _runs(np.all(np.abs(np.diff(values, axis=0)) < STILL, axis=1)):
        moved = np.ptp(others[first : last + 1], axis=0)
        if FEWEST_STATIONS <= last - first + 2 <= len(values) and (not len(moved) or moved.max() > MOVED):
            yield first, last


def _runs(true: BoolArray) -> list[tuple[int, int]]:
    """First index of each run of true values, and the index after its last."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], true, [False]]).astype(int)))
    return [(first, end) for first, end in edges.reshape(-1, 2).tolist()]


# -- stage 2: readings of another time ------------------------------------------


def _wheels_earlier(readings: Readings, delay_ns: int, sides: Sequence[str]) -> Readings:
    return _with_wheels(readings, sides, lambda track: replace(track, time_ns=track.time_ns - delay_ns))


def _joints_earlier(readings: Readings, delay_ns: int) -> Readings:
    joints = readings.joints.copy()
    for log, tracks in enumerate(readings.joint_tracks):
        mine = readings.log == log
        at_ns = readings.time_ns[mine]
        joints[mine] += sampled(tracks, at_ns + delay_ns) - sampled(tracks, at_ns)
    return replace(readings, joints=joints)


def _all_earlier(readings: Readings, delay_ns: int) -> Readings:
    return _wheels_earlier(_joints_earlier(readings, delay_ns), delay_ns, SIDES)


def _delays(readings: Readings) -> Iterator[Hypothesis]:
    """Stamps that are late or early by so much that joints or wheels move while the images show a stop.

    A delay is tried if nothing moves at nearly all stations without it, and if both wheels still have readings of at
    least half the recording.
    """
    shortest_s = min((float(np.ptp(track.time_ns)) * 1e-9 for track in readings.wheels), default=0.0)
    most = int(min(_LONGEST_DELAY_S, shortest_s / 2) / _DELAY_STEP_S)
    shifts_s = _DELAY_STEP_S * np.arange(-most, most + 1)
    parts: list[tuple[str, Sequence[tuple[Track, ...]], Callable[..., Readings]]] = []
    for which, sides in (("both wheels", SIDES), *((f"the {side} wheel", (side,)) for side in SIDES)):
        own = [tuple(getattr(track, side) for side in sides) for track in readings.wheels]
        parts.append((f"readings of {which} are", own, partial(_wheels_earlier, sides=sides)))
    every = [
        (*joints, track.right, track.left)
        for joints, track in zip(readings.joint_tracks, readings.wheels, strict=False)  # none without tracks
    ]
    parts += [("joint readings are", readings.joint_tracks, _joints_earlier), (_IMAGES, every, _all_earlier)]
    for cause, tracks, earlier in parts:
        moving = np.array([_moving_share(readings, tracks, shift_s) for shift_s in shifts_s])
        if moving[most] < _MOSTLY_STILL:
            continue  # still as stamped
        stops_s = [(shifts_s[i] + shifts_s[j - 1]) / 2 for i, j in _runs(moving < _MOSTLY_STILL)]
        for delay_s in sorted(stops_s, key=abs)[:_DELAYS]:
            late = delay_s < 0 if cause == _IMAGES else delay_s > 0  # late readings are early images
            others = "joints and wheels" if readings.rig.chain.joints else "wheels"
            against = f" against the {others}" * (cause == _IMAGES)
            yield Hypothesis(
                f"the {cause} about {abs(delay_s):.1f} s {'late' if late else 'early'}{against}",
                "correct the clock that stamps them, and record again",
                partial(earlier, delay_ns=round(delay_s * 1e9)),
            )


def late_readings(readings: Readings) -> Iterator[Readings]:
    """The readings with delays of the wheels, and of wheels and joints, as drivers, filters and cameras have them."""
    for delay_s in _USUAL_DELAYS_S:
        yield _wheels_earlier(readings, round(delay_s * 1e9), SIDES)
        if readings.rig.chain.joints:
            yield _all_earlier(readings, round(delay_s * 1e9))


def _moving_share(readings: Readings, tracks: Sequence[tuple[Track, ...]], shift_s: float) -> float:
    """Share of the stations at which some of the tracks move, if their stamps are late by so much."""
    moving = np.zeros(len(readings.log), dtype=np.bool_)
    for log, own in enumerate(tracks):
        mine = readings.log == log
        if not own:
            continue
        at_ns = readings.time_ns[mine] + round(shift_s * 1e9)
        moving[mine] = np.any(_moved_around(own, at_ns) > _noise_at_rest(own), axis=1)
    return float(moving.mean())


def _moved_around(tracks: tuple[Track, ...], at_ns: IntArray) -> FloatArray:
    """Changes of K tracks around each of n times, (n, K)."""
    return np.abs(sampled(tracks, at_ns + _AROUND_NS) - sampled(tracks, at_ns - _AROUND_NS))


def _noise_at_rest(tracks: tuple[Track, ...]) -> FloatArray:
    """(K,) Largest change that noise explains, if tracks rest for a good part of the time."""
    first, last = (int(end) for end in tracks[0].time_ns[[0, -1]])
    moved = _moved_around(tracks, np.arange(first, last + 1, _AROUND_NS))
    return np.maximum(STILL, _NOISE * np.quantile(moved, _AT_REST, axis=0))


def _moved(readings: Readings, name: str, by: int) -> Readings:
    count = len(readings.log)
    own = np.arange(max(-by, 0), count - max(by, 0))
    own = own[readings.log[own] == readings.log[own + by]]
    return replace(readings.of(own), **{name: getattr(readings, name)[own + by]})


def _neighbors(readings: Readings) -> Iterator[Hypothesis]:
    """Images or joint readings that belong to the station before or after."""
    both = (("images", "T_c_k"), ("joint readings", "joints"))
    for by, which in ((1, "previous"), (-1, "next")):
        for what, name in both if readings.rig.chain.joints else both[:1]:
            yield Hypothesis(
                f"the {what} are those of the {which} station",
                "check the clock that stamps them, and that the driver sends each one at once, and record again",
                partial(_moved, name=name, by=by),
            )


# -- two mistakes ------------------------------------------------------------------------------------


def _two(readings: Readings) -> Iterator[Hypothesis]:
    """Two mistakes in the readings of joints and wheels, as of a new robot."""
    # A delay shifts the tracks as they are read: it comes first.
    rows = [*_delays(readings), *_joints(readings), *_wheels(readings)]
    for pair in combinations(rows, 2):
        causes, cures = ([getattr(row, name) for row in pair] for name in ("cause", "cure"))
        yield Hypothesis(", and ".join(causes), "; and ".join(cures), partial(_without, mistakes=pair))


def _without(readings: Readings, mistakes: Sequence[Hypothesis]) -> Readings:
    for mistake in mistakes:
        readings = mistake.transform(readings)
    return readings


# -- stage 3: readings that say nothing: a joint, or the wheels, as the images show them --------------


def _joints_as_seen(readings: Readings, frozen: bool) -> Iterator[Hypothesis]:
    """Readings of one joint that never change, or that have nothing to do with it."""
    for column, name in enumerate(readings.rig.chain.joints):
        if (np.ptp(readings.joints[:, column]) < STILL) != frozen:
            continue
        cause = f"the readings of {name} do not fit; the images, the wheels and the other joints do"
        cure = "check the topic, the clock, the sign and the unit of this joint, and its gear"
        if frozen:
            cause = f"the reading of {name} never changes, and the images do not fit a joint at rest"
            cure = "check that the state of this joint is recorded while it moves"
        yield Hypothesis(cause, cure, partial(_joint_as_seen, column=column))


def _free_wheels(readings: Readings) -> Iterator[Hypothesis]:
    """Readings of the wheels that have nothing to do with the drive."""
    sides = [(side, [getattr(track, side) for track in readings.wheels]) for side in SIDES]
    still = [side for side, tracks in sides if all(np.ptp(track.value) < STILL for track in tracks)]
    rising = all(
        np.all(np.diff(track.value) >= -STILL) and np.ptp(track.value) > MOVED
        for _, tracks in sides
        for track in tracks
    )
    shown = "the images and the head joints show" if readings.rig.chain.joints else "the images show"
    if len(still) == 2:
        cause = "the readings of both wheels never change, and the images do not fit a base at rest"
        cure = "check that the wheel encoders are recorded while the base moves"
        if readings.rig.sources.assumed_odometry is not None:
            cause = "the poses of the odometry never change, and the images do not fit a base at rest"
            cure = "have its driver publish poses (the twist is not read), or record wheel joints or counters"
    elif still:
        cause = f"the reading of the {still[0]} wheel never changes, and that of the other wheel does"
        cure = "check the cable and the driver of this encoder, and record again"
    elif rising:
        cause = (
            "the readings of both wheels never decrease, but the images show that the base drives to and fro"
        )
        cure = "read the encoders with their direction (quadrature), and record again"
    elif readings.rig.sources.assumed_odometry is not None:
        cause = f"the odometry does not fit the drive that {shown}"
        cure = (
            "check that it is of this drive, its clock, and that it is not reset or fused with other sensors"
        )
    else:
        cause = f"the readings of the wheels do not fit the drive that {shown}"
        cure = (
            "check the topics and the clocks of both wheels, the stamps of the images, and the counters: bits in "
            "rig.yaml, resets, gears"
        )
    yield Hypothesis(cause, cure, _wheels_as_seen)


def _joint_as_seen(readings: Readings, column: int) -> Readings:
    """The readings of one joint by the images, with nominal wheels or any; none if it is at rest."""
    readings = readings.of(slice(_FREE_STATIONS))
    wheels = readings.nominal.wheels

    def free(some: Readings) -> _Free:
        joints, count = some.joints.copy(), len(some.joints)
        T_w_v = dead_reckoned(some.pairs, wheels or ANY_WHEELS)

        def head(free: FloatArray) -> FloatArray:
            joints[:, column], sizes = free[:count], np.exp(free[count:])
            base = (
                dead_reckoned(some.pairs, WheelGeometry.of(ANY_WHEELS.vector * sizes))
                if len(sizes)
                else T_w_v
            )
            return base @ head_pose(some.rig.chain, joints)

        angles = np.full(count, np.median(some.joints[:, column]))
        return head, lambda _: np.append(angles, np.zeros(3 * (wheels is None)))

    joints = readings.joints.copy()
    joints[:, column] = _as_seen(readings, free)[: len(joints)]
    moves = np.ptp(joints[:, column]) > MOVED
    return replace(readings, joints=joints) if moves else readings.of(slice(0))


def _wheels_as_seen(readings: Readings) -> Readings:
    """The readings of nominal wheels, or of any, by the images and the joints."""
    readings = readings.of(slice(_FREE_STATIONS))

    def base(planar: FloatArray) -> FloatArray:
        return planar_pose(np.concatenate([np.zeros((1, 3)), planar.reshape(-1, 3)]))

    def free(some: Readings) -> _Free:
        T_v_h = head_pose(some.rig.chain, some.joints)

        def start(X: FloatArray) -> FloatArray:
            T_v_k = T_v_h @ X @ some.T_c_k
            T_v0_vn = T_v_k[0] @ se3.inverse(T_v_k[1:])
            heading = np.arctan2(T_v0_vn[:, 1, 0] - T_v0_vn[:, 0, 1], T_v0_vn[:, 0, 0] + T_v0_vn[:, 1, 1])
            return np.column_stack([T_v0_vn[:, :2, 3], heading]).ravel()

        return lambda planar: base(planar) @ T_v_h, start

    wheels = readings.nominal.wheels or ANY_WHEELS
    return replace(readings, wheels=(_rolled(base(_as_seen(readings, free)), wheels, readings.time_ns),))


#: T_w_h (N, 4, 4) by a free part (F,), and this part at the start, by the head-eye transform.
_Free = tuple[Callable[[FloatArray], FloatArray], Callable[[FloatArray], FloatArray]]


def _as_seen(readings: Readings, free: Callable[[Readings], _Free]) -> FloatArray:
    """The free part (F,) with which the board stays at its place, and the head-eye transform near its nominal one.

    Without a nominal one, near that of all cameras along the axes of the head with which a few stations fit best.
    """
    X, sigma = readings.nominal.T_h_c, _NOMINAL_MOUNT
    if X is None:
        sigma, few = _ANY_MOUNT, readings.of(slice(_SCOUT_STATIONS))
        along = se3.transform(Rotation.create_group("O").as_matrix(), np.zeros(3))
        fits = [_fitted(few, free(few), each, sigma, _SCOUT_STEPS) for each in along]
        X = min(fits, key=lambda fit: fit[0])[1]
    return _fitted(readings, free(readings), X, sigma, _FREE_STEPS)[2]


def _fitted(
    readings: Readings, free: _Free, X: FloatArray, sigma: FloatArray, steps: int
) -> tuple[float, FloatArray, FloatArray]:
    """Cost, head-eye transform and free part (F,) of the fit near a head-eye transform, with sigmas of its twist."""
    head, start = free
    scale_m = _SPREAD * float(np.linalg.norm(readings.T_c_k[:, :3, 3], axis=1).mean())
    corners_k = np.broadcast_to(readings.corners_k, (len(readings.T_c_k), 4, 3))

    def residuals(x: FloatArray) -> FloatArray:
        mount = X @ se3.exp(x[:6] * sigma)
        corners_w = se3.act(head(x[6:]) @ mount @ readings.T_c_k, corners_k)
        spread = (corners_w - np.median(corners_w, axis=0)) / scale_m
        return np.concatenate([spread.ravel(), x[:6]])

    x0 = np.concatenate([np.zeros(6), start(X)])
    fit = least_squares(residuals, x0, loss="soft_l1", max_nfev=steps)
    return float(fit.cost), X @ se3.exp(fit.x[:6] * sigma), np.asarray(fit.x[6:])


def _rolled(T_w_v: FloatArray, wheels: WheelGeometry, time_ns: IntArray) -> WheelTrack:
    """Rotation of the wheels between base poses (N, 4, 4): a turn, a straight line and a turn on each leg."""
    T_vi_vj = se3.inverse(T_w_v[:-1]) @ T_w_v[1:]
    first = np.arctan2(T_vi_vj[:, 1, 3], T_vi_vj[:, 0, 3])
    backward = np.abs(first) > math.pi / 2  # rather drives backwards than turns around
    first = np.where(backward, first - np.copysign(math.pi, first), first)
    length_m = np.where(backward, -1.0, 1.0) * np.hypot(T_vi_vj[:, 0, 3], T_vi_vj[:, 1, 3])
    last = heading_of(T_vi_vj) - first
    zero = np.zeros_like(first)
    turn, drive = np.stack([first, zero, last], axis=1), np.stack([zero, length_m, zero], axis=1)
    rolled = [
        np.concatenate([[0.0], np.cumsum((drive + side * turn * wheels.separation_m / 2) / radius_m)])
        for side, radius_m in ((1, wheels.radius_right_m), (-1, wheels.radius_left_m))
    ]
    begin, third = time_ns[:-1], np.diff(time_ns) // 3
    stamps = np.append(np.stack([begin, begin + third, time_ns[1:] - third], axis=1), time_ns[-1])
    return WheelTrack.at_same_times(stamps, *rolled)


#: The table, in stages of growing freedom: mistakes in a whole recording, two at once, readings that never change, and
#: readings that say nothing.
WHOLE: Stages = ((_joints, _wheels, _poses, interruptions), (_delays, _neighbors))
TWO: Stages = ((_two,),)
FROZEN: Stages = ((partial(_joints_as_seen, frozen=True),),)
FREE_PARTS: Stages = ((partial(_joints_as_seen, frozen=False),), (_free_wheels,))
#: The same for the motions of a planar sensor, and clocks.
MOTIONS: Stages = ((_motions, _wheels),)
LATE: Stages = ((_late_wheels,),)
