"""Recordings that can be read and are wrong: none passes with a wrong result, unless it cannot be seen."""

from dataclasses import replace

import numpy as np
import pytest

from mobilecal_cli.simulate.robot import tick_robot
from mobilecal_cli.solvers import solve
from tests.extractions import STATION_NOISE, simulated
from tests.hostile.meaning import OUTCOMES, WRONG, outcome, recorded
from tests.judging import judge
from tests.truth import parameters_of


@pytest.mark.slow
@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_recording_is_refused_fails_or_does_no_harm(name):
    found = outcome(name)
    assert found.kind in OUTCOMES
    if not WRONG[name].unseen:
        assert found.kind != "PASS, wrong", f"{found.sigmas:.1f} sigma"


@pytest.mark.long
def test_a_board_that_sinks_does_no_harm():
    """The floor's height takes it up: the result is right, and so are its standard deviations."""
    solution = solve(WRONG["board 3 cm lower from the middle"].change(recorded()))
    off = solution.parameters.minus(parameters_of(tick_robot())) / solution.uncertainty.std
    assert np.abs(off).max() < 3
    assert solution.uncertainty.noise.floor_m == pytest.approx(0.015, rel=0.3)
    assert all(jump.part == "board" for jump in solution.jumps)


@pytest.mark.long
@pytest.mark.parametrize("seed", range(3))
def test_an_uneven_floor_is_no_step(seed):
    """Heights vary by 10 mm from station to station."""
    made = simulated("standard", replace(STATION_NOISE, floor_m=0.01), "tick", 20, seed)
    solution = solve(made)
    assert solution.jumps == ()
    (height,) = (check for check in judge(solution, made).checks if check.id == "noise.height")
    assert height.value == pytest.approx(10, rel=0.5)
    assert height.outcome == "pass"
