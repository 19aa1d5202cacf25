"""Monte Carlo with a fifth of the stations corrupted and one wheel slip: outliers found, and the resulting errors."""

import time
from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from mobilecal_cli.errors import SolveError
from mobilecal_cli.likelihood.dataset import Inliers, dataset_of
from mobilecal_cli.simulate.robot import PAPER_ROBOT
from tests import extractions
from tests.bench.simulated import DISTURBED, RUNS_PER_ROUTE, as_described, information_of, route_of, spoiled
from tests.bench.study import NINE_RATIOS, Study, head, line, numbers, results_of, rms
from tests.fits import maximum_likelihood
from tests.truth import errors, nees

RUNS = 1000
_FALSE = float(chi2.isf(1e-6, 9)) / 9


def one_run(stations: int, seed: int) -> tuple[np.ndarray, np.ndarray, float, str, float]:
    """Error, sigma of the good data's bound, NEES / 9, what was found, seconds."""
    robot, route = PAPER_ROBOT, route_of(stations, seed // RUNS_PER_ROUTE)
    sound = extractions.extraction_of(robot, route, DISTURBED, seed)
    extraction, bad, slip = spoiled(sound, np.random.default_rng(seed))
    good = Inliers.all_of(dataset_of(sound))
    views, legs = good.views.copy(), good.legs.copy()
    views[bad], legs[slip] = False, False
    bound = np.linalg.inv(information_of(robot, route, replace(good, views=views, legs=legs)))[:9, :9]
    start = time.perf_counter()
    try:
        fit = maximum_likelihood(as_described(extraction))
    except SolveError:
        return np.full(9, np.nan), np.sqrt(np.diag(bound)), np.nan, "refused", time.perf_counter() - start
    seconds = time.perf_counter() - start
    parameters = fit.lin.state.parameters
    off = errors(parameters, robot), np.sqrt(np.diag(bound)), nees(parameters, fit.covariance, robot)
    found = "other" if fit.inliers.views[bad].any() else "bad stations, slip otherwise"
    if np.array_equal(fit.inliers.views, views) and np.array_equal(fit.inliers.legs, legs):
        found = "exactly these"
    return *off, found, seconds


def study(stations: int, runs: int) -> None:
    """Print one table."""
    error, sigma, each, found, seconds = zip(*results_of(one_run, stations, seeds=range(runs)), strict=True)
    head("", *NINE_RATIOS, title=f"### N = {stations}, {runs} runs, noise levels estimated")
    line("rms error divided by the bound of the good data", *numbers(rms(np.array(error) / sigma)))
    false = np.flatnonzero(np.array(each) > _FALSE)
    print("\nOutliers: " + ", ".join(f"{name} {found.count(name)}" for name in sorted(set(found))) + ".")
    print(
        f"NEES / 9: mean {np.nanmean(each):.2f}, median {np.nanmedian(each):.2f}, maximum {np.nanmax(each):.2f}; "
        f"false results (above {_FALSE:.1f}): {len(false)}, seeds {false.tolist()}. "
        f"{np.mean(seconds):.1f} s per run."
    )


def main(asked: Study) -> None:
    """N = 12 and N = 40."""
    study(12, asked.runs)
    study(40, asked.runs)
