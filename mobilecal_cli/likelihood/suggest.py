"""What to record next: the stop after the log's last that would tell most, from the information matrix."""

from __future__ import annotations

from dataclasses import dataclass, fields, replace

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.camera import project_with_jacobian
from mobilecal_cli.kinematics import head_jacobian, head_pose, unseen_height
from mobilecal_cli.likelihood.dataset import Dataset
from mobilecal_cli.likelihood.legs import leg_covariances, linearize_legs
from mobilecal_cli.likelihood.measurements import ENCODERS, PROCESSES, STAMP
from mobilecal_cli.likelihood.noise import Inliers, encoder_sigmas, own_sigmas
from mobilecal_cli.likelihood.posterior import Posterior
from mobilecal_cli.likelihood.processes import processes_of
from mobilecal_cli.likelihood.state import State, base_at, cameras_at, head_at
from mobilecal_cli.likelihood.views import linearize_views
from mobilecal_cli.model import (
    NINE,
    BoolArray,
    CameraRig,
    FloatArray,
    Suggestion,
    WheelTrack,
)

# Accuracy that a robot needs: the least certain parameter is the worst relative to these.
NEEDED = np.array(
    [0.003, 0.003, 0.003, 0.003, 0.003, 0.003, 0.003, 0.003, 0.003]
)  # rad, m; wheels: of themselves
_TURNS_DEG = (0, -50, -25, 25, 50)
_DRIVES_M = (0.0, 0.3, -0.3, 0.6)
_LOOKS = ((0.5, 0.5), (0.25, 0.3), (0.75, 0.3), (0.25, 0.7), (0.75, 0.7), (0.5, 0.2), (0.5, 0.8))
_MARGIN = 0.02  # of the picture's size
_ROOM = 1.2  # range of distances: the log's own, so much wider
_REACH_RAD = 0.35  # beyond the joints' range in the log
_NEAREST = 0.35  # least cosine of the angle between the board's normal and the line of sight
_AIM_STEPS = 20
_LEAST_DEPTH_M = 0.1
_UPRIGHT = 0.5  # component of the vertical beyond which a coordinate is a height


@dataclass(frozen=True, slots=True, eq=False)
class _Stops:
    """Stops to choose from, C of them.

    Attributes:
        turn_rad, drive_m, face_rad: (C,) the base's way from the log's last station: a turn, a drive, another turn.
        base: (C, 3) where it ends, in the world.
        joints: (C, J) where the head's joints stand.
    """

    turn_rad: FloatArray
    drive_m: FloatArray
    face_rad: FloatArray
    base: FloatArray
    joints: FloatArray

    def select(self, chosen: BoolArray) -> _Stops:
        return _Stops(*(getattr(self, part.name)[chosen] for part in fields(self)))


def _boards(data: Dataset, state: State, base: FloatArray, joints: FloatArray) -> FloatArray:
    """T_c_k from base poses (C, 3) and joints (C, J): (C, 4, 4)."""
    flat = np.concatenate([base[:, :2], np.zeros((len(base), 1))], axis=1)
    T_w_v = se3.transform(se3.rotation_z(base[:, 2]), flat)
    T_w_c = T_w_v @ head_pose(data.chain, joints) @ state.parameters.T_h_c
    T: FloatArray = se3.inverse(T_w_c) @ state.T_w_k[data.log[-1]]
    return T


def _aimed(data: Dataset, state: State, stops: _Stops, target: FloatArray) -> _Stops:
    """The stops with joints that bring the board's middle as near as they can to pixels (C, 2) of the first camera.

    Where no joint pans, the base turns after its drive.
    """
    rig, X = cameras_at(data, state), state.parameters.T_h_c
    middle = data.points_k.mean(axis=0)
    joints, base, turns = stops.joints, stops.base.copy(), 0 if data.chain.pan else 1
    to_camera = se3.adjoint(se3.inverse(X))
    for _ in range(_AIM_STEPS):
        points = se3.act(_boards(data, state, base, joints), middle[None])
        points[..., 2] = np.maximum(points[..., 2], _LEAST_DEPTH_M)
        at, J_p = project_with_jacobian(rig.first, points)
        off = at[:, 0] - target
        if np.abs(off).max() < 1.0:
            break
        J_twist = np.concatenate([np.cross(points, J_p[:, 0]), J_p[:, 0]], axis=-1)
        about_z = se3.adjoint(se3.inverse(head_pose(data.chain, joints)))[..., 2:3]
        moves = np.concatenate([about_z[..., :turns], head_jacobian(data.chain, joints)], axis=-1)
        step = np.linalg.pinv(-J_twist @ (to_camera @ moves), rcond=1e-3) @ off[..., None]
        step = np.clip(step[..., 0], -0.3, 0.3)
        base[:, 2] -= step[:, :turns].sum(axis=1)
        joints = joints - step[:, turns:]
    face = stops.face_rad + base[:, 2] - stops.base[:, 2]
    return replace(stops, face_rad=face, base=base, joints=joints)


def _seen_whole(data: Dataset, T_c_k: FloatArray, rig: CameraRig, distances: FloatArray) -> BoolArray:
    """(C,) whether the cameras that usually show the board see all of it well."""
    points_c = se3.act(T_c_k, data.points_k)
    reach = np.linalg.norm(T_c_k[:, :3, 3], axis=1)
    middle = points_c.mean(axis=1)
    facing = np.abs(np.einsum("ca,ca->c", T_c_k[:, :3, 2], middle)) / np.linalg.norm(middle, axis=1)
    fine = (reach > distances.min() / _ROOM) & (reach < distances.max() * _ROOM) & (facing > _NEAREST)
    fine &= points_c[..., 2].min(axis=1) > _LEAST_DEPTH_M
    points_c = np.where(fine[:, None, None], points_c, [0.0, 0.0, 1.0])
    usual = data.seen.any(axis=2).mean(axis=0)
    for camera, T_c_camera, share in zip(rig.each, rig.T_c_each, usual, strict=True):
        if share < usual.max() / 2:
            continue
        points = se3.act(se3.inverse(T_c_camera), points_c)
        ahead = np.all(points[..., 2] > _LEAST_DEPTH_M, axis=1)
        at, _ = project_with_jacobian(camera, np.where(ahead[:, None, None], points, [0.0, 0.0, 1.0]))
        fine &= ahead
        edge, size = _MARGIN * camera.width, np.array([camera.width, camera.height])
        fine &= np.all((at >= edge) & (at <= size - 1 - edge), axis=(1, 2))
    return np.asarray(fine)


def _reachable(data: Dataset, state: State) -> _Stops:
    """Stops a turn and a drive away from the last, from which the whole board is seen."""
    rig = cameras_at(data, state)
    T_w_c = base_at(data, state) @ head_at(data, state) @ state.parameters.T_h_c
    distances = np.linalg.norm((se3.inverse(T_w_c) @ state.T_w_k[data.log])[:, :3, 3], axis=1)
    ways = [(np.radians(turn), drive, u, v) for turn in _TURNS_DEG for drive in _DRIVES_M for u, v in _LOOKS]
    turn, drive, u, v = np.array(ways).T
    last = state.base[-1]
    heading = last[2] + turn
    base = np.stack([last[0] + drive * np.cos(heading), last[1] + drive * np.sin(heading), heading], axis=1)
    stops = _Stops(turn, drive, np.zeros(len(turn)), base, np.repeat(data.joints[-1:], len(turn), axis=0))
    stops = _aimed(data, state, stops, np.stack([u * rig.first.width, v * rig.first.height], axis=1))
    low, high = data.joints.min(axis=0) - _REACH_RAD, data.joints.max(axis=0) + _REACH_RAD
    fine = np.all((stops.joints > low) & (stops.joints < high), axis=1)
    fine &= _seen_whole(data, _boards(data, state, stops.base, stops.joints), rig, distances)
    return stops.select(fine)


def _with_stops(data: Dataset, state: State, stops: _Stops) -> tuple[Dataset, State]:
    """A data set of the last station and, each reached from it, all the stops."""
    count, J = len(stops.turn_rad), data.joints.shape[1]
    wide = replace(
        data,
        pixels=np.repeat(data.pixels[-1:], count + 1, axis=0),
        seen=np.ones((count + 1, *data.seen.shape[1:]), dtype=np.bool_),
        pose_weight=np.zeros((count + 1, 6, 6)),
        whitening=np.broadcast_to(np.eye(2), (count + 1, *data.whitening.shape[1:])),
        joints=np.concatenate([data.joints[-1:], stops.joints]),
        joint_tracks=(),
        joint_widths_ns=(),
        moving=np.zeros(count + 1, dtype=np.bool_),
        approach_direction=np.zeros((count + 1, J)),
        wheels_between=np.zeros((count + 1, 2)),
        joints_between=np.zeros((count + 1, J)),
        log=np.zeros(count + 1, dtype=np.int64),
        first_log=int(data.first_log + data.log[-1]),
        tracks=data.tracks[data.log[-1] :][:1],
        motions=None,
        legs=np.stack([np.zeros(count, dtype=np.int64), np.arange(1, count + 1)], axis=1),
        times_ns=np.arange(count + 1),
        T_c_k=np.repeat(
            data.T_c_k[-1:], count + 1, axis=0
        ),  # of no meaning at a stop that is not recorded yet
        T_c_k_cov=np.repeat(data.T_c_k_cov[-1:], count + 1, axis=0),
        points_c=np.repeat(data.points_c[-1:], count + 1, axis=0),
    )
    base = np.concatenate([state.base[-1:], stops.base])
    there = State.without_errors(wide, state.parameters, state.T_w_k[data.log[-1:]], base)
    return wide, replace(there, constants=state.constants)


def _leg(lin: Posterior, turn_rad: float, drive_m: float, face_rad: float) -> FloatArray:
    """(P + 2 B, P + 2 B) information of a leg that turns, drives and turns again, and of the processes along it.

    About the shared parameters and the base blocks of both ends.
    """
    data, state, noise = lin.data, lin.state, lin.noise
    wheels = state.parameters.wheels
    sides = ((1, wheels.radius_right_m), (-1, wheels.radius_left_m))
    turned = np.array([0.0, turn_rad, turn_rad, turn_rad + face_rad]) * wheels.separation_m / 2
    driven = np.array([0.0, 0.0, drive_m, drive_m])
    right, left = ((driven + way * turned) / radius for way, radius in sides)
    times = np.arange(4)
    end = np.array([[drive_m * np.cos(turn_rad), drive_m * np.sin(turn_rad), turn_rad + face_rad]])
    stop = _Stops(np.zeros(1), np.zeros(1), np.zeros(1), end, data.joints[-1:])
    pair, there = _with_stops(data, replace(state, base=np.zeros_like(state.base)), stop)
    track = WheelTrack.at_same_times(times, right, left)
    pair = replace(pair, tracks=(track,), times_ns=times[[0, -1]])
    along = processes_of(pair, wheels, noise, Inliers.all_of(pair))
    legs = linearize_legs(pair, there, along)
    by_start = legs.by_start[0].copy()
    # The start is a station like any other here, not the origin of the world.
    by_start[:, :3] = [[1, 0, -end[0, 1]], [0, 1, end[0, 0]], [0, 0, 1]]
    by_shared = legs.by_shared[0]
    rows = np.concatenate([by_shared, by_start, legs.by_end[0]], axis=1)
    covariance = np.asarray(sum(leg_covariances(pair.steps(), wheels, noise, ends_known=True).values()))
    H: FloatArray = rows.T @ np.linalg.inv(covariance[0]) @ rows
    before = by_shared.shape[1] + np.arange(PROCESSES.start, PROCESSES.stop)
    after, rho, weight = before + STAMP, along.rho[1], 1 / along.variance[1]
    H[before, before] += rho**2 * weight
    H[after, after] += weight
    H[before, after] -= rho * weight
    H[after, before] -= rho * weight
    return H


def _informations(lin: Posterior, stops: _Stops) -> FloatArray:
    """(C, P + 6 + B, P + 6 + B) information of each stop about the shared parameters, the board and the last base."""
    data, state, noise = lin.data, lin.state, lin.noise
    wide, there = _with_stops(data, state, stops)
    views = linearize_views(wide, there, Inliers.all_of(wide), noise, np.zeros((wide.stations, 6)))
    count, P, B, own = len(stops.turn_rad), data.layout.size + 6, STAMP, data.own_width
    of_leg = np.r_[: P - 6, P : P + 2 * B]
    sigma, encoders_sigma = own_sigmas(wide, Inliers.all_of(wide), noise)[0], encoder_sigmas(wide, noise)[0]
    legs: dict[tuple[float, ...], FloatArray] = {}
    out = np.empty((count, P + B, P + B))
    ways = np.stack([stops.turn_rad, stops.drive_m, stops.face_rad], axis=1)
    for c, way in enumerate(map(tuple, ways.tolist())):
        if way not in legs:
            legs[way] = _leg(lin, *way)
        H = np.zeros((P + 2 * B + own,) * 2)  # shared, board, last base, new base, the new stop's own errors
        of_view = [
            views.by_shared[c + 1],
            views.by_board[c + 1],
            np.zeros((6, B)),
            views.by_base[c + 1],
            views.by_own[c + 1],
        ]
        A = np.zeros((6 + len(views.direct), len(H)))
        A[:6] = np.concatenate(of_view, axis=1)
        A[range(6, len(A)), views.direct] = 1.0
        H += A.T @ views.information[c + 1] @ A
        H[np.ix_(of_leg, of_leg)] += legs[way]
        encoders = P + B + np.arange(ENCODERS.start, ENCODERS.stop)
        errors = np.arange(P + 2 * B, len(H))
        H[encoders, encoders] += encoders_sigma**-2
        H[errors, errors] += sigma**-2
        kept = P + B
        out[c] = H[:kept, :kept] - H[:kept, kept:] @ np.linalg.solve(H[kept:, kept:], H[kept:, :kept])
    return out


def suggestions(lin: Posterior, covariance: FloatArray, most: int = 5) -> tuple[Suggestion, ...]:
    """The stops that would shrink the worst standard deviation most, best first, one for each turn and drive.

    A height that no motion of this robot shows is left out.

    Args:
        lin: the optimum.
        covariance: (P, P) of the shared parameters.
        most: how many at most.
    """
    if lin.data.posed.any():
        return ()  # no camera says from where the target would be seen
    normal, wheels, last = lin.normal, lin.state.parameters.wheels.vector, int(lin.data.log[-1])
    # Shared parameters, last board and last base block; at a stop, the stamp's error has no effect.
    by_board = np.concatenate([np.zeros((len(covariance), 6)), np.eye(6), normal.base_by_board[-1][:STAMP]])
    by_shared = np.concatenate(
        [np.eye(len(covariance)), normal.board_by_shared[last], normal.base_by_shared[-1][:STAMP]]
    )
    joint = by_shared @ covariance @ by_shared.T + by_board @ normal.board_covariance[last] @ by_board.T
    joint[-STAMP:, -STAMP:] += normal.base_covariance()[0][-1][:STAMP, :STAMP]
    needed = np.concatenate([NEEDED[:6], NEEDED[6:] * wheels])
    vertical = unseen_height(lin.data.chain)
    if vertical is not None:
        needed[3:6][np.abs(vertical) > _UPRIGHT] = np.inf
    now = np.sqrt(np.diag(covariance)[:9])
    if not (now / needed).any():
        return ()  # all nine are fixed
    worst = int(np.argmax(now / needed))
    stops = _reachable(lin.data, lin.state)
    best: dict[tuple[float, float], Suggestion] = {}
    for c, M in enumerate(_informations(lin, stops)):
        told = joint @ M
        after = joint[:9, :9] - told[:9] @ np.linalg.solve(np.eye(len(M)) + told, joint[:, :9])
        then = np.sqrt(np.diag(after))
        gain = 1 - float(np.max(then / needed) / np.max(now / needed))
        way = (float(stops.turn_rad[c]), float(stops.drive_m[c]))
        if way not in best or best[way].gain < gain:
            known = float(now[worst]), float(then[worst])
            face = float(stops.face_rad[c])
            best[way] = Suggestion(*way, face, stops.joints[c], NINE[worst], *known, gain)
    return tuple(sorted(best.values(), key=lambda s: -s.gain)[:most])
