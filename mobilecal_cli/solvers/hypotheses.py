"""Why a recording does not fit its robot: hypotheses on single mistakes, and one scorer.

A hypothesis turns the readings into those without the mistake. The scorer solves them by the linear method and a few
steps of eq. 19 on the board's poses, without the worst legs. A cause is named only if the corrected readings fit as
recordings fit. Those of a later stage have more freedom, and are tried only if none of the stages before fits.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial

import numpy as np
from scipy.optimize import least_squares

from mobilecal_cli import se3
from mobilecal_cli.errors import SolveError
from mobilecal_cli.kinematics import (
    FEWEST_LEGS,
    MotionSeen,
    cut_at,
    encoder_steps_rad,
    head_pose,
    integrate,
    join,
    motion_seen,
)
from mobilecal_cli.likelihood.measurements import MotionPairs
from mobilecal_cli.model import (
    BoolArray,
    Diagnosis,
    Extraction,
    FloatArray,
    IntArray,
    Parameters,
    Rig,
    Track,
    WheelGeometry,
    WheelTrack,
    sampled,
)
from mobilecal_cli.solvers.initial import initial_with_prior, linear_estimate
from mobilecal_cli.solvers.linear import InitialPrior, Rounds, ratios_of
from mobilecal_cli.solvers.refine import refine_lm
from mobilecal_cli.solvers.transfer import base_motion, residuals_m, rms_m

_SIDES = ("right", "left")
#: Misfit of recordings that fit: up to 0.012 with noisy wheels, 0.3 px, and constants as far off as their priors.
FITS = 0.02
_FITS_CHANGED = FITS / 2  # the parts before and after a change
_FITS_FREE = FITS / 4  # with a free part: it takes up other mistakes too, but never to the level of the noise
_CONSISTENT_PX = 1.5  # stereo reprojection error beyond which the images are wrong, not a joint or the wheels
_BETTER = 0.4  # and at most this share of the misfit without the correction
_EQUAL = 1.5  # hypotheses whose misfits differ by less cannot be distinguished
_SAME_RAD = 0.5  # unless one of them turns the camera further from its nominal rotation by more than this
_USED = 0.8  # share of the legs that must fit; the others may be outliers
_PROMISING = 10 * FITS  # linear solutions beyond this are not refined
_ROUNDS = 12  # of the linear method
_MOST_LEGS = 40  # that are scored, spread over the recording; stations at which a free part is estimated
_FEWEST_IN_PART = 5  # stations before or after a change, or in a recording
_STILL, _MOVED = 1e-4, 0.05  # rad or m: a reading that stays the same, and one that changes
_TURNED_RAD = 0.5  # wheel rotation: with less, noise and unequal wheels look like a turn
_AROUND_RAD = 2.5  # from the nominal rotation: more than an optical frame from a body frame
_OTHER_WHEELS = 3.0  # times the nominal radius: no tire differs by so much
_SAME_UNIT_M = 0.05
_SAME_VIEW = 0.01  # rad, and share of the distance: motion that moves the image by a few pixels
_OUTLIERS_IN_PART = 2  # with so many stations of the other part, one may still fit
_CHANGED_SCALE = (
    0.05  # of a wheel's readings: less is within the noise of the linear method on a few stations
)
_LONGEST_DELAY_S, _DELAY_STEP_S, _DELAYS = 20.0, 0.25, 4  # delays that are tried, and how many of them
_MOSTLY_STILL = 0.1  # share of stations that may be left out of a delay's stop
_AROUND_NS = 100_000_000
_SPREAD = (
    0.01  # of the board's corners over the distance, beyond which a station counts less, while a part is free
)
_MOUNT_RAD, _MOUNT_M = 0.2, 0.05  # of a nominal head-eye transform, while a part is free


@dataclass(frozen=True, eq=False)
class Readings:
    """What cameras, joints and wheels of N stations say.

    Attributes:
        rig: the robot.
        T_c_k: (N, 4, 4) board in the first camera.
        corners_k: (4, 3) outer corners of the board, m.
        joints: (N, J) readings, rad or m.
        time_ns, log: (N,) stamps, and index of the recording.
        wheels, joint_tracks: see `Extraction`.
        consistent: the images fit camera_info and the board.
    """

    rig: Rig
    T_c_k: FloatArray
    corners_k: FloatArray
    joints: FloatArray
    time_ns: IntArray
    log: IntArray
    wheels: tuple[WheelTrack, ...]
    joint_tracks: tuple[tuple[Track, ...], ...]
    consistent: bool

    def of(self, stations: IntArray | BoolArray | slice) -> Readings:
        """Some stations alone."""
        by_station = ("T_c_k", "joints", "time_ns", "log")
        return replace(self, **{name: getattr(self, name)[stations] for name in by_station})

    def at_s(self, station: int) -> str:
        """Time of a station from the beginning of its recording."""
        begin = self.wheels[int(self.log[station])].time_ns[0]
        return f"{(int(self.time_ns[station]) - int(begin)) / 1e9:.1f}"

    @property
    def nominal_head_eye(self) -> FloatArray | None:
        """Nominal pose of the first camera on the head, (4, 4)."""
        nominal = self.rig.nominal.T_h_reference
        return None if nominal is None else nominal @ se3.inverse(self.rig.cameras.T_c_reference)

    @cached_property
    def pairs(self) -> MotionPairs:
        """The legs, with the outer corners of the board."""
        steps, legs = [], []
        for number, track in enumerate(self.wheels):
            mine = np.flatnonzero(self.log == number)
            if len(mine) > 1:
                times = self.time_ns[mine]
                steps.append(cut_at(track, np.clip(times, track.time_ns[0], track.time_ns[-1])))
                legs.append(np.stack([mine[:-1], mine[1:]], axis=1))
        between = np.concatenate(legs)
        log = self.log[between[:, 0]]
        points_c = se3.act(self.T_c_k, np.broadcast_to(self.corners_k, (len(self.T_c_k), 4, 3)))
        chain, T_v_h = np.searchsorted(log, log), head_pose(self.rig.chain, self.joints)
        return MotionPairs(T_v_h, self.T_c_k, points_c, between, chain, join(steps))

    @cached_property
    def motion(self) -> MotionSeen:
        """What joints and wheels move."""
        pairs = self.pairs
        return motion_seen(pairs.T_v_h, pairs.steps.totals_rad, encoder_steps_rad(self.wheels))

    @property
    def distinguishes(self) -> bool:
        """Whether the motion can tell mistakes apart: the head tilts, and the base drives and turns."""
        return self.motion.tilts and self._roams

    @property
    def planar(self) -> bool:
        """Whether the motion can tell mistakes of the wheels apart, of a camera that no joint moves."""
        return not self.rig.chain.joints and self._roams

    @property
    def _roams(self) -> bool:
        return self.motion.drives and self.motion.turned_rad > _TURNED_RAD


def readings_of(extraction: Extraction) -> Readings:
    """The readings of an extraction with at least one leg."""
    observations, board = extraction.observations, extraction.board
    square_m = board.square_m or float(np.median([o.square_m for o in observations]))
    grid = board.grid().reshape(-1, 3) * square_m
    ends = [0, board.columns - 1, len(grid) - board.columns, len(grid) - 1]
    return Readings(
        extraction.rig,
        np.stack([o.T_c_k for o in observations]),
        grid[ends],
        np.stack([o.joints for o in observations]),
        np.array([o.time_ns for o in observations], dtype=np.int64),
        np.array([o.log for o in observations], dtype=np.int64),
        extraction.wheels,
        extraction.joint_tracks,
        float(np.median([o.reprojection_px for o in observations])) < _CONSISTENT_PX,
    )


Transform = Callable[[Readings], Readings]


@dataclass(frozen=True, slots=True, eq=False)
class Hypothesis:
    """A mistake, what to do about it, and what gives the readings without it."""

    cause: str
    cure: str
    transform: Transform


Stages = tuple[tuple[Callable[[Readings], Iterator[Hypothesis]], ...], ...]


# -- the scorer -----------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Score:
    """A fit: rms of most legs and of all over the distance to the board, and the camera's turn from nominal."""

    misfit: float
    of_all: float
    turned_rad: float
    wheels: WheelGeometry


class _Scorer:
    """Scores readings by the linear method, from the nominal wheels and those of the readings as they stand."""

    def __init__(self, as_is: Readings) -> None:
        self._as_is, nominal = as_is, as_is.rig.nominal
        X = as_is.nominal_head_eye
        self._prior, self._R_h_c = InitialPrior(X, nominal.wheels), None if X is None else X[:3, :3]
        self._starts = [] if nominal.wheels is None else [ratios_of(nominal.wheels)]
        if as_is.distinguishes:
            try:
                linear = linear_estimate(_thinned(as_is.pairs), nominal.wheels).parameters
                self._starts.append(np.abs(ratios_of(linear.wheels)) * [1.0, -1.0])
            except (SolveError, np.linalg.LinAlgError):
                pass

    def __call__(self, readings: Readings, possible: bool = True) -> _Score | None:
        """The best fit with positive wheels, or with any; None without one.

        Motion that does not show all parameters fits many mistakes: there, only the readings as they stand are scored.
        """
        legs = len(readings.log) - len(np.unique(readings.log))
        full = legs >= _FEWEST_IN_PART - 1 and readings.distinguishes
        shown = full or (legs >= _FEWEST_IN_PART - 1 and readings.planar)
        if legs < FEWEST_LEGS or not (shown or readings is self._as_is):
            return None
        pairs = _thinned(readings.pairs)
        distance_m = float(np.linalg.norm(pairs.points_c, axis=-1).mean())
        solutions: list[tuple[float, Parameters]] = []
        for ratios in self._starts if full else [np.zeros(2)]:
            try:
                parameters = (
                    Rounds(pairs).after(ratios, _ROUNDS)
                    if full
                    else initial_with_prior(pairs, self._prior, readings.motion)
                )
                misfit, kept = _misfit(pairs, parameters, distance_m)
                if misfit < _PROMISING:
                    parameters = refine_lm(pairs.select(kept), parameters).parameters
                    misfit, _ = _misfit(pairs, parameters, distance_m)
            except (SolveError, np.linalg.LinAlgError):
                continue
            if not (shown and possible) or np.all(parameters.wheels.vector > 0):
                solutions.append((misfit, parameters))
        if not solutions:
            return None
        misfit, best = min(solutions, key=lambda item: item[0])
        turn = np.eye(3) if self._R_h_c is None else self._R_h_c.T @ best.T_h_c[:3, :3]
        of_all = rms_m(residuals_m(pairs, best)) / distance_m
        return _Score(misfit, of_all, float(np.linalg.norm(se3.log_so3(turn))), best.wheels)


def _thinned(pairs: MotionPairs) -> MotionPairs:
    legs = len(pairs.legs)
    if legs <= _MOST_LEGS:
        return pairs
    return pairs.select(np.linspace(0, legs - 1, _MOST_LEGS).round().astype(np.int64))


def _misfit(pairs: MotionPairs, parameters: Parameters, distance_m: float) -> tuple[float, IntArray]:
    """Rms of the corners' transfer error over the distance, on the legs that fit best, and these legs."""
    squared = np.mean(np.sum(residuals_m(pairs, parameters) ** 2, axis=-1), axis=1)
    kept = np.sort(np.argsort(squared)[: math.ceil(_USED * len(squared))])
    return math.sqrt(float(squared[kept].mean())) / distance_m, kept


# -- stage 1: signs, sides and units, and readings that stop -----------------------------------------


def _joints_times(factor: float, columns: Sequence[int] | slice = slice(None)) -> Transform:
    def transform(readings: Readings) -> Readings:
        joints = readings.joints.copy()
        joints[:, columns] *= factor
        return replace(readings, joints=joints)

    return transform


def _wheels_with(
    change: Callable[[Track], Track], sides: Sequence[str] = _SIDES, swapped: bool = False
) -> Transform:
    """Change the readings of the wheels on some sides, after their exchange."""

    def changed(right: Track, left: Track) -> WheelTrack:
        return WheelTrack(
            change(right) if "right" in sides else right, change(left) if "left" in sides else left
        )

    def transform(readings: Readings) -> Readings:
        ends = [(track.right, track.left) for track in readings.wheels]
        tracks = tuple(changed(left, right) if swapped else changed(right, left) for right, left in ends)
        return replace(readings, wheels=tracks)

    return transform


def _times(factor: float) -> Callable[[Track], Track]:
    return lambda track: replace(track, value=factor * track.value)


def _joints(readings: Readings) -> Iterator[Hypothesis]:
    """Signs, order and units of the head joints' readings."""
    chain = readings.rig.chain
    joints = chain.joints
    for column, name in enumerate(joints):
        yield Hypothesis(
            f"the sign of joint {name} is reversed",
            f"reverse the axis of {name} in head.chain or in the URDF, or the sign of its readings",
            _joints_times(-1.0, [column]),
        )
    if len(joints) > 1:
        yield Hypothesis(
            "the signs of all head joints are reversed",
            "reverse the axes of the head joints in head.chain or in the URDF, or the signs of their readings",
            _joints_times(-1.0),
        )
    if chain.pan in joints and chain.tilt in joints and chain.pan != chain.tilt:
        order = np.arange(len(joints))
        pan, tilt = joints.index(chain.pan), joints.index(chain.tilt)
        order[[pan, tilt]] = tilt, pan
        yield Hypothesis(
            f"the readings of {chain.pan} and {chain.tilt} are exchanged",
            "exchange joints.pan and joints.tilt in rig.yaml, or the names in the recording",
            lambda r: replace(r, joints=r.joints[:, order]),
        )
    for unit, factor in (("degrees", math.pi / 180), ("radians, but were taken for degrees", 180 / math.pi)):
        cure = "set the unit in joints.fields in rig.yaml, or correct the recording"
        yield Hypothesis(f"the joint readings are in {unit}", cure, _joints_times(factor))
        for column, name in enumerate(joints if len(joints) > 1 else ()):
            yield Hypothesis(f"the readings of {name} are in {unit}", cure, _joints_times(factor, [column]))


def _of_sides(rig: Rig, swapped: bool, sides: Sequence[str]) -> tuple[str, str]:
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
        for sides in ((), _SIDES) if odometry else ((), ("right",), ("left",), _SIDES):
            if swapped or sides:
                yield Hypothesis(
                    *_of_sides(readings.rig, swapped, sides), _wheels_with(_times(-1.0), sides, swapped)
                )
    if not odometry:
        yield Hypothesis(
            "the wheel readings are in degrees",
            "convert them to rad, or state ticks_per_revolution: 360 in rig.yaml",
            _wheels_with(_times(math.pi / 180)),
        )


def _interruptions(readings: Readings) -> Iterator[Hypothesis]:
    """Stretches of stations in which one reading stays the same while another changes, or both wheels; left out."""
    for log, track in enumerate(readings.wheels):
        mine = np.flatnonzero(readings.log == log)
        if len(mine) < _FEWEST_IN_PART:
            continue
        joints, turned = readings.joints[mine], sampled((track.right, track.left), readings.time_ns[mine])
        of_joints = [
            (f"the reading of joint {name} does not change", joints[:, [j]], np.delete(joints, j, axis=1))
            for j, name in enumerate(readings.rig.chain.joints)
        ]
        of_wheels = [
            (f"the reading of the {side} wheel does not change", turned[:, [j]], turned[:, [1 - j]])
            for j, side in enumerate(_SIDES)
        ] + [("the readings of both wheels do not change", turned, turned[:, :0])]
        for number, (cause, values, others) in enumerate(of_joints + of_wheels):
            for first, last in _still(values, others):
                if first and last < len(mine) - 1 and number >= len(of_joints):
                    continue  # the leg across would be wrong
                kept = np.delete(np.arange(len(readings.log)), mine[first + 1 if first else 0 : last + 1])
                yield Hypothesis(
                    f"{cause} between {readings.at_s(mine[first])} and {readings.at_s(mine[last])} s",
                    "check the cable and the driver, and record again, or leave this stretch out",
                    partial(Readings.of, stations=kept),
                )


def _still(values: FloatArray, others: FloatArray) -> Iterator[tuple[int, int]]:
    """First and last row of stretches in which readings (n, k) stay the same while the others (n, m) change, if any."""
    for first, last in _runs(np.all(np.abs(np.diff(values, axis=0)) < _STILL, axis=1)):
        moved = np.ptp(others[first : last + 1], axis=0)
        if _FEWEST_IN_PART <= last - first + 2 <= len(values) and (not len(moved) or moved.max() > _MOVED):
            yield first, last


def _runs(true: BoolArray) -> list[tuple[int, int]]:
    """First index of each run of true values, and the index after its last."""
    edges = np.flatnonzero(np.diff(np.concatenate([[False], true, [False]]).astype(int)))
    return [(first, end) for first, end in edges.reshape(-1, 2).tolist()]


# -- stage 2: readings of another time ------------------------------------------


def _wheels_earlier(delay_ns: int, sides: Sequence[str]) -> Transform:
    return _wheels_with(lambda track: replace(track, time_ns=track.time_ns - delay_ns), sides)


def _joints_earlier(delay_ns: int) -> Transform:
    def transform(readings: Readings) -> Readings:
        joints = readings.joints.copy()
        for log, tracks in enumerate(readings.joint_tracks):
            mine = readings.log == log
            at_ns = readings.time_ns[mine]
            joints[mine] += sampled(tracks, at_ns + delay_ns) - sampled(tracks, at_ns)
        return replace(readings, joints=joints)

    return transform


def _delays(readings: Readings) -> Iterator[Hypothesis]:
    """Stamps that are late or early by so much that joints or wheels move while the images show a stop.

    A delay is tried if nothing moves at nearly all stations without it, and if both wheels still have readings of at
    least half the recording.
    """
    shortest_s = min((float(np.ptp(track.time_ns)) * 1e-9 for track in readings.wheels), default=0.0)
    most = int(min(_LONGEST_DELAY_S, shortest_s / 2) / _DELAY_STEP_S)
    shifts_s = _DELAY_STEP_S * np.arange(-most, most + 1)
    wheels = (
        ("readings of both wheels are", _SIDES),
        ("readings of the right wheel are", ("right",)),
        ("readings of the left wheel are", ("left",)),
    )
    parts: list[tuple[str, Sequence[tuple[Track, ...]], Callable[[int], Transform]]] = [
        (
            cause,
            [tuple(getattr(track, side) for side in sides) for track in readings.wheels],
            partial(_wheels_earlier, sides=sides),
        )
        for cause, sides in wheels
    ]
    for cause, tracks, earlier in (*parts, ("joint readings are", readings.joint_tracks, _joints_earlier)):
        moving = np.array([_moving_share(readings, tracks, shift_s) for shift_s in shifts_s])
        if moving[most] < _MOSTLY_STILL:
            continue  # still as stamped
        stops_s = [(shifts_s[i] + shifts_s[j - 1]) / 2 for i, j in _runs(moving < _MOSTLY_STILL)]
        for delay_s in sorted(stops_s, key=abs)[:_DELAYS]:
            yield Hypothesis(
                f"the {cause} about {abs(delay_s):.1f} s {'late' if delay_s > 0 else 'early'}",
                "correct the clock that stamps them, and record again",
                earlier(round(delay_s * 1e9)),
            )


def _moving_share(readings: Readings, tracks: Sequence[tuple[Track, ...]], shift_s: float) -> float:
    """Share of the stations at which some of the tracks move, if their stamps are late by so much."""
    moving = np.zeros(len(readings.log), dtype=np.bool_)
    for log, own in enumerate(tracks):
        mine = readings.log == log
        at_ns = readings.time_ns[mine] + round(shift_s * 1e9)
        moved = np.abs(sampled(own, at_ns + _AROUND_NS) - sampled(own, at_ns - _AROUND_NS))
        moving[mine] = np.any(moved > _STILL, axis=1)
    return float(moving.mean())


def _neighbors(_: Readings) -> Iterator[Hypothesis]:
    """Images or joint readings that belong to the station before or after."""

    def moved(readings: Readings, name: str, by: int) -> Readings:
        count = len(readings.log)
        own = np.arange(max(-by, 0), count - max(by, 0))
        own = own[readings.log[own] == readings.log[own + by]]
        return replace(readings.of(own), **{name: getattr(readings, name)[own + by]})

    for by, which in ((1, "previous"), (-1, "next")):
        for what, name in (("images", "T_c_k"), ("joint readings", "joints")):
            yield Hypothesis(
                f"the {what} are those of the {which} station",
                "check the clock that stamps them, and that the driver sends each one at once, and record again",
                partial(moved, name=name, by=by),
            )


# -- stage 3: readings that say nothing: a joint, or the wheels, as the images show them --------------


def _free_joints(readings: Readings) -> Iterator[Hypothesis]:
    """Readings of one joint that have nothing to do with it."""
    for column, name in enumerate(readings.rig.chain.joints):
        still = bool(np.ptp(readings.joints[:, column]) < _STILL)
        yield Hypothesis(
            f"the reading of {name} never changes, and the images do not fit a joint at rest"
            if still
            else f"the readings of {name} do not fit; the images, the wheels and the other joints do",
            "check that the state of this joint is recorded while it moves"
            if still
            else "check the topic, the clock, the sign and the unit of this joint, and its gear",
            partial(_joint_as_seen, column=column),
        )


def _free_wheels(readings: Readings) -> Iterator[Hypothesis]:
    """Readings of the wheels that have nothing to do with the drive."""
    sides = [(side, [getattr(track, side) for track in readings.wheels]) for side in _SIDES]
    still = [side for side, tracks in sides if all(np.ptp(track.value) < _STILL for track in tracks)]
    rising = all(np.all(np.diff(track.value) >= -_STILL) for _, tracks in sides for track in tracks)
    shown = "the images and the head joints show" if readings.rig.chain.joints else "the images show"
    cause, cure = (
        f"the readings of the wheels do not fit the drive that {shown}",
        "check the topics, the clocks and the counters of both wheels: overflow, resets, gears",
    )
    if readings.rig.sources.assumed_odometry is not None:
        cause, cure = (
            f"the odometry does not fit the drive that {shown}",
            "check that it is of this drive, its clock, and that it is not reset or fused with other sensors",
        )
    if len(still) == 2:
        cause = "the readings of both wheels never change, and the images do not fit a base at rest"
        cure = "check that the wheel encoders are recorded while the base moves"
    elif still:
        cause = f"the reading of the {still[0]} wheel never changes, and that of the other wheel does"
        cure = "check the cable and the driver of this encoder, and record again"
    elif rising:
        cause = (
            "the readings of both wheels never decrease, but the images show that the base drives to and fro"
        )
        cure = "read the encoders with their direction (quadrature), and record again"
    yield Hypothesis(cause, cure, _wheels_as_seen)


def _joint_as_seen(readings: Readings, column: int) -> Readings:
    """The readings of one joint by the images, with nominal wheels; none if this joint is at rest."""
    readings = readings.of(slice(_MOST_LEGS))
    wheels, joints = readings.rig.nominal.wheels, readings.joints.copy()
    if wheels is None:
        return readings.of(slice(0))
    T_w_v = [np.eye(4)]
    for T_vi_vj in base_motion(integrate(readings.pairs.steps, wheels)):
        T_w_v.append(T_w_v[-1] @ T_vi_vj)
    base = np.stack(T_w_v)

    def place(free: FloatArray) -> tuple[FloatArray, FloatArray]:
        joints[:, column] = free
        return base, joints

    free = _as_seen(readings, place, np.full(len(joints), np.median(joints[:, column])))
    if np.ptp(free) <= _MOVED:
        return readings.of(slice(0))
    return replace(readings, joints=place(free)[1])


def _wheels_as_seen(readings: Readings) -> Readings:
    """The readings of nominal wheels by the images and the joints; none without nominal values."""
    readings = readings.of(slice(_MOST_LEGS))
    X, wheels = readings.nominal_head_eye, readings.rig.nominal.wheels
    if X is None or wheels is None:
        return readings.of(slice(0))

    def place(free: FloatArray) -> tuple[FloatArray, FloatArray]:
        x, y, heading = np.concatenate([np.zeros((1, 3)), free.reshape(-1, 3)]).T
        return se3.transform(se3.rotation_z(heading), np.stack([x, y, 0 * x], axis=1)), readings.joints

    T_v_k = head_pose(readings.rig.chain, readings.joints) @ X @ readings.T_c_k
    T_v0_vn = T_v_k[0] @ se3.inverse(T_v_k[1:])
    heading = np.arctan2(T_v0_vn[:, 1, 0] - T_v0_vn[:, 0, 1], T_v0_vn[:, 0, 0] + T_v0_vn[:, 1, 1])
    T_w_v, _ = place(_as_seen(readings, place, np.column_stack([T_v0_vn[:, :2, 3], heading]).ravel()))
    return replace(readings, wheels=(_rolled(T_w_v, wheels, readings.time_ns),))


def _as_seen(
    readings: Readings, place: Callable[[FloatArray], tuple[FloatArray, FloatArray]], start: FloatArray
) -> FloatArray:
    """The free part of the readings with which the board stays where it is, the head-eye transform near nominal.

    Args:
        readings: of one recording.
        place: free part (F,) → T_w_v (N, 4, 4) and joints (N, J).
        start: (F,) free part to start from.
    """
    X = readings.nominal_head_eye
    if X is None:
        return start
    scale_m = _SPREAD * float(np.linalg.norm(readings.T_c_k[:, :3, 3], axis=1).mean())
    corners_k = np.broadcast_to(readings.corners_k, (len(readings.T_c_k), 4, 3))

    def residuals(x: FloatArray) -> FloatArray:
        T_w_v, joints = place(x[6:])
        mount = X @ se3.exp(x[:6] * ([_MOUNT_RAD] * 3 + [_MOUNT_M] * 3))
        corners_w = se3.act(T_w_v @ head_pose(readings.rig.chain, joints) @ mount @ readings.T_c_k, corners_k)
        spread = (corners_w - np.median(corners_w, axis=0)) / scale_m
        return np.concatenate([spread.ravel(), x[:6]])

    optimum = least_squares(residuals, np.concatenate([np.zeros(6), start]), loss="soft_l1", max_nfev=30)
    return np.asarray(optimum.x[6:])


def _rolled(T_w_v: FloatArray, wheels: WheelGeometry, time_ns: IntArray) -> WheelTrack:
    """Rotation of the wheels between base poses (N, 4, 4): a turn, a straight line and a turn on each leg."""
    T_vi_vj = se3.inverse(T_w_v[:-1]) @ T_w_v[1:]
    first = np.arctan2(T_vi_vj[:, 1, 3], T_vi_vj[:, 0, 3])
    backward = np.abs(first) > math.pi / 2  # rather drives backwards than turns around
    first = np.where(backward, first - np.copysign(math.pi, first), first)
    length_m = np.where(backward, -1.0, 1.0) * np.hypot(T_vi_vj[:, 0, 3], T_vi_vj[:, 1, 3])
    last = np.arctan2(T_vi_vj[:, 1, 0], T_vi_vj[:, 0, 0]) - first
    zero = np.zeros_like(first)
    turn, drive = np.stack([first, zero, last], axis=1), np.stack([zero, length_m, zero], axis=1)
    rolled = [
        np.concatenate([[0.0], np.cumsum((drive + side * turn * wheels.separation_m / 2) / radius_m)])
        for side, radius_m in ((1, wheels.radius_right_m), (-1, wheels.radius_left_m))
    ]
    begin, third = time_ns[:-1], np.diff(time_ns) // 3
    stamps = np.append(np.stack([begin, begin + third, time_ns[1:] - third], axis=1), time_ns[-1])
    return WheelTrack.at_same_times(stamps, *rolled)


#: The table, in stages of growing freedom: mistakes in a whole recording, and readings that say nothing.
_WHOLE = ((_joints, _wheels, _interruptions), (_delays, _neighbors))
_FREE = ((_free_joints,), (_free_wheels,))


# -- the search -----------------------------------------------------------------------------------


class Search:
    """The search for the one mistake because of which a recording does not fit; each step is made once, when needed.

    Args:
        extraction: a recording of a target with at least three legs.
    """

    def __init__(self, extraction: Extraction) -> None:
        self._extraction = extraction

    @cached_property
    def _readings(self) -> Readings:
        return readings_of(self._extraction)

    @cached_property
    def _score(self) -> _Scorer:
        return _Scorer(self._readings)

    @cached_property
    def _as_is(self) -> _Score | None:
        return self._score(self._readings)

    @property
    def _fits(self) -> bool:
        return self._as_is is not None and self._as_is.misfit < FITS

    @property
    def _base(self) -> float | None:
        """Misfit of the readings as they stand; None if nothing fits them, or if their motion does not show it."""
        return None if self._as_is is None or not self._readings.distinguishes else self._as_is.misfit

    @cached_property
    def misfit(self) -> float | None:
        """Misfit of most legs over the distance to the board; None if they fit, or the motion does not show it."""
        score = self._score(self._readings, possible=False)
        return None if score is None or score.misfit < FITS else score.misfit

    @cached_property
    def of_whole(self) -> Diagnosis | None:
        """The mistake in all readings; None if they fit, or if none of the known ones explains them."""
        at_rest = _same_view(self._readings)
        if at_rest is None and self._as_is is not None and self._fits:
            return _other_wheels(self._as_is.wheels, self._readings.rig.nominal.wheels)
        return at_rest or self._named(self._readings, _WHOLE)

    @cached_property
    def diagnosis(self) -> Diagnosis | None:
        """The mistake in all readings, or else in some: of one recording, from a station on, or of one sensor."""
        if self.of_whole is not None or self._fits:
            return self.of_whole
        if len(self._readings.wheels) > 1:
            return self._of_one_log()
        free = _FREE if self._readings.consistent else ()
        return self._from_a_station_on() or self._named(self._readings, free, _FITS_FREE)

    def _limit(self, fits: float) -> float:
        return fits if self._base is None else min(_BETTER * self._base, fits)

    def _named(self, readings: Readings, stages: Stages, fits: float = FITS) -> Diagnosis | None:
        """The hypotheses of the first stage with which the readings fit, about as well as with the best one."""
        limit = self._limit(fits)
        for stage in stages:
            scored = [
                (self._score(row.transform(readings)), row) for family in stage for row in family(readings)
            ]
            fitting = [(fit, row) for fit, row in scored if fit is not None and fit.misfit < limit]
            if not fitting:
                continue
            least = min(fit.misfit for fit, _ in fitting)
            equal = [(fit, row) for fit, row in fitting if fit.misfit < _EQUAL * least]
            nearest = min(fit.turned_rad for fit, _ in equal)
            named = [row for fit, row in equal if fit.turned_rad < nearest + _SAME_RAD]
            cures = dict.fromkeys(row.cure for row in named)
            return Diagnosis(" or ".join(row.cause for row in named), ", or ".join(cures), self._base, least)
        return None

    def _of_one_log(self) -> Diagnosis | None:
        """The mistake of one of several recordings."""
        logs = len(self._extraction.wheels)
        for log in range(logs):
            alone = self._extraction.of_log(log)
            diagnosis = Search(alone).diagnosis if len(alone.observations) > FEWEST_LEGS else None
            if diagnosis is not None:
                return replace(diagnosis, cause=f"recording {log + 1} of {logs}: {diagnosis.cause}")
        return None

    def _from_a_station_on(self) -> Diagnosis | None:
        """A change: the first stations fit on their own, and the others too, or without a mistake."""
        readings, limit = self._readings, self._limit(_FITS_CHANGED)
        count = len(readings.log)
        if count < 2 * _FEWEST_IN_PART:
            return None

        def fit_of(part: slice) -> _Score | None:
            fit = self._score(readings.of(part))
            return fit if fit is not None and fit.of_all < limit else None

        low, high = _FEWEST_IN_PART, count - _FEWEST_IN_PART
        while low < high:  # the most first stations that fit
            middle = (low + high + 1) // 2
            low, high = (middle, high) if fit_of(slice(middle)) else (low, middle - 1)
        # A part may fit with an outlier of the other one.
        for cut in range(low, max(low - _OUTLIERS_IN_PART, _FEWEST_IN_PART) - 1, -1):
            before = fit_of(slice(cut))
            if before is None:
                continue
            after = fit_of(slice(cut, None))
            if after is not None:
                return self._change(cut, before, after)
            diagnosis = self._named(readings.of(slice(cut, None)), _WHOLE[:1])
            if diagnosis is not None:
                return replace(diagnosis, cause=f"from about {readings.at_s(cut)} s on, {diagnosis.cause}")
        return None

    def _change(self, cut: int, before: _Score, after: _Score) -> Diagnosis:
        """What changes where all stations before the cut fit, and all after it."""
        readings, misfit = self._readings, max(before.misfit, after.misfit)
        log = (np.arange(len(readings.log)) >= cut).astype(np.int64)
        apart = self._score(replace(readings, log=log, wheels=readings.wheels * 2))
        if apart is not None and apart.misfit < _EQUAL * misfit:
            what = "the readings of the wheels jump, or the board or the robot is moved by hand,"
        else:  # larger readings look like smaller wheels
            factors = before.wheels.vector[:2] / after.wheels.vector[:2]
            what = " and ".join(
                f"the {side} wheel's readings become {factor:.2g} times as large"
                for side, factor in zip(_SIDES, factors.tolist(), strict=True)
                if abs(factor - 1) > _CHANGED_SCALE
            )
        return Diagnosis(
            f"{what or 'a wheel, a joint or a camera changes'} between {readings.at_s(cut - 1)} and "
            f"{readings.at_s(cut)} s: the recording fits before and after, but not as a whole",
            "check the wheels, the head, the cameras and the board at this time, and record again without the change",
            self._base,
            misfit,
        )


# -- what needs no fit ------------------------------------------------------------------------------


def _same_view(readings: Readings) -> Diagnosis | None:
    """All stations show the board at the same place while joints or wheels move."""
    away = se3.inverse(readings.T_c_k[0]) @ readings.T_c_k
    distance_m = float(np.linalg.norm(readings.T_c_k[0, :3, 3]))
    still = np.linalg.norm(se3.log_so3(away[:, :3, :3]), axis=-1).max() < _SAME_VIEW
    still &= np.linalg.norm(away[:, :3, 3], axis=-1).max() < _SAME_VIEW * distance_m
    moves = [
        np.ptp(readings.joints, axis=0),
        np.abs(readings.pairs.steps.totals_rad).max(axis=0, initial=0.0),
    ]
    if not still or np.concatenate(moves).max() <= _MOVED:
        return None
    return Diagnosis(
        "all stations show the board at the same place, but the base or the head moves",
        "check that the images are not frozen, and that the board does not move with the robot",
        None,
        None,
    )


def turned_around(rig: Rig, T_h_c: FloatArray) -> Diagnosis | None:
    """A camera on the base that is upside down or looks back against its nominal pose: wheels that are exchanged.

    A planar drive with exchanged or reversed wheels fits as well as the right one, with the base turned by 180 degrees.
    """
    nominal = rig.nominal.T_h_reference
    if rig.chain.joints or nominal is None:
        return None
    turn = T_h_c[:3, :3] @ (nominal @ se3.inverse(rig.cameras.T_c_reference))[:3, :3].T
    if float(np.linalg.norm(se3.log_so3(turn))) < _AROUND_RAD:
        return None
    upside_down, backward = bool(turn[2, 2] < 0), bool(turn[0, 0] < 0)
    # Upside down, the base turns the other way; turned about the vertical, it drives backwards and turns as before.
    cause, cure = _of_sides(rig, upside_down != backward, ("right", "left") if backward else ())
    return Diagnosis(
        f"{cause}, or the nominal pose of the camera is that of another frame",
        f"{cure}, or correct nominal.head_eye",
        None,
        None,
    )


def _other_wheels(wheels: WheelGeometry, nominal: WheelGeometry | None) -> Diagnosis | None:
    """Wheel radii with which the recording fits but which are several times the nominal ones: another unit."""
    if nominal is None:
        return None
    radii_m = wheels.vector[:2]
    ratios = radii_m / nominal.vector[:2]
    factor = float(np.mean(np.abs(ratios)))
    right, left = (f"{1e3 * radius_m:.4g}" for radius_m in radii_m)
    if 1 / _OTHER_WHEELS < factor < _OTHER_WHEELS:
        if ratios[0] * ratios[1] > 0:
            return None
        return Diagnosis(
            f"the wheel radii that fit are {right} and {left} mm: one of the wheels counts in the other direction",
            "negate wheels.left.sign or wheels.right.sign in rig.yaml: readings increase when driving forward",
            None,
            None,
        )
    meters = " (1 m: the readings are in meters)" if abs(radii_m - 1).max() < _SAME_UNIT_M else ""
    return Diagnosis(
        f"the wheel radii that fit are {right} and {left} mm, {factor:.2g} times the nominal ones{meters}",
        "check the unit and the ticks_per_revolution of the wheel readings (radians are expected), and a gear ratio",
        None,
        None,
    )
