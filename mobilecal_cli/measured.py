"""Calibration from poses that somebody else measured: a target's pose in a sensor, or a sensor's own planar motion.

A measured pose stands where the corners of a board stand otherwise: any detector, motion capture, or lidar odometry.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Final

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.likelihood.dataset import NOT_MEASURED
from mobilecal_cli.model import (
    Board,
    Camera,
    CameraRig,
    Corners,
    Extraction,
    FloatArray,
    HeadChain,
    Nominal,
    Observation,
    Rig,
    SensorMotion,
    Sources,
    WheelGeometry,
    WheelSource,
    WheelTrack,
)

_TARGET: Final = Board(4, 3, 0.1)  # points of the target, for errors in mm
_NO_CAMERA = Camera("sensor", 640, 480, np.diag([500.0, 500.0, 1.0]), np.zeros(0), "none")


@dataclass(frozen=True, slots=True, eq=False)
class TargetPose:
    """A target that stands still, as a sensor on the head saw it.

    Attributes:
        time_s: when, by the wheels' clock.
        T_c_k: (4, 4) target coordinates to sensor coordinates, m.
        covariance: (6, 6) of T_c_k, rotation (rad) before translation (m), left perturbation: T = exp(delta) T_c_k.
            Its scale is estimated: only ratios matter where many poses were measured. Components with a standard
            deviation above 100 were not measured.
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
        poses: sorted by time.
        wheel_time_s: (n,) increasing.
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

    Args:
        drives: one or more; each has a target of its own, which stands still meanwhile.
        wheels_m: nominal radius of the right and left wheel, and their separation, m.
        chain: from the base (origin midway between the wheels, x forward, z up) to the head; None for a sensor that is
            fixed to the base.
        T_h_c: (4, 4) nominal sensor coordinates to head coordinates, m; needed where the motion does not show the whole
            transform: a sensor that is fixed to the base never shows its height.
        noise: known noise levels: name → standard deviation, see `Noise`.

    Raises:
        ConfigError: wheels that are not positive, a joint of the chain without a reading, or a covariance that is not
            positive definite.
    """
    if not all(math.isfinite(value) and value > 0 for value in wheels_m):
        raise ConfigError(f"wheels_m {wheels_m}: not positive", "give radii and separation in m")
    chain = chain or HeadChain("base", "base", ())
    observations, tracks = [], []
    for log, drive in enumerate(drives):
        times = np.round(np.asarray(drive.wheel_time_s, dtype=np.float64) * 1e9).astype(np.int64)
        tracks.append(
            WheelTrack.at_same_times(times, np.asarray(drive.right_rad), np.asarray(drive.left_rad))
        )
        observations += [_observed(log, k, pose, chain) for k, pose in enumerate(drive.poses)]
    nowhere, wheel = {"camera": ""}, WheelSource("measured")
    rig = Rig(
        CameraRig(("camera",), (_NO_CAMERA,), np.eye(4)[None], False, np.eye(3)[None], "camera"),
        chain,
        Nominal(T_h_c, WheelGeometry(*(float(value) for value in wheels_m))),
        Sources(nowhere, nowhere, (), {"right": wheel, "left": wheel}),
        {},
        noise or {},
    )
    return Extraction(rig, _TARGET, tuple(observations), tuple(tracks), (), (), (), {})


def from_motions(
    motions: Sequence[SensorMotion],
    wheels_m: tuple[float, float, float],
    T_v_c: FloatArray,
    noise: Mapping[str, float] | None = None,
) -> Extraction:
    """Measurements for `solve` from the planar motion of a sensor that is fixed to the base.

    Each leg is a recording of its own: legs need not follow one another.

    Args:
        motions: legs, in any order.
        wheels_m: nominal radius of the right and left wheel, and their separation, m.
        T_v_c: (4, 4) nominal sensor coordinates to base coordinates, m; height, roll and pitch stay as they are.
        noise: known noise levels: name → standard deviation, see `Noise`.

    Raises:
        ConfigError: a covariance that is not positive definite.
    """
    ahead = se3.transform(np.eye(3), np.array([0.0, 0.0, 1.0]))
    nothing = np.diag(np.full(6, math.inf))
    drives = []
    for number, leg in enumerate(motions, 1):
        x, y, heading = leg.motion.tolist()
        T = se3.transform(se3.rotation_z(np.array(heading)), np.array([x, y, 0.0]))
        poses = TargetPose(0.0, ahead, nothing), TargetPose(1.0, se3.inverse(T) @ ahead, nothing)
        turned = np.array([0.0, leg.right_rad]), np.array([0.0, leg.left_rad])
        drives.append(Drive(poses, np.array([0.0, 1.0]), *turned))
        _require_positive(f"leg {number}", leg.covariance, 3, "give a covariance of x, y and heading")
    return replace(from_poses(drives, wheels_m, None, T_v_c, noise), motions=tuple(motions))


def _require_positive(where: str, covariance: FloatArray, size: int, hint: str) -> None:
    square = covariance.shape == (size, size)
    if not square or not np.all(np.linalg.eigvalsh((covariance + covariance.T) / 2) > 0):
        raise ConfigError(f"{where}: the covariance is not positive definite, or not {size} x {size}", hint)


def _observed(log: int, station: int, pose: TargetPose, chain: HeadChain) -> Observation:
    where = f"drive {log + 1}, pose {station + 1}"
    missing = [name for name in chain.joints if name not in pose.joints]
    if missing:
        raise ConfigError(f"{where}: no reading of {', '.join(missing)}", "give all joints of the chain")
    covariance = np.array(pose.covariance, dtype=np.float64)
    if covariance.shape == (6, 6):
        wide = np.flatnonzero(~(np.diag(covariance) < NOT_MEASURED**2))
        covariance[wide], covariance[:, wide] = 0.0, 0.0
        covariance[wide, wide] = NOT_MEASURED**2
    _require_positive(where, covariance, 6, "give what is not measured an infinite variance")
    assert _TARGET.square_m is not None
    points = _TARGET.grid() * _TARGET.square_m
    joints = np.array([pose.joints[name] for name in chain.joints])
    nowhere = Corners(np.zeros((len(points), 2)), 1.0, 1, np.zeros(len(points), dtype=np.bool_))
    points_c = se3.act(np.asarray(pose.T_c_k, dtype=np.float64)[None], points)[0]
    return Observation(
        log=log,
        station=station,
        time_ns=round(pose.time_s * 1e9),
        at_rest=True,
        joints=joints,
        joints_std=np.zeros(len(joints)),
        views=(nowhere,),
        points_c=points_c,
        points_cov=np.zeros((len(points), 3, 3)),
        T_c_k=pose.T_c_k,
        T_c_k_cov=covariance,
        square_m=_TARGET.square_m,
        reprojection_px=0.0,
    )
