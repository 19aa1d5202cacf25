"""Robots drawn from their priors: are the standard deviations true, is the bound reached, and what does it cost?"""

from dataclasses import replace

import numpy as np

from mobilecal_cli.model.arrays import FloatArray
from tests.bench.imperfect import (
    AS_PRINTED,
    ROBOTS,
    USUAL,
    VERDICTS,
    Case,
    Run,
    bound_of,
    given,
    print_runs,
    run_of,
    true_robot,
    verdict_cells,
)
from tests.bench.simulated import RUNS_PER_ROUTE, as_described
from tests.bench.study import NINE_RATIOS, Study, head, line, numbers, results_of, rms
from tests.fits import maximum_likelihood
from tests.truth import errors

RUNS = 1000
CASES = {
    "paper's robot, N = 12": Case("paper", 12),
    "pan-tilt robot, N = 20": Case("pan-tilt", 20),
    "pan-tilt robot, N = 40": Case("pan-tilt", 40),
    "pan-tilt robot, moving, 40 images": Case("pan-tilt", 20, "moving"),
    "skid-steered robot with four wheel joints, N = 20": Case("skid-steer", 20),
    "odometry alone, N = 20": Case("odometry", 20),
    "stereo pair on the base, N = 20": Case("pair on the base", 20),
    "one camera on the base, N = 20": Case("camera on the base", 20),
    "one camera on a pan-tilt head, N = 12": Case("camera on pan-tilt", 12),
    "one camera on a pan-tilt head, N = 40": Case("camera on pan-tilt", 40),
    "one camera on a pan-tilt head, moving, 40 images": Case("camera on pan-tilt", 20, "moving"),
    "three cameras on a pan-tilt head, N = 20": Case("three cameras", 20),
}


def drawn(name: str) -> Case:
    """A case with every constant drawn from its prior, and every noise level around the estimator's guess."""
    return CASES[name].drawn(noise=USUAL, outside=AS_PRINTED, levels_drawn=True)


def one_run(name: str, seed: int) -> tuple[Run, Run, FloatArray]:
    """Noise levels given, and estimated; and the bound, (9,) standard deviations."""
    case = drawn(name)
    extraction, noise = case.extraction(seed), case.noise_of(seed)
    robot = true_robot(ROBOTS[case.robot], extraction, case.route(seed))
    bound = bound_of(case.robot, case.motion, case.stations, seed // RUNS_PER_ROUTE, noise)
    known = run_of(replace(extraction, rig=replace(extraction.rig, noise=given(noise))), robot)
    return known, run_of(extraction, robot), np.sqrt(np.diag(bound))


def price_of(name: str, seed: int) -> tuple[FloatArray, FloatArray]:
    """Errors on a robot that is exactly as described: with uncertain constants, and taking everything for exact."""
    extraction = CASES[name].extraction(seed)
    robot = true_robot(ROBOTS[CASES[name].robot], extraction, CASES[name].route(seed))
    fits = (maximum_likelihood(each) for each in (extraction, as_described(extraction)))
    uncertain, exact = (errors(fit.lin.state.parameters, robot) for fit in fits)
    return uncertain, exact


LEVELS_OF = ("levels given", "levels estimated")


def study(name: str, runs: int) -> None:
    """Print the table of one case."""
    results = results_of(one_run, name, seeds=range(runs))
    bound = np.array([r[2] for r in results])
    head("", *NINE_RATIOS, title=f"### {name}, {runs} runs, drawn from the priors")
    each = {label: [r[which] for r in results] for which, label in enumerate(LEVELS_OF)}
    for label, mine in each.items():
        line(f"rms error over the bound, {label}", *numbers(rms([r.error for r in mine] / bound)))
    for label, mine in each.items():
        ratio = np.array([r.error for r in mine]) / [r.std for r in mine]
        line(f"rms error over sigma, {label}", *numbers(rms(ratio)))
    head("", *VERDICTS, "runs with outliers", "with contradictions")
    for label, mine in each.items():
        spoilt, named = sum(r.outliers > 0 for r in mine), sum(bool(r.named) for r in mine)
        line(label, *verdict_cells(mine), spoilt, named)
        print_runs(mine, lambda r: r.false_pass or r.level.startswith("refused"))


def price(name: str, runs: int) -> None:
    """Print what uncertain constants cost in one case."""
    paid = results_of(price_of, name, seeds=range(min(runs, max(runs // 5, 20))))
    uncertain, exact = (np.array([p[k] for p in paid]) for k in (0, 1))
    head("", *NINE_RATIOS, title=f"The price, {len(paid)} runs of a robot exactly as described")
    line("rms error over that of the exact model", *numbers(rms(uncertain) / rms(exact)))


def main(asked: Study) -> None:
    """All cases; at most 300 runs of moving ones."""
    for name in asked.chosen(CASES):
        study(name, min(asked.runs, 300) if CASES[name].motion == "moving" else asked.runs)
        if not asked.parts:
            price(name, asked.runs)
