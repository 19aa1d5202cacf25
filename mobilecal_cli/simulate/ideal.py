"""Observations computed from ground truth without images, for exact tests and Monte Carlo studies."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from mobilecal_cli.errors import ConfigError
from mobilecal_cli.model import (
    Corners,
    Extraction,
    FloatArray,
    IntArray,
    Observation,
    Track,
    WheelTrack,
)
from mobilecal_cli.simulate.actual import ActualRobot
from mobilecal_cli.simulate.robot import SimulatedRobot, pose
from mobilecal_cli.simulate.route import Route
from mobilecal_cli.simulate.views import views
from mobilecal_cli.vision import BoardPose, Miss, board_pose, square_from_points, triangulate

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
        floor_rad, floor_m: sigma of the base's roll and pitch, and of its height, at each station.
        stamp_s: sigma of each image stamp in motion, s.
        wheel_share: sigma of each wheel's relative scale error.
        floor_length_m: driven distance over which the floor stays alike; 0: another floor at each station.
        floor_smooth: the floor has slopes without steps (a Gaussian kernel), instead of an exponential one.
        wheel_length_m: driven distance over which a scale error stays the same; 0: one for each leg.
    """

    pixel_px: float = 0.0
    wheel_rad_per_sqrt_rad: float = 0.0
    encoder_step_rad: float = 0.0
    joint_rad: float = 0.0
    floor_rad: float = 0.0
    floor_m: float = 0.0
    stamp_s: float = 0.0
    wheel_share: float = 0.0
    floor_length_m: float = 0.0
    floor_smooth: bool = False
    wheel_length_m: float = 0.0


def station_times_s(route: Route, stations: int = 40) -> FloatArray:
    """Middle of every rest; on a route without rests, equally spaced times."""
    if len(route.rests_s):
        return np.asarray(route.rests_s.mean(axis=1))
    return np.linspace(0.5, route.duration_s - 0.5, stations)


def nanoseconds(times_s: FloatArray) -> IntArray:
    """Header stamps for times of a recording, int64 ns."""
    return np.asarray(START_NS + np.round(np.asarray(times_s) * 1e9).astype(np.int64), dtype=np.int64)


def floor_in_base(
    noise: Noise, path_m: FloatArray, random: np.random.Generator, still: bool = False
) -> FloatArray:
    """Roll, pitch and height of the base on an uneven floor, at each station: (N, 4, 4), base axes.

    They are the same at all stations of a base that stands still.

    Args:
        noise: its levels.
        path_m: (N,) driven distance at each station, m.
        random: source of the noise.
        still: whether the base never moves.
    """
    count = len(path_m)
    turns, lifts = random.normal(size=(count, 2)), random.normal(size=count)
    if noise.floor_length_m:
        root = _process_root(path_m / noise.floor_length_m, noise.floor_smooth)
        turns, lifts = root @ turns, root @ lifts
    poses = np.array(
        [
            pose((0.0, 0.0, float(lift)), Rotation.from_rotvec([roll, pitch, 0.0]))
            for (roll, pitch), lift in zip(noise.floor_rad * turns, noise.floor_m * lifts, strict=True)
        ]
    )
    return np.repeat(poses[:1], count, axis=0) if still else poses


def _process_root(at: FloatArray, smooth: bool) -> FloatArray:
    """A root of the covariance of a stationary process of unit variance, at positions (N,) in correlation lengths."""
    apart = np.abs(at[:, None] - at[None])
    values, vectors = np.linalg.eigh(np.exp(-(apart**2) / 2 if smooth else -apart))
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def driven_m(actual: ActualRobot, route: Route, times_s: FloatArray) -> FloatArray:
    """(n,) path that the wheels rolled, mean of both, from the start to given times, m."""
    wheels = actual.stated.wheels
    moments = np.unique(np.concatenate([route.drive.breaks_s, times_s]))
    rolled = np.abs(np.diff(route.drive.wheel_angles(moments, wheels), axis=0)) @ wheels.vector[:2] / 2
    return np.asarray(np.interp(times_s, moments, np.concatenate([[0.0], np.cumsum(rolled)])))


def rolled_as_read(
    angles: FloatArray, leg: IntArray, noise: Noise, random: np.random.Generator, heavy_tails: bool = False
) -> FloatArray:
    """Wheel rotations with noise, before the encoders' steps.

    Args:
        angles: (n, 2) true rotations of the right and left wheel, rad.
        leg: (n - 1,) leg of each change, from 0.
        noise: their levels.
        random: source of the noise.
        heavy_tails: Student t distribution with 3 degrees of freedom, of the same variance.
    """

    def unit(*size: int) -> FloatArray:
        return np.asarray(
            random.standard_t(3, size) / np.sqrt(3) if heavy_tails else random.normal(size=size)
        )

    change = np.diff(angles, axis=0)
    error = np.zeros(change.shape)
    if noise.wheel_rad_per_sqrt_rad:
        error += unit(*change.shape) * noise.wheel_rad_per_sqrt_rad * np.sqrt(np.abs(change))
    if noise.wheel_share:
        error += noise.wheel_share * unit(int(leg.max()) + 1, 2)[leg] * change
    return np.asarray(angles + np.concatenate([np.zeros((1, 2)), np.cumsum(error, axis=0)]))


def _wheel_track(
    actual: ActualRobot, route: Route, stamps_s: FloatArray, noise: Noise, random: np.random.Generator
) -> WheelTrack:
    # The track is linear between the segment boundaries and the stations' times, so it must contain both.
    late_s = actual.constants.get("time_wheels", 0.0)
    moments = np.unique(
        np.concatenate(
            [np.arange(0, route.duration_s, _TRACK_STEP_S), route.drive.breaks_s + late_s, stamps_s]
        )
    )
    moments = moments[np.concatenate([[True], np.diff(moments) > 1e-6])]
    angles = route.drive.wheel_angles(moments - late_s, actual.stated.wheels)
    leg = np.searchsorted(stamps_s, moments[:-1], side="right")
    if noise.wheel_length_m:  # the scale error changes after so much driven distance, not from leg to leg
        rolled_m = driven_m(actual, route, np.clip((moments[:-1] + moments[1:]) / 2, 0, route.duration_s))
        leg = np.floor(rolled_m / noise.wheel_length_m + random.uniform()).astype(np.int64)
    angles = rolled_as_read(angles, leg, noise, random, actual.outside.heavy_tails)
    if noise.encoder_step_rad:
        angles = np.floor(angles / noise.encoder_step_rad) * noise.encoder_step_rad
    return WheelTrack.at_same_times(nanoseconds(moments), angles[:, 0], angles[:, 1])


def _joint_tracks(actual: ActualRobot, route: Route) -> tuple[Track, ...]:
    moments = np.arange(0, route.duration_s, _TRACK_STEP_S)
    values = actual.readings(route, moments)
    return tuple(Track(nanoseconds(moments), values[:, j]) for j in range(values.shape[1]))


def ideal_extraction(
    robot: SimulatedRobot,
    route: Route,
    noise: Noise | None = None,
    seed: int = 0,
    nominal: bool = True,
    camera_late_s: float = 0.0,
) -> Extraction:
    """Extraction of a drive with ideal image processing, of a robot as stated, with only the given noise.

    Without pixel noise the points and board poses are exact. With it, points are triangulated from noisy
    pixels and the pose minimizes the reprojection error, as for real images.

    Args:
        robot, route: the ground truth.
        noise: none by default.
        seed: of the noise.
        nominal: whether nominal values are known.
        camera_late_s: delay of the camera stamps relative to joints and wheels, s.
    """
    return extraction_of(ActualRobot(robot, {}), route, noise or Noise(), seed, nominal, camera_late_s)


def extraction_of(
    actual: ActualRobot,
    route: Route,
    noise: Noise,
    seed: int = 0,
    nominal: bool = True,
    camera_late_s: float = 0.0,
    images: int = 40,
) -> Extraction:
    """Extraction of a drive of the actual robot, as its description makes it; see `ideal_extraction`.

    `images` is their number where the robot never rests.
    """
    # Noise of the floor and the stamps leaves the random numbers of the other noise as they are.
    random, other_random = (np.random.default_rng([seed, stream]) for stream in (2, 6))
    robot, corners_k = actual.stated, route.corners_k()
    rig, at_rest = robot.rig_cameras, len(route.rests_s) > 0
    times_s = station_times_s(route, images)
    stamps_s = times_s + camera_late_s
    path_m = driven_m(actual, route, times_s)
    floor = floor_in_base(noise, path_m, other_random, still=route.motion == "base_fixed")
    if not at_rest:
        stamps_s = stamps_s + noise.stamp_s * other_random.normal(size=len(times_s))
    readings = actual.readings(route, stamps_s)
    seen = views(actual, route, times_s, floor)
    sigma = noise.pixel_px or _UNIT_SIGMA_PX
    exact = actual.as_stated and not noise.pixel_px
    observations = []
    for i, time_ns in enumerate(nanoseconds(stamps_s)):
        T_c_k = seen.T_c_k[i]
        left, right = (at[i] + noise.pixel_px * random.normal(size=at[i].shape) for at in seen.pixels)
        points = triangulate(rig, left, right, sigma, sigma)
        if isinstance(points, Miss):
            raise ConfigError(f"station {i}: {points.reason}: {points.detail}", "reduce the pixel noise")
        found: BoardPose = board_pose(rig, corners_k, left, right, sigma, sigma, T_c_k)
        exact_points = corners_k @ T_c_k[:3, :3].T + T_c_k[:3, 3]
        square_m = route.board.square_m or 0.0
        observations.append(
            Observation(
                log=0,
                station=i,
                time_ns=int(time_ns),
                at_rest=at_rest,
                joints=readings[i] + noise.joint_rad * random.normal(size=readings.shape[1]),
                joints_std=np.full(readings.shape[1], noise.joint_rad),
                left=Corners(left, sigma, 1),
                right=Corners(right, sigma, 1),
                points_c=exact_points if exact else points.points_c,
                points_cov=points.points_cov,
                T_c_k=T_c_k if exact else found.T_c_k,
                T_c_k_cov=found.T_c_k_cov,
                square_m=square_m
                if actual.as_stated
                else square_from_points(points.points_c, route.board.grid()),
                reprojection_px=found.rms_px,
            )
        )
    return Extraction(
        rig=robot.rig(nominal),
        board=route.board,
        observations=tuple(observations),
        wheels=(_wheel_track(actual, route, stamps_s, noise, random),),
        rejections=(),
        notes=(),
        logs=(),
        counts={"stations": len(observations), "observations": len(observations)},
        joint_tracks=(_joint_tracks(actual, route),),
    )
