"""Logs that never rest, with a camera clock 25 ms late: is the offset found, and the nine numbers with it?"""

from dataclasses import replace

import numpy as np

from mobilecal_cli.simulate.robot import PAPER_ROBOT
from mobilecal_cli.solvers import solve
from tests.actual import PRIORS
from tests.bench.simulated import DISTURBED, as_described, route_of
from tests.bench.study import NINE_RATIOS, Study, head, line, numbers, results_of, rms
from tests.extractions import extraction_of
from tests.truth import errors, nees

RUNS = 100
_LATE_S = 0.025
_CLOCKS = ("time_joints", "time_wheels")


def one_run(seed: int) -> tuple[np.ndarray, np.ndarray, float, np.ndarray, np.ndarray, int]:
    """Error, sigma, NEES / 9 of the nine; error and sigma of the two offsets; how much was left out."""
    robot = PAPER_ROBOT
    extraction = extraction_of(robot, route_of(12, seed, "moving"), DISTURBED, seed, camera_late_s=_LATE_S)
    described = as_described(extraction)
    sigmas = {"all": 0.0, **dict.fromkeys(_CLOCKS, PRIORS["clock"])}
    solution = solve(replace(described, rig=replace(described.rig, prior_sigmas=sigmas)))
    found = solution.uncertainty
    assert found is not None
    off = nees(solution.parameters, found.covariance, robot)
    offsets = np.array([[solution.constants[name].value, solution.constants[name].std] for name in _CLOCKS])
    error = errors(solution.parameters, robot)
    return error, found.std, off, offsets[:, 0] + _LATE_S, offsets[:, 1], len(solution.outliers)


def main(asked: Study) -> None:
    """Each run has a route of its own."""
    runs = asked.runs
    error, std, each, offset, offset_std, left_out = zip(*results_of(one_run, seeds=range(runs)), strict=True)
    title = f"Recordings without stops, 40 images, {runs} runs, noise levels estimated, cameras 25 ms late."
    head("", *NINE_RATIOS, title=title)
    line("rms error divided by the stated sigma", *numbers(rms(np.array(error) / std)))
    head("offset", "rms error (ms)", "mean stated sigma (ms)", "rms error over sigma")
    off, sigma = np.array(offset), np.array(offset_std)
    columns = 1e3 * rms(off), 1e3 * sigma.mean(axis=0), rms(off / sigma)
    for name, *values in zip(_CLOCKS, *columns, strict=True):
        line(name, *numbers(values))
    print(f"\nMean NEES / 9: {np.mean(each):.2f}. Runs with outliers: {sum(n > 0 for n in left_out)}.")
