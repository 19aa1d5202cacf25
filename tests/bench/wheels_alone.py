"""Legs of a real robot with one planar sensor, against the published calibration of the same data."""

import json
import time
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.measured import from_motions
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.observations import SensorMotion
from mobilecal_cli.solvers import solve
from tests.bench.study import Study, head, line

DATA = Path(__file__).resolve().parents[3] / "shared" / "data" / "wheels_alone"
#: Recording → nominal heading of the laser, deg. It is mounted turned for one of the recordings.
RUNS = {"l90": -90.0, "lstraight": 0.0}
NOMINAL = (0.0205, 0.0205, 0.089)  # radii and separation, m
SIGMA = np.array([0.002, 0.002, np.radians(0.2)])  # of the laser's motion, m and rad; its scale is estimated


def legs_of(run: str) -> list[SensorMotion]:
    """All legs; the file is a sequence of JSON objects."""
    text, decoder, at = (DATA / f"{run}.tuple").read_text().strip(), json.JSONDecoder(), 0
    legs = []
    while at < len(text):
        leg, end = decoder.raw_decode(text, at)
        turned = leg["phi_r"] * leg["T"], leg["phi_l"] * leg["T"]
        legs.append(SensorMotion(*turned, np.array(leg["sm"]), np.diag(SIGMA**2)))
        at = end + len(text[end:]) - len(text[end:].lstrip())
    return legs


def published(run: str) -> tuple[FloatArray, FloatArray]:
    """Radii (right, left) and separation, m, and their standard deviations."""
    result = json.loads((DATA / f"{run}_results.json").read_text())
    # The covariance's order is right and left radius, axle, pose of the laser: diameters are twice the radii.
    std = np.sqrt(np.diag(np.array(result["covariance"])))[:3]
    return np.array([result["r_diam"] / 2, result["l_diam"] / 2, result["axle"]]), std


def solved(run: str, what: str, legs: Sequence[SensorMotion]) -> None:
    """Print a row of the table: one solution."""
    T_v_c = se3.transform(se3.rotation_z(np.radians(RUNS[run])), np.zeros(3))
    start = time.perf_counter()
    solution = solve(from_motions(legs, NOMINAL, T_v_c))
    seconds = time.perf_counter() - start
    assert solution.uncertainty is not None
    value, std = solution.parameters.wheels.vector, np.sqrt(np.diag(solution.uncertainty.covariance))[6:]
    truth, sigma = published(run)
    line(
        run,
        f"{what}: {len(legs):,}",
        "{:.3f} ± {:.3f}, {:.3f} ± {:.3f}, {:.2f} ± {:.2f}".format(*np.stack((value, std), 1).ravel() * 1e3),
        ", ".join(f"{off:+.2f}" for off in (value - truth) / sigma),
        f"{len(solution.outliers)}",
        f"{seconds:.0f} s",
    )


def main(_: Study) -> None:
    """Print the table."""
    head("run", "legs", "radii and separation, mm", "off, published sigmas", "outliers", "time")
    for run in RUNS:
        legs = legs_of(run)
        parts = {"all": legs, "first": legs[:3000], "even": legs[::2], "odd": legs[1::2]}
        parts["a tenth"] = legs[::10]
        for what, part in parts.items():
            solved(run, what, part)
