"""Transfer error: the corners of a station predicted in the one before by the parameters alone (eqs. 18 and 19).

And its minimum: by Levenberg-Marquardt, or by Powell's method as in the paper.
"""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from scipy.optimize import least_squares, minimize

from mobilecal_cli import se3
from mobilecal_cli.errors import SolveError
from mobilecal_cli.kinematics import Arcs, integrate
from mobilecal_cli.likelihood.measurements import MotionPairs, planar_pose
from mobilecal_cli.model import FloatArray, Parameters, Refinement, WheelGeometry

_MOST_STEPS = 100
_LEAST_GAIN, _LEAST_STEP = 1e-12, 1e-11  # relative, of the cost and of the parameters
_STEP = 1e-5  # of a difference: rad, m


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


def _derivatives(function: Callable[[FloatArray], FloatArray], x: FloatArray) -> FloatArray:
    """(n, k) of a function (k,) → (n,), by central differences."""
    differences = [function(x + step) - function(x - step) for step in _STEP * np.eye(len(x))]
    return np.array(differences).T / (2 * _STEP)


def refine_lm(pairs: MotionPairs, start: Parameters) -> Refinement:
    """Minimize eq. 19 by Levenberg-Marquardt.

    Raises:
        SolveError: no minimum within 100 steps.
    """
    history = []

    def residuals(x: FloatArray) -> FloatArray:
        return residuals_m(pairs, start.plus(x)).ravel()

    def jacobian(x: FloatArray) -> FloatArray:
        """Of the start, and of each point that is better than the one before."""
        history.append(point_rms_m(pairs, start.plus(x)))
        return _derivatives(residuals, x)

    least = least_squares(
        residuals,
        np.zeros(9),
        jacobian,
        x_scale="jac",
        ftol=_LEAST_GAIN,
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
    J = _derivatives(lambda x: residuals_m(pairs, start.plus(x)).ravel(), np.zeros(9))
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
