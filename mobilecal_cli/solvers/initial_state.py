"""Initial base poses and board poses for some parameters."""

from __future__ import annotations

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.kinematics import integrate
from mobilecal_cli.likelihood.dataset import Dataset
from mobilecal_cli.likelihood.noise import Inliers
from mobilecal_cli.likelihood.state import State
from mobilecal_cli.model import FloatArray, Parameters
from mobilecal_cli.solvers.transfer import base_motion


def initial_state(data: Dataset, parameters: Parameters, inliers: Inliers) -> State:
    """Base poses by dead reckoning with some parameters, and the boards' median poses.

    After an outlier leg, the images of the board place the base.
    """
    pairs = data.pairs
    motion = integrate(pairs.steps, parameters.wheels)
    T_vi_vj, psi = base_motion(motion), motion.psi_rad
    count = data.stations
    T_w_v = np.broadcast_to(np.eye(4), (count, 4, 4)).copy()
    heading = np.zeros(count)
    T_v_k = pairs.T_v_h @ parameters.T_h_c @ pairs.T_c_k
    boards = np.broadcast_to(np.eye(4), (data.logs, 4, 4)).copy()
    known = np.zeros(data.logs, dtype=np.bool_)
    into = {int(j): leg for leg, (_, j) in enumerate(data.legs)}
    starts = [s for s in range(count) if s not in into or not inliers.legs[into[s]]]
    for start, end in zip(starts, [*starts[1:], count], strict=True):
        members = np.arange(start, end)
        driven = [into[s] for s in range(start + 1, end)]
        T_w_v[members], heading[members] = _dead_reckoning(motion.t_m[driven], psi[driven])
        seeing = members[inliers.views[members]]
        board = data.log[start]
        if start in into and known[board] and len(seeing):
            # T_w_v with the board where it is known to be, flattened, at this stretch's start.
            placed = boards[board] @ se3.inverse(T_v_k[seeing]) @ se3.inverse(T_w_v[seeing])
            shift = _median_pose(placed)
            yaw = np.arctan2(shift[1, 0], shift[0, 0])
            flat = se3.transform(se3.rotation_z(yaw), np.array([shift[0, 3], shift[1, 3], 0.0]))
            T_w_v[members], heading[members] = flat @ T_w_v[members], heading[members] + yaw
        elif start in into:
            leg = into[start]
            shift = T_w_v[data.legs[leg, 0]] @ T_vi_vj[leg]
            heading[members] += heading[data.legs[leg, 0]] + psi[leg]
            T_w_v[members] = shift @ T_w_v[members]
        if not known[board] and len(seeing):
            boards[board] = _median_pose(T_w_v[seeing] @ T_v_k[seeing])
            known[board] = True
    for board in np.intersect1d(np.flatnonzero(~known), data.log):
        boards[board] = _median_pose((T_w_v @ T_v_k)[data.log == board])
    base = np.concatenate([T_w_v[:, :2, 3], heading[:, None]], axis=1)
    return State.without_errors(data, parameters, boards, base)


def _dead_reckoning(t_m: FloatArray, psi_rad: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Poses (n + 1, 4, 4) in the first one's frame, and headings (n + 1,), along n legs one after the other."""
    heading = np.concatenate([[0.0], np.cumsum(psi_rad)])
    Rz = se3.rotation_z(heading)
    t = np.zeros((len(heading), 3))
    t[1:, :2] = np.cumsum((Rz[:-1, :2, :2] @ t_m[..., None])[..., 0], axis=0)
    return se3.transform(Rz, t), heading


def _median_pose(T: FloatArray) -> FloatArray:
    """A pose in the middle of several: medians of the twists from one of them."""
    best: FloatArray = T[len(T) // 2]
    for _ in range(3 if len(T) > 2 else 0):
        best = best @ se3.exp(np.median(se3.log(se3.inverse(best) @ T), axis=0))
    return best
