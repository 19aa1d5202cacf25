"""Recordings that can be read and are wrong: none passes with a wrong result, unless it cannot be seen."""

import re
from dataclasses import replace

import numpy as np
import pytest

from mobilecal_cli.simulate.robot import TICK_ROBOT
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


#: Recording → outcome, or what of it is sure (refused and FAIL both name the cause), and what is said; each had a false
#: cause in some version.
SAID = {
    "counters without a direction": ("refused, right cause", "readings of both wheels never decrease"),
    "joints 2 s late": ("refused, right cause", "the joint readings are about 2.0 s late"),
    "right images of the next station": ("FAIL, right cause", "do not fit camera_info and the board, or one another"),
    "images of half the resolution": ("refused, right cause", "focal lengths of about 0.6"),
    "both images frozen from the middle": (
        "FAIL, right cause", "from about 42.6 s on, all stations show the board at the same place",
    ),
    "pan 3 degrees off from the middle": ("FAIL, right cause", r"\(40.4 s\), the zero position of pan_joint changed by 2.9"),
    "right images shifted by 15 px from the middle": (
        "FAIL, right cause", r"\(40.4 s\), the right camera against the left camera moved by 1.6 degrees",
    ),
    "right wheel 2 % larger from the middle": ("FAIL, right cause", "the size of the right wheel changed by 1.[67] mm"),
    "right wheel 5 % larger from the middle": ("FAIL, right cause", "the size of the right wheel changed by 3.9 mm"),
    "a second recording of another robot": ("FAIL, right cause", "Between recording 2 and the other, the sizes of both wheels"),
    "right wheel reversed from the middle": (
        "right cause", "from about 42.6 s on, the right wheel's encoder has the wrong sign",
    ),
    "head mounted 10 cm further to the front": ("FAIL, right cause", "position of the axis along x differs by -100"),
    "pan axis turned by 10 degrees": ("FAIL, right cause", "direction of the axis, about x differs by -10"),
    "square in inches": ("FAIL, right cause", "squares and the stereo baseline disagree"),
    "counters of 32 bits wrap in the middle": ("PASS, right", ""),
    "focal lengths 1 % off": ("PASS, right", ""),
}  # fmt: skip


@pytest.mark.long
@pytest.mark.parametrize("name", SAID)
def test_the_cause_of_a_wrong_recording_is_named(name):
    found, (kind, said) = outcome(name), SAID[name]
    assert kind in found.kind
    assert re.search(said, found.message)


@pytest.mark.long
def test_a_board_that_turns_is_the_only_change():
    """What is left of it to first order looked like another zero position of the pan joint, by 0.4 degrees: FAIL."""
    solution = solve(WRONG["board turned by 5 degrees from the middle"].change(recorded()))
    (jump,) = solution.jumps
    assert (jump.part, jump.station, jump.turn_rad) == ("board", 10, pytest.approx(0.087, abs=0.002))
    off = solution.parameters.minus(parameters_of(TICK_ROBOT)) / solution.uncertainty.std
    assert np.abs(off).max() < 3


@pytest.mark.long
def test_a_board_that_sinks_does_no_harm():
    """The floor's height takes it up: the result is right, and so are its standard deviations."""
    solution = solve(WRONG["board 3 cm lower from the middle"].change(recorded()))
    off = solution.parameters.minus(parameters_of(TICK_ROBOT)) / solution.uncertainty.std
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
