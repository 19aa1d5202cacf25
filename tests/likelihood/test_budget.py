"""The size of the world: residuals that are lengths shrink with it, and say nothing of it."""

from dataclasses import replace

import pytest

from mobilecal_cli.solvers import Constraints, solve
from tests.bench import imperfect
from tests.truth import parameters_of

SIGMA = 0.01


def test_stations_do_not_pull_the_size_of_the_squares():
    """Nothing but its prior tells it: 60 stations made it smaller by half a sigma, 2,000 by all that was possible."""
    case = imperfect.Case(robot="camera on the base", stations=60, noise=imperfect.USUAL)
    extraction = case.extraction(2)
    rig = replace(extraction.rig, prior_sigmas={"all": 0.0, "square_scale": SIGMA})
    # A height that the robot description states wrongly pulls at it; one with a prior of the user is estimated.
    height = Constraints(
        priors={"t_z": (float(parameters_of(imperfect.ROBOTS[case.robot]).T_h_c[2, 3]), 0.1)}
    )
    square = solve(replace(extraction, rig=rig), constraints=height).constants["square_scale"]
    assert square.std == pytest.approx(SIGMA, rel=0.02)
    assert abs(square.value) < 0.1 * SIGMA
