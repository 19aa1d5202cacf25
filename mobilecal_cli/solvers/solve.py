"""Solve an extraction for the nine parameters."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mobilecal_cli.errors import SolveError
from mobilecal_cli.kinematics import integrate
from mobilecal_cli.likelihood.observability import tainted
from mobilecal_cli.likelihood.problem import head_at
from mobilecal_cli.model import (
    NINE,
    BoolArray,
    Extraction,
    FloatArray,
    LinearEstimate,
    Method,
    NoiseLevels,
    Parameters,
    Refinement,
    Solution,
    Uncertainty,
)
from mobilecal_cli.solvers.asked import Asked
from mobilecal_cli.solvers.carry import point_rms_m
from mobilecal_cli.solvers.findings import evidence_of, jackknife_std, over_logs, scale_of, suggestions_of
from mobilecal_cli.solvers.fit import Fit
from mobilecal_cli.solvers.linear import linear_estimate, ratios_of
from mobilecal_cli.solvers.loops import Loops, closed_loops
from mobilecal_cli.solvers.maximum_likelihood import Solver
from mobilecal_cli.solvers.outliers import outliers_of
from mobilecal_cli.solvers.refine import refine_lm, refine_powell
from mobilecal_cli.solvers.residuals import residuals_of
from mobilecal_cli.solvers.signs import check_signs

_LOG = logging.getLogger(__name__)


def _motion(
    extraction: Extraction, loops: Loops, solution_psi: FloatArray, path_m: float
) -> dict[str, float]:
    chain = extraction.rig.chain
    joints = np.degrees(np.stack([o.joints for o in extraction.observations]))
    ranges = dict(zip(chain.joints, np.ptp(joints, axis=0), strict=True))
    motion = {
        f"{role}_range_deg": float(ranges[name])
        for role, name in (("pan", chain.pan), ("tilt", chain.tilt))
        if name in ranges
    }
    return {
        **motion,
        "turned_deg": float(np.degrees(np.sum(np.abs(solution_psi)))),
        "largest_turn_deg": float(np.degrees(np.max(np.abs(solution_psi)))),
        "driven_m": path_m,
    }


def solve(
    extraction: Extraction,
    method: Method = "ml",
    start_ratios: FloatArray | None = None,
    asked: Asked | None = None,
    on_step: Callable[[], None] = lambda: None,
) -> Solution:
    """Solution for all nine parameters.

    Args:
        extraction: at least four observations; for all methods but "ml", the motion must make all nine parameters
            observable (see `uncertainty`).
        method: "ml" (maximum likelihood), "linear" (paper, section 3.5), "paper" (eq. 19 by Powell) or "lm"
            (eq. 19 by Levenberg-Marquardt).
        start_ratios: (2,) wheel ratios (aR, aL) to start from; the nominal ones and a grid are tried too.
        asked: constraints, priors and additional parameters, for "ml" only.
        on_step: called before each optimization step, for "ml" only.

    Raises:
        SolveError: did not converge, an encoder has the wrong sign, the wheels are swapped, or an unobservable
            parameter has no nominal value.
    """
    try:
        return _solved(extraction, method, start_ratios, asked or Asked(), on_step)
    except np.linalg.LinAlgError as error:
        raise SolveError(
            f"numerical failure in the solver: {error}",
            "run calibrate on the recording again; if this recurs, its stations are inconsistent with one another",
        ) from error


def _solved(
    extraction: Extraction,
    method: Method,
    start_ratios: FloatArray | None,
    asked: Asked,
    on_step: Callable[[], None],
) -> Solution:
    loops = closed_loops(extraction)
    if method == "ml":
        return _by_likelihood(extraction, loops, start_ratios, asked, on_step)
    linear = linear_estimate(loops, extraction.rig.nominal.wheels, start_ratios)
    check_signs(linear.parameters.wheels)
    refiner = {"linear": None, "paper": refine_powell, "lm": refine_lm}[method]
    refinement = refiner(loops, linear.parameters) if refiner is not None else None
    return _solution(extraction, loops, method, linear, refinement)


def _solution(
    extraction: Extraction,
    loops: Loops,
    method: Method,
    linear: LinearEstimate,
    refinement: Refinement | None,
    believed: BoolArray | None = None,
) -> Solution:
    best = refinement or linear
    residuals = residuals_of(extraction, loops, best.parameters, believed)
    wheels = best.parameters.wheels
    path = (wheels.radius_right_m * loops.steps.right_rad + wheels.radius_left_m * loops.steps.left_rad) / 2
    psi = integrate(loops.steps, wheels).psi_rad
    return Solution(
        method=method,
        parameters=best.parameters,
        linear=linear,
        refinement=refinement,
        residuals=residuals,
        point_rms_m=math.sqrt(float(np.mean(residuals.leg_point_rms_m**2))),
        reprojection_rms_px=math.sqrt(float(np.mean(residuals.leg_reprojection_px**2))),
        motion=_motion(extraction, loops, psi, float(np.sum(np.abs(path)))),
    )


def _pulled(loops: Loops, start: Parameters) -> LinearEstimate:
    """The initial estimate of a partly unobservable problem as a `LinearEstimate`."""
    rms = point_rms_m(loops, start)
    return LinearEstimate(start, (start,), 1, rms, ratios_of(start.wheels), "nominal", math.inf)


def _with_extras(loops: Loops, fit: Fit) -> Loops:
    """The loops corrected for the fit's additional parameters (time offsets, pan zero, backlash, mount)."""
    problem, state = fit.problem, fit.optimum.state
    as_read = replace(state, joint_errors=np.zeros_like(state.joint_errors))
    return replace(loops, T_v_h=head_at(problem, as_read), steps=problem.steps(state.extra("time_wheels")))


def _by_likelihood(
    extraction: Extraction,
    loops: Loops,
    start_ratios: FloatArray | None,
    asked: Asked,
    on_step: Callable[[], None],
) -> Solution:
    solver = Solver(extraction, asked, on_step)
    if solver.plain:
        linear = linear_estimate(loops, extraction.rig.nominal.wheels, start_ratios)
        check_signs(linear.parameters.wheels)
    else:
        linear = _pulled(loops, solver.linear())  # no sign check: an unobservable scale may have any sign
    fit = solver.solve(linear.parameters)
    found = evidence_of(fit)
    scale = scale_of(extraction, found)
    if scale is not None and scale.apart and "square_scale" not in asked.extras:
        _LOG.info("square size and stereo baseline are inconsistent: the square size is estimated")
        extended = replace(asked, extras=(*asked.extras, "square_scale"))
        fit = Solver(extraction, extended, on_step).solve(linear.parameters)
        found = evidence_of(fit)
        scale = scale_of(extraction, found)
    fit = over_logs(fit)
    parameters = fit.optimum.state.parameters
    check_signs(parameters.wheels)
    i, j = fit.problem.legs.T
    believed = fit.selection.legs & fit.selection.views[i] & fit.selection.views[j]
    if not believed.any():
        believed[:] = True
    explained = _with_extras(loops, fit)
    rms = point_rms_m(explained, parameters)
    history = np.array([linear.point_rms_m, rms])
    refinement = Refinement("ml", parameters, history, rms, len(fit.optimum.history))
    solution = _solution(extraction, explained, "ml", linear, refinement, believed)
    names = fit.problem.layout.names[9:]
    std = np.sqrt(np.diag(fit.covariance)[9 : fit.problem.layout.named])
    return replace(
        solution,
        uncertainty=uncertainty_of(fit, asked),
        outliers=outliers_of(extraction, fit),
        extras={name: (fit.optimum.state.extra(name), float(s)) for name, s in zip(names, std, strict=True)},
        evidence=found,
        scale=scale,
        between=fit.between,
        suggestions=suggestions_of(fit),
    )


def uncertainty_of(fit: Fit, asked: Asked) -> Uncertainty:
    """Uncertainty of the nine parameters of a fit."""
    covariance = fit.covariance[:9, :9]
    fixed = np.array([name in asked.fixed for name in NINE])
    scales = fit.directions.scales[:9]
    levels = [name for name in fit.components if name not in fit.given]
    return Uncertainty(
        covariance=covariance,
        observable=~tainted(fit.held[:, :9], scales, np.sqrt(np.diag(covariance))) & ~fixed,
        held=fit.held[:, :9],
        scales=scales,
        singular_values=fit.directions.singular_values,
        noise=NoiseLevels(
            fit.noise.pixel_px,
            fit.noise.wheel_rad_per_sqrt_rad,
            fit.noise.encoder_rad,
            fit.noise.joint_rad,
            tuple(levels),
            {name: fit.components[name].redundancy for name in levels},
        ),
        fixed=fixed,
        jackknife_std=jackknife_std(fit),
    )
