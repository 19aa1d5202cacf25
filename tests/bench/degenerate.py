"""Motion that does not show all parameters: are the standard deviations true, those of derived figures included?

Nominal values are drawn from their priors, so that an unobservable parameter is as wrong as it is stated to be.
"""

import math
from collections import Counter
from dataclasses import replace

import numpy as np

from mobilecal_cli.errors import SolveError
from mobilecal_cli.likelihood.constants import NINE_SIGMAS, WHEEL_SIGMA
from mobilecal_cli.model.calibration import NINE, Parameters
from mobilecal_cli.model.rig import Nominal, WheelGeometry
from mobilecal_cli.simulate.robot import PAPER_ROBOT, SimulatedRobot
from mobilecal_cli.solvers import constraints_of, solve
from tests.bench.simulated import DISTURBED, GIVEN, RUNS_PER_ROUTE, as_described, route_of
from tests.bench.study import NINE_RATIOS, Study, head, line, results_of
from tests.extractions import extraction_of
from tests.truth import errors, parameters_of, predicted

# Motion, and what is fixed: wheels alone with a known head-eye transform is the case of Antonelli and Chiaverini.
_CASES = [(motion, "") for motion in ("head_fixed", "pan_only", "straight", "spin", "base_fixed")]
_CASES += [("standard", "head_eye")]
_STATIONS, RUNS = 12, 200
_DERIVED = ("camera position", "straight: distance", "straight: heading", "heading per turn")


def drawn_nominal(robot: SimulatedRobot, random: np.random.Generator) -> Parameters:
    """Nominal values of a robot, such that the truth is drawn from the priors around them."""
    off = np.clip(random.normal(size=9), -3, 3)
    head = parameters_of(robot).plus(np.concatenate([NINE_SIGMAS * off[:6], np.zeros(3)]))
    return replace(head, wheels=WheelGeometry.of(robot.wheels.vector / (1 + WHEEL_SIGMA * off[6:])))


def derived_errors(found: Parameters, robot: SimulatedRobot) -> np.ndarray:
    """(4,) true errors of the figures in `_DERIVED`: m, m per m, rad per m, rad per turn."""
    a, b = found.wheels, robot.wheels
    right, left = a.radius_right_m / b.radius_right_m, a.radius_left_m / b.radius_left_m
    turn = 2 * math.pi * ((right + left) / 2 * b.separation_m / a.separation_m - 1)
    shift = np.linalg.norm(found.T_h_c[:3, 3] - robot.T_h_c[:3, 3])
    return np.array([shift, (right + left) / 2 - 1, (right - left) / a.separation_m, turn])


def one_run(motion: str, fix: str, seed: int) -> tuple[np.ndarray, tuple[str, ...]]:
    """Error over stated sigma of the nine and of the derived figures, and the parameters marked as unobservable."""
    robot, route = PAPER_ROBOT, route_of(_STATIONS, seed // RUNS_PER_ROUTE, motion)  # type: ignore[arg-type]
    extraction = extraction_of(robot, route, DISTURBED, seed)
    rig = replace(extraction.rig, noise=GIVEN)
    nominal = drawn_nominal(robot, np.random.default_rng(seed))
    if fix:
        nominal = Parameters(robot.T_h_c, nominal.wheels)
    T_h_reference = nominal.T_h_c @ rig.cameras.T_c_reference
    rig = replace(rig, nominal=Nominal(T_h_reference, WheelGeometry.of(nominal.wheels.vector)))
    try:
        constraints = constraints_of([fix] if fix else [], [], [])
        solution = solve(as_described(replace(extraction, rig=rig)), constraints=constraints)
    except SolveError as error:
        return np.full(9 + len(_DERIVED), np.nan), (f"refused: {error.message[:40]}",)
    known = solution.uncertainty
    assert known is not None
    error = errors(solution.parameters, robot)
    p = predicted(solution.parameters, known.covariance)
    stated = [p.camera_m, p.along_m_per_m, p.heading_rad_per_m, p.heading_rad_per_turn]
    sigmas = np.concatenate([known.std, stated])
    off = np.concatenate([error, derived_errors(solution.parameters, robot)])
    ratio = np.where(sigmas > 0, off / np.where(sigmas > 0, sigmas, 1.0), np.nan)
    return ratio, tuple(name for name, ok in zip(NINE, known.observable, strict=True) if not ok)


def main(asked: Study) -> None:
    """All cases."""
    title = (
        f"N = {_STATIONS}, {asked.runs} runs each, noise levels given, nominal values drawn from their priors: rms error "
        "over the stated sigma."
    )
    head("", *NINE_RATIOS, *_DERIVED, "unobservable", title=title)
    for motion, fix in _CASES:
        ratios, hidden = zip(*results_of(one_run, motion, fix, seeds=range(asked.runs)), strict=True)
        shown = np.isfinite(ratios).sum(axis=0)
        size = np.sqrt(np.nansum(np.square(ratios), axis=0) / np.maximum(shown, 1))
        cells = [f"{v:.2f}" if n > asked.runs / 2 else "fixed" for v, n in zip(size, shown, strict=True)]
        marked = Counter(", ".join(names) or "none" for names in hidden).most_common()
        says = "; ".join(f"{names}: {count}" for names, count in marked)
        line(f"{motion}{f', {fix} fixed' if fix else ''}", *cells, says)
