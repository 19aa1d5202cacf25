"""Reprojection residuals of each station in raw pixels, and their derivatives.

All unknowns that move camera or board change the board's pose in the left camera, T_c_k → exp(delta) T_c_k. The
derivatives pass through these six numbers per station. Additional parameters that change the cameras or the board
itself ("direct" extras) have their own columns.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.camera import project_with_jacobian
from mobilecal_cli.kinematics import head_jacobian
from mobilecal_cli.likelihood.noise import Noise, Selection
from mobilecal_cli.likelihood.problem import Problem, State, cameras_at, head_at, joints_at
from mobilecal_cli.likelihood.shared import POSE_EXTRAS
from mobilecal_cli.model import FloatArray

_BLOCK = 500  # stations: 10 MB of derivatives for 54 corners


@dataclass(frozen=True, slots=True, eq=False)
class Views:
    """Whitened reprojection residuals of all stations at a state.

    Attributes:
        residual_px: (N, 2, M, 2) predicted minus detected.
        information: (N, Q, Q) of (delta, direct extras): J^T J of the whitened inlier residuals.
        gradient: (N, Q) J^T r.
        cost: (N,) sum of squares.
        by_base: (N, Q, 5) delta by base twist (x, y, heading) and encoder errors (zero).
        by_joints: (N, Q, J) delta by joint errors.
        by_shared: (N, Q, P) delta and direct extras by the global parameters.
    """

    residual_px: FloatArray
    information: FloatArray
    gradient: FloatArray
    cost: FloatArray
    by_base: FloatArray
    by_joints: FloatArray
    by_shared: FloatArray


def board_in_camera(problem: Problem, state: State) -> FloatArray:
    """Predicted board pose of each station, T_c_k = X^-1 T_v_h^-1 T_w_v^-1 T_w_k, (N, 4, 4)."""
    T_w_c = state.T_w_v @ head_at(problem, state) @ state.parameters.T_h_c
    T: FloatArray = se3.inverse(T_w_c) @ state.T_w_k[problem.board]
    return T


def whitened(W: FloatArray, values: FloatArray) -> FloatArray:
    """Corner residuals or derivatives (N, 2, M, 2, ...) px, multiplied by the lower triangular whitening W."""
    W = W.reshape(*W.shape, *[1] * (values.ndim - 4))
    result = np.empty_like(values)
    np.multiply(W[:, :, :, 0, 0], values[:, :, :, 0], out=result[:, :, :, 0])
    np.multiply(W[:, :, :, 1, 1], values[:, :, :, 1], out=result[:, :, :, 1])
    result[:, :, :, 1] += W[:, :, :, 1, 0] * values[:, :, :, 0]
    return result


def blocks_of(stations: int) -> Iterator[slice]:
    """Blocks of stations, which limit the memory for the corner derivatives to a few MB."""
    yield from (slice(i, i + _BLOCK) for i in range(0, stations, _BLOCK))


def corner_residuals(
    problem: Problem, state: State, T_c_k: FloatArray, stations: slice = slice(None)
) -> tuple[FloatArray, FloatArray]:
    """Predicted minus detected corners of some stations for board poses T_c_k, and their derivatives.

    Returns:
        (N, 2, M, 2) residuals, px, and (N, 2, M, 2, Q) derivatives by (delta, direct extras).
    """
    rig = cameras_at(problem, state)
    scale = 1 + state.extra("square_scale")
    points_c = se3.act(T_c_k, scale * problem.points_k)
    T_r_c = se3.inverse(rig.T_c_r)
    points_r = se3.act(T_r_c, points_c)
    direct = [name for name in problem.layout.extras if name not in POSE_EXTRAS]
    turning = se3.left_jacobian_so3(np.array([state.extra(f"stereo_r_{axis}") for axis in "xyz"]))
    residual = np.empty((*points_c.shape[:2], 2, 2)).swapaxes(1, 2)
    J = np.zeros((len(points_c), 2, points_c.shape[1], 2, 6 + len(direct)))
    for k, (camera, points) in enumerate(((rig.left, points_c), (rig.right, points_r))):
        at, J_p = project_with_jacobian(camera, points)
        residual[:, k] = at - problem.pixels[stations, k]
        J_c = J_p if k == 0 else (J_p.reshape(-1, 3) @ T_r_c[:3, :3]).reshape(J_p.shape)
        x, y, z = np.moveaxis(points_c, -1, 0)[..., None]
        by_x, by_y, by_z = np.moveaxis(J_c, -1, 0)
        J[:, k, :, :, 0] = y * by_z - z * by_y  # point x J_c
        J[:, k, :, :, 1] = z * by_x - x * by_z
        J[:, k, :, :, 2] = x * by_y - y * by_x
        J[:, k, :, :, 3:6] = J_c
        for column, name in enumerate(direct, 6):
            side = ("left", "right")[k]
            if name == "square_scale":
                grown = points_c - T_c_k[:, None, :3, 3]
                J[:, k, :, :, column] = np.einsum("nmab,nmb->nma", J_c, grown) / scale
            elif name == "baseline_scale" and k == 1:
                shift = T_r_c[:3, :3] @ problem.cameras.T_c_r[:3, 3]
                J[:, k, :, :, column] = -J_p @ shift
            elif name.startswith("stereo_r_") and k == 1:
                # R_c_r → exp(rho) R_c_r rotates the point by -rho about r's origin, in axes of c.
                arm = points_c - rig.T_c_r[:3, 3]
                axis = turning[:, "xyz".index(name[-1])]
                J[:, k, :, :, column] = -np.einsum("nmab,nmb->nma", J_c, np.cross(axis, arm))
            elif name == f"focal_{side}":
                J[:, k, :, :, column] = (at - camera.K[:2, 2]) / camera.K[0, 0]
            elif name in (f"principal_{side}_x", f"principal_{side}_y"):
                J[:, k, :, "xy".index(name[-1]), column] = 1.0
    return residual, J


def _pose_columns(
    problem: Problem, state: State, T_c_k: FloatArray, width: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    X, chain, layout = state.parameters.T_h_c, problem.chain, problem.layout
    count, names = problem.stations, chain.joints
    by_base = np.zeros((count, width, 5))
    Ad_c_v = se3.adjoint(se3.inverse(head_at(problem, state) @ X))
    by_base[:, :6, 0], by_base[:, :6, 1], by_base[:, :6, 2] = (-Ad_c_v[:, :, k] for k in (3, 4, 2))
    by_base[problem.first] = 0.0  # the world is the base at its first station
    by_joints = np.zeros((count, width, len(names)))
    by_joints[:, :6] = -se3.adjoint(se3.inverse(X)) @ head_jacobian(chain, joints_at(problem, state))

    by_shared = np.zeros((count, width, layout.size))
    by_shared[:, :3, :3] = by_shared[:, 3:6, 3:6] = -X[:3, :3].T
    for column, name in enumerate(layout.extras, 9):
        joint = {"pan_zero": chain.pan, "backlash_pan": chain.pan, "backlash_tilt": chain.tilt}.get(name)
        if name == "time_joints":
            rates = problem.joint_rates(state.extra(name))
            by_shared[:, :6, column] = (by_joints[:, :6] @ rates[:, :, None])[..., 0]
        elif name.startswith("mount_"):
            by_shared[:, :6, column] = -Ad_c_v[:, :, 3 + "xy".index(name[-1])]
        elif joint in names:
            j = names.index(joint)
            share = np.ones(count) if name == "pan_zero" else -problem.joint_sides[:, j] / 2
            by_shared[:, :6, column] = by_joints[:, :6, j] * share[:, None]
    direct = [column for column, name in enumerate(layout.extras, 9) if name not in POSE_EXTRAS]
    for row, column in enumerate(direct, 6):
        by_shared[:, row, column] = 1.0
    Ad_c_k = se3.adjoint(T_c_k)
    for b in range(layout.boards):
        mine = problem.board == b
        by_shared[mine, :6, layout.named + 6 * b : layout.named + 6 * (b + 1)] = Ad_c_k[mine]
    return by_base, by_joints, by_shared


def linearize_views(problem: Problem, state: State, selection: Selection, noise: Noise) -> Views:
    """Residuals and information of all stations' images."""
    T_c_k = board_in_camera(problem, state)
    believed = selection.corners & selection.views[:, None, None]
    root_weight = np.where(believed, 1 / noise.pixel_px, 0.0)
    parts = []
    for block in blocks_of(problem.stations):
        residual, J = corner_residuals(problem, state, T_c_k[block], block)
        width = J.shape[-1]
        W = problem.whitening[block] * root_weight[block, ..., None, None]
        A = whitened(W, J).reshape(len(J), -1, width)
        r = whitened(W, residual).reshape(len(J), -1)
        At = np.swapaxes(A, 1, 2)
        parts.append((residual, At @ A, (At @ r[..., None])[..., 0], np.sum(r**2, axis=1)))
    residuals, information, gradient, cost = (np.concatenate(part) for part in zip(*parts, strict=True))
    return Views(
        residuals,
        information,
        gradient,
        cost,
        *_pose_columns(problem, state, T_c_k, width),
    )
