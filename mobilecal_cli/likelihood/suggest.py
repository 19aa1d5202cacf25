"""What to record next: the stop after the log's last that would tell most, from the information matrix."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.camera import project, undistorted
from mobilecal_cli.kinematics import JointFrames, head_pose, unseen_height
from mobilecal_cli.likelihood.dataset import Inliers
from mobilecal_cli.likelihood.measurements import (
    BASE,
    BY_STATION,
    ERRORS,
    LEAST_DEPTH_M,
    STAMP,
    planar_pose,
    steps_between,
)
from mobilecal_cli.likelihood.normal import station_rows
from mobilecal_cli.likelihood.posterior import Posterior
from mobilecal_cli.likelihood.state import State
from mobilecal_cli.model.arrays import BoolArray, FloatArray
from mobilecal_cli.model.calibration import NINE
from mobilecal_cli.model.findings import Suggestion
from mobilecal_cli.model.observations import WheelTrack

#: Accuracy that a robot needs, rad, m, and of the wheels themselves: the least certain parameter is the worst of it.
NEEDED = np.full(9, 0.003)
_TURNS_DEG = (0, -50, -25, 25, 50)
_DRIVES_M = (0.0, -0.3, 0.6)
#: Where the board is in the first camera's image, from its middle, in shares of what the board leaves free there.
_LOOKS = ((0.0, 0.0), (-0.7, -0.7), (0.7, -0.7), (-0.7, 0.7), (0.7, 0.7))
# Readings of the wheels while the robot turns, drives and turns, and the time between them.
_PIECES, _PIECE_NS = 20, 100_000_000
_MARGIN = 0.02  # of the picture's size
_ROOM = 1.2  # range of distances: the log's own, so much wider
_REACH_RAD = 0.35  # beyond the joints' range in the log
_NEAREST = 0.35  # least cosine of the angle between the board's normal and the line of sight
_AIM_STEPS = 6
_MOST_STEP = 0.5  # rad or m
_MOST = 3
_AT_ONCE = 10  # stops, which take some MB each where images are sharp
_UPRIGHT = 0.5  # component of the vertical beyond which a coordinate is a height


def _bases(state: State, ways: FloatArray) -> FloatArray:
    """(C, 3) base poses that ways (C, 3) lead to from the last station: a turn (rad), a drive (m), another turn."""
    x, y, heading = state.base[-1, BASE]
    turn, drive, face = ways.T
    along = heading + turn
    return np.stack([x + drive * np.cos(along), y + drive * np.sin(along), along + face], axis=1)


def _boards(state: State, ways: FloatArray) -> FloatArray:
    """(C, 4, 4) the board in the base on a flat floor, at the end of ways."""
    return np.asarray(se3.inverse(planar_pose(_bases(state, ways))) @ state.T_w_k[state.data.log[-1]])


def _aimed(state: State, ways: FloatArray, rays_c: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Ways (C, 3) and joints (C, J) that bring the board's middle as near as they can to rays (C, 3) of a camera.

    Where no joint pans, the base turns after its drive.
    """
    data, ways = state.data, ways.copy()
    joints = np.repeat(data.joints[-1:], len(ways), axis=0)
    X, turns = state.parameters.T_h_c, 0 if data.chain.pan else 1
    middle_k = data.points_k.mean(axis=0)
    for _ in range(_AIM_STEPS):
        frames = JointFrames.at(data.chain, joints)
        T_v_c = frames.T_v_h @ X
        middle = se3.act(_boards(state, ways), middle_k[None])
        sight = middle[:, 0] - T_v_c[:, :3, 3]
        distance = np.linalg.norm(sight, axis=1)[:, None]
        sight /= distance
        off = sight - (T_v_c[:, :3, :3] @ rays_c[..., None])[..., 0]
        twists = frames.by_joints().mT
        if turns:
            about_z = np.broadcast_to(np.eye(6)[2], (len(ways), 1, 6))
            twists = np.concatenate([about_z, twists], axis=1)
        moved = (twists[..., 3:] + np.cross(twists[..., :3], middle)) / distance[..., None]
        across = moved - (moved @ sight[..., None]) * sight[:, None]
        step = (np.linalg.pinv(across.mT, rcond=1e-3) @ off[..., None])[..., 0]
        step = np.clip(step, -_MOST_STEP, _MOST_STEP)
        ways[:, 2] += step[:, :turns].sum(axis=1)
        joints = joints + step[:, turns:]
    return ways, joints


def _in_view(state: State, T_c_k: FloatArray) -> BoolArray:
    """(C, K) cameras that show the whole board, at poses of it in the first one, (C, 4, 4)."""
    rig, points_c = state.cameras, se3.act(T_c_k, state.data.points_k)
    shown = []
    for camera, T_c_camera in zip(rig.each, rig.T_c_each, strict=True):
        points = se3.act(se3.inverse(T_c_camera), points_c)
        ahead = np.all(points[..., 2] > LEAST_DEPTH_M, axis=1)
        at = project(camera, np.where(ahead[:, None, None], points, [0.0, 0.0, 1.0]))
        edge, size = _MARGIN * camera.width, np.array([camera.width, camera.height])
        shown.append(ahead & np.all((at >= edge) & (at <= size - 1 - edge), axis=(1, 2)))
    return np.stack(shown, axis=1)


def _seen_whole(state: State, T_c_k: FloatArray) -> BoolArray:
    """(C,) whether as many cameras as usual see all of the board well."""
    data = state.data
    distances = np.linalg.norm(state.T_c_k[:, :3, 3], axis=1)
    points_c = se3.act(T_c_k, data.points_k)
    reach = np.linalg.norm(T_c_k[:, :3, 3], axis=1)
    middle = points_c.mean(axis=1)
    facing = np.abs(np.einsum("ca,ca->c", T_c_k[:, :3, 2], middle)) / np.linalg.norm(middle, axis=1)
    fine = (reach > distances.min() / _ROOM) & (reach < distances.max() * _ROOM) & (facing > _NEAREST)
    usual = np.median(data.seen.any(axis=2).sum(axis=1))
    return np.asarray(fine & (_in_view(state, T_c_k).sum(axis=1) >= usual))


def _reachable(state: State) -> tuple[FloatArray, FloatArray]:
    """Ways (C, 3) from the last station, and joints (C, J), from which the whole board is seen."""
    data, rig, X = state.data, state.cameras, state.parameters.T_h_c
    every = [
        (np.radians(turn), drive, 0.0, *look) for turn in _TURNS_DEG for drive in _DRIVES_M for look in _LOOKS
    ]
    ways, looks = np.split(np.array(every), [3], axis=1)
    away_m = _boards(state, ways)[:, :3, 3] - (head_pose(data.chain, data.joints[-1]) @ X)[:3, 3]
    board_px = rig.first.K[0, 0] * np.ptp(data.points_k, axis=0)[:2] / np.linalg.norm(away_m, axis=1)[:, None]
    size_px = np.array([rig.first.width, rig.first.height])
    free_px = np.maximum(size_px - board_px, 0.0) / 2
    flat, _ = undistorted(rig.first, size_px / 2 + looks * free_px)
    rays = np.concatenate([flat, np.ones((len(flat), 1))], axis=1)
    ways, joints = _aimed(state, ways, rays / np.linalg.norm(rays, axis=1, keepdims=True))
    low, high = data.joints.min(axis=0) - _REACH_RAD, data.joints.max(axis=0) + _REACH_RAD
    within = np.all((joints > low) & (joints < high), axis=1)
    ways, joints = ways[within], joints[within]
    T_c_k = se3.inverse(head_pose(data.chain, joints) @ X) @ _boards(state, ways)
    seen = _seen_whole(state, T_c_k)
    return ways[seen], joints[seen]


def _with_stops(lin: Posterior, ways: FloatArray, joints: FloatArray) -> Posterior:
    """The last station twice, first as the world's origin, and all the stops, each reached from it.

    The wheels' track is that of all ways, one after another.
    """
    data, state, wheels = lin.data, lin.state, lin.state.parameters.wheels
    count, last, half_m = len(ways) + 2, int(data.log[-1]), wheels.separation_m / 2
    right, left = (
        _evenly(ways * [side * half_m, 1.0, side * half_m]) / radius_m
        for side, radius_m in ((1, wheels.radius_right_m), (-1, wheels.radius_left_m))
    )
    copies: dict[str, Any] = {name: np.repeat(getattr(data, name)[-1:], count, axis=0) for name in BY_STATION}
    zero = ("moving", "approach_direction", "wheels_between", "joints_between", "pose_weight")
    copies.update((name, np.zeros_like(copies[name])) for name in zero)
    copies["joints"][2:] = joints
    copies["times_ns"] = 3 * _PIECES * _PIECE_NS * np.arange(count)
    T_v_c = head_pose(data.chain, joints) @ state.parameters.T_h_c
    copies["seen"][2:] = _in_view(state, se3.inverse(T_v_c) @ _boards(state, ways))[..., None]
    copies["whitening"] = np.broadcast_to(np.eye(2), copies["whitening"].shape)
    tracks = (WheelTrack.at_same_times(_PIECE_NS * np.arange(len(right)), right, left),) * (last + 1)
    wide = replace(
        data,
        **copies,
        joint_tracks=(),
        joint_widths_ns=(),
        tracks=tracks,
        driven=steps_between(tracks, copies["log"], copies["times_ns"]),
        motions=(),
        legs=np.stack([np.minimum(np.arange(count - 1), 1), np.arange(1, count)], axis=1),
    )
    base = np.concatenate([state.base[[-1, -1], BASE], _bases(state, ways)])
    there = State.without_errors(wide, state.parameters, state.T_w_k[: last + 1], base)
    there = replace(there, constants=state.constants)
    every = Posterior.at(there, Inliers.all_of(wide), lin.noise, lin.priors)
    return every.changed(apart=True, traced=tuple(range(6, 6 + len(wide.layout.direct))))


def _evenly(ways: FloatArray) -> FloatArray:
    """(n,) way after each piece of a rest and of ways (N, 3), at even rates in each of these."""
    pieces = np.repeat(np.concatenate([np.zeros(3), ways.ravel()]) / _PIECES, _PIECES)
    return np.concatenate([np.zeros(1), np.cumsum(pieces)])


def _shown(lin: Posterior) -> tuple[FloatArray, FloatArray]:
    """What the stops' images show: (C, 6, P + 6 + B) rows, and the information (C, Q, Q) about (delta, constants).

    The rows are derivatives of delta by the shared parameters, the board and the last base. A stop's own base is what
    follows from these along the leg, with the noise of the leg. See `_with_stops`.
    """
    views, legs, count, P, B = lin.views, lin.legs, len(lin.data.legs), lin.data.layout.size, STAMP
    errors = np.arange(B)[ERRORS]
    # left (a leg's second base) = right (shared, board, its first base) + noise
    left, right = np.tile(np.eye(B), (count, 1, 1)), np.zeros((count, B, P + 6 + B))
    left[:, BASE], right[:, BASE, :P], right[:, BASE, P + 6 :] = legs.by_end, -legs.by_shared, -legs.by_start
    right[:, errors, P + 6 + errors] = lin.processes.rho[1:]
    noise = np.zeros((count, B, B))
    noise[:, BASE, BASE] = lin.leg_covariance
    noise[:, errors, errors] = lin.processes.variance[1:]
    J = views.by_base[1:] @ np.linalg.inv(left)
    beside = np.concatenate([np.zeros((1, 6, 6)), J @ noise @ J.mT])
    rows = J[1:] @ right[1:]
    rows[:, :, :P] += views.by_shared[2:]
    rows[:, :, P : P + 6] += views.by_board[2:]
    return rows, station_rows(lin, beside)[2:, np.argsort(views.traced)]


def _variances(lin: Posterior, joint: FloatArray, ways: FloatArray, joints: FloatArray) -> FloatArray:
    """(C, 9) variances of the nine with each of some stops.

    The covariance before, (J, J), is of the shared parameters, the last board and base.
    """
    columns, then = lin.views.columns, np.empty((len(ways), 9))
    for begin in range(0, len(ways), _AT_ONCE):
        some = slice(begin, begin + _AT_ONCE)
        for c, (rows, G) in enumerate(
            zip(*_shown(_with_stops(lin, ways[some], joints[some])), strict=True), begin
        ):
            across = np.concatenate([rows @ joint, joint[columns]])
            nine, spread = across[:, :9], np.concatenate([across @ rows.T, across[:, columns]], axis=1)
            shrunk = G @ np.linalg.solve(np.eye(len(G)) + spread @ G, nine)
            then[c] = np.diag(joint)[:9] - np.sum(nine * shrunk, axis=0)
    return then


def suggestions(lin: Posterior, covariance: FloatArray) -> tuple[Suggestion, ...]:
    """The stops that would shrink the worst standard deviation most, best first, one for each turn and drive.

    A height that no motion of this robot shows is left out. The covariance is (P, P), of the shared parameters.
    """
    if lin.data.posed:
        return ()  # no camera says from where the target would be seen
    normal, wheels, last = lin.normal, lin.state.parameters.wheels.vector, int(lin.data.log[-1])
    # Shared parameters, last board and last base block; at a stop, the stamp's error has no effect.
    by_board = np.concatenate([np.zeros((len(covariance), 6)), np.eye(6), normal.base_by_board[-1][:STAMP]])
    by_shared = np.concatenate(
        [np.eye(len(covariance)), normal.board_by_shared[last], normal.base_by_shared[-1][:STAMP]]
    )
    joint = by_shared @ covariance @ by_shared.T + by_board @ normal.board_covariance[last] @ by_board.T
    joint[-STAMP:, -STAMP:] += lin.base_covariance[0][-1][:STAMP, :STAMP]
    needed = np.concatenate([NEEDED[:6], NEEDED[6:] * wheels])
    vertical = unseen_height(lin.data.chain)
    if vertical is not None:
        needed[3:6][np.abs(vertical) > _UPRIGHT] = np.inf
    now = np.sqrt(np.diag(covariance)[:9])
    worst = int(np.argmax(now / needed))
    if not now[worst] > 0:
        return ()  # all nine are fixed
    ways, joints = _reachable(lin.state)
    then = np.sqrt(np.maximum(_variances(lin, joint, ways, joints), 0.0))  # rounding
    gain = 1 - np.max(then / needed, axis=1) / np.max(now / needed)
    best: dict[tuple[float, ...], Suggestion] = {}
    for c in np.argsort(-gain, kind="stable"):
        turn, drive, face = ways[c].tolist()
        known = float(now[worst]), float(then[c, worst]), float(gain[c])
        best.setdefault((turn, drive), Suggestion(turn, drive, face, joints[c], NINE[worst], *known))
    return tuple(best.values())[:_MOST]
