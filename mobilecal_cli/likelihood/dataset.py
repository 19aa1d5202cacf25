"""An extraction as measurements, with the constants that are estimated from it."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from mobilecal_cli.kinematics import between_steps, encoder_steps_rad
from mobilecal_cli.likelihood.constants import Constant, Layout, kind_of
from mobilecal_cli.likelihood.measurements import Measurements, legs_between, steps_between
from mobilecal_cli.model.arrays import BoolArray, FloatArray, IntArray
from mobilecal_cli.model.observations import Extraction, Observation, WheelTrack
from mobilecal_cli.model.signals import Track

#: Kind of measurement that is used or not as a whole → its degrees of freedom: a station's images, a leg's wheels,
#: and a joint reading.
DEGREES = {"views": 6, "legs": 3, "readings": 1}
_LEAST_CLAIM_PX = 0.01  # the camera model is not more exact than this, whatever several images agree on
#: A component of a measured pose with a larger standard deviation, rad or m, was not measured.
NOT_MEASURED = 100.0
_LEAST_VARIANCE = 1e-6  # of a corner, relative to a usual one
_OFF_THE_CURVE = 1 / 8  # a sudden change of the rate, see `between_readings`
_MOVED_RAD, _NOISE_SIGMAS = 0.002, 6.0  # less than both is noise of a reading, not a motion
_LOOKED_BACK = 64  # readings before a station, where a joint's last motion is looked for first
# A joint in motion: its own direction counts, not how it got there.
_INTERVAL_NS, _MOVING_RADPS = 50_000_000, 0.03
# A joint that moves within the longer of these intervals before and after a station, but hardly there, turns back.
_AROUND_NS = np.array([-3, -1, 0, 1, 3]) * _INTERVAL_NS
# The motion of a joint is taken over the first interval, or over so long a one that noise moves the joint by less than
# `_STILL_RAD` within a usual offset of the clocks, but at most the second. Fewer changes show no noise.
_LEAST_WIDTH_S, _MOST_WIDTH_S = 0.04, 0.1
_STILL_RAD, _OFFSET_S, _FEWEST_CHANGES = 1e-4, 0.02, 20
_MEDIAN = 0.6745  # of the absolute value of a standard normal variable


@dataclass(frozen=True, eq=False)
class Dataset(Measurements):
    """Measurements, and what is estimated from them.

    Attributes:
        layout: columns of the parameters that all recordings share.
    """

    layout: Layout

    def with_constants(self, constants: Sequence[Constant]) -> Dataset:
        """The same measurements with other constants estimated."""
        return replace(self, layout=Layout(tuple(constants)))


@dataclass(frozen=True, slots=True, eq=False)
class Inliers:
    """The measurements that are used.

    Attributes:
        corners: (N, C, M) corners of each image, among those that were detected.
        views: (N,) stations whose images are used.
        legs: (L,) legs whose wheels are used.
        readings: (N, J) joint readings that are used.
    """

    corners: BoolArray
    views: BoolArray
    legs: BoolArray
    readings: BoolArray

    @classmethod
    def all_of(cls, data: Dataset) -> Inliers:
        """Every measurement."""
        every = (
            np.ones(shape, dtype=np.bool_) for shape in (data.stations, len(data.legs), data.joints.shape)
        )
        return cls(data.seen, *every)

    def same(self, other: Inliers) -> bool:
        """Whether both are the same measurements."""
        kinds = ("corners", *DEGREES)
        return all(np.array_equal(getattr(self, kind), getattr(other, kind)) for kind in kinds)

    @property
    def used_corners(self) -> BoolArray:
        """(N, C, M) corners of the stations whose images are used."""
        return self.corners & self.views[:, None, None]


def dataset_of(extraction: Extraction, constants: Sequence[Constant] = ()) -> Dataset:
    """Gather the measurements of an extraction.

    Args:
        extraction: at least one observation.
        constants: rows of the constants to estimate.
    """
    observations = extraction.observations
    log = np.array([o.log for o in observations])
    times_ns = np.array([o.time_ns for o in observations], dtype=np.int64)
    joints = np.stack([o.joints for o in observations])
    steps = encoder_steps_rad(extraction.wheels)
    moving = np.array([not o.at_rest for o in observations])
    tracks = extraction.wheels
    if moving.any():  # at rest a reading is as good as its step; in motion its changes are more exact
        tracks = tuple(WheelTrack(*map(between_steps, (t.right, t.left), steps)) for t in tracks)
    units = extraction.rig.chain.joint_units
    joint_noise = [[_noise(track) for track in of_log] for of_log in extraction.joint_tracks]
    widths_ns = tuple(tuple(map(_width_ns, of_log, units)) for of_log in joint_noise)
    shown = np.stack([[view.seen for view in o.views] for o in observations])
    claims = np.hypot([[view.sigma_px for view in o.views] for o in observations], _LEAST_CLAIM_PX)
    usual = math.sqrt(np.mean(claims[shown.any(axis=2)] ** 2)) if shown.any() else 1.0
    of_tracks = [*zip(extraction.joint_tracks, widths_ns, joint_noise, strict=True)]
    sides, turned = _approach_direction(of_tracks, log, times_ns, joints)
    on_the_way = between_readings(extraction.joint_tracks, log, times_ns, moving, joints.shape[1])
    play = kind_of("backlash").sigma * np.array(units)
    return Dataset(
        cameras=extraction.rig.cameras,
        chain=extraction.rig.chain,
        points_k=extraction.board.grid() * extraction.square_m,
        pixels=np.stack([[view.pixels for view in o.views] for o in observations]),
        seen=shown,
        whitening=_whitening(observations, claims / usual),
        claimed_px=usual,
        pixels_cov=np.stack([[view.cov_px2 for view in o.views] for o in observations]),
        pose_weight=np.stack([_pose_weight(o) for o in observations]),
        T_c_k=np.stack([o.T_c_k for o in observations]),
        points_c=np.stack([o.points_c for o in observations]),
        points_cov=np.stack([o.points_cov for o in observations]),
        joints=joints,
        joint_tracks=extraction.joint_tracks,
        joint_widths_ns=widths_ns,
        moving=moving,
        approach_direction=sides,
        wheels_between=between_readings([(t.right, t.left) for t in tracks], log, times_ns, moving, 2),
        joints_between=np.hypot(on_the_way, play * (turned & moving[:, None])),
        log=log,
        legs=legs_between(log),
        tracks=tracks,
        driven=steps_between(tracks, log, times_ns),
        motions=extraction.motions,
        times_ns=times_ns,
        encoder_step_rad=steps,
        sources=extraction.rig.sources,
        layout=Layout(tuple(constants)),
    )


def between_readings(
    tracks: Sequence[Sequence[Track]], log: IntArray, times_ns: IntArray, moving: BoolArray, count: int
) -> FloatArray:
    """(N, K) sigma of K tracks of each recording at the stations, interpolated between two readings, rad or m.

    Where the ways in the times T before and after an interval T differ by d, the curve in between is off by d / 8 at
    most if the rate changes at once, and by nothing if it changes steadily. At rest, and where the tracks are not
    known, 0.
    """
    sigma = np.zeros((len(times_ns), count))
    for number, of_log in enumerate(tracks):
        mine = np.flatnonzero((log == number) & moving)
        for k, track in enumerate(of_log if len(mine) else ()):
            after = np.clip(np.searchsorted(track.time_ns, times_ns[mine]), 1, len(track.time_ns) - 1)
            begin, end = track.time_ns[after - 1], track.time_ns[after]
            ways = (track.at(2 * end - begin) - track.at(end), track.at(begin) - track.at(2 * begin - end))
            sigma[mine, k] = _OFF_THE_CURVE * np.abs(ways[0] - ways[1])
    return sigma


def _noise(track: Track) -> float:
    """Standard deviation of the readings of a track, from their third differences: steady acceleration is no noise."""
    offsets, value = (track.time_ns - track.time_ns[:1]).astype(np.float64), track.value
    if np.count_nonzero(np.diff(value)) < _FEWEST_CHANGES:
        return 0.0
    before, after = offsets[1:-1] - offsets[:-2], offsets[2:] - offsets[1:-1]
    off_line = value[1:-1] - (value[:-2] * after + value[2:] * before) / (before + after)
    thirds = np.diff(off_line)[np.diff(value)[1:-1] != 0]
    # The variance of this difference is 5 times the noise's.
    noise = float(np.median(np.abs(thirds))) / _MEDIAN / math.sqrt(5) if len(thirds) else 0.0
    return noise if math.isfinite(noise) else 0.0  # damaged readings


def _width_ns(noise: float, unit: float) -> int:
    """Interval over which the motion of a joint with a noise of its readings, rad or m, is taken; see `joint_units`."""
    width_s = math.sqrt(2) * noise / (_STILL_RAD * unit) * _OFFSET_S
    return round(min(max(width_s, _LEAST_WIDTH_S), _MOST_WIDTH_S) * 1e9)


def _pose_weight(o: Observation) -> FloatArray:
    """(6, 6) inverse covariance of a pose that was measured without corners, 0 along what was not measured."""
    weight = np.zeros((6, 6))
    if not o.shown:
        measured = np.flatnonzero(np.diag(o.T_c_k_cov) < NOT_MEASURED**2)
        weight[np.ix_(measured, measured)] = np.linalg.inv(o.T_c_k_cov[np.ix_(measured, measured)])
    return weight


def _whitening(observations: Sequence[Observation], relative_sigma: FloatArray) -> FloatArray:
    """Inverse Cholesky factors of the corners' covariances in units of the noise level, (N, C, M, 2, 2)."""
    cov = np.stack([[view.relative_cov for view in o.views] for o in observations])
    cov = cov * relative_sigma[..., None, None, None] ** 2
    a = np.sqrt(np.maximum(cov[..., 0, 0], _LEAST_VARIANCE))
    b = cov[..., 1, 0] / a
    c = np.sqrt(np.maximum(cov[..., 1, 1] - b**2, _LEAST_VARIANCE))
    W = np.zeros_like(cov)
    W[..., 0, 0], W[..., 1, 0], W[..., 1, 1] = 1 / a, -b / (a * c), 1 / c
    return W


def _approach_direction(
    tracks: Sequence[tuple[Sequence[Track], Sequence[int], Sequence[float]]],
    log: IntArray,
    times_ns: IntArray,
    joints: FloatArray,
) -> tuple[FloatArray, BoolArray]:
    """(N, J) the direction of each joint's last motion before each station, from -1 to 1, and where it just turned.

    Where a joint turns back, its play is on neither side: there the direction changes in proportion to the rate. Until
    it has come back by more than noise, the side may be the other one.

    Args:
        tracks: of each recording, those of its joints, their widths, see `Measurements`, and the noise of one reading.
        log, times_ns, joints: of the stations.
    """
    sides, turned = np.zeros(joints.shape), np.zeros(joints.shape, dtype=np.bool_)
    for number, of_log in enumerate(tracks):
        mine = np.flatnonzero(log == number)
        for j, (track, width_ns, noise) in enumerate(zip(*of_log, strict=True)):
            moved = max(_MOVED_RAD, _NOISE_SIGMAS * noise)
            last = _last_motion(track, times_ns[mine], joints[mine, j], moved)
            around_ns = times_ns[mine] + _AROUND_NS[:, None]
            long_ago, before, here, after, later = track.mean(around_ns.ravel(), width_ns).reshape(
                around_ns.shape
            )
            rate = (here - before) / (_INTERVAL_NS * 1e-9)
            own = np.clip((after - before) / (2e-9 * _INTERVAL_NS) / _MOVING_RADPS, -1, 1)
            turns = np.minimum(np.abs(long_ago - here), np.abs(later - here)) > moved
            sides[mine, j] = np.where((np.abs(rate) > _MOVING_RADPS) | turns, own, last)
            turned[mine, j] = (own * last < 0) | (turns & (np.abs(own) < 1))
    return sides, turned


def _last_motion(track: Track, times_ns: IntArray, readings: FloatArray, moved: float) -> FloatArray:
    """(n,) from which side a joint last came to its readings at some times: +1, -1, or 0 where it never moved.

    A smaller difference than `moved` is no motion.
    """
    side, stops = np.zeros(len(times_ns)), np.searchsorted(track.time_ns, times_ns)
    ever = np.maximum(track.value.max() - readings, readings - track.value.min()) > moved
    for i in np.flatnonzero(ever).tolist():
        away, looked, stop = np.zeros(0), 0, int(stops[i])
        while not len(away) and looked < stop:  # mostly just before; else twice as far back
            seen, looked = looked, min(2 * looked + _LOOKED_BACK, stop)
            values = track.value[stop - looked : stop - seen]
            away = values[np.abs(values - readings[i]) > moved]
        side[i] = np.sign(readings[i] - away[-1]) if len(away) else 0.0
    return side
