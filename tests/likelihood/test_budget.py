"""The size of the world: residuals that are lengths shrink with it, and say nothing of it."""

from dataclasses import replace

import pytest

from mobilecal_cli.solvers import solve
from tests.bench import imperfect

SIGMA = 0.01


def test_stations_do_not_pull_the_size_of_the_squares():
    """Nothing but its prior tells it: 60 stations made it smaller by half a sigma, 2,000 by all that was possible."""
    level = replace(imperfect.USUAL, floor_rad=1e-5)  # the lever of a base that leans tells something of it
    case = imperfect.Case(robot="camera on the base", stations=60, noise=level)
    extraction = case.extraction(2)
    sigmas = {"all": 0.0, "square_scale": SIGMA}
    square = solve(replace(extraction, rig=replace(extraction.rig, prior_sigmas=sigmas))).constants[
        "square_scale"
    ]
    assert square.std == pytest.approx(SIGMA, rel=0.02)
    assert abs(square.value) < 0.1 * SIGMA
