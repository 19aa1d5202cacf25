"""The same likelihood solved by Ceres (pyceres) and gtsam: optimum, time and memory compared."""

from __future__ import annotations

import tempfile
import time
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np

from mobilecal_cli.export.extraction import extraction_from_npz, extraction_to_npz
from mobilecal_cli.likelihood.dataset import Dataset, Inliers, dataset_of
from mobilecal_cli.likelihood.posterior import Posterior
from mobilecal_cli.likelihood.state import State
from mobilecal_cli.simulate.robot import PAPER_ROBOT
from mobilecal_cli.solvers.initial import linear_estimate, start_state
from mobilecal_cli.solvers.optimize import optimize
from tests.bench.simulated import DISTURBED, TRUE_NOISE, route_of
from tests.bench.study import kernel_mb, measured, table
from tests.extractions import extraction_of
from tests.truth import no_priors

SIZES = (12, 200, 2000)
SOLVERS = ("mobilecal", "ceres", "gtsam")
HEAD = (
    "stations", "runs", "mobilecal (s)", "Ceres (s)", "gtsam (s)", "Ceres / mobilecal", "gtsam / mobilecal",
    "Ceres without callbacks / mobilecal", "gtsam without callbacks / mobilecal", "growth of memory (MB)",
    "difference of cost", "difference of the parameters",
)  # fmt: skip


@dataclass(frozen=True)
class Found:
    """Result of one run: time to build and solve, growth of memory, cost and the nine parameters."""

    seconds: float
    callbacks: float
    mb: float
    cost: float
    nine: list[float]


def start_of(path: Path) -> tuple[Dataset, State]:
    """The problem and the linear start, the same for all solvers."""
    extraction = extraction_from_npz(path)
    data = dataset_of(extraction)
    parameters = linear_estimate(data.pairs, extraction.rig.nominal.wheels).parameters
    return data, start_state(data, parameters, Inliers.all_of(data))


def likelihood_at(data: Dataset, state: State) -> Posterior:
    """The likelihood of all measurements, without priors."""
    priors = no_priors(data.layout, state.parameters)
    return Posterior.at(state, Inliers.all_of(data), TRUE_NOISE, priors)


def by_mobilecal(data: Dataset, start: State) -> tuple[State, float]:
    """The optimizer of mobilecal, which needs no callbacks."""
    return optimize(likelihood_at(data, start))[0].state, 0.0


def one(solver: str, path: str) -> dict[str, Any]:
    """In its own process: solve; fields of `Found`."""
    solve = by_mobilecal
    if solver == "ceres":
        from tests.bench.established_ceres import by_ceres as solve
    elif solver == "gtsam":
        from tests.bench.established_gtsam import by_gtsam as solve
    data, start = start_of(Path(path))
    Path("/proc/self/clear_refs").write_text("5")  # forget the peak that making the start had
    before = kernel_mb("VmRSS")
    began = time.perf_counter()
    end, callbacks = solve(data, start)
    seconds = time.perf_counter() - began
    memory = kernel_mb("VmHWM") - before
    cost = replace(likelihood_at(data, start), state=end).cost
    return asdict(Found(seconds, callbacks, memory, cost, end.parameters.vector.tolist()))


def row(stations: int, runs: int) -> list[str]:
    """One line of the table: the solvers take turns, and a ratio is of runs that follow one another."""
    with tempfile.TemporaryDirectory() as directory:
        path = Path(directory) / "extraction.npz"
        extraction = extraction_of(PAPER_ROBOT, route_of(stations, 0), DISTURBED, 0)
        path.write_bytes(extraction_to_npz(extraction))
        turns = [{solver: Found(**measured(one, solver, path)) for solver in SOLVERS} for _ in range(runs)]
    seconds = [f"{median(turn[solver].seconds for turn in turns):.3g}" for solver in SOLVERS]
    ratios = [
        f"{median(taken(turn[solver]) / turn['mobilecal'].seconds for turn in turns):.3g}"
        for taken in (lambda of: of.seconds, lambda of: of.seconds - of.callbacks)
        for solver in SOLVERS[1:]
    ]
    memory = ", ".join(f"{median(turn[solver].mb for turn in turns):.0f}" for solver in SOLVERS)
    ours = turns[0]["mobilecal"]
    theirs = [turns[0][solver] for solver in SOLVERS[1:]]
    cost = ", ".join(f"{abs(ours.cost / other.cost - 1):.1e}" for other in theirs)
    nine = ", ".join(f"{np.abs(np.array(ours.nine) / other.nine - 1).max():.1e}" for other in theirs)
    return [f"{stations:,}", f"{runs}", *seconds, *ratios, memory, cost, nine]


def solvers(repeats: int = 5) -> str:
    """The study as a Markdown table.

    Each time is the median of `repeats` runs, each in its own process. It covers building and solving the problem,
    from the same measurements and the same linear solution. Without callbacks, the time in cost functions and
    derivatives is subtracted for the other solvers, but not for mobilecal. The growth of memory is relative to the
    start; it is listed in the order of `SOLVERS`. Differences of cost and parameters are relative to mobilecal.
    """
    return table(HEAD, [row(stations, repeats) for stations in SIZES])
