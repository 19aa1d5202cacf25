"""Transfer error: the corners of a station predicted in the one before by the parameters alone (eqs. 18 and 19).

And its minimum: by Levenberg-Marquardt with analytic derivatives, or by Powell's method as in the paper.
"""

from __future__ import annotations

import math

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.errors import SolveError
from mobilecal_cli.kinematics import Arcs, integrate
from mobilecal_cli.likelihood.measurements import MotionPairs, planar_pose
from mobilecal_cli.model import FloatArray, Parameters, Refinement

_MAX_STEPS = 100
_LEAST_GAIN_M, _LEAST_GAIN = 1e-15, 1e-12  # of the point rms, and over it: a smaller one is rounding
# Over the diagonal of the normal matrix: from a start that is nearly a minimum, down to rounding, up to no step at all.
_FIRST_DAMPING, _LEAST_DAMPING, _LARGEST_DAMPING = 1e-6, 1e-15, 1e8


def base_motion(motion: Arcs) -> FloatArray:
    """T_vi_vj of each leg: (L, 4, 4)."""
    return planar_pose(np.column_stack([motion.t_m, motion.psi_rad]))


def camera_motion(pairs: MotionPairs, parameters: Parameters) -> FloatArray:
    """T_ci_cj = X^-1 T_v_hi^-1 T_vi_vj T_v_hj X of each leg (the matrix of eq. 18): (L, 4, 4)."""
    i, j = pairs.legs.T
    T_vi_vj = base_motion(integrate(pairs.steps, parameters.wheels))
    X = parameters.T_h_c
    return np.asarray(se3.inverse(pairs.T_v_h[i] @ X) @ T_vi_vj @ pairs.T_v_h[j] @ X)


def residuals_m(pairs: MotionPairs, parameters: Parameters) -> FloatArray:
    """Predicted minus detected corners of each leg, p^_i,f - p_i,f: (L, M, 3), m, in frame ci."""
    i, j = pairs.legs.T
    return np.asarray(se3.act(camera_motion(pairs, parameters), pairs.points_c[j]) - pairs.points_c[i])


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
    by_wheels = motion.by_wheels()
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
    shifted = by_wheels * np.array([[1.0], [1.0], [0.0]])
    in_vi = swept[..., None] * by_wheels[:, None, 2:] + shifted[:, None]
    J[..., 6:] = np.einsum("lab,lmbk->lmak", T_ci_vi[:, :3, :3], in_vi)
    return predicted - pairs.points_c[i], J


def _normal_equations(pairs: MotionPairs, parameters: Parameters) -> tuple[FloatArray, FloatArray, float]:
    residuals, J = residuals_with_jacobian(pairs, parameters)
    flat = J.reshape(-1, 9)
    return flat.T @ flat, flat.T @ residuals.reshape(-1), rms_m(residuals)


def refine_lm(pairs: MotionPairs, start: Parameters) -> Refinement:
    """Minimize eq. 19 by Levenberg-Marquardt.

    Raises:
        SolveError: no minimum within 100 steps.
    """
    parameters, damping = start, _FIRST_DAMPING
    H, gradient, rms = _normal_equations(pairs, parameters)
    history, evaluations = [rms], 1
    while len(history) <= _MAX_STEPS:
        scale = np.sqrt(np.diag(H))
        scale[scale == 0] = 1.0  # these legs do not show the parameter: it stays
        step = -np.linalg.solve(H / np.outer(scale, scale) + damping * np.eye(9), gradient / scale) / scale
        trial = parameters.plus(step)
        H_trial, gradient_trial, rms_trial = _normal_equations(pairs, trial)
        evaluations += 1
        if rms_trial <= rms:
            gain = rms - rms_trial
            parameters, H, gradient, rms = trial, H_trial, gradient_trial, rms_trial
            history.append(rms)
            damping = max(damping / 10, _LEAST_DAMPING)
            if gain <= _LEAST_GAIN_M + _LEAST_GAIN * rms:
                break
        else:
            damping *= 10
            if damping > _LARGEST_DAMPING:
                break  # no step helps any more: the minimum, to rounding
    else:
        raise SolveError(
            f"the refinement did not converge in {_MAX_STEPS} steps: point rms {rms * 1e3:.3f} mm",
            "use --method ml, which tolerates outliers and finds what does not fit",
        )
    return Refinement("lm", parameters, np.array(history), rms, evaluations)


def refine_powell(pairs: MotionPairs, start: Parameters) -> Refinement:
    """Minimize eq. 19 by Powell's direction-set method (section 3.6), the paper's own choice.

    The parameters are taken along the eigenvectors of the normal matrix at the start, scaled to equal effect:
    directions that are conjugate from the first line search on, so few sweeps are needed.

    Raises:
        SolveError: no minimum within scipy's limits.
    """
    from scipy.optimize import minimize  # heavy, and for this method alone

    H, _, rms = _normal_equations(pairs, start)
    scale = np.sqrt(np.diag(H))
    values, vectors = np.linalg.eigh(H / np.outer(scale, scale))
    count = H.shape[0]
    equal_effect = vectors / np.sqrt(np.maximum(values, values[-1] * 1e-12)) / scale[:, None]
    unit = max(rms, 1e-6) * math.sqrt(pairs.points_c.shape[1] * len(pairs.legs))
    evaluations = 0

    def at(x: FloatArray) -> Parameters:
        return start.plus(equal_effect @ x * unit)

    def cost(x: FloatArray) -> float:
        nonlocal evaluations
        evaluations += 1
        return (point_rms_m(pairs, at(x)) * 1e3) ** 2  # mm^2, a number of sensible size

    history = [rms]
    result = minimize(
        cost,
        np.zeros(count),
        method="Powell",
        callback=lambda x: history.append(point_rms_m(pairs, at(x))),
        options={"xtol": 1e-9, "ftol": 1e-13, "maxiter": 200, "maxfev": 40_000},
    )
    if not result.success:
        raise SolveError(
            f"Powell's method did not converge: {result.message} after {evaluations} evaluations",
            "use --method lm, which minimizes the same cost",
        )
    parameters = at(result.x)
    rms = point_rms_m(pairs, parameters)
    history[-1] = rms
    return Refinement("paper", parameters, np.array(history), rms, evaluations)
