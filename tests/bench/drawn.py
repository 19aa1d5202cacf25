"""Robots drawn from their priors: are the standard deviations true, is the bound reached, and what does it cost?"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np

from mobilecal_cli.model import FloatArray
from mobilecal_cli.solvers.maximum_likelihood import maximum_likelihood
from tests.bench.imperfect import (
    ROBOTS,
    USUAL,
    Case,
    Run,
    all_kinds,
    bound_of,
    given,
    run_of,
    true_robot,
    with_noise,
)
from tests.bench.simulated import HEADER, RUNS_PER_ROUTE, as_described, conditions, errors, map_runs, row

CASES = {
    "paper's robot, N = 12": Case("paper", 12),
    "pan-tilt robot, N = 20": Case("pan-tilt", 20),
    "pan-tilt robot, N = 40": Case("pan-tilt", 40),
    "pan-tilt robot, moving, 40 images": Case("pan-tilt", 20, "moving"),
    "skid-steered robot with four wheel joints, N = 20": Case("skid-steer", 20),
    "odometry alone, N = 20": Case("odometry", 20),
}
_SHORT = HEADER.replace(" (deg)", "").replace(" (mm)", "")


def drawn(name: str) -> Case:
    """A case with every constant drawn from its prior and every noise at its level."""
    case = CASES[name]
    return replace(case, kinds=all_kinds(case.motion == "moving"), noise=USUAL, lengths_drawn=True)


def one_run(name: str, seed: int) -> tuple[Run, Run]:
    """Noise levels given, and estimated."""
    case = drawn(name)
    extraction = case.extraction(seed)
    robot = true_robot(ROBOTS[case.robot](), extraction, case.route(seed))
    return run_of(with_noise(extraction, given(USUAL)), robot), run_of(extraction, robot)


def price_of(name: str, seed: int) -> tuple[FloatArray, FloatArray]:
    """Errors on a robot that is exactly as described: with uncertain constants, and taking everything for exact."""
    extraction = CASES[name].extraction(seed)
    robot = true_robot(ROBOTS[CASES[name].robot](), extraction, CASES[name].route(seed))
    fits = (maximum_likelihood(each) for each in (extraction, as_described(extraction)))
    uncertain, exact = (errors(fit.lin.state.parameters, robot) for fit in fits)
    return uncertain, exact


def study(name: str, runs: int) -> None:
    """Print the table of one case."""
    case = CASES[name]
    tasks = [(name, seed) for seed in range(runs)]
    results = list(map_runs(one_run, tasks))
    numbers = [seed // RUNS_PER_ROUTE for seed in range(runs)]
    bound = np.array(
        [np.sqrt(np.diag(bound_of(case.robot, case.motion, case.stations, number))) for number in numbers]
    )
    print(f"\n### {name}, {runs} runs, drawn from the priors\n\n{_SHORT}")
    for which, label in enumerate(("levels given", "levels estimated")):
        error = np.array([r[which].error for r in results])
        print(row(f"rms error over the bound, {label}", np.sqrt(np.nanmean((error / bound) ** 2, axis=0))))
    for which, label in enumerate(("levels given", "levels estimated")):
        error, std = (np.array([getattr(r[which], n) for r in results]) for n in ("error", "std"))
        print(row(f"rms error over sigma, {label}", np.sqrt(np.nanmean((error / std) ** 2, axis=0))))
    print(
        "\n| | mean NEES / 9 | median | PASS | FAIL | NOT ENOUGH | refused | false PASS | runs with outliers | "
        "with contradictions |\n" + "| --- " * 10 + "|"
    )
    for which, label in enumerate(("levels given", "levels estimated")):
        mine = [r[which] for r in results]
        nees, levels = np.array([r.nees[3] for r in mine]), [r.level for r in mine]
        counts = [sum(level == wanted for level in levels) for wanted in ("PASS", "FAIL", "NOT ENOUGH")]
        refused = sum(level.startswith("refused") for level in levels)
        false, spoilt = sum(r.false_pass for r in mine), sum(r.outliers > 0 for r in mine)
        cells = [f"{np.nanmean(nees):.3f}", f"{np.nanmedian(nees):.2f}", *counts, refused, false, spoilt]
        print(f"| {label} | " + " | ".join(map(str, [*cells, sum(bool(r.named) for r in mine)])) + " |")
        for seed, r in enumerate(mine):
            if r.false_pass or r.level.startswith("refused"):
                print(f"  seed {seed}: {r.level}, NEES / 9 {r.nees[3]:.1f}, {r.named}")
    paid = list(map_runs(price_of, tasks[: max(runs // 5, 20)]))
    uncertain, exact = (np.array([p[k] for p in paid]) for k in (0, 1))
    ratio = np.sqrt(np.mean(uncertain**2, axis=0) / np.mean(exact**2, axis=0))
    print(f"\nThe price, {len(paid)} runs of a robot exactly as described\n\n{_SHORT}")
    print(row("rms error over that of the exact model", ratio))
    sys.stdout.flush()


def main() -> None:
    """All cases; runs as an argument (1,000 by default, moving ones 300 at most), then names of cases."""
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 1000
    print(conditions())
    for name in CASES:
        if len(sys.argv) < 3 or any(part in name for part in sys.argv[2:]):
            study(name, min(runs, 300) if CASES[name].motion == "moving" else runs)


if __name__ == "__main__":
    main()
