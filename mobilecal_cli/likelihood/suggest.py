"""What to record next: the stop after the log's last that would tell most, from the information matrix."""

from __future__ import annotations

import itertools
from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.camera import project_with_jacobian
from mobilecal_cli.kinematics import head_jacobian, head_pose
from mobilecal_cli.likelihood.legs import leg_covariance, linearize_legs
from mobilecal_cli.likelihood.marginals import Marginals
from mobilecal_cli.likelihood.noise import Noise, Selection
from mobilecal_cli.likelihood.problem import Problem, State, cameras_at, head_at
from mobilecal_cli.likelihood.system import System
from mobilecal_cli.likelihood.views import linearize_views
from mobilecal_cli.model import NINE, FloatArray, Suggestion, WheelTrack

# The precision that a robot's work wants: what is worst is worst against these.
WANTED = np.array(
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


@dataclass(frozen=True, slots=True, eq=False)
class _Stop:
    turn_rad: float
    drive_m: float
    base: FloatArray
    joints: FloatArray
    T_c_k: FloatArray


def _aimed(
    problem: Problem, state: State, base: FloatArray, joints: FloatArray, target: FloatArray
) -> tuple[FloatArray, FloatArray] | None:
    """Joints at which the board's middle is seen at a pixel of the left camera, and T_c_k there."""
    rig, X = cameras_at(problem, state), state.parameters.T_h_c
    T_w_v = se3.transform(se3.rotation_z(base[2]), np.array([base[0], base[1], 0.0]))
    T_v_k = se3.inverse(T_w_v) @ state.T_w_k[problem.board[-1]]
    middle = problem.points_k.mean(axis=0)
    for _ in range(_AIM_STEPS):
        T_c_k = se3.inverse(head_pose(problem.chain, joints) @ X) @ T_v_k
        point = se3.act(T_c_k, middle[None])
        if point[0, 2] < 0.05:
            point = np.array([[point[0, 0], point[0, 1], 0.05]])
        at, J_p = project_with_jacobian(rig.left, point)
        off = at[0] - target
        if np.abs(off).max() < 1.0:
            return joints, T_c_k
        J = J_p[0] @ np.concatenate([-np.cross(np.eye(3), point[0]), np.eye(3)], axis=1)
        J = J @ (-se3.adjoint(se3.inverse(X)) @ head_jacobian(problem.chain, joints))
        joints = joints - np.clip(np.linalg.lstsq(J, off, rcond=1e-3)[0], -0.3, 0.3)
    return None


def _seen_whole(problem: Problem, state: State, T_c_k: FloatArray, distances: FloatArray) -> bool:
    rig = cameras_at(problem, state)
    points_c = se3.act(T_c_k, problem.points_k)
    reach = float(np.linalg.norm(T_c_k[:3, 3]))
    if points_c[:, 2].min() < 0.1 or not distances.min() / _ROOM < reach < distances.max() * _ROOM:
        return False
    middle = points_c.mean(axis=0)
    if abs(float(T_c_k[:3, 2] @ middle)) / float(np.linalg.norm(middle)) < _NEAREST:
        return False
    for camera, points in ((rig.left, points_c), (rig.right, se3.act(se3.inverse(rig.T_c_r), points_c))):
        at, _ = project_with_jacobian(camera, points)
        edge = _MARGIN * camera.width
        size = np.array([camera.width, camera.height])
        if np.any(at < edge) or np.any(at > size - 1 - edge):
            return False
    return True


def _stops(problem: Problem, state: State) -> Iterator[_Stop]:
    """Reachable stops from which the whole board is seen."""
    left = problem.cameras.left
    at = (
        se3.inverse(state.T_w_v @ head_at(problem, state) @ state.parameters.T_h_c)
        @ state.T_w_k[problem.board]
    )
    distances = np.linalg.norm(at[:, :3, 3], axis=1)
    low, high = problem.joints.min(axis=0) - _REACH_RAD, problem.joints.max(axis=0) + _REACH_RAD
    last = state.base[-1]
    for turn_deg, drive in itertools.product(_TURNS_DEG, _DRIVES_M):
        turn = float(np.radians(turn_deg))
        heading = last[2] + turn
        base = np.array([last[0] + drive * np.cos(heading), last[1] + drive * np.sin(heading), heading])
        for u, v in _LOOKS:
            target = np.array([u * left.width, v * left.height])
            found = _aimed(problem, state, base, problem.joints[-1], target)
            if found is None:
                continue
            joints, T_c_k = found
            if np.all((joints > low) & (joints < high)) and _seen_whole(problem, state, T_c_k, distances):
                yield _Stop(turn, drive, base, joints, T_c_k)


def _information(problem: Problem, state: State, noise: Noise, stop: _Stop) -> FloatArray:
    """(P + 5, P + 5) information of one more stop about the shared numbers and the last station's base block."""
    wheels = state.parameters.wheels
    turn = stop.turn_rad * wheels.separation_m / 2
    sides = ((turn, wheels.radius_right_m), (-turn, wheels.radius_left_m))
    right, left = ([0.0, by / radius, (by + stop.drive_m) / radius] for by, radius in sides)
    times = np.array([0, 1, 2], dtype=np.int64)
    pair = replace(
        problem,
        pixels=np.stack([problem.pixels[-1]] * 2),
        relative_sigma=np.ones((2, 2)),
        joints=np.stack([problem.joints[-1], stop.joints]),
        joint_tracks=(),
        moving=np.zeros(2, dtype=np.bool_),
        joint_sides=np.zeros((2, problem.joints.shape[1])),
        log=np.zeros(2, dtype=np.int64),
        board=problem.board[-1:].repeat(2),
        legs=np.array([[0, 1]]),
        tracks=(WheelTrack(times, np.array(right), np.array(left)),),
        times_ns=np.array([0, 2], dtype=np.int64),
    )
    there = replace(
        state,
        base=np.stack([state.base[-1], stop.base]),
        joint_errors=np.zeros((2, problem.joints.shape[1])),
        encoder_errors=np.zeros((2, 2)),
    )
    views = linearize_views(pair, there, Selection.everything(pair), noise)
    legs = linearize_legs(pair, there, noise.encoder_rad > 0)
    # The start is a station like any other here, not the origin of the world.
    by_start = legs.by_start.copy()
    between = np.linalg.inv(leg_covariance(pair, wheels, noise))[0]
    cos, sin = np.cos(stop.turn_rad), np.sin(stop.turn_rad)
    by_start[0, :, :3] = [[1, 0, -stop.drive_m * sin], [0, 1, stop.drive_m * cos], [0, 0, 1]]
    P, J = problem.layout.size, problem.joints.shape[1]
    H = np.zeros((P + 5 + 5 + J, P + 5 + 5 + J))  # shared, last base, new base, new joints
    seen = np.concatenate(
        [views.by_shared[1], np.zeros((views.by_shared.shape[1], 5)), views.by_base[1], views.by_joints[1]],
        axis=1,
    )
    H += seen.T @ views.information[1] @ seen
    driven = np.concatenate(
        [legs.by_all_shared(problem.layout)[0], by_start[0], legs.by_end[0], np.zeros((3, J))], axis=1
    )
    H += driven.T @ between @ driven
    encoder = noise.encoder_rad or 1.0
    H[range(P + 8, P + 10), range(P + 8, P + 10)] += encoder**-2
    H[range(P + 10, P + 10 + J), range(P + 10, P + 10 + J)] += noise.joint_rad**-2
    kept = P + 5
    out: FloatArray = H[:kept, :kept] - H[:kept, kept:] @ np.linalg.solve(H[kept:, kept:], H[kept:, :kept])
    return out


def suggestions(
    problem: Problem,
    state: State,
    noise: Noise,
    system: System,
    marginal: Marginals,
    covariance: FloatArray,
    held: FloatArray,
    scales: FloatArray,
    most: int = 5,
) -> tuple[Suggestion, ...]:
    """The stops that would shrink the worst standard deviation most, best first, one for each way of driving.

    Args:
        problem, state, noise, system, marginal: the optimum.
        covariance: (P, P) of the shared numbers.
        held: (K, named) directions that the log does not show, in units of `scales`: known to one scale each.
        scales: (named,) units.
        most: how many at most.
    """
    P, named = problem.layout.size, problem.layout.named
    wide = covariance.copy()
    along = held * scales
    wide[:named, :named] += along.T @ along
    follow = system.base_by_shared[-1]
    own, _ = system.base_covariance()
    joint = np.block([[wide, wide @ follow.T], [follow @ wide, own[-1] + follow @ wide @ follow.T]])
    wheels = state.parameters.wheels
    sizes = np.array([wheels.radius_right_m, wheels.radius_left_m, wheels.separation_m])
    wanted = np.concatenate([WANTED[:6], WANTED[6:] * sizes])
    now = np.sqrt(np.diag(wide)[:9])
    worst = int(np.argmax(now / wanted))
    best: dict[tuple[float, float], Suggestion] = {}
    for stop in _stops(problem, state):
        M = _information(problem, state, noise, stop)
        after = joint - joint @ M @ np.linalg.solve(np.eye(P + 5) + joint @ M, joint)
        then = np.sqrt(np.diag(after)[:9])
        gain = 1 - float(np.max(then / wanted) / np.max(now / wanted))
        found = Suggestion(
            stop.turn_rad, stop.drive_m, stop.joints, NINE[worst], float(now[worst]), float(then[worst]), gain
        )
        way = (stop.turn_rad, stop.drive_m)
        if way not in best or best[way].gain < gain:
            best[way] = found
    return tuple(sorted(best.values(), key=lambda s: -s.gain)[:most])
