"""Monte Carlo: is the maximum-likelihood estimate as good as the bound, and are its standard deviations true?"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mobilecal_cli.errors import SolveError
from mobilecal_cli.likelihood.noise import Inliers
from mobilecal_cli.model import KnownNoise, Method
from mobilecal_cli.simulate.robot import paper_robot
from mobilecal_cli.solvers import solve
from mobilecal_cli.solvers.maximum_likelihood import maximum_likelihood
from tests.bench.simulated import (
    DEGREES_MM,
    DISTURBED,
    GIVEN,
    HEADER,
    RUNS_PER_ROUTE,
    as_described,
    both_sizes,
    bound_of,
    errors,
    map_runs,
    route_of,
    row,
)
from tests.extractions import ideal_extraction

_LEVELS = {"ml, noise levels given": GIVEN, "ml, noise levels estimated": KnownNoise()}
_PAPER_EVERY = 10  # Powell's method takes longer than all the others together
_NOTHING = (np.full(9, np.nan), np.nan, False)


def one_run(stations: int, seed: int) -> dict[str, tuple[np.ndarray, float, bool]]:
    """Error, NEES / 9 (NaN without covariance), and whether there were outliers, by method."""
    robot, number = paper_robot(), seed // RUNS_PER_ROUTE
    extraction = ideal_extraction(robot, route_of(stations, number), DISTURBED, seed)
    result = {}
    for name, known in _LEVELS.items():
        try:
            known_noise = replace(extraction, rig=replace(extraction.rig, noise=known))
            fit = maximum_likelihood(as_described(known_noise))
        except SolveError:
            result[name] = _NOTHING
            continue
        error = errors(fit.lin.state.parameters, robot)
        nees = float(error @ np.linalg.solve(fit.covariance[:9, :9], error)) / 9
        result[name] = (error, nees, not fit.inliers.same(Inliers.all_of(fit.data)))
    methods: tuple[Method, ...] = ("linear",) if seed % _PAPER_EVERY else ("linear", "paper")
    for method in methods:
        try:
            result[method] = (errors(solve(extraction, method).parameters, robot), np.nan, False)
        except SolveError:
            result[method] = _NOTHING
    return result


def study(stations: int, runs: int) -> None:
    """Print one table."""
    found = list(map_runs(one_run, [(stations, seed) for seed in range(runs)]))
    sigma = np.array([np.sqrt(np.diag(bound_of(stations, seed // RUNS_PER_ROUTE))) for seed in range(runs)])
    print(f"\n### N = {stations}, {runs} runs\n\nRoot-mean-square errors\n\n{HEADER}")
    print(row("Cramer-Rao bound", np.sqrt(np.mean(sigma**2, axis=0)) * DEGREES_MM, 3))
    rows = {}
    for name in found[0]:
        error = np.array([f.get(name, _NOTHING)[0] for f in found])
        tried = sum(name in f for f in found)
        failed = tried - int(np.isfinite(error[:, 0]).sum())
        name += f" (every {_PAPER_EVERY}th run)" if tried < runs else ""
        rows[name] = error
        rms = np.sqrt(np.nanmean(error**2, axis=0)) * DEGREES_MM
        print(row(name + (f" ({failed} runs refused)" if failed else ""), rms, 3))
    print("\nDivided by the bound of each run\n\n" + HEADER.replace(" (deg)", "").replace(" (mm)", ""))
    for name, error in rows.items():
        print(row(name, np.sqrt(np.nanmean((error / sigma) ** 2, axis=0))))
    print("\n| | mean NEES / 9 | median | runs with outliers |\n| --- | --- | --- | --- |")
    for name in _LEVELS:
        nees = np.array([f[name][1] for f in found])
        left_out = sum(f[name][2] for f in found)
        print(f"| {name} | {np.nanmean(nees):.3f} | {np.nanmedian(nees):.3f} | {left_out} |")


def main() -> None:
    """Both sizes."""
    both_sizes(study)


if __name__ == "__main__":
    main()
