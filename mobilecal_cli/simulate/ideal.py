"""Observations computed from ground truth without images, for exact tests and Monte Carlo studies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mobilecal_cli.errors import ConfigError
from mobilecal_cli.model import (
    Corners,
    Extraction,
    FloatArray,
    IntArray,
    Observation,
    StereoRig,
    Track,
    WheelTrack,
)
from mobilecal_cli.simulate.drive import base_in_world
from mobilecal_cli.simulate.robot import SimulatedRobot
from mobilecal_cli.simulate.route import Route
from mobilecal_cli.simulate.stereo import pixels
from mobilecal_cli.vision import BoardPose, Miss, board_pose, triangulate

START_NS = 1_700_000_000_000_000_000
_TRACK_STEP_S = 0.02
_UNIT_SIGMA_PX = 0.05  # typical refinement error; only a weight if there is no noise


@dataclass(frozen=True, slots=True)
class Noise:
    """Measurement noise; zero by default.

    Attributes:
        pixel_px: sigma of each corner coordinate, px.
        wheel_rad_per_sqrt_rad: sigma of a wheel's rotation over one radian; grows with the square root.
        encoder_step_rad: resolution of the wheel encoders, rad; 0 for unlimited.
        joint_rad: sigma of a station's joint reading, rad.
    """

    pixel_px: float = 0.0
    wheel_rad_per_sqrt_rad: float = 0.0
    encoder_step_rad: float = 0.0
    joint_rad: float = 0.0


def station_times_s(route: Route, stations: int = 40) -> FloatArray:
    """Middle of every rest; on a route without rests, equally spaced times."""
    if len(route.rests_s):
        return np.asarray(route.rests_s.mean(axis=1))
    return np.linspace(0.5, route.duration_s - 0.5, stations)


def nanoseconds(times_s: FloatArray) -> IntArray:
    """Header stamps for times of a recording, int64 ns."""
    return np.asarray(START_NS + np.round(np.asarray(times_s) * 1e9).astype(np.int64), dtype=np.int64)


def _wheel_track(
    robot: SimulatedRobot, route: Route, times_s: FloatArray, noise: Noise, random: np.random.Generator
) -> WheelTrack:
    # The track is linear between the segment boundaries and the stations' times, so it must contain both.
    moments = np.unique(
        np.concatenate([np.arange(0, route.duration_s, _TRACK_STEP_S), route.drive.breaks_s, times_s])
    )
    moments = moments[np.concatenate([[True], np.diff(moments) > 1e-6])]
    angles = route.drive.wheel_angles(moments, robot.wheels)
    if noise.wheel_rad_per_sqrt_rad:
        turned = np.abs(np.diff(angles, axis=0))
        error = random.normal(size=turned.shape) * noise.wheel_rad_per_sqrt_rad * np.sqrt(turned)
        angles = angles + np.concatenate([np.zeros((1, 2)), np.cumsum(error, axis=0)])
    if noise.encoder_step_rad:
        angles = np.floor(angles / noise.encoder_step_rad) * noise.encoder_step_rad
    return WheelTrack.at_same_times(nanoseconds(moments), angles[:, 0], angles[:, 1])


def _joint_tracks(route: Route) -> tuple[Track, ...]:
    moments = np.arange(0, route.duration_s, _TRACK_STEP_S)
    values = route.joints(moments)
    return tuple(Track(nanoseconds(moments), values[:, j]) for j in range(values.shape[1]))


def _measured(
    rig: StereoRig, corners_k: FloatArray, T_c_k: FloatArray, pixel_px: float, random: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    T_r_k = np.linalg.inv(rig.T_c_r) @ T_c_k
    both = []
    for camera, T in ((rig.left, T_c_k), (rig.right, T_r_k)):
        at = pixels(camera, corners_k @ T[:3, :3].T + T[:3, 3])
        both.append(at + pixel_px * random.normal(size=at.shape))
    return both[0], both[1]


def ideal_extraction(
    robot: SimulatedRobot,
    route: Route,
    noise: Noise | None = None,
    seed: int = 0,
    nominal: bool = True,
    camera_late_s: float = 0.0,
) -> Extraction:
    """Extraction of a drive with ideal image processing, which adds only the given noise.

    Without pixel noise the points and board poses are exact. With it, points are triangulated from noisy
    pixels and the pose minimizes the reprojection error, as for real images.

    Args:
        robot, route: the ground truth.
        noise: none by default.
        seed: of the noise.
        nominal: whether nominal values are known.
        camera_late_s: delay of the camera stamps relative to joints and wheels, s.
    """
    noise = noise or Noise()
    random = np.random.default_rng([seed, 2])
    rig, corners_k = robot.rig_cameras, route.corners_k()
    times_s = station_times_s(route)
    stamps_s = times_s + camera_late_s
    joints, readings = route.joints(times_s), route.joints(stamps_s)
    T_w_v = base_in_world(route.drive.poses(times_s))
    sigma = noise.pixel_px or _UNIT_SIGMA_PX
    observations = []
    for i, time_ns in enumerate(nanoseconds(stamps_s)):
        T_w_c = T_w_v[i] @ robot.head_pose(joints[i]) @ robot.T_h_c
        T_c_k = np.linalg.inv(T_w_c) @ route.T_w_k
        left, right = _measured(rig, corners_k, T_c_k, noise.pixel_px, random)
        points = triangulate(rig, left, right, sigma, sigma)
        if isinstance(points, Miss):
            raise ConfigError(f"station {i}: {points.reason}: {points.detail}", "reduce the pixel noise")
        found: BoardPose = board_pose(rig, corners_k, left, right, sigma, sigma, T_c_k)
        exact_points = corners_k @ T_c_k[:3, :3].T + T_c_k[:3, 3]
        observations.append(
            Observation(
                log=0,
                station=i,
                time_ns=int(time_ns),
                at_rest=len(route.rests_s) > 0,
                joints=readings[i] + noise.joint_rad * random.normal(size=joints.shape[1]),
                joints_std=np.full(joints.shape[1], noise.joint_rad),
                left=Corners(left, sigma, 1),
                right=Corners(right, sigma, 1),
                points_c=points.points_c if noise.pixel_px else exact_points,
                points_cov=points.points_cov,
                T_c_k=found.T_c_k if noise.pixel_px else T_c_k,
                T_c_k_cov=found.T_c_k_cov,
                square_m=route.board.square_m or 0.0,
                reprojection_px=found.rms_px,
            )
        )
    return Extraction(
        rig=robot.rig(nominal),
        board=route.board,
        observations=tuple(observations),
        wheels=(_wheel_track(robot, route, stamps_s, noise, random),),
        rejections=(),
        notes=(),
        logs=(),
        counts={"stations": len(observations), "observations": len(observations)},
        joint_tracks=(_joint_tracks(route),),
    )
