"""From an extraction to the nine numbers."""

from __future__ import annotations

import math

import numpy as np

from mobilecal_cli.kinematics import integrate
from mobilecal_cli.model import Extraction, FloatArray, Method, Solution
from mobilecal_cli.solvers.linear import linear_estimate
from mobilecal_cli.solvers.loops import Loops, closed_loops
from mobilecal_cli.solvers.refine import refine_lm, refine_powell
from mobilecal_cli.solvers.residuals import residuals_of
from mobilecal_cli.solvers.signs import check_signs


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


def solve(extraction: Extraction, method: Method = "lm", start_ratios: FloatArray | None = None) -> Solution:
    """Solve for all nine numbers at once.

    Args:
        extraction: at least four observations, of motion that shows all nine (see `uncertainty`).
        method: "linear" (paper, section 3.5), "paper" (eq. 19 by Powell) or "lm" (eq. 19 by
            Levenberg-Marquardt).
        start_ratios: (2,) wheel ratios (aR, aL) to start from; the nominal ones and a grid are tried too.

    Raises:
        SolveError: not converged, or an encoder's sign or the wheels' order is wrong.
    """
    loops = closed_loops(extraction)
    linear = linear_estimate(loops, extraction.rig.nominal.wheels, start_ratios)
    check_signs(linear.parameters.wheels)
    refiner = {"linear": None, "paper": refine_powell, "lm": refine_lm}[method]
    refinement = refiner(loops, linear.parameters) if refiner is not None else None
    best = refinement or linear
    residuals = residuals_of(extraction, loops, best.parameters)
    wheels = best.parameters.wheels
    path = (wheels.radius_right_m * loops.steps.right_rad + wheels.radius_left_m * loops.steps.left_rad) / 2
    psi = integrate(loops.steps, wheels).psi_rad
    return Solution(
        method=method,
        parameters=best.parameters,
        linear=linear,
        refinement=refinement,
        residuals=residuals,
        point_rms_m=best.point_rms_m,
        reprojection_rms_px=math.sqrt(float(np.mean(residuals.leg_reprojection_px**2))),
        motion=_motion(extraction, loops, psi, float(np.sum(np.abs(path)))),
    )
