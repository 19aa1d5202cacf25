"""Transfer error: the corners of a station predicted in the one before by the parameters alone (eqs. 18 and 19).

And its minimum: by Levenberg-Marquardt, or by Powell's method as in the paper.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.optimize import least_squares, minimize

from mobilecal_cli import se3
from mobilecal_cli.errors import SolveError
from mobilecal_cli.kinematics import Arcs, integrate
from mobilecal_cli.likelihood.measurements import MotionPairs, planar_pose
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.calibration import Parameters
from mobilecal_cli.model.rig import WheelGeometry
from mobilecal_cli.model.solution import Refinement

_MOST_STEPS = 100
_LEAST_GAIN, _LEAST_STEP = 1e-12, 1e-11  # relative, of the cost and of the parameters


def base_motion(motion: Arcs) -> FloatArray:
    """T_vi_vj of each leg: (L, 4, 4)."""
    return planar_pose(np.column_stack([motion.t_m, motion.psi_rad]))


def reckoned_base(pairs: MotionPairs, wheels: WheelGeometry) -> FloatArray:
    """(N, 3) x, y (m) and heading (rad, not wrapped) of the base at every station, see `dead_reckoned`."""
    base, motion = np.zeros((len(pairs.T_v_h), 3)), integrate(pairs.steps, wheels)
    for (i, j), (x, y), psi in zip(pairs.legs, motion.t_m, motion.psi_rad, strict=True):
        cos, sin = np.cos(base[i, 2]), np.sin(base[i, 2])
        base[j] = base[i] + [cos * x - sin * y, sin * x + cos * y, psi]
    return base


def dead_reckoned(pairs: MotionPairs, wheels: WheelGeometry) -> FloatArray:
    """T_w_v of every station, w being the base at its log's first observation: (N, 4, 4)."""
    return planar_pose(reckoned_base(pairs, wheels))


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


def by_parameters(pairs: MotionPairs, parameters: Parameters) -> FloatArray:
    """(3 L M, 9) derivatives of the residuals, in their order, by a step of the parameters (`Parameters.plus`), m."""
    (i, j), motion, X = pairs.legs.T, integrate(pairs.steps, parameters.wheels), parameters.T_h_c
    R_h_c, T_v_hi, T_v_hj = X[:3, :3], pairs.T_v_h[i], pairs.T_v_h[j]
    T_vi_vj = base_motion(motion)
    T_hi_hj = se3.inverse(T_v_hi) @ T_vi_vj @ T_v_hj
    turned_h = pairs.points_c[j] @ R_h_c.T
    points_hj = turned_h + X[:3, 3]
    from_camera_h = se3.act(T_hi_hj, points_hj) - X[:3, 3]
    R_hi_hj = T_hi_hj[:, None, :3, :3]
    J = np.empty((*points_hj.shape, 9))
    J[..., :3] = se3.skew(from_camera_h) - R_hi_hj @ se3.skew(turned_h)
    J[..., 3:6] = R_hi_hj - np.eye(3)
    ahead = se3.act(T_vi_vj, se3.act(T_v_hj, points_hj)) - T_vi_vj[:, None, :3, 3]
    by_motion = np.zeros((*points_hj.shape, 3))
    by_motion[..., 0, 0] = by_motion[..., 1, 1] = 1.0
    by_motion[..., 0, 2], by_motion[..., 1, 2] = -ahead[..., 1], ahead[..., 0]
    J[..., 6:] = T_v_hi[:, None, :3, :3].mT @ by_motion @ motion.by_wheels()[:, None]
    return np.asarray(R_h_c.T @ J).reshape(-1, 9)


def refine_lm(pairs: MotionPairs, start: Parameters, least_gain: float = _LEAST_GAIN) -> Refinement:
    """Minimize eq. 19 by Levenberg-Marquardt, until a step lowers it by less than this share.

    Raises:
        SolveError: no minimum within 100 steps.
    """
    history = []

    def residuals(x: FloatArray) -> FloatArray:
        return residuals_m(pairs, start.plus(x)).ravel()

    def jacobian(x: FloatArray) -> FloatArray:
        """Of the start, and of each point that is better than the one before."""
        history.append(point_rms_m(pairs, start.plus(x)))
        return by_parameters(pairs, start.plus(x))

    least = least_squares(
        residuals,
        np.zeros(9),
        jacobian,
        x_scale="jac",
        ftol=least_gain,
        xtol=_LEAST_STEP,
        gtol=None,
        max_nfev=_MOST_STEPS,
    )
    parameters = start.plus(least.x)
    rms = point_rms_m(pairs, parameters)
    if not least.success:
        raise SolveError(
            f"the refinement did not converge in {_MOST_STEPS} steps: point rms {rms * 1e3:.3f} mm",
            "use --method ml, which tolerates outliers and finds what does not fit",
        )
    return Refinement("lm", parameters, np.array([*history, rms]), rms, least.nfev)


def refine_powell(pairs: MotionPairs, start: Parameters) -> Refinement:
    """Minimize eq. 19 by Powell's direction-set method (section 3.6), the paper's own choice.

    The parameters are taken along the eigenvectors of the normal matrix at the start, scaled to equal effect:
    directions that are conjugate from the first line search on, so few sweeps are needed.

    Raises:
        SolveError: no minimum within scipy's limits.
    """
    J = by_parameters(pairs, start)
    H, rms = J.T @ J, point_rms_m(pairs, start)
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
