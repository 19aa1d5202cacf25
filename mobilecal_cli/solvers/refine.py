"""Minimization of eq. 19: by Levenberg-Marquardt with analytic derivatives, or by Powell's method as in the paper."""

from __future__ import annotations

import math

import numpy as np

from mobilecal_cli.errors import SolveError
from mobilecal_cli.likelihood.measurements import MotionPairs
from mobilecal_cli.model import FloatArray, Parameters, Refinement
from mobilecal_cli.solvers.transfer import point_rms_m, residuals_with_jacobian, rms_m

_MAX_STEPS = 100
_LEAST_GAIN_M, _LEAST_GAIN = 1e-15, 1e-12  # of the point rms, and over it: a smaller one is rounding
# Over the diagonal of the normal matrix: from a start that is nearly a minimum, down to rounding, up to no step at all.
_FIRST_DAMPING, _LEAST_DAMPING, _LARGEST_DAMPING = 1e-6, 1e-15, 1e8


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
