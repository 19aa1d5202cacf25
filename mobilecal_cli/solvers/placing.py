"""Initial base poses and board poses for given parameters."""

from __future__ import annotations

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.kinematics import integrate
from mobilecal_cli.likelihood.noise import Selection
from mobilecal_cli.likelihood.problem import Problem, State, no_extras
from mobilecal_cli.model import FloatArray, Parameters
from mobilecal_cli.solvers.carry import base_motion
from mobilecal_cli.solvers.loops import Loops


def state_at(problem: Problem, parameters: Parameters, loops: Loops, selection: Selection) -> State:
    """State for given parameters: base poses by dead reckoning, and the boards' median poses.

    Across outlier legs, the base pose follows from the board seen by the cameras.
    """
    motion = integrate(loops.steps, parameters.wheels)
    T_vi_vj, psi = base_motion(motion), motion.psi_rad
    count = problem.stations
    T_w_v = np.broadcast_to(np.eye(4), (count, 4, 4)).copy()
    heading = np.zeros(count)
    T_v_k = loops.T_v_h @ parameters.T_h_c @ loops.T_c_k
    boards = np.broadcast_to(np.eye(4), (problem.layout.boards, 4, 4)).copy()
    known = np.zeros(problem.layout.boards, dtype=np.bool_)
    into = {int(j): leg for leg, (_, j) in enumerate(problem.legs)}
    starts = [s for s in range(count) if s not in into or not selection.legs[into[s]]]
    for start, end in zip(starts, [*starts[1:], count], strict=True):
        members = np.arange(start, end)
        driven = [into[s] for s in range(start + 1, end)]
        T_w_v[members], heading[members] = _dead_reckoning(motion.t_m[driven], psi[driven])
        seeing = members[selection.views[members]]
        board = problem.board[start]
        if start in into and known[board] and len(seeing):
            # T_w_v at the start of this section from the known board pose, projected onto the floor.
            placed = boards[board] @ se3.inverse(T_v_k[seeing]) @ se3.inverse(T_w_v[seeing])
            shift = _median_pose(placed)
            yaw = np.arctan2(shift[1, 0], shift[0, 0])
            flat = se3.transform(se3.rotation_z(yaw), np.array([shift[0, 3], shift[1, 3], 0.0]))
            T_w_v[members], heading[members] = flat @ T_w_v[members], heading[members] + yaw
        elif start in into:
            leg = into[start]
            shift = T_w_v[problem.legs[leg, 0]] @ T_vi_vj[leg]
            heading[members] += heading[problem.legs[leg, 0]] + psi[leg]
            T_w_v[members] = shift @ T_w_v[members]
        if not known[board] and len(seeing):
            boards[board] = _median_pose(T_w_v[seeing] @ T_v_k[seeing])
            known[board] = True
    return State(
        parameters,
        no_extras(),
        boards,
        np.concatenate([T_w_v[:, :2, 3], heading[:, None]], axis=1),
        np.zeros_like(problem.joints),
        np.zeros((count, 2)),
    )


def _dead_reckoning(t_m: FloatArray, psi_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Poses (n + 1, 4, 4) in the frame of the first, and headings (n + 1,), along n consecutive legs."""
    heading = np.concatenate([[0.0], np.cumsum(psi_rad)])
    Rz = se3.rotation_z(heading)
    t = np.zeros((len(heading), 3))
    t[1:, :2] = np.cumsum((Rz[:-1, :2, :2] @ t_m[..., None])[..., 0], axis=0)
    return se3.transform(Rz, t), heading


def _median_pose(T: FloatArray) -> FloatArray:
    """Median pose: component-wise median of the twists from one of the poses."""
    best: FloatArray = T[len(T) // 2]
    for _ in range(3):
        best = best @ se3.exp(np.median(se3.log(se3.inverse(best) @ T), axis=0))
    return best
