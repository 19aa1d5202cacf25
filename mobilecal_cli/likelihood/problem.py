"""Input of the likelihood: the measurements, and the state at which it is evaluated."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.kinematics import Increments, between_steps, cut_at, encoder_step_rad, head_pose, join
from mobilecal_cli.likelihood.shared import EXTRA_NAMES, INDEX, Layout
from mobilecal_cli.likelihood.sides import joint_sides
from mobilecal_cli.model import (
    BoolArray,
    Extraction,
    FloatArray,
    HeadChain,
    IntArray,
    JointLink,
    Observation,
    Parameters,
    StereoRig,
    Track,
    WheelGeometry,
    WheelTrack,
)

_SLOPE_S = 0.04  # time interval of a finite-difference rate
_LEAST_CLAIM_PX = 0.01  # error of the camera model, which averaging over images does not reduce
_LEAST_VARIANCE = 1e-6  # relative to a typical corner


@dataclass(frozen=True, eq=False)
class Problem:
    """The measurements of N stations, as arrays.

    Attributes:
        cameras, chain: stereo pair and head, from the robot description.
        points_k: (M, 3) corners on the board, m.
        pixels: (N, 2, M, 2) corners, left then right, px.
        seen: (N, 2, M) detected corners.
        whitening: (N, 2, M, 2, 2) lower triangular W with W^T W the inverse of each corner's covariance, in units of
            the noise level: the stated sigmas of all stations' typical corners have rms 1.
        joints: (N, J) readings.
        joint_tracks: joint readings over time, one tuple per recording; empty if unknown.
        moving: (N,) stations that are not at rest, where time offsets matter.
        joint_sides: (N, J) the direction of each joint's last motion, +1 or -1; 0 if unknown.
        log: (N,) the recording of each station.
        board: (N,) the index of the board pose at each station.
        legs: (L, 2) consecutive stations of one recording.
        tracks: wheels of each recording.
        times_ns: (N,) the stations' stamps.
        encoder_step_rad: resolution of the encoders; 0 for none.
        layout: the global parameters.
    """

    cameras: StereoRig
    chain: HeadChain
    points_k: FloatArray
    pixels: FloatArray
    seen: BoolArray
    whitening: FloatArray
    joints: FloatArray
    joint_tracks: tuple[tuple[Track, ...], ...]
    moving: BoolArray
    joint_sides: FloatArray
    log: IntArray
    board: IntArray
    legs: IntArray
    tracks: tuple[WheelTrack, ...]
    times_ns: IntArray
    encoder_step_rad: float
    layout: Layout

    @property
    def stations(self) -> int:
        """Number of stations."""
        return len(self.joints)

    @property
    def joint_kinds(self) -> tuple[str, ...]:
        """Kind of each joint, in the order of `HeadChain.joints`."""
        kinds = {link.joint: link.kind for link in self.chain.links if isinstance(link, JointLink)}
        return tuple(kinds[name] for name in self.chain.joints)

    @property
    def first(self) -> BoolArray:
        """First stations of the recordings, (N,); their base poses are the world's origin."""
        first = np.ones(self.stations, dtype=np.bool_)
        first[self.legs[:, 1]] = False
        return first

    def stamps_ns(self, time_offset_s: float) -> IntArray:
        """Image stamps shifted by a time offset, (N,); unchanged at rest."""
        return np.asarray(self.times_ns + self.moving * round(time_offset_s * 1e9), dtype=np.int64)

    def joint_shift(self, time_offset_s: float) -> FloatArray:
        """Joint motion from each station's stamp to the stamp shifted by a time offset, (N, J)."""
        shift = np.zeros_like(self.joints)
        for number, tracks in enumerate(self.joint_tracks):
            mine = self.log == number
            before, after = self.times_ns[mine], self.stamps_ns(time_offset_s)[mine]
            for j, track in enumerate(tracks):
                shift[mine, j] = track.at(after) - track.at(before)
        return shift

    def joint_rates(self, time_offset_s: float) -> FloatArray:
        """Joint rates at the stations, (N, J), rad/s; 0 at rest."""
        late, early = time_offset_s + _SLOPE_S / 2, time_offset_s - _SLOPE_S / 2
        return np.asarray((self.joint_shift(late) - self.joint_shift(early)) / _SLOPE_S)

    def wheel_rates(self, time_offset_s: float) -> FloatArray:
        """Rates of the right and left wheel at the stations, (N, 2), rad/s; 0 at rest."""
        rates = np.zeros((self.stations, 2))
        for number, track in enumerate(self.tracks):
            mine = self.log == number
            late, early = (self.stamps_ns(time_offset_s + side * _SLOPE_S / 2)[mine] for side in (1, -1))
            for k, value in enumerate((track.right_rad, track.left_rad)):
                wheel = Track(track.time_ns, value)
                rates[mine, k] = (wheel.at(late) - wheel.at(early)) / _SLOPE_S
        return rates

    def steps(self, time_offset_s: float = 0.0) -> Increments:
        """Wheel rotations along the legs, with the stations' stamps shifted by a time offset."""
        if time_offset_s == 0 or not self.moving.any():
            return self._steps_as_stamped
        return self._cut(self.stamps_ns(time_offset_s))

    @cached_property
    def _steps_as_stamped(self) -> Increments:
        return self._cut(self.times_ns)

    def _cut(self, stamps_ns: IntArray) -> Increments:
        parts = []
        for number, track in enumerate(self.tracks):
            times = stamps_ns[self.log == number]
            if len(times) > 1:
                parts.append(cut_at(track, np.clip(times, track.time_ns[0], track.time_ns[-1])))
        return join(parts) if parts else Increments(np.zeros(0), np.zeros(0), np.zeros(0, dtype=np.int64), 0)

    def with_extras(self, extras: tuple[str, ...]) -> Problem:
        """The same measurements with other additional parameters."""
        return replace(self, layout=Layout(extras, self.layout.boards))


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """Values of all unknowns.

    Attributes:
        parameters: the nine parameters.
        extras: (len(EXTRAS),) all additional parameters, 0 if not estimated.
        T_w_k: (B, 4, 4) board poses; w is the base at the first station of the board's recording.
        base: (N, 3) base poses x, y (m), heading (rad, not wrapped) in w.
        joint_errors: (N, J) corrections added to the readings.
        encoder_errors: (N, 2) corrections added to the readings of the right and left wheel, rad.
    """

    parameters: Parameters
    extras: FloatArray
    T_w_k: FloatArray
    base: FloatArray
    joint_errors: FloatArray
    encoder_errors: FloatArray

    def extra(self, name: str) -> float:
        """Value of one additional parameter."""
        return float(self.extras[INDEX[name]])

    @property
    def T_w_v(self) -> FloatArray:
        """Base poses in the world, (N, 4, 4)."""
        flat = np.concatenate([self.base[:, :2], np.zeros((len(self.base), 1))], axis=1)
        return se3.transform(se3.rotation_z(self.base[:, 2]), flat)


def joints_at(problem: Problem, state: State) -> FloatArray:
    """True joint positions, (N, J): readings corrected for errors, time offset, backlash and pan zero."""
    joints = problem.joints + state.joint_errors
    if state.extra("time_joints"):
        joints += problem.joint_shift(state.extra("time_joints"))
    names = problem.chain.joints
    for name, role in (("backlash_pan", problem.chain.pan), ("backlash_tilt", problem.chain.tilt)):
        if role in names:
            column = names.index(role)
            joints[:, column] -= state.extra(name) / 2 * problem.joint_sides[:, column]
    if problem.chain.pan in names:
        joints[:, names.index(problem.chain.pan)] += state.extra("pan_zero")
    return joints


def head_at(problem: Problem, state: State) -> FloatArray:
    """Head pose T_v_h of every station, (N, 4, 4)."""
    T_v_h = head_pose(problem.chain, joints_at(problem, state)).copy()
    T_v_h[:, 0, 3] += state.extra("mount_x")
    T_v_h[:, 1, 3] += state.extra("mount_y")
    return T_v_h


def cameras_at(problem: Problem, state: State) -> StereoRig:
    """The stereo pair with the estimated corrections of a state."""
    return cameras_with(problem.cameras, dict(zip(EXTRA_NAMES, state.extras.tolist(), strict=True)))


def cameras_with(rig: StereoRig, extras: Mapping[str, float]) -> StereoRig:
    """A stereo pair with estimated corrections; the same object if there are none.

    Args:
        rig: the stereo pair of the robot description.
        extras: name → value in the unit of `EXTRAS`; missing ones are zero.
    """
    changing = EXTRA_NAMES[INDEX["stereo_r_x"] : INDEX["square_scale"]]
    value = {name: extras.get(name, 0.0) for name in changing}
    if not any(value.values()):
        return rig
    T = rig.T_c_r.copy()
    turn = np.array([value[f"stereo_r_{axis}"] for axis in "xyz"])
    T[:3, :3] = se3.exp_so3(turn) @ T[:3, :3]
    T[:3, 3] *= 1 + value["baseline_scale"]
    changed = {}
    for side, camera in (("left", rig.left), ("right", rig.right)):
        K = camera.K.copy()
        K[0, 0] += value[f"focal_{side}"]
        K[1, 1] += value[f"focal_{side}"] * camera.K[1, 1] / camera.K[0, 0]
        K[0, 2] += value[f"principal_{side}_x"]
        K[1, 2] += value[f"principal_{side}_y"]
        changed[side] = replace(camera, K=K)
    return replace(rig, left=changed["left"], right=changed["right"], T_c_r=T)


def no_extras() -> FloatArray:
    """All additional parameters at zero, (len(EXTRAS),)."""
    return np.zeros(len(EXTRA_NAMES))


def problem_of(extraction: Extraction, extras: tuple[str, ...] = ()) -> Problem:
    """The measurements of an extraction as arrays.

    Args:
        extraction: at least one observation.
        extras: names of the additional parameters; the square size is always added if the board does not state it.
    """
    seen = extraction.observations
    log = np.array([o.log for o in seen])
    legs = [
        pair
        for number in range(len(extraction.wheels))
        for pair in itertools.pairwise(np.flatnonzero(log == number).tolist())
    ]
    square_m = extraction.board.square_m
    if square_m is None:
        square_m = float(np.median([o.square_m for o in seen]))
        extras = tuple(name for name in EXTRA_NAMES if name in (*extras, "square_scale"))
    step = max(
        (encoder_step_rad(side) for track in extraction.wheels for side in (track.right_rad, track.left_rad)),
        default=0.0,
    )
    moving = np.array([not o.at_rest for o in seen])
    tracks = extraction.wheels
    if (
        step and moving.any()
    ):  # in motion, the times of the step changes give a better resolution than one step
        tracks = tuple(between_steps(track) for track in tracks)
    logs, board = np.unique(log, return_inverse=True)
    claims = np.hypot([[o.left.sigma_px, o.right.sigma_px] for o in seen], _LEAST_CLAIM_PX)
    return Problem(
        cameras=extraction.rig.cameras,
        chain=extraction.rig.chain,
        points_k=extraction.board.grid() * square_m,
        pixels=np.stack([np.stack([o.left.pixels, o.right.pixels]) for o in seen]),
        seen=np.stack([np.stack([o.left.seen, o.right.seen]) for o in seen]),
        whitening=_whitening(seen, claims / np.sqrt(np.mean(claims**2))),
        joints=np.stack([o.joints for o in seen]),
        joint_tracks=extraction.joint_tracks,
        moving=moving,
        joint_sides=joint_sides(extraction),
        log=log,
        board=board.astype(np.int64),
        legs=np.array(legs, dtype=np.int64).reshape(-1, 2),
        tracks=tracks,
        times_ns=np.array([o.time_ns for o in seen], dtype=np.int64),
        encoder_step_rad=step,
        layout=Layout(extras, len(logs)),
    )


def _whitening(seen: Sequence[Observation], relative_sigma: FloatArray) -> FloatArray:
    """Inverse Cholesky factors of the corners' covariances in units of the noise level, (N, 2, M, 2, 2)."""
    cov = np.stack([np.stack([o.left.relative_cov, o.right.relative_cov]) for o in seen])
    cov = cov * relative_sigma[..., None, None, None] ** 2
    a = np.sqrt(np.maximum(cov[..., 0, 0], _LEAST_VARIANCE))
    b = cov[..., 1, 0] / a
    c = np.sqrt(np.maximum(cov[..., 1, 1] - b**2, _LEAST_VARIANCE))
    W = np.zeros_like(cov)
    W[..., 0, 0], W[..., 1, 0], W[..., 1, 1] = 1 / a, -b / (a * c), 1 / c
    return W


def moved(problem: Problem, state: State, shared: FloatArray, base: FloatArray, errors: FloatArray) -> State:
    """State after a step.

    Args:
        problem: gives the layout.
        state: start of the step.
        shared: (layout.size,) step of the nine parameters (small rotation vector and translation in the head's frame),
            the additional parameters and the boards (body twists).
        base: (N, 5) step of the base poses as body twists (x, y, heading) and of the encoder errors, right and left.
        errors: (N, J) step of the joint errors.
    """
    layout, X, wheels = problem.layout, state.parameters.T_h_c, state.parameters.wheels
    T_h_c = se3.transform(se3.exp_so3(shared[:3]) @ X[:3, :3], X[:3, 3] + shared[3:6])
    extras = state.extras.copy()
    extras[[INDEX[name] for name in layout.extras]] += shared[9 : layout.named]
    cos, sin = np.cos(state.base[:, 2]), np.sin(state.base[:, 2])
    x, y, turn = base[:, 0], base[:, 1], base[:, 2]
    return State(
        parameters=Parameters(
            T_h_c,
            WheelGeometry(
                wheels.radius_right_m + float(shared[6]),
                wheels.radius_left_m + float(shared[7]),
                wheels.separation_m + float(shared[8]),
            ),
        ),
        extras=extras,
        T_w_k=state.T_w_k @ se3.exp(shared[layout.named :].reshape(-1, 6)),
        base=state.base + np.stack([cos * x - sin * y, sin * x + cos * y, turn], axis=1),
        joint_errors=state.joint_errors + errors,
        encoder_errors=state.encoder_errors + base[:, 3:],
    )
