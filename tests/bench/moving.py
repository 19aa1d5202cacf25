"""Logs that never rest, with a camera clock 25 ms late: is the offset found, and the nine numbers with it?"""

from __future__ import annotations

import sys

import numpy as np

from mobilecal_cli.simulate.robot import paper_robot
from mobilecal_cli.solvers import solve
from tests.bench.simulated import DISTURBED, HEADER, as_described, conditions, errors, map_runs, route_of, row
from tests.extractions import ideal_extraction

_LATE_S = 0.025
_CLOCKS = ("time_joints", "time_wheels")


def one_run(seed: int) -> tuple[np.ndarray, np.ndarray, float, np.ndarray, np.ndarray, int]:
    """Error, sigma, NEES / 9 of the nine; error and sigma of the two offsets; how much was left out."""
    robot = paper_robot()
    extraction = ideal_extraction(robot, route_of(12, seed, "moving"), DISTURBED, seed, camera_late_s=_LATE_S)
    solution = solve(as_described(extraction))
    found = solution.uncertainty
    assert found is not None
    error = errors(solution.parameters, robot)
    nees = float(error @ np.linalg.solve(found.covariance, error)) / 9
    offsets = np.array([solution.constants[name] for name in _CLOCKS])
    return error, found.std, nees, offsets[:, 0] + _LATE_S, offsets[:, 1], len(solution.outliers)


def main() -> None:
    """Runs, each with a route of its own, as an argument; 100 by default."""
    runs = int(sys.argv[1]) if len(sys.argv) > 1 else 100
    print(conditions())
    results = list(map_runs(one_run, [(seed,) for seed in range(runs)]))
    error, std = np.array([r[0] for r in results]), np.array([r[1] for r in results])
    offset, offset_std = np.array([r[3] for r in results]), np.array([r[4] for r in results])
    header = HEADER.replace(" (deg)", "").replace(" (mm)", "")
    print(
        f"\nRecordings without stops, 40 images, {runs} runs, noise levels estimated, cameras 25 ms late.\n\n{header}"
    )
    print(row("rms error divided by the stated sigma", np.sqrt(np.mean((error / std) ** 2, axis=0))))
    print(
        "\n| offset | rms error (ms) | mean stated sigma (ms) | rms error over sigma |\n| --- | --- | --- | --- |"
    )
    for k, name in enumerate(_CLOCKS):
        ratio = np.sqrt(np.mean((offset[:, k] / offset_std[:, k]) ** 2))
        rms, mean = np.sqrt(np.mean(offset[:, k] ** 2)), np.mean(offset_std[:, k])
        print(f"| {name} | {1e3 * rms:.2f} | {1e3 * mean:.2f} | {ratio:.2f} |")
    left_out = sum(r[5] > 0 for r in results)
    print(f"\nMean NEES / 9: {np.mean([r[2] for r in results]):.2f}. Runs with outliers: {left_out}.")


if __name__ == "__main__":
    main()
