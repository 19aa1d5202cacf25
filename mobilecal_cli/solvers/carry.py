"""Prediction of each station's corners from the next station (eq. 18), and the transfer error (eq. 19)."""

from __future__ import annotations

import math

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.kinematics import LegMotion, integrate, integrate_with_jacobian
from mobilecal_cli.model import FloatArray, Parameters
from mobilecal_cli.solvers.loops import Loops


def base_motion(motion: LegMotion) -> FloatArray:
    """Base motion T_vi_vj of each leg, (L, 4, 4)."""
    t = np.concatenate([motion.t_m, np.zeros((len(motion.t_m), 1))], axis=1)
    return se3.transform(se3.rotation_z(motion.psi_rad), t)


def camera_motion(loops: Loops, parameters: Parameters) -> FloatArray:
    """Camera motion T_ci_cj = X^-1 T_v_hi^-1 T_vi_vj T_v_hj X of each leg (eq. 18), (L, 4, 4)."""
    i, j = loops.legs.T
    T_vi_vj = base_motion(integrate(loops.steps, parameters.wheels))
    X = parameters.T_h_c
    T_ci_cj: FloatArray = se3.inverse(loops.T_v_h[i] @ X) @ T_vi_vj @ loops.T_v_h[j] @ X
    return T_ci_cj


def residuals_m(loops: Loops, parameters: Parameters) -> FloatArray:
    """Predicted minus measured corners of each leg, p^_i,f - p_i,f, in frame ci, (L, M, 3), m."""
    i, j = loops.legs.T
    carried = se3.act(camera_motion(loops, parameters), loops.points_c[j])
    residuals: FloatArray = carried - loops.points_c[i]
    return residuals


def rms_m(residuals: FloatArray) -> float:
    """Root mean square length of residual vectors (square root of eq. 19), (..., 3) → m."""
    return math.sqrt(float(np.mean(np.sum(residuals**2, axis=-1))))


def point_rms_m(loops: Loops, parameters: Parameters) -> float:
    """Point error of the given parameters, m: the square root of eq. 19, "Error" in the paper's Table 1."""
    return rms_m(residuals_m(loops, parameters))


def residuals_with_jacobian(loops: Loops, parameters: Parameters) -> tuple[FloatArray, FloatArray]:
    """Residuals of `residuals_m` and their derivatives.

    Returns:
        (L, M, 3) residuals and (L, M, 3, 9) derivatives by (delta, rR, rL, b). The twist delta (6) moves the camera
        in its own frame: X exp(delta), tangent order of `se3`.
    """
    i, j = loops.legs.T
    motion, d_psi, d_t = integrate_with_jacobian(loops.steps, parameters.wheels)
    X = parameters.T_h_c
    T_vj_cj = loops.T_v_h[j] @ X
    T_ci_vi = se3.inverse(loops.T_v_h[i] @ X)
    T_ci_vj = T_ci_vi @ base_motion(motion)
    points_j = loops.points_c[j]
    carried = se3.act(T_ci_vj @ T_vj_cj, points_j)

    J = np.empty((*carried.shape, 9))
    # X exp(delta) on the right moves the point in cj; exp(-delta) on the left moves the predicted point in ci.
    R_ci_cj = (T_ci_vj @ T_vj_cj)[:, None, :3, :3]
    J[..., :3] = se3.skew(carried) - R_ci_cj @ se3.skew(points_j)
    J[..., 3:6] = R_ci_cj - np.eye(3)
    # psi rotates the point about the z axis of vi: d(Rz p)/dpsi = z x (Rz p).
    points_vj = se3.act(T_vj_cj, points_j)
    Rz = se3.rotation_z(motion.psi_rad)
    turned = np.einsum("lab,lmb->lma", Rz, points_vj)
    swept = np.stack([-turned[..., 1], turned[..., 0], np.zeros_like(turned[..., 0])], axis=-1)
    d_t3 = np.concatenate([d_t, np.zeros((len(d_t), 1, 3))], axis=1)
    in_vi = swept[..., None] * d_psi[:, None, None, :] + d_t3[:, None]
    J[..., 6:] = np.einsum("lab,lmbk->lmak", T_ci_vi[:, :3, :3], in_vi)
    return carried - loops.points_c[i], J


def moved(parameters: Parameters, delta: FloatArray) -> Parameters:
    """Parameters after a step (9,) in the order of `residuals_with_jacobian`."""
    wheels = parameters.wheels
    return Parameters(
        parameters.T_h_c @ se3.exp(delta[:6]),
        type(wheels)(
            wheels.radius_right_m + float(delta[6]),
            wheels.radius_left_m + float(delta[7]),
            wheels.separation_m + float(delta[8]),
        ),
    )
