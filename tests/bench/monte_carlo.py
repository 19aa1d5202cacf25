"""Monte Carlo: is the maximum-likelihood estimate as good as the bound, and are its standard deviations true?"""

from dataclasses import replace

import numpy as np

from mobilecal_cli.errors import SolveError
from mobilecal_cli.likelihood.dataset import Inliers
from mobilecal_cli.model.solution import Method
from mobilecal_cli.simulate.robot import PAPER_ROBOT
from mobilecal_cli.solvers import solve
from tests.bench.simulated import DISTURBED, GIVEN, RUNS_PER_ROUTE, as_described, bound_of, route_of
from tests.bench.study import (
    DEGREES_MM,
    NINE_COLUMNS,
    NINE_RATIOS,
    Study,
    head,
    line,
    numbers,
    results_of,
    rms,
)
from tests.extractions import extraction_of
from tests.fits import maximum_likelihood
from tests.truth import errors, nees

_LEVELS = {"ml, noise levels given": GIVEN, "ml, noise levels estimated": {}}
_PAPER_EVERY = 10  # Powell's method takes longer than all the others together
RUNS = 1000
_NOTHING = (np.full(9, np.nan), np.nan, False)


def one_run(stations: int, seed: int) -> dict[str, tuple[np.ndarray, float, bool]]:
    """Error, NEES / 9 (NaN without covariance), and whether there were outliers, by method."""
    robot, number = PAPER_ROBOT, seed // RUNS_PER_ROUTE
    extraction = extraction_of(robot, route_of(stations, number), DISTURBED, seed)
    result = {}
    for name, known in _LEVELS.items():
        try:
            known_noise = replace(extraction, rig=replace(extraction.rig, noise=known))
            fit = maximum_likelihood(as_described(known_noise))
        except SolveError:
            result[name] = _NOTHING
            continue
        found, left_out = fit.lin.state.parameters, not fit.inliers.same(Inliers.all_of(fit.data))
        result[name] = (errors(found, robot), nees(found, fit.covariance, robot), left_out)
    methods: tuple[Method, ...] = ("linear",) if seed % _PAPER_EVERY else ("linear", "paper")
    for method in methods:
        try:
            result[method] = (errors(solve(extraction, method).parameters, robot), np.nan, False)
        except SolveError:
            result[method] = _NOTHING
    return result


def study(stations: int, runs: int) -> None:
    """Print one table."""
    found = results_of(one_run, stations, seeds=range(runs))
    sigma = np.array([np.sqrt(np.diag(bound_of(stations, seed // RUNS_PER_ROUTE))) for seed in range(runs)])
    head("", *NINE_COLUMNS, title=f"### N = {stations}, {runs} runs\n\nRoot-mean-square errors")
    line("Cramer-Rao bound", *numbers(rms(sigma) * DEGREES_MM, 3))
    rows = {}
    for name in found[0]:
        error = np.array([f.get(name, _NOTHING)[0] for f in found])
        tried = sum(name in f for f in found)
        failed = tried - int(np.isfinite(error[:, 0]).sum())
        name += f" (every {_PAPER_EVERY}th run)" if tried < runs else ""
        rows[name] = error
        line(name + (f" ({failed} runs refused)" if failed else ""), *numbers(rms(error) * DEGREES_MM, 3))
    head("", *NINE_RATIOS, title="Divided by the bound of each run")
    for name, error in rows.items():
        line(name, *numbers(rms(error / sigma)))
    head("", "mean NEES / 9", "median", "runs with outliers")
    for name in _LEVELS:
        each = np.array([f[name][1] for f in found])
        left_out = sum(f[name][2] for f in found)
        line(name, f"{np.nanmean(each):.3f}", f"{np.nanmedian(each):.3f}", left_out)


def main(asked: Study) -> None:
    """N = 12 and N = 40."""
    study(12, asked.runs)
    study(40, asked.runs)
