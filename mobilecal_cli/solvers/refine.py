"""Minimize eq. 19 by Levenberg-Marquardt with analytic derivatives, or by Powell's method as in the paper."""

from __future__ import annotations

import math

import numpy as np

from mobilecal_cli.errors import SolveError
from mobilecal_cli.model import FloatArray, Parameters, Refinement
from mobilecal_cli.solvers.carry import (
    moved,
    point_rms_m,
    residuals_with_jacobian,
    rms_m,
)
from mobilecal_cli.solvers.loops import Loops

_MAX_STEPS = 100
_SMALLEST_GAIN = 1e-15
_FIRST_DAMPING = 1e-6
_LARGEST_DAMPING = 1e8


def _normal_equations(loops: Loops, parameters: Parameters) -> tuple[FloatArray, FloatArray, float]:
    residuals, J = residuals_with_jacobian(loops, parameters)
    flat = J.reshape(-1, 9)
    return flat.T @ flat, flat.T @ residuals.reshape(-1), rms_m(residuals)


def refine_lm(loops: Loops, start: Parameters) -> Refinement:
    """Minimize eq. 19 by Levenberg-Marquardt.

    Raises:
        SolveError: did not converge within 100 steps.
    """
    parameters, damping = start, _FIRST_DAMPING
    H, gradient, rms = _normal_equations(loops, parameters)
    history, evaluations = [rms], 1
    while len(history) <= _MAX_STEPS:
        scale = np.sqrt(np.diag(H))
        step = -np.linalg.solve(H / np.outer(scale, scale) + damping * np.eye(9), gradient / scale) / scale
        trial = moved(parameters, step)
        H_trial, gradient_trial, rms_trial = _normal_equations(loops, trial)
        evaluations += 1
        if rms_trial <= rms:
            gain = rms - rms_trial
            parameters, H, gradient, rms = trial, H_trial, gradient_trial, rms_trial
            history.append(rms)
            damping = max(damping / 10, 1e-15)
            if gain <= _SMALLEST_GAIN + 1e-12 * rms:
                break
        else:
            damping *= 10
            if damping > _LARGEST_DAMPING:
                break  # no step reduces the cost: converged to rounding error
    else:
        raise SolveError(
            f"the refinement did not converge in {_MAX_STEPS} steps: point error {rms * 1e3:.3f} mm",
            "the linear estimate may be too inaccurate: check its residuals with --method linear",
        )
    return Refinement("lm", parameters, np.array(history), rms, evaluations)


def refine_powell(loops: Loops, start: Parameters) -> Refinement:
    """Minimize eq. 19 by Powell's direction-set method, as the paper does (section 3.6).

    The search directions are the eigenvectors of the normal matrix at the start, scaled to equal effect. They are
    conjugate from the first line search on, so few sweeps are needed.

    Raises:
        SolveError: did not converge within scipy's limits.
    """
    from scipy.optimize import minimize  # slow to import, and only this method needs it

    H, _, rms = _normal_equations(loops, start)
    scale = np.sqrt(np.diag(H))
    values, vectors = np.linalg.eigh(H / np.outer(scale, scale))
    count = H.shape[0]
    equal_effect = vectors / np.sqrt(np.maximum(values, values[-1] * 1e-12)) / scale[:, None]
    unit = max(rms, 1e-6) * math.sqrt(loops.points_c.shape[1] * len(loops.legs))
    evaluations = 0

    def at(x: FloatArray) -> Parameters:
        return moved(start, equal_effect @ x * unit)

    def cost(x: FloatArray) -> float:
        nonlocal evaluations
        evaluations += 1
        return (point_rms_m(loops, at(x)) * 1e3) ** 2  # mm^2, a number of sensible size

    history = [rms]
    result = minimize(
        cost,
        np.zeros(count),
        method="Powell",
        callback=lambda x: history.append(point_rms_m(loops, at(x))),
        options={"xtol": 1e-9, "ftol": 1e-13, "maxiter": 200, "maxfev": 40_000},
    )
    if not result.success:
        raise SolveError(
            f"Powell's method did not converge: {result.message} after {evaluations} evaluations",
            "use --method lm, which minimizes the same cost",
        )
    parameters = at(result.x)
    rms = point_rms_m(loops, parameters)
    history[-1] = rms
    return Refinement("paper", parameters, np.array(history), rms, evaluations)
