"""Monte Carlo: is the maximum-likelihood estimate as good as the bound, and are its standard deviations true?"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from mobilecal_cli.errors import SolveError
from mobilecal_cli.model import KnownNoise
from mobilecal_cli.simulate.ideal import ideal_extraction
from mobilecal_cli.simulate.robot import paper_robot
from mobilecal_cli.solvers import solve
from tests.bench.simulated import (
    DEGREES_MM,
    DISTURBED,
    GIVEN,
    HEADER,
    RUNS_PER_ROUTE,
    both_sizes,
    bound_of,
    errors,
    map_runs,
    route_of,
    row,
)

_METHODS = {
    "ml, noise levels given": ("ml", GIVEN),
    "ml, noise levels estimated": ("ml", KnownNoise()),
    "linear": ("linear", KnownNoise()),
    "paper": ("paper", KnownNoise()),
}


def one_run(stations: int, seed: int) -> dict[str, tuple[np.ndarray, float, int]]:
    """Errors over the bound's sigmas, NEES / 9 (NaN without covariance), and how much was left out, by method."""
    robot, number = paper_robot(), seed // RUNS_PER_ROUTE
    extraction = ideal_extraction(robot, route_of(stations, number), DISTURBED, seed)
    result = {}
    for name, (method, known) in _METHODS.items():
        try:
            told = replace(extraction, rig=replace(extraction.rig, noise=known))
            solution = solve(told, method)  # type: ignore[arg-type]
        except SolveError:
            result[name] = (np.full(9, np.nan), np.nan, -1)
            continue
        error, nees, out = errors(solution.parameters, robot), np.nan, 0
        if solution.uncertainty is not None:
            nees = float(error @ np.linalg.solve(solution.uncertainty.covariance, error)) / 9
            out = len(solution.outliers)
        result[name] = (error, nees, out)
    return result


def study(stations: int, runs: int) -> None:
    """Print one table."""
    found = list(map_runs(one_run, [(stations, seed) for seed in range(runs)]))
    sigma = np.array([np.sqrt(np.diag(bound_of(stations, seed // RUNS_PER_ROUTE))) for seed in range(runs)])
    print(f"\n### N = {stations}, {runs} runs\n\nRoot-mean-square errors\n\n{HEADER}")
    print(row("Cramer-Rao bound", np.sqrt(np.mean(sigma**2, axis=0)) * DEGREES_MM, 3))
    rows = {}
    for name in _METHODS:
        error = np.array([f[name][0] for f in found])
        failed = int(np.isnan(error[:, 0]).sum())
        rows[name] = (error, failed)
        rms = np.sqrt(np.nanmean(error**2, axis=0)) * DEGREES_MM
        print(row(name + (f" ({failed} runs refused)" if failed else ""), rms, 3))
    print("\nOver the bound of each run\n\n" + HEADER.replace(" (deg)", "").replace(" (mm)", ""))
    for name, (error, _) in rows.items():
        print(row(name, np.sqrt(np.nanmean((error / sigma) ** 2, axis=0))))
    print("\n| | mean NEES / 9 | median | runs in which something was left out |\n| --- | --- | --- | --- |")
    for name in list(_METHODS)[:2]:
        nees = np.array([f[name][1] for f in found])
        left_out = sum(f[name][2] > 0 for f in found)
        print(f"| {name} | {np.nanmean(nees):.3f} | {np.nanmedian(nees):.3f} | {left_out} |")


def main() -> None:
    """Both sizes."""
    both_sizes(study)


if __name__ == "__main__":
    main()
