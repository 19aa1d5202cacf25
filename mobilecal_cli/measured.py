"""Calibration from poses that somebody else measured: a target's pose in a sensor, or a sensor's own planar motion.

A measured pose stands where the corners of a board stand otherwise: any detector, motion capture, or lidar odometry.
"""

from __future__ import annotations

import math
import reprlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.arguments import all_of, by_name, require
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.likelihood.dataset import NOT_MEASURED
from mobilecal_cli.likelihood.measurements import planar_pose
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.calibration import NINE
from mobilecal_cli.model.observations import Corners, Extraction, Observation, SensorMotion, WheelTrack
from mobilecal_cli.model.rig import (
    Board,
    Camera,
    CameraRig,
    HeadChain,
    Nominal,
    Rig,
    Sources,
    WheelGeometry,
    WheelSource,
)
from mobilecal_cli.model.signals import Track
from mobilecal_cli.model.solution import Noise
from mobilecal_cli.ranges import SIGMA, number_of, of_parameter

_TARGET: Final = Board(4, 3, 0.1)  # points of the target, for errors in mm
_NO_ROTATION = 1e-3  # R^T R of a rotation with four digits differs less from the identity
_LEAST_SIGMA = 1e-6  # rad, m: no pose is measured so exactly; unknown covariances are often zero
_FARTHEST_M = 100.0  # of a target or a sensor
_CLEAR = 100.0  # times the noise of a motion: what is far from it
_BOTH_RAD = ("right_rad", "left_rad")
_WHEELS = "the radius of the right and the left wheel, and their separation, m"
# A pose around which the wheels turn is one in motion, if they are read more often than that meanwhile.
_AROUND_NS, _FEW_READINGS = 250_000_000, 2
_STILL_RAD = 0.005
_NO_CAMERA = Camera("sensor", 640, 480, np.diag([500.0, 500.0, 1.0]), np.zeros(0), "none")


@dataclass(frozen=True, slots=True, eq=False)
class TargetPose:
    """A target that stands still, as a sensor on the head saw it.

    Attributes:
        time_s: when, by the wheels' clock. Where the wheels turn at a pose, and are read several times in half
            a second, the offset of this clock is estimated.
        T_c_k: (4, 4) target coordinates to sensor coordinates, m.
        covariance: (6, 6) of T_c_k, rotation (rad) before translation (m), left perturbation: T = exp(delta) T_c_k.
            Its scale is estimated: only ratios matter where many poses were measured. Components with a standard
            deviation above 100 were not measured; below 1e-6, none is possible.
        joints: name → reading of each joint of the head, rad or m.
    """

    time_s: float
    T_c_k: FloatArray
    covariance: FloatArray
    joints: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class Drive:
    """One recording: poses at stops, and the wheels in between.

    Attributes:
        poses: in any order.
        wheel_time_s: (n,) increasing, from before the first pose to after the last.
        right_rad, left_rad: (n,) rotation of the wheels, positive when driving forward.
    """

    poses: Sequence[TargetPose]
    wheel_time_s: FloatArray
    right_rad: FloatArray
    left_rad: FloatArray


def from_poses(
    drives: Sequence[Drive],
    wheels_m: tuple[float, float, float],
    chain: HeadChain | None = None,
    T_h_c: FloatArray | None = None,
    noise: Mapping[str, float] | None = None,
) -> Extraction:
    """Measurements for `solve` from the poses of a target.

    Wheels are as exact as the scale of the poses, which nothing else shows. Of several poses at one stop, their median
    counts, once.

    Args:
        drives: one or more; each has a target of its own, which stands still meanwhile.
        wheels_m: nominal radius of the right and left wheel, and their separation, m.
        chain: from the base (origin midway between the wheels, x forward, z up) to the head; None for a sensor that is
            fixed to the base.
        T_h_c: (4, 4) nominal sensor coordinates to head coordinates, m; needed where the motion does not show the whole
            transform: a sensor that is fixed to the base never shows its height.
        noise: known noise levels: name → standard deviation, see `Noise`.

    Raises:
        ConfigError: no poses, wheels that are not possible, times that do not increase or do not cover the poses,
            readings that are not finite, a pose that is no rigid transform, a joint of the chain without a reading, a
            covariance that is not positive definite, an unknown noise level, or an argument of another type.
    """
    rig = _rig(wheels_m, HeadChain("base", "base", ()) if chain is None else chain, T_h_c, noise)
    observations, tracks, notes = [], [], []
    for log, drive in enumerate(all_of("drives", drives, Drive, "a list of mc.Drive")):
        where = f"drive {log + 1}"
        poses = all_of(f"{where}: poses", drive.poses, TargetPose, "a list of mc.TargetPose")
        in_order = sorted(poses, key=lambda pose: number_of(f"{where}: time_s of a pose", pose.time_s))
        tracks.append(_wheels(where, drive, [pose.time_s for pose in in_order]))
        checked = [_checked(f"{where}, pose {k}", pose, rig.chain) for k, pose in enumerate(in_order, 1)]
        stations = _at_stops(tracks[-1], checked)
        observations += [_observed(log, k, pose, tracks[-1], _TARGET) for k, pose in enumerate(stations)]
        if len(stations) < len(checked):
            notes.append(
                f"{where}: of several poses at one stop, the median counts: {len(checked)} are {len(stations)}."
            )
    if not observations:
        raise ConfigError("drives: no poses", "give drives with poses of a target")
    # Readings at the poses alone do not show how the joints move, so only the clock of the wheels is estimated.
    unknown = tuple(
        tuple(Track(track.right.time_ns[[0, -1]], np.zeros(2)) for _ in rig.chain.joints) for track in tracks
    )
    joint_tracks = () if all(o.at_rest for o in observations) else unknown
    return Extraction(
        rig, _TARGET, tuple(observations), tuple(tracks), (), tuple(notes), (), {}, joint_tracks
    )


def from_motions(
    motions: Sequence[SensorMotion],
    wheels_m: tuple[float, float, float],
    T_v_c: FloatArray,
    noise: Mapping[str, float] | None = None,
) -> Extraction:
    """Measurements for `solve` from the planar motion of a sensor that is fixed to the base.

    Each leg is a recording of its own: legs need not follow one another.

    Args:
        motions: legs, in any order; in that of the drive, more mistakes are named.
        wheels_m: nominal radius of the right and left wheel, and their separation, m.
        T_v_c: (4, 4) nominal sensor coordinates to base coordinates, m; height, roll and pitch stay as they are.
        noise: known noise levels: name → standard deviation, see `Noise`.

    Raises:
        ConfigError: no motions, a motion that is not finite, a covariance that is not positive definite, or as for
            `from_poses`.
    """
    if not (motions := all_of("motions", motions, SensorMotion, "a list of mc.SensorMotion")):
        raise ConfigError("motions: none is given", "give a list of mc.SensorMotion")
    rig = _rig(wheels_m, HeadChain("base", "base", ()), _rigid("T_v_c", T_v_c), noise)
    tracks = []
    for number, leg in enumerate(motions, 1):
        where = f"leg {number}"
        motion = _array(f"{where}: motion", leg.motion, "x, y and heading", (3,))
        if not np.isfinite(motion).all():
            raise ConfigError(f"{where}: motion: {motion} is not finite", "leave out motions that failed")
        if (far_m := math.hypot(*motion[:2])) > _FARTHEST_M:
            raise ConfigError(
                f"{where}: a motion of {far_m:.0f} m (limit {_FARTHEST_M:g} m)", "give x and y in m"
            )
        turned = [np.array([0.0, number_of(f"{where}: {name}", getattr(leg, name))]) for name in _BOTH_RAD]
        tracks.append(_wheels(where, Drive((), np.array([0.0, 1.0]), *turned), ()))
        _require_positive(where, leg.covariance, 3, "give a covariance of x, y and heading")
    # A target ahead, which none sees, makes points of the motions: as far as they are long or far from their noise.
    moved = np.array([leg.motion for leg in motions])
    sigma = np.sqrt(np.median([np.diag(leg.covariance) for leg in motions], axis=0))
    away_m = max(math.hypot(*np.sqrt(np.mean(moved[:, :2] ** 2, axis=0))), _CLEAR * float(sigma[:2].max()))
    target = replace(_TARGET, square_m=away_m / 3 * min(1.0, 1 / (_CLEAR * float(sigma[2]))))
    ahead = se3.transform(np.eye(3), np.array([0.0, 0.0, away_m]))
    observations = []
    for log, (leg, track) in enumerate(zip(motions, tracks, strict=True)):
        # The motion's error as one of the pose at its end: (x, y, heading) are the columns of translation and rotation.
        of_pose = np.zeros((6, 3))
        of_pose[[3, 4, 2], [0, 1, 2]] = 1.0
        covariance = of_pose @ leg.covariance @ of_pose.T
        nothing = np.diag(np.full(6, NOT_MEASURED**2))
        for station, T in enumerate((np.eye(4), planar_pose(leg.motion))):
            pose = TargetPose(float(station), se3.inverse(T) @ ahead, nothing)
            seen = _observed(log, station, pose, track, target)
            if station:
                seen = replace(seen, points_cov=_points_cov(seen.points_c, covariance))
            observations.append(seen)
    return Extraction(rig, target, tuple(observations), tuple(tracks), (), (), (), {}, motions=motions)


def _rig(
    wheels_m: tuple[float, float, float],
    chain: HeadChain,
    T_h_c: FloatArray | None,
    noise: Mapping[str, float] | None,
) -> Rig:
    """A robot without cameras.

    Raises:
        ConfigError: see `from_poses`.
    """
    wheels = WheelGeometry(
        *(
            of_parameter(name).check(f"wheels_m: {name}", value)
            for name, value in zip(
                NINE[6:], _array("wheels_m", wheels_m, _WHEELS, (3,)).tolist(), strict=True
            )
        )
    )
    if T_h_c is not None:
        T_h_c = _rigid("T_h_c", T_h_c)
    require("chain", chain, HeadChain, "a HeadChain, or None for a sensor that is fixed to the base")
    levels, known = dict(by_name("noise", noise)), Noise.limits("guess")
    for name, value in levels.items():
        if name not in known:
            raise ConfigError(f"noise: {name}: no such noise level", f"noise levels: {', '.join(known)}")
        levels[name] = SIGMA.check(f"noise: {name}", value)
    nowhere, wheel = {"camera": ""}, WheelSource("measured")
    return Rig(
        CameraRig(("camera",), (_NO_CAMERA,), np.eye(4)[None], False, np.eye(3)[None], "camera"),
        chain,
        Nominal(T_h_c, wheels),
        Sources(nowhere, nowhere, {}, {"right": wheel, "left": wheel}),
        {},
        levels,
    )


def _array(
    where: str, values: object, give: str = "numbers", shape: tuple[int, ...] | None = None
) -> FloatArray:
    """Numbers as an array, of this shape where one is given.

    Raises:
        ConfigError: something else, or another shape.
    """
    try:
        array = np.array(values, dtype=np.float64)
    except (TypeError, ValueError):
        array = np.zeros(0)
    if not array.size or (shape is not None and array.shape != shape):
        of_shape = "" if shape is None else f" of shape {shape}"
        raise ConfigError(f"{where}: {reprlib.repr(values)} is no array{of_shape}", f"give {give}")
    return array


def _wheels(where: str, drive: Drive, times_s: Sequence[float]) -> WheelTrack:
    """The track of both wheels, which covers these times of the poses.

    Raises:
        ConfigError: see `from_poses`.
    """
    names = ("wheel_time_s", "right_rad", "left_rad")
    time_s, right, left = (_array(f"{where}: {name}", getattr(drive, name)) for name in names)
    if time_s.ndim != 1 or not time_s.shape == right.shape == left.shape or len(time_s) < 2:
        raise ConfigError(
            f"{where}: {time_s.shape} wheel times, {right.shape} right and {left.shape} left readings",
            "give two or more of each, as many readings as times",
        )
    for name, values in zip(names, (time_s, right, left), strict=True):
        wrong = np.flatnonzero(~np.isfinite(values))
        if len(wrong):
            raise ConfigError(
                f"{where}: {name}[{wrong[0]}] is {values[wrong[0]]}", "leave out readings that failed"
            )
    stays = np.flatnonzero(np.diff(time_s) <= 0)
    if len(stays):
        k = int(stays[0])
        raise ConfigError(
            f"{where}: wheel_time_s does not increase: [{k}] is {time_s[k]:g} s, and the next is {time_s[k + 1]:g} s",
            "give each reading its own time, in s, not rounded, and sort them by it",
        )
    outside = [at for at in times_s if not time_s[0] <= at <= time_s[-1]]
    if outside:
        raise ConfigError(
            f"{where}: no wheel readings at {len(outside)} of {len(times_s)} poses (the first at {outside[0]:g} s; "
            f"wheel readings from {time_s[0]:g} to {time_s[-1]:g} s)",
            "give the times of poses by the wheels' clock, in s",
        )
    return WheelTrack.at_same_times(np.round(time_s * 1e9).astype(np.int64), right, left)


def _turned_rad(track: WheelTrack, begin_ns: int, end_ns: int) -> float:
    """The longest way of a wheel in an interval."""
    stamps = track.right.time_ns
    begin_ns, end_ns = max(begin_ns, int(stamps[0])), min(end_ns, int(stamps[-1]))
    between = stamps[slice(*np.searchsorted(stamps, [begin_ns, end_ns]))]
    at_ns = np.concatenate([[begin_ns], between, [end_ns]])
    return max(float(np.ptp(side.at(at_ns))) for side in (track.right, track.left))


def _turned_around_rad(track: WheelTrack, time_ns: int) -> float:
    """The way of a wheel around a time; NaN where they are read too rarely to tell whether they turn."""
    begin_ns, end_ns = time_ns - _AROUND_NS, time_ns + _AROUND_NS
    read = int(np.diff(np.searchsorted(track.right.time_ns, [begin_ns, end_ns]))[0])
    return _turned_rad(track, begin_ns, end_ns) if read > _FEW_READINGS else math.nan


def _at_stops(track: WheelTrack, poses: Sequence[TargetPose]) -> list[TargetPose]:
    """Poses in order, with those at one stop as one: their errors there are not independent.

    It is the median of each component, so that a few wrong ones do not count.
    """
    stops: list[list[TargetPose]] = []
    for pose in poses:
        if stops and _same_stop(track, stops[-1][0], pose):
            stops[-1].append(pose)
        else:
            stops.append([pose])
    return [_median(stop) for stop in stops]


def _same_stop(track: WheelTrack, first: TargetPose, pose: TargetPose) -> bool:
    """Whether joints and wheels rest at two poses and in between."""
    if any(abs(pose.joints[name] - first.joints[name]) >= _STILL_RAD for name in first.joints):
        return False
    at_ns = [round(each.time_s * 1e9) for each in (first, pose)]
    rests = all(_turned_around_rad(track, time_ns) <= _STILL_RAD for time_ns in at_ns)
    return rests and _turned_rad(track, *at_ns) < _STILL_RAD


def _median(poses: Sequence[TargetPose]) -> TargetPose:
    """The median of poses at one stop."""
    first = poses[len(poses) // 2]
    apart = [se3.log(pose.T_c_k @ se3.inverse(first.T_c_k)) for pose in poses]
    T_c_k = se3.exp(np.median(apart, axis=0)) @ first.T_c_k
    return replace(first, T_c_k=T_c_k, covariance=np.mean([pose.covariance for pose in poses], axis=0))


def _rigid(where: str, T: FloatArray) -> FloatArray:
    """(4, 4) the rigid transform that is nearest to one whose digits were rounded.

    Raises:
        ConfigError: it is none.
    """
    T = _array(where, T)
    if T.shape != (4, 4) or not np.isfinite(T).all():
        raise ConfigError(f"{where}: not a finite 4 x 4 matrix", "leave out poses that were not measured")
    R = T[:3, :3]
    off = float(np.abs(R.T @ R - np.eye(3)).max())
    if off > _NO_ROTATION or np.linalg.det(R) < 0 or np.any(T[3] != [0.0, 0.0, 0.0, 1.0]):
        raise ConfigError(
            f"{where}: not a rigid transform (R^T R differs from the identity by {off:.2g}, determinant "
            f"{np.linalg.det(R):.2g}, last row {T[3].tolist()})",
            "give a rotation matrix with determinant 1, a translation in m, and 0 0 0 1 below",
        )
    far_m = float(np.linalg.norm(T[:3, 3]))
    if far_m > _FARTHEST_M:
        raise ConfigError(
            f"{where}: a translation of {far_m:.0f} m (limit {_FARTHEST_M:g} m)", "give translations in m"
        )
    U, _, Vt = np.linalg.svd(R)
    return se3.transform(U @ Vt, T[:3, 3])


def _require_positive(where: str, covariance: FloatArray | None, size: int, hint: str) -> None:
    if (
        covariance is None
        or covariance.shape != (size, size)
        or not np.isfinite(covariance).all()
        or not np.all(np.linalg.eigvalsh((covariance + covariance.T) / 2) > _LEAST_SIGMA**2)
    ):
        raise ConfigError(
            f"{where}: the covariance is not positive definite, not {size} x {size}, or of a standard deviation below "
            f"{_LEAST_SIGMA:g} rad or m",
            f"{hint}; one that is unknown, standard deviations that are likely, such as 0.01 rad and 0.01 m",
        )


def _checked(where: str, pose: TargetPose, chain: HeadChain) -> TargetPose:
    """A pose with the readings of the chain, in order.

    Raises:
        ConfigError: see `from_poses`.
    """
    joints = by_name(f"{where}: joints", pose.joints)
    missing = [name for name in chain.joints if name not in joints]
    if missing:
        raise ConfigError(f"{where}: no reading of {', '.join(missing)}", "give all joints of the chain")
    T_c_k = _rigid(where, pose.T_c_k)
    readings = {name: number_of(f"{where}: {name}", joints[name]) for name in chain.joints}
    unread = [name for name, reading in readings.items() if not math.isfinite(reading)]
    if unread:
        raise ConfigError(
            f"{where}: {', '.join(unread)} is not finite", "leave out poses without all readings"
        )
    covariance = _array(f"{where}: covariance", pose.covariance)
    wide = np.zeros(0, dtype=np.int64)
    if covariance.shape == (6, 6):
        wide = np.flatnonzero(np.diag(covariance) >= NOT_MEASURED**2)
        covariance[wide], covariance[:, wide] = 0.0, 0.0
        covariance[wide, wide] = NOT_MEASURED**2
    _require_positive(where, covariance, 6, "give what is not measured an infinite variance")
    return TargetPose(pose.time_s, T_c_k, covariance, readings)


def _observed(log: int, station: int, pose: TargetPose, track: WheelTrack, target: Board) -> Observation:
    assert target.square_m is not None
    points = target.grid() * target.square_m
    nowhere = Corners(np.zeros((len(points), 2)), 1.0, 1, np.zeros(len(points), dtype=np.bool_))
    points_c = se3.act(pose.T_c_k[None], points)[0]
    of_points = pose.covariance.copy()  # what was not measured counts as exact
    wide = np.diag(of_points) >= NOT_MEASURED**2
    of_points[wide], of_points[:, wide] = 0.0, 0.0
    time_ns = round(pose.time_s * 1e9)
    return Observation(
        log=log,
        station=station,
        time_ns=time_ns,
        at_rest=not _turned_around_rad(track, time_ns) > _STILL_RAD,
        joints=np.array(list(pose.joints.values())),
        joints_std=np.zeros(len(pose.joints)),
        views=(nowhere,),
        points_c=points_c,
        points_cov=_points_cov(points_c, of_points),
        T_c_k=pose.T_c_k,
        T_c_k_cov=pose.covariance,
        square_m=target.square_m,
        reprojection_px=0.0,
    )


def _points_cov(points_c: FloatArray, covariance: FloatArray) -> FloatArray:
    """(M, 3, 3) covariances of points (M, 3), m, that move with a pose of covariance (6, 6), a left perturbation."""
    by_pose = se3.by_twist(points_c)
    return np.asarray(by_pose @ covariance @ by_pose.mT)
