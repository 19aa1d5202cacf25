"""One, two and three cameras on the base, on a head that pans and on one that pans and tilts: are the sigmas true?

`python -m tests.bench.configurations [RUNS]`: robots with every constant drawn from its prior, 20 stops. NEES / n is over
the n parameters that the motion shows: all nine, or all but the camera's height where no joint tilts the camera.
"""

from __future__ import annotations

import sys

import numpy as np

from mobilecal_cli.calibrate.steps import Data, Report, fitted
from mobilecal_cli.errors import MobilecalError
from mobilecal_cli.kinematics import unseen_height
from mobilecal_cli.model import NINE, Parameters
from mobilecal_cli.simulate.imperfect import draw
from mobilecal_cli.simulate.route import plan_route
from tests.bench.imperfect import USUAL
from tests.bench.simulated import conditions, map_runs
from tests.extractions import Imperfection, imperfect_extraction
from tests.robots import CONFIGURATIONS

_ROUTES = 10  # that the runs share
_FALSE = 5.0  # sigmas: a PASS with a larger error of any parameter is wrong


def one_run(cameras: int, chain: str, seed: int) -> tuple[float, float, str]:
    """NEES / n, the largest error in sigmas, and the verdict."""
    robot = CONFIGURATIONS[cameras, chain]()
    what = Imperfection(draw(robot, np.random.default_rng([seed, 7])), USUAL)
    extraction = imperfect_extraction(robot, plan_route(robot, stations=20, seed=seed % _ROUTES), what, seed)
    try:
        found = fitted(extraction)
    except MobilecalError as error:
        return np.nan, np.nan, type(error).__name__
    hidden = unseen_height(robot.chain) is not None
    kept = [k for k, name in enumerate(NINE) if not (hidden and name == "t_z")]
    error = found.parameters.minus(Parameters(robot.T_h_c, robot.wheels))[kept]
    covariance = found.solution.uncertainty.covariance[np.ix_(kept, kept)]
    nees = float(error @ np.linalg.solve(covariance, error)) / len(kept)
    worst = float(np.abs(error / np.sqrt(np.diag(covariance))).max())
    return nees, worst, Report(Data(extraction), found).verdict.level


def main() -> None:
    """All configurations; runs as an argument, 100 by default."""
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    print(conditions())
    print(f"\n{runs} runs each\n")
    print("| cameras | chain | NEES / n | PASS | FAIL | NOT ENOUGH | refused | false PASS |")
    print("| --- " * 8 + "|")
    for cameras, chain in CONFIGURATIONS:
        found = list(map_runs(one_run, [(cameras, chain, seed) for seed in range(runs)], 2))
        nees, worst, levels = (list(column) for column in zip(*found, strict=True))
        counts = [levels.count(level) for level in ("PASS", "FAIL", "NOT ENOUGH")]
        false = sum(w > _FALSE for w, level in zip(worst, levels, strict=True) if level == "PASS")
        cells = [cameras, chain, f"{np.nanmean(nees):.2f}", *counts, runs - sum(counts), false]
        print("| " + " | ".join(map(str, cells)) + " |", flush=True)


if __name__ == "__main__":
    main()
