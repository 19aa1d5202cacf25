"""The measurements of all stations as arrays, and the legs between them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

import numpy as np
from scipy.optimize import nnls

from mobilecal_cli import se3
from mobilecal_cli.kinematics import Increments, cut_at, head_pose, join
from mobilecal_cli.model.arrays import BoolArray, FloatArray, IntArray
from mobilecal_cli.model.observations import SensorMotion, WheelTrack
from mobilecal_cli.model.rig import Camera, CameraRig, HeadChain, Sources
from mobilecal_cli.model.signals import Track
from mobilecal_cli.model.solution import Noise

LEAST_DEPTH_M = 0.01  # of a point that a camera may show
_RATE_NS = 40_000_000  # rates of wheels are differences over this time
_SMOOTH_NS = 80_000_000  # rates in an image are differences of means over about this time
_SMOOTHER = np.geomspace(0.25, 2.5, 41)  # times it: those that are compared
_NO_RATE = 1e-30  # square of rates, (rad/s)^2, without effect: a joint may stand still
_LEAST_ENCODER_SHARE = 1e-3  # of a wheel without steps next to one with steps: keeps the matrices regular
_AT_REST_RAD = 1e-3  # a wheel that turns less between two stations stands still

#: Columns of a station's base block: base pose (x, y, heading), and errors: encoders (right, left), roll, pitch and
#: height of the floor, scale of the right and left wheel, and the stamp.
BASE, ERRORS = slice(0, 3), slice(3, None)
ENCODERS, FLOOR, SCALES, STAMP = slice(3, 5), slice(5, 8), slice(8, 10), 10
#: Columns of a station's own errors: joint readings, and the base's sway (roll, pitch, height).
JOINTS, SWAY = slice(None, -3), slice(-3, None)


def _smooth_rate(track: Track, times_ns: IntArray, width_ns: int) -> FloatArray:
    """(n,) rates at some times: differences of means over an interval before and after each."""
    later, earlier = (track.mean(times_ns + side * (width_ns // 2), width_ns) for side in (1, -1))
    return (later - earlier) / (1e-9 * width_ns)


def _smooth_width_ns(track: Track, times_ns: IntArray) -> int:
    """Interval for `_smooth_rate` with the least error: noise and steps fall with its cube, the motion's bend grows.

    With w in units of `_SMOOTH_NS`, the variance of white noise is ``v / w^3``, and the mean square of the bias ``k w``
    where speeds change suddenly, ``b w^4`` where they change steadily. The difference between the rates of w and of
    w / 2 has about 7, 0.21 and 0.56 times these.
    """
    widths = np.array([0.5, 1.0, 2.0, 4.0])
    rates = [_smooth_rate(track, times_ns, int(w * _SMOOTH_NS)) for w in widths]
    apart = np.array([np.mean((b - a) ** 2) for a, b in pairwise(rates)]) + _NO_RATE
    powers = np.array([-3.0, 1.0, 4.0])
    terms = [7.0, 0.21, 0.56] * widths[1:, None] ** powers
    errors = _SMOOTHER[:, None] ** powers @ nnls(terms / apart[:, None], np.ones(len(apart)))[0]
    return int(_SMOOTHER[np.argmin(errors)] * _SMOOTH_NS)


@dataclass(frozen=True, slots=True, eq=False)
class MotionPairs:
    """Pairs of stations that a leg joins, and what cameras, joints and wheels measured there (eq. 3).

    Attributes:
        T_v_h: (N, 4, 4) head in the base, from the joint readings.
        T_c_k: (N, 4, 4) board in the first camera.
        points_c: (N, M, 3) triangulated corners, m.
        legs: (L, 2) first and second station of each leg.
        first_leg: (L,) first leg of the recording that the leg belongs to; legs of a recording are consecutive.
        steps: wheel rotations along the legs.
    """

    T_v_h: FloatArray
    T_c_k: FloatArray
    points_c: FloatArray
    legs: IntArray
    first_leg: IntArray
    steps: Increments

    @classmethod
    def of(
        cls, T_v_h: FloatArray, T_c_k: FloatArray, points_c: FloatArray, log: IntArray, steps: Increments
    ) -> MotionPairs:
        """All legs of stations in recordings (N,)."""
        legs = legs_between(log)
        of_leg = log[legs[:, 0]]
        return cls(T_v_h, T_c_k, points_c, legs, np.searchsorted(of_leg, of_leg), steps)

    def select(self, legs: IntArray) -> MotionPairs:
        """Some legs alone (increasing indices), each as a recording of its own."""
        return replace(
            self, legs=self.legs[legs], first_leg=np.arange(len(legs)), steps=self.steps.select(legs)
        )


def planar_pose(pose: FloatArray) -> FloatArray:
    """(n, 3) x, y (m) and heading (rad) of a frame in a plane, or (3,) → (n, 4, 4) or (4, 4)."""
    flat = np.concatenate([pose[..., :2], np.zeros_like(pose[..., :1])], axis=-1)
    return se3.transform(se3.rotation_z(pose[..., 2]), flat)


def heading_of(T: FloatArray) -> FloatArray:
    """Rotation about z of poses (n, 4, 4), rad."""
    return np.asarray(np.arctan2(T[..., 1, 0], T[..., 0, 0]))


def legs_between(log: IntArray) -> IntArray:
    """(L, 2) each two consecutive stations of one recording, of stations in recordings (N,), sorted."""
    first = np.flatnonzero(log[:-1] == log[1:])
    return np.stack([first, first + 1], axis=1)


def steps_between(tracks: Sequence[WheelTrack], log: IntArray, stamps_ns: IntArray) -> Increments:
    """Wheel rotations of the legs between stations in recordings (N,), with their turning rates, cut at stamps (N,)."""
    parts = []
    for number, track in enumerate(tracks):
        times = stamps_ns[log == number]
        if len(times) > 1:
            parts.append(cut_at(track, np.clip(times, track.time_ns[0], track.time_ns[-1]), motion=True))
    return join(parts) if parts else Increments(np.zeros(0), np.zeros(0), np.zeros(0, dtype=np.int64), 0)


def in_each_camera(
    rig: CameraRig, points_c: FloatArray, shown: BoolArray
) -> Iterator[tuple[Camera, FloatArray, FloatArray]]:
    """Each camera, its rotation R_camera_c (3, 3), and points of the first camera's frame in its own, m.

    Points that are neither shown nor in front of a camera are 1 m ahead: they count for nothing, and stay finite.

    Args:
        rig: C cameras.
        points_c: (..., 3).
        shown: (C, ...) points that a camera shows.
    """
    for k, (camera, T_c_camera) in enumerate(zip(rig.each, rig.T_c_each, strict=True)):
        T_camera_c = se3.inverse(T_c_camera)
        points = se3.act(T_camera_c, points_c) if k else points_c
        elsewhere = ~shown[k] & (points[..., 2] < LEAST_DEPTH_M)
        yield camera, T_camera_c[:3, :3], np.where(elsewhere[..., None], [0.0, 0.0, 1.0], points)


@dataclass(frozen=True, eq=False)
class Measurements:
    """The measurements of N stations of one or several recordings.

    Attributes:
        cameras, chain: the stated geometry.
        points_k: (M, 3) corners on the board, m.
        pixels: (N, C, M, 2) corners in the images of C cameras, px.
        seen: (N, C, M) corners that were detected; the others are no measurements.
        whitening: (N, C, M, 2, 2) lower triangular W with W^T W the inverse of each corner's covariance, in units of
            the noise level: the claims of all stations' usual corners have rms 1.
        claimed_px: rms of these claims, px.
        pixels_cov: (N, C, M, 2, 2) covariance of each corner as stated, px^2.
        pose_weight: (N, 6, 6) inverse covariance of a measured board pose, left perturbation, as stated; 0 where
            corners were detected.
        T_c_k: (N, 4, 4) board pose of each station by itself.
        points_c, points_cov: (N, M, 3) and (N, M, 3, 3) triangulated corners, m, and their covariances as stated.
        joints: (N, J) readings.
        joint_tracks: the head's joints over time, one tuple per recording; empty where they are not known.
        joint_widths_ns: intervals over which the motion of each of them is taken; longer for noisy readings.
        moving: (N,) stations that are not at rest: there, the offset of a clock matters.
        approach_direction: (N, J) the direction of each joint's last motion, +1 or -1; 0 where it is not known.
        wheels_between, joints_between: (N, 2) and (N, J) sigma of what is interpolated between two readings, rad or m,
            and of the side of its play of a joint that just turned back; 0 at rest.
        log: (N,) the recording of each station. Each recording has a board pose of its own.
        legs: (L, 2) consecutive stations of one recording.
        tracks: wheels of each recording.
        driven: their rotations over the legs, cut at the stations' stamps.
        motions: of a planar sensor over each leg; empty where there is none.
        times_ns: (N,) the stations' stamps.
        encoder_step_rad: (2,) resolution of the right and left wheel's encoder; 0 for none.
        sources: of the recordings' measurements.
    """

    cameras: CameraRig
    chain: HeadChain
    points_k: FloatArray
    pixels: FloatArray
    seen: BoolArray
    whitening: FloatArray
    claimed_px: float
    pixels_cov: FloatArray
    pose_weight: FloatArray
    T_c_k: FloatArray
    points_c: FloatArray
    points_cov: FloatArray
    joints: FloatArray
    joint_tracks: tuple[tuple[Track, ...], ...]
    joint_widths_ns: tuple[tuple[int, ...], ...]
    moving: BoolArray
    approach_direction: FloatArray
    wheels_between: FloatArray
    joints_between: FloatArray
    log: IntArray
    legs: IntArray
    tracks: tuple[WheelTrack, ...]
    driven: Increments
    motions: tuple[SensorMotion, ...]
    times_ns: IntArray
    encoder_step_rad: FloatArray
    sources: Sources

    @property
    def stations(self) -> int:
        """Number of stations."""
        return len(self.joints)

    @property
    def logs(self) -> int:
        """Number of recordings, also of those without stations."""
        return len(self.tracks)

    @property
    def scale_of_squares(self) -> bool:
        """Whether nothing but the squares gives the scale: with one camera, what contradicts them is another error."""
        return len(self.cameras.names) == 1

    @cached_property
    def posed(self) -> bool:
        """Whether the board's poses were measured, not its corners."""
        return not self.seen.any()

    @property
    def images_level(self) -> str:
        """Noise level of the images, or of measured poses."""
        return "pose_scale" if self.posed else "pixel_px"

    @property
    def base_width(self) -> int:
        """Unknowns of a station that legs couple, see `BASE` and `ERRORS`; the stamp's only in motion."""
        return STAMP + 1 if self.moving.any() and self.joint_tracks else STAMP

    @property
    def own_width(self) -> int:
        """Unknowns of a station that nothing couples to others, see `JOINTS` and `SWAY`."""
        return int(self.joints.shape[1]) + 3

    @property
    def joint_units(self) -> FloatArray:
        """(J,) what one unit of joint noise is for each joint: 1 rad of a revolute, 0.1 m of a prismatic one."""
        return np.array(self.chain.joint_units)

    def joint_sigmas(self, noise: Noise) -> FloatArray:
        """(N, J) sigma of each reading, rad or m."""
        return np.hypot(noise.joint_rad * self.joint_units, self.joints_between)

    @property
    def encoder_shares(self) -> FloatArray:
        """(2,) encoder noise of the right and left wheel in units of the coarser one's: as their steps."""
        coarser = self.encoder_step_rad.max()
        if coarser == 0:
            return np.ones(2)
        return np.asarray(np.maximum(self.encoder_step_rad / coarser, _LEAST_ENCODER_SHARE))

    @cached_property
    def drives(self) -> BoolArray:
        """(N,) stations of recordings in which the base moves: there the floor differs from station to station."""
        turned = np.abs(self.driven.totals_rad).max(axis=1, initial=0.0)
        moved = turned > _AT_REST_RAD + 2 * self.encoder_step_rad.max()
        return np.isin(self.log, self.log[self.legs[moved, 0]])

    @property
    def first(self) -> BoolArray:
        """(N,) the first station of each recording, whose base pose is the world's origin."""
        first = np.ones(self.stations, dtype=np.bool_)
        first[self.legs[:, 1]] = False
        return first

    # -- stamps in motion -------------------------------------------------------------------------

    def stamps_ns(self, time_offset_s: FloatArray | float) -> IntArray:
        """(N,) stamps of the images by another clock, also of one for each station. Stations at rest keep theirs."""
        offset_ns = np.rint(1e9 * np.asarray(time_offset_s)).astype(np.int64)
        return np.asarray(self.times_ns + self.moving * offset_ns)

    @cached_property
    def _in_motion(self) -> list[tuple[BoolArray, int, Track, int, int]]:
        """Stations in motion of each recording, (N,), with column, track and widths of each joint, and of its wheels.

        Rates are differences over the first width; those in images, of means over the second.
        """
        parts = []
        for number, (joints, widths_ns) in enumerate(
            zip(self.joint_tracks, self.joint_widths_ns, strict=True)
        ):
            mine, wheels = self.moving & (self.log == number), self.tracks[number]
            of_log = zip((*joints, wheels.right, wheels.left), (*widths_ns, _RATE_NS, _RATE_NS), strict=True)
            for column, (track, width_ns) in enumerate(of_log if mine.any() else ()):
                parts.append((mine, column, track, width_ns, _smooth_width_ns(track, self.times_ns[mine])))
        return parts

    def joint_shift(self, time_offset_s: FloatArray | float) -> FloatArray:
        """(N, J) motion of the joints from each station's stamp to its stamp by another clock."""
        shift, after = np.zeros_like(self.joints), self.stamps_ns(time_offset_s)
        for mine, column, track, width_ns, _ in self._in_motion:
            if column < shift.shape[1]:
                before = track.mean(self.times_ns[mine], width_ns)
                shift[mine, column] = track.mean(after[mine], width_ns) - before
        return shift

    def rates(
        self, joints_s: FloatArray | float, wheels_s: FloatArray | float, in_images: bool = False
    ) -> FloatArray:
        """(N, J + 2) rates of the joints, and of the right and left wheel, at the stations; 0 at rest, rad/s or m/s.

        Args:
            joints_s, wheels_s: offsets of their clocks, also of one for each station.
            in_images: while rows are exposed one after another, or cameras. Steps of encoders within 40 ms look like
                motion there: in a read-out of 20 ms, the board seemed turned by 0.3 degrees.
        """
        joints = self.joints.shape[1]
        rates = np.zeros((self.stations, joints + 2))
        joints_ns, wheels_ns = self.stamps_ns(joints_s), self.stamps_ns(wheels_s)
        for mine, column, track, width_ns, smooth_ns in self._in_motion:
            at = (joints_ns if column < joints else wheels_ns)[mine]
            if in_images:
                rates[mine, column] = _smooth_rate(track, at, smooth_ns)
            else:
                half = width_ns // 2
                rates[mine, column] = (track.at(at + half) - track.at(at - half)) / (2e-9 * half)
        return rates

    # -- legs -------------------------------------------------------------------------------------

    def steps(self, time_offset_s: FloatArray | float = 0.0) -> Increments:
        """Wheel rotations of the legs, cut at the stations' stamps by another clock."""
        if not (np.any(time_offset_s) and self.moving.any()):
            return self.driven
        stamps_ns = self.stamps_ns(time_offset_s)
        return steps_between(self.tracks, self.log, stamps_ns)

    @cached_property
    def pairs(self) -> MotionPairs:
        """The legs as the linear method and eqs. 18 and 19 take them."""
        T_v_h = head_pose(self.chain, self.joints)
        return MotionPairs.of(T_v_h, self.T_c_k, self.points_c, self.log, self.steps())


BY_STATION = (
    "log",
    "pixels",
    "seen",
    "whitening",
    "pose_weight",
    "T_c_k",
    "pixels_cov",
    "points_c",
    "points_cov",
    "joints",
    "moving",
    "approach_direction",
    "wheels_between",
    "joints_between",
    "times_ns",
)
