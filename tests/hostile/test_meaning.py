"""Recordings that can be read and are wrong: none passes with a wrong result, unless it cannot be seen."""

import re
from dataclasses import replace

import pytest

from mobilecal_cli.report.verdict import judge
from mobilecal_cli.simulate.robot import tick_robot
from mobilecal_cli.simulate.route import plan_route
from mobilecal_cli.solvers import solve
from tests.extractions import STATION_NOISE, Imperfection, imperfect_extraction
from tests.hostile.meaning import OUTCOMES, WRONG, outcome, recorded


@pytest.mark.slow
@pytest.mark.parametrize("name", WRONG)
def test_a_wrong_recording_is_refused_fails_or_does_no_harm(name):
    found = outcome(name)
    assert found.kind in OUTCOMES
    if not WRONG[name].unseen:
        assert found.kind != "PASS, wrong", f"{found.sigmas:.1f} sigma"


@pytest.mark.parametrize(
    ("name", "kind"),
    [
        pytest.param("wheels in meters", "refused, right cause", marks=pytest.mark.long),
        ("wheels 0.3 s late", "PASS, right"),
    ],
)
def test_outcomes(name, kind):
    assert outcome(name).kind == kind


def test_a_board_that_sinks_is_named():
    made = WRONG["board 3 cm lower from the middle"].change(recorded())
    solution = solve(made)
    (jump,) = solution.jumps
    assert (jump.part, jump.station) == ("board", 10)
    assert jump.move_m == pytest.approx(0.03, abs=3e-3)
    verdict = judge(solution, made)
    (said,) = (check for check in verdict.checks if check.id == "jump")
    assert re.match(r"At station 10 \(\d+\.\d s\), the board moved by 3\d mm", said.why)
    assert verdict.level == "FAIL"


@pytest.mark.parametrize(
    "seed", [pytest.param(0, marks=pytest.mark.long), pytest.param(1, marks=pytest.mark.long), 2]
)
def test_an_uneven_floor_is_no_step(seed):
    """Heights vary by 10 mm from station to station."""
    uneven, robot = Imperfection({}, replace(STATION_NOISE, floor_m=0.01)), tick_robot()
    made = imperfect_extraction(robot, plan_route(robot, stations=20, seed=seed), uneven, seed)
    solution = solve(made)
    assert solution.jumps == ()
    (height,) = (check for check in judge(solution, made).checks if check.id == "noise.height")
    assert height.value == pytest.approx(10, rel=0.5)
    assert height.outcome == "pass"
