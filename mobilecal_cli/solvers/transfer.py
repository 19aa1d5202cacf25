"""Transfer error: the corners of a station predicted in the one before by the parameters alone (eqs. 18 and 19)."""

from __future__ import annotations

import math

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.kinematics import Arcs, integrate
from mobilecal_cli.likelihood.measurements import MotionPairs
from mobilecal_cli.model import FloatArray, Parameters


def base_motion(motion: Arcs) -> FloatArray:
    """T_vi_vj of each leg: (L, 4, 4)."""
    t = np.concatenate([motion.t_m, np.zeros((len(motion.t_m), 1))], axis=1)
    return se3.transform(se3.rotation_z(motion.psi_rad), t)


def camera_motion(pairs: MotionPairs, parameters: Parameters) -> FloatArray:
    """T_ci_cj = X^-1 T_v_hi^-1 T_vi_vj T_v_hj X of each leg (the matrix of eq. 18): (L, 4, 4)."""
    i, j = pairs.legs.T
    T_vi_vj = base_motion(integrate(pairs.steps, parameters.wheels))
    X = parameters.T_h_c
    T_ci_cj: FloatArray = se3.inverse(pairs.T_v_h[i] @ X) @ T_vi_vj @ pairs.T_v_h[j] @ X
    return T_ci_cj


def residuals_m(pairs: MotionPairs, parameters: Parameters) -> FloatArray:
    """Predicted minus detected corners of each leg, p^_i,f - p_i,f: (L, M, 3), m, in frame ci."""
    i, j = pairs.legs.T
    predicted = se3.act(camera_motion(pairs, parameters), pairs.points_c[j])
    residuals: FloatArray = predicted - pairs.points_c[i]
    return residuals


def rms_m(residuals: FloatArray) -> float:
    """Square root of eq. 19: root of the mean squared length, (..., 3) → m."""
    return math.sqrt(float(np.mean(np.sum(residuals**2, axis=-1))))


def point_rms_m(pairs: MotionPairs, parameters: Parameters) -> float:
    """Square root of eq. 19 at some parameters, m: the "Error" of the paper's Table 1."""
    return rms_m(residuals_m(pairs, parameters))


def leg_rms_m(pairs: MotionPairs, parameters: Parameters) -> FloatArray:
    """(L,) the same of each leg, m."""
    return np.asarray(np.sqrt(np.mean(np.sum(residuals_m(pairs, parameters) ** 2, axis=-1), axis=-1)))


def residuals_with_jacobian(pairs: MotionPairs, parameters: Parameters) -> tuple[FloatArray, FloatArray]:
    """`residuals_m` and their derivatives.

    Returns:
        (L, M, 3) residuals and (L, M, 3, 9) derivatives by a step of the parameters, see `Parameters.plus`.
    """
    i, j = pairs.legs.T
    motion = integrate(pairs.steps, parameters.wheels)
    d_psi, d_t = motion.by_wheels()
    X = parameters.T_h_c
    T_vj_cj = pairs.T_v_h[j] @ X
    T_ci_vi = se3.inverse(pairs.T_v_h[i] @ X)
    T_ci_vj = T_ci_vi @ base_motion(motion)
    points_j = pairs.points_c[j]
    predicted = se3.act(T_ci_vj @ T_vj_cj, points_j)

    J = np.empty((*predicted.shape, 9))
    # A step turns and shifts the points in the head's frame at j; X^-1 undoes the same at i.
    R_ci_h = X[:3, :3].T
    R_ci_hj = T_ci_vj[:, None, :3, :3] @ pairs.T_v_h[j][:, None, :3, :3]
    J[..., :3] = R_ci_h @ se3.skew(predicted @ X[:3, :3].T) - R_ci_hj @ se3.skew(points_j @ X[:3, :3].T)
    J[..., 3:6] = R_ci_hj - R_ci_h
    # A larger psi turns the point about vi's z axis after it is at vj: d(Rz p)/dpsi = z x (Rz p).
    points_vj = se3.act(T_vj_cj, points_j)
    Rz = se3.rotation_z(motion.psi_rad)
    turned = np.einsum("lab,lmb->lma", Rz, points_vj)
    swept = np.stack([-turned[..., 1], turned[..., 0], np.zeros_like(turned[..., 0])], axis=-1)
    d_t3 = np.concatenate([d_t, np.zeros((len(d_t), 1, 3))], axis=1)
    in_vi = swept[..., None] * d_psi[:, None, None, :] + d_t3[:, None]
    J[..., 6:] = np.einsum("lab,lmbk->lmak", T_ci_vi[:, :3, :3], in_vi)
    return predicted - pairs.points_c[i], J
