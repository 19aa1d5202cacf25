"""Extractions of simulated drives computed without images, for exact tests and Monte Carlo studies.

Also the imperfections that `mobilecal simulate` does not render: noise of the measurements, a floor and wheel errors
that change with the driven distance, exposure during motion, and what no constant of the estimator describes.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from itertools import chain

import numpy as np
from scipy.signal import lfilter

from mobilecal_cli import se3
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.observations import Corners, Extraction, Observation, WheelTrack
from mobilecal_cli.model.rig import Board, Camera
from mobilecal_cli.model.signals import Track
from mobilecal_cli.simulate.record import nanoseconds
from mobilecal_cli.simulate.robot import ROBOTS, SimulatedRobot
from mobilecal_cli.simulate.route import Route, plan_route
from mobilecal_cli.vision import Miss
from mobilecal_cli.vision.pose import StereoPoints, board_pose, square_from_points, triangulate
from tests.actual import (
    STATION_NOISE as STATION_NOISE,
)
from tests.actual import (
    ActualRobot,
    Noise,
    camera_in_world,
    constant_kinds,
    floor_poses,
    joint_key,
    pixels,
    rolled_as_read,
    station_times_s,
)
from tests.robots import corners_of, hidden, rig_of

_TRACK_STEP_S, _FILTER_STEP_S = 0.02, 0.001
_UNIT_SIGMA_PX = 0.05  # typical refinement error; only a weight if there is no noise
_NOTHING_PX = 1e-6
_WAVES = 200  # of a floor that is a function of the place
_SHUTTER_ROUNDS = 4  # each shrinks the error by the rows that a corner moves during one image


@dataclass(frozen=True, slots=True)
class Outside:
    """Imperfections beside those of `constant_kinds`; none by default.

    Attributes:
        sag_rad: the head tilts further by sag sin(tilt), rad.
        gravity_play_rad: whole play of the tilt joint, whose weight keeps it on the side it tilts to, rad.
        heavy_tails: wheel noise by a Student t distribution with 3 degrees of freedom, of the same variance.
        print_m: sigma of every corner's place on the board, in the plane, m; `print_seed` draws them.
        print_across_m: the same across the plane, m.
        print_seed: see there.
        sheet_m: the columns beyond the board's middle are on another sheet, displaced by this along x and y, m.
        lens_px: rms of what each lens does beside its model: waves over the image; `lens_seed` draws them.
        lens_waves_px: shortest and longest of these waves.
        lens_seed: see there.
        turn_sides: relative change of the separation in turns to the left, and its negative in those to the right.
        wheel_delay_s: delay of the right wheel's readings.
        wheel_smoothing_s: time of a low-pass that the wheels' readings went through.
        drift: the floor carries the base along x and y of the world, m per m that the wheels roll.
    """

    sag_rad: float = 0.0
    gravity_play_rad: float = 0.0
    heavy_tails: bool = False
    print_m: float = 0.0
    print_across_m: float = 0.0
    print_seed: int = 0
    sheet_m: float = 0.0
    lens_px: float = 0.0
    lens_waves_px: tuple[float, float] = (320.0, 320.0)
    lens_seed: int = 0
    turn_sides: float = 0.0
    wheel_delay_s: float = 0.0
    wheel_smoothing_s: float = 0.0
    drift: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class OutsideRobot(ActualRobot):
    """A physical robot with imperfections outside the estimator's constants."""

    outside: Outside = Outside()

    @property
    def as_stated(self) -> bool:
        """Whether cameras, chain and board are as stated."""
        return not any(self.constants.values()) and self.outside == Outside()

    def positions(self, route: Route, times_s: FloatArray) -> FloatArray:
        position = ActualRobot.positions(self, route, times_s)
        if not self.stated.tilt:
            return position
        tilt = self.stated.joint_names.index(self.stated.tilt)
        beyond = np.zeros(position.shape)
        beyond[:, tilt] = self.outside.sag_rad * np.sin(position[:, tilt])
        beyond[:, tilt] += self.outside.gravity_play_rad / 2 * np.sign(position[:, tilt])
        return position - beyond

    def corners_k(self, board: Board) -> FloatArray:
        """(M, 3) corners of a stated board as they are, in the board frame, m."""
        shape, grid = self.shape(board), board.grid()
        plane = grid[:, :2] * (board.square_m or 0.0) * shape.scale
        plane[:, 0] += np.tan(shape.shear_rad) * plane[:, 1]
        outside, random = self.outside, np.random.default_rng([self.outside.print_seed, 11])
        x = grid[:, 0]
        plane += outside.print_m * random.normal(size=(len(x), 2))
        plane += outside.sheet_m * (x > (x.min() + x.max()) / 2)[:, None]
        height = shape.height_m(*grid.T[:2]) + outside.print_across_m * random.normal(size=len(x))
        return np.column_stack([plane, height])


class HeavyTails:
    """Random numbers by a Student t distribution with 3 degrees of freedom, of unit variance."""

    def __init__(self, random: np.random.Generator) -> None:
        self._random = random

    def normal(self, size) -> FloatArray:
        return self._random.standard_t(3, size) / np.sqrt(3)


def floor_in_base(
    noise: Noise, path_m: FloatArray, base: FloatArray, random: np.random.Generator, still: bool
) -> FloatArray:
    """As `actual.floor_in_base`, alike over the driven distances (N,) at the stations, m, or at base poses (N, 3)."""
    turns, lifts = random.normal(size=(len(path_m), 2)), random.normal(size=len(path_m))
    if noise.floor_place_m:
        turns, height_m = _smooth_surface(base, noise.floor_place_m, random)
        lifts = height_m * noise.floor_rad / (noise.floor_m or np.inf)
    if noise.floor_length_m:
        root = _process_root(path_m / noise.floor_length_m, noise.floor_smooth)
        turns, lifts = root @ turns, root @ lifts
    poses = floor_poses(noise.floor_rad, noise.floor_m, turns, lifts, still)
    if noise.sway_rad or noise.sway_m:
        turns, lifts = random.normal(size=(len(path_m), 2)), random.normal(size=len(path_m))
        poses = poses @ floor_poses(noise.sway_rad, noise.sway_m, turns, lifts, still)
    return poses


def _smooth_surface(
    base: FloatArray, alike_m: float, random: np.random.Generator
) -> tuple[FloatArray, FloatArray]:
    """Roll and pitch (N, 2) on a Gaussian field with slopes of 1 rad (rms), and its heights (N,), m."""
    wave_per_m = random.normal(size=(2, _WAVES)) / alike_m
    phase = base[:, :2] @ wave_per_m + random.uniform(0, 2 * np.pi, _WAVES)
    size_m = alike_m * np.sqrt(2 / _WAVES)
    by_x, by_y = (-size_m * np.sin(phase) @ wave_per_m.T).T
    cos, sin = np.cos(base[:, 2]), np.sin(base[:, 2])
    turns = np.column_stack([cos * by_y - sin * by_x, -(cos * by_x + sin * by_y)])
    return turns, size_m * np.cos(phase).sum(axis=1)


def _process_root(at: FloatArray, smooth: bool) -> FloatArray:
    """A root of the covariance of a stationary process of unit variance, at positions (N,) in correlation lengths."""
    apart = np.abs(at[:, None] - at[None])
    values, vectors = np.linalg.eigh(np.exp(-(apart**2) / 2 if smooth else -apart))
    return np.asarray(vectors * np.sqrt(np.maximum(values, 0.0)))


def driven_m(actual: OutsideRobot, route: Route, times_s: FloatArray) -> FloatArray:
    """(n,) path that the wheels rolled, mean of both, from the start to given times, m."""
    wheels = actual.stated.wheels
    moments = np.unique(np.concatenate([route.drive.breaks_s, times_s]))
    rolled = np.abs(np.diff(route.drive.wheel_angles(moments, wheels), axis=0)) @ wheels.vector[:2] / 2
    return np.asarray(np.interp(times_s, moments, np.concatenate([[0.0], np.cumsum(rolled)])))


def _smoothed(moments: FloatArray, angles: FloatArray, time_s: float) -> FloatArray:
    """Angles (n, 2) after a first-order low-pass."""
    even = np.arange(moments[0], moments[-1] + _FILTER_STEP_S, _FILTER_STEP_S)
    share = 1 - math.exp(-_FILTER_STEP_S / time_s)
    smooth = [
        lfilter([share], [1, share - 1], np.interp(even, moments, angle - angle[0])) for angle in angles.T
    ]
    return np.stack(
        [np.interp(moments, even, each) + angle[0] for each, angle in zip(smooth, angles.T, strict=True)],
        axis=1,
    )


def _wheel_track(
    actual: OutsideRobot, route: Route, stamps_s: FloatArray, noise: Noise, random: np.random.Generator
) -> WheelTrack:
    # The track is linear between the segment boundaries and the stations' times, so it must contain both.
    late_s = actual.constants.get("time_wheels", 0.0)
    regular = np.arange(0, route.duration_s, _TRACK_STEP_S)
    moments = np.unique(np.concatenate([regular, route.drive.breaks_s + late_s, stamps_s]))
    moments = moments[np.concatenate([[True], np.diff(moments) > 1e-6])]
    angles = route.drive.wheel_angles(moments - late_s, actual.stated.wheels, actual.stated.slip)
    turned = np.diff(angles @ [1.0, -1.0], prepend=0.0)
    further = np.cumsum(actual.outside.turn_sides / 2 * np.abs(turned))[:, None]
    angles = angles + further * [1.0, -1.0]
    angles[:, 0] = np.interp(moments - actual.outside.wheel_delay_s, moments, angles[:, 0])
    if actual.outside.wheel_smoothing_s:
        angles = _smoothed(moments, angles, actual.outside.wheel_smoothing_s)
    leg = np.searchsorted(stamps_s, moments[:-1], side="right")
    if noise.wheel_length_m:  # the scale error changes after so much driven distance, not from leg to leg
        rolled_m = driven_m(actual, route, np.clip((moments[:-1] + moments[1:]) / 2, 0, route.duration_s))
        leg = np.floor(rolled_m / noise.wheel_length_m + random.uniform()).astype(np.int64)
    source = HeavyTails(random) if actual.outside.heavy_tails else random
    angles = rolled_as_read(angles, leg, noise, source)
    if noise.encoder_step_rad:
        angles = np.floor(angles / noise.encoder_step_rad) * noise.encoder_step_rad
    return WheelTrack.at_same_times(nanoseconds(moments), angles[:, 0], angles[:, 1])


def _joint_tracks(actual: OutsideRobot, route: Route, noise: Noise, seed: int) -> tuple[Track, ...]:
    moments = np.arange(0, route.duration_s, _TRACK_STEP_S)
    values = actual.readings(route, moments)
    values = values + noise.joint_rad * np.random.default_rng([seed, 9]).normal(size=values.shape)
    return tuple(Track(nanoseconds(moments), values[:, j]) for j in range(values.shape[1]))


def views(
    actual: OutsideRobot,
    route: Route,
    times_s: FloatArray,
    floor: FloatArray,
    apart_s: FloatArray | float = 0.0,
) -> tuple[FloatArray, list[FloatArray]]:
    """T_c_k, (N, 4, 4), and the board's corners in each of the actual cameras, (N, M, 2) px.

    Args:
        actual, route: the ground truth.
        times_s: (N,) times of the images.
        floor: (N, 4, 4) see `floor_in_base`.
        apart_s: (N,) how much later the cameras but for the first take each image.
    """
    rig, corners_k = actual.rig_cameras, actual.corners_k(route.board)
    half_s = actual.constants.get("readout", 0.0) / 2
    poses: dict[tuple[float, bool], FloatArray] = {}

    def exposed(camera: Camera, T_x_c: FloatArray | None, late_s: float) -> FloatArray:
        key = late_s, T_x_c is None or not np.any(apart_s)
        if key not in poses:
            taken_s = times_s + late_s + (0.0 if key[1] else apart_s)
            T_w_c = camera_in_world(actual, route, np.clip(taken_s, 0, route.duration_s), floor)
            poses[key] = np.asarray(np.linalg.inv(T_w_c) @ route.T_w_k)
        T_x_k = poses[key] if T_x_c is None else np.array([T_x_c @ T for T in poses[key]])
        points = np.array([corners_k @ T[:3, :3].T + T[:3, 3] for T in T_x_k])
        ahead = points[..., 2:] > 0.05
        return np.where(ahead, pixels(camera, np.where(ahead, points, [0.0, 0.0, 1.0])), np.nan)

    every = []
    for k, (name, camera) in enumerate(zip(rig.names, rig.each, strict=True)):
        T_x_c = np.asarray(np.linalg.inv(rig.T_c_each[k]), dtype=np.float64) if k else None
        late_s = actual.constants.get(f"time_{name}", 0.0) if k else 0.0
        at = exposed(camera, T_x_c, late_s)
        if half_s:
            first, last = (exposed(camera, T_x_c, late_s + half) for half in (-half_s, half_s))
            at = _row_by_row(first, at, last, camera.height)
        every.append(at + _waves(at, actual.outside, k))
    return poses[0.0, True], every


def _waves(at: FloatArray, outside: Outside, camera: int) -> FloatArray:
    """Displacements (N, M, 2) of pixels by eight plane waves in random directions, along x and y each, px."""
    random = np.random.default_rng([outside.lens_seed, 12, camera])
    direction = random.uniform(0, 2 * np.pi, (8, 2))
    phase = random.uniform(0, 2 * np.pi, (8, 2))
    length_px = np.exp(random.uniform(*np.log(outside.lens_waves_px), (8, 2)))
    ways = np.stack([np.cos(direction), np.sin(direction)]) * 2 * np.pi / length_px  # (2, 8, 2)
    phase = phase + np.tensordot(np.nan_to_num(at), ways, 1)
    return np.asarray(outside.lens_px * np.sqrt(2 / 8) * np.sin(phase).sum(axis=2))


def _row_by_row(first: FloatArray, middle: FloatArray, last: FloatArray, height: int) -> FloatArray:
    """Pixels of a rolling shutter from those at the times of the first, middle and last row: (..., 2) each."""
    at = middle
    for _ in range(_SHUTTER_ROUNDS):
        s = (2 * at[..., 1:] + 1) / height - 1
        at = middle + s * (last - first) / 2 + s**2 * (first + last - 2 * middle) / 2
    return at


def simulated(motion="standard", noise=None, robot="paper", stations=12, seed=3, **more) -> Extraction:
    """`extraction_of` a planned route; the seed is that of the route and of the noise.

    Args:
        robot: its name, or the robot.
        more: further arguments of `extraction_of`.
    """
    described = ROBOTS[robot] if isinstance(robot, str) else robot
    return extraction_of(described, plan_route(described, motion, stations, seed=seed), noise, seed, **more)


def joined(*parts: Extraction) -> Extraction:
    """Several extractions as the recordings of one."""
    return replace(
        parts[0],
        observations=tuple(replace(o, log=log) for log, part in enumerate(parts) for o in part.observations),
        wheels=tuple(chain.from_iterable(part.wheels for part in parts)),
        joint_tracks=tuple(chain.from_iterable(part.joint_tracks for part in parts)),
    )


def slipped(extraction: Extraction, leg: int, right_rad: float, left_rad: float = 0.0) -> Extraction:
    """The same with wheels that turn on, in the middle of a leg, without the base."""
    (track,) = extraction.wheels
    first, second = extraction.observations[leg : leg + 2]
    late = track.time_ns > (first.time_ns + second.time_ns) // 2
    wheels = track.right_rad + right_rad * late, track.left_rad + left_rad * late
    return replace(extraction, wheels=(WheelTrack.at_same_times(track.time_ns, *wheels),))


def in_view(camera: Camera, pixels: FloatArray) -> bool:
    """Whether a camera shows the whole board."""
    inside = (pixels > 0) & (pixels < np.array([camera.width, camera.height]) - 1)
    return bool(np.all(np.isfinite(pixels)) and np.all(inside))


def extraction_of(
    robot: SimulatedRobot,
    route: Route,
    noise: Noise | None = None,
    seed: int = 0,
    *,
    constants: Mapping[str, float] | None = None,
    outside: Outside | None = None,
    nominal: bool = True,
    camera_late_s: float = 0.0,
    images: int = 40,
) -> Extraction:
    """Extraction of a drive with ideal image processing, as the robot's description makes it.

    Of a robot as stated, without pixel noise, the points and board poses are exact. Otherwise points are triangulated
    from the pixels and the pose minimizes the reprojection error, as for real images.

    Args:
        robot: the description, with the true head-eye transform and wheels.
        route: the true motion of base and joints; readings follow from it.
        noise: of the recording; none by default.
        seed: of the noise.
        constants: name → true minus stated value; a missing one is zero.
        outside: what no constant describes.
        nominal: whether nominal values are known.
        camera_late_s: delay of the camera stamps relative to joints and wheels, s.
        images: their number where the robot never rests.

    Raises:
        ConfigError: the cameras' images are too inconsistent to be triangulated.
    """
    last_zeros = {f"{joint_key(robot, joint)}_zero" for joint in robot.joint_names[-1:]}
    if unknown := set(constants or {}) - set(constant_kinds(robot)) - last_zeros:
        raise ValueError(f"unknown constants: {', '.join(sorted(unknown))}")
    actual, noise = OutsideRobot(robot, constants or {}, outside or Outside()), noise or Noise()
    # Noise of the floor and the stamps leaves the random numbers of the other noise as they are.
    random, other_random = (np.random.default_rng([seed, stream]) for stream in (2, 6))
    corners_k = corners_of(route)
    rig, at_rest = robot.rig_cameras, len(route.rests_s) > 0
    times_s = station_times_s(route, images)
    stamps_s = times_s + camera_late_s
    path_m = driven_m(actual, route, times_s)
    base = route.drive.poses(times_s)
    floor = floor_in_base(noise, path_m, base, other_random, still=route.motion == "base_fixed")
    carried = np.zeros((len(times_s), 3))
    carried[:, :2] = path_m[:, None] * actual.outside.drift
    in_base = np.einsum("nab,nb->na", se3.rotation_z(-base[:, 2]), carried)
    floor = se3.transform(np.eye(3), in_base) @ floor
    if not at_rest:
        stamps_s = stamps_s + noise.stamp_s * other_random.normal(size=len(times_s))
    readings = actual.readings(route, stamps_s)
    apart_s = 0.0 if at_rest else noise.pair_s * np.random.default_rng([seed, 13]).normal(size=len(times_s))
    true_poses, seen = views(actual, route, times_s, floor, apart_s)
    shifts = noise.shift_px * np.random.default_rng([seed, 14]).normal(size=(len(rig.each), len(times_s), 2))
    sigma = noise.pixel_px or _UNIT_SIGMA_PX
    exact = actual.as_stated and not noise.pixel_px
    observations = []
    for i, time_ns in enumerate(nanoseconds(stamps_s)):
        T_c_k = true_poses[i]
        pixels = [
            at[i] + noise.pixel_px * random.normal(size=at[i].shape) + shift[i]
            for at, shift in zip(seen, shifts, strict=True)
        ]
        shown = [k for k, at in enumerate(pixels) if rig.calibrated or in_view(rig.each[k], at)]
        if not shown:
            continue
        corners = [Corners(at, sigma, 1) if k in shown else hidden(at) for k, at in enumerate(pixels)]
        own, own_views = rig.some(shown), [corners[k] for k in shown]
        by = len(shown) if rig.calibrated else 1  # cameras that the board pose is from
        views_by = own_views[:by]
        if exact:  # rounding alone would be minimized for long
            odd = _NOTHING_PX * (np.arange(len(corners_k)) % 2)[:, None]
            views_by = [replace(view, pixels=view.pixels + odd) for view in views_by]
        found = board_pose(own.some(range(by)), corners_k, views_by, T_c_k)
        exact_points = corners_k @ T_c_k[:3, :3].T + T_c_k[:3, 3]
        estimated = corners_k @ found.T_c_k[:3, :3].T + found.T_c_k[:3, 3]
        points = StereoPoints(estimated, np.zeros((len(corners_k), 3, 3)), 0.0)
        if by > 1:
            points = triangulate(own, own_views)
        if isinstance(points, Miss):
            raise ConfigError(f"station {i}: {points.reason}: {points.detail}", "reduce the pixel noise")
        square_m = route.board.square_m or 0.0
        if not actual.as_stated:
            square_m = square_from_points(points.points_c, route.board.grid())
        observations.append(
            Observation(
                log=0,
                station=i,
                time_ns=int(time_ns),
                at_rest=at_rest,
                joints=readings[i] + noise.joint_rad * random.normal(size=readings.shape[1]),
                joints_std=np.full(readings.shape[1], noise.joint_rad),
                views=tuple(corners),
                points_c=exact_points if exact else points.points_c,
                points_cov=points.points_cov,
                T_c_k=T_c_k if exact else found.T_c_k,
                T_c_k_cov=found.T_c_k_cov,
                square_m=square_m,
                reprojection_px=found.rms_px,
            )
        )
    return Extraction(
        rig=rig_of(robot, nominal),
        board=route.board,
        observations=tuple(observations),
        wheels=(_wheel_track(actual, route, stamps_s, noise, random),),
        rejections=(),
        notes=(),
        logs=(),
        counts={"stations": len(observations), "observations": len(observations)},
        joint_tracks=(_joint_tracks(actual, route, noise, seed),),
    )
