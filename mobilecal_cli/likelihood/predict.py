"""Expected errors of the camera's pose, of projected points and of dead reckoning, from the covariance."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.camera import project, project_with_jacobian
from mobilecal_cli.kinematics import head_pose
from mobilecal_cli.likelihood.constants import PATTERNS, camera_change, corrected_chain, table
from mobilecal_cli.likelihood.effects import INTRINSICS, CameraEffect, Clock, FloorEffect
from mobilecal_cli.likelihood.posterior import Posterior
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.calibration import Parameters
from mobilecal_cli.model.findings import AtWork
from mobilecal_cli.model.rig import CameraRig, HeadChain
from mobilecal_cli.model.solution import Solution

STEP = 1e-6  # of a constant, rad, m, px or a share, for differences
#: Distance of the point ahead of the camera whose position error is predicted, m.
AHEAD_M = 2.0


def camera_covariance(lin: Posterior, covariance: FloatArray) -> tuple[FloatArray, tuple[str, ...]]:
    """Covariance of the first camera's pose in the base and of its own constants, (6 + K, 6 + K), and their K names.

    The pose's part is a right twist, mean over the head's poses in the recording. `covariance` is (P, P), of the shared
    parameters.
    """
    patterns = {row.name for row in lin.data.layout.constants if row.kind in PATTERNS}
    own = {
        name: column
        for column, name, effect in lin.data.layout.of(CameraEffect)
        if effect.camera == 0 and effect.of in INTRINSICS and name not in patterns
    }
    poses = in_base(lin)
    constants = np.broadcast_to(
        np.eye(len(covariance))[list(own.values())], (len(poses), len(own), len(covariance))
    )
    by_shared = np.concatenate([poses, constants], axis=1)
    return np.mean(by_shared @ covariance @ by_shared.mT, axis=0), tuple(own)


def in_base(lin: Posterior) -> FloatArray:
    """(N, 6, P) the first camera's pose in the base by the shared parameters, right twist: not how the base stands.

    With the constants of the head's chain and joints applied.
    """
    poses = -lin.views.by_shared  # the board moves the other way
    for effect in (FloorEffect, Clock):
        poses[:, :, [column for column, _, _ in lin.data.layout.of(effect)]] = 0.0
    return poses


def camera_in_base(chain: HeadChain, constants: Mapping[str, float], T_h_c: FloatArray) -> FloatArray:
    """(4, 4) T_v_c of a camera where all joints read zero, with the corrections of the head chain.

    Args:
        chain: as stated.
        constants: name → estimated difference from the stated value.
        T_h_c: (4, 4) head-eye transform.
    """
    improved, zeros = corrected_chain(chain, constants)
    return np.asarray(head_pose(improved, zeros) @ T_h_c)


def off_as_stated(chain: HeadChain, constants: Mapping[str, float], T_h_c: FloatArray) -> tuple[float, float]:
    """How far the camera is elsewhere in the base, rad and m, without the corrections of the head chain."""
    stated, corrected = (camera_in_base(chain, values, T_h_c) for values in ({}, constants))
    off = se3.inverse(stated) @ corrected
    return float(np.linalg.norm(se3.log_so3(off[:3, :3]))), float(np.linalg.norm(off[:3, 3]))


def weights_of(parameters: Parameters, camera: FloatArray) -> Mapping[str, FloatArray]:
    """Field of `AtWork` → (K, K) W for the covariance of K parameters, of which the nine come first.

    Its variance is the sum over the elements of W times the covariance: W is the mean of g g^T over the derivatives g
    of the figure. Straight driving over s meters: both wheels turn by s / r,
    so a radius error moves its wheel by s dr / r. Turn in place by psi: psi = (rR phiR - rL phiL) / b with
    rR phiR = -rL phiL = psi b / 2 (paper, eq. 10).

    Args:
        parameters: the nine.
        camera: (n, 6, K) derivatives of the camera's pose at n poses of the head, right twists.
    """
    wheels, count, K = parameters.wheels, len(camera), camera.shape[2]
    rR, rL, b = wheels.radius_right_m, wheels.radius_left_m, wheels.separation_m
    ahead = camera[:, 3:] + np.cross(camera[:, :3], np.array([[[0.0], [0.0], [AHEAD_M]]]), axis=1)

    def of_camera(rows: FloatArray) -> FloatArray:
        flat = rows.reshape(-1, K)
        return np.asarray(flat.T @ flat / count)

    def of_wheels(*values: float) -> FloatArray:
        gradient = np.zeros(K)
        gradient[6:9] = values
        return np.outer(gradient, gradient)

    heading = of_wheels(1 / (rR * b), -1 / (rL * b), 0.0)
    return {
        "camera_m": of_camera(camera[:, 3:]),
        "camera_rad": of_camera(camera[:, :3]),
        "point_m": of_camera(ahead),
        "along_m_per_m": of_wheels(0.5 / rR, 0.5 / rL, 0.0),
        "heading_rad_per_m": heading,
        "sideways_m_per_m": heading / 4,
        "heading_rad_per_turn": (2 * math.pi) ** 2 * of_wheels(0.5 / rR, 0.5 / rL, -1 / b),
    }


def expected(weights: Mapping[str, FloatArray], covariance: FloatArray) -> AtWork:
    """Expected errors from their weights, see `weights_of`, and the covariance (K, K) of the parameters."""
    return AtWork(**{name: math.sqrt(max(0.0, float(np.sum(W * covariance)))) for name, W in weights.items()})


def projection_std_px(solution: Solution, cameras: CameraRig, points_c: FloatArray) -> FloatArray:
    """1 sigma of the pixels of points that are known in the base, (n,), px: the larger axis of the ellipse.

    From the first camera's pose in the base and its own constants, with their correlations, to first order.

    Args:
        solution: has an uncertainty.
        cameras: as stated.
        points_c: (n, 3) in the first camera's frame, m.
    """
    assert solution.uncertainty is not None
    J_point = project_with_jacobian(solution.cameras.each[0], points_c)[1]
    J = [np.cross(J_point, points_c[:, None]), -J_point]  # by the camera's right twist
    rows = table(cameras, HeadChain("", "", ()))
    values = {c.name: c.value for c in solution.constants.values()}
    for name in solution.uncertainty.camera_constants:
        ahead, behind = (
            project(
                camera_change(cameras, rows, values | {name: values[name] + step}).apply(cameras).each[0],
                points_c,
            )
            for step in (STEP, -STEP)
        )
        J.append((ahead - behind)[..., None] / (2 * STEP))
    by_all = np.concatenate(J, axis=2)
    covariance = by_all @ solution.uncertainty.camera @ by_all.mT
    return np.asarray(np.sqrt(np.linalg.eigvalsh(covariance)[:, -1]))
