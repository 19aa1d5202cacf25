"""The iterative linear method on exact data: every parameter to 1e-9, from every start."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from mobilecal_cli.errors import SolveError
from mobilecal_cli.kinematics import Increments
from mobilecal_cli.likelihood.dataset import dataset_of
from mobilecal_cli.model.rig import WheelGeometry
from mobilecal_cli.simulate.robot import PAPER_ROBOT
from mobilecal_cli.solvers import initial
from mobilecal_cli.solvers.initial import grid_of_starts, linear_estimate
from mobilecal_cli.solvers.linear import Rounds
from tests.extractions import Noise, joined, simulated
from tests.truth import errors

ROBOT = PAPER_ROBOT
WHEELS = ROBOT.wheels
EXACT = 1e-9


def drive(seed=0, motion="standard", stations=12, pixel_px=0.0):
    """A recording of the paper's robot without nominal values, exact but for the noise of corners."""
    return simulated(motion, Noise(pixel_px), ROBOT, stations, seed, nominal=False)


@cache
def pairs_of(seed=0, motion="standard", pixel_px=0.0):
    return dataset_of(drive(seed, motion, pixel_px=pixel_px)).pairs


def largest_error(estimate):
    return np.abs(errors(estimate.parameters, ROBOT)).max()


def test_exact_data_without_nominal_wheels():
    estimate = linear_estimate(pairs_of(0))
    assert largest_error(estimate) < EXACT
    assert estimate.point_rms_m < 1e-12
    assert estimate.rounds_to_tolerance <= 3
    assert estimate.start_from == "grid"


@pytest.mark.parametrize("factor", [0.9, 1.1])
def test_nominal_wheels_ten_percent_off(factor):
    nominal = WheelGeometry.of(WHEELS.vector * [factor, 1, 1 / factor])
    for motion in ("standard", "large_turns"):
        estimate = linear_estimate(pairs_of(1, motion), nominal)
        assert largest_error(estimate) < EXACT
        assert estimate.start_from == "nominal"


@pytest.mark.parametrize("start", [(0.0, 0.0), (5.0, -5.0), (-0.44, 0.45), (0.01, -0.01), (0.45, 0.45)])
def test_from_any_start(start, monkeypatch):
    starts = [np.array(start), *grid_of_starts()]
    monkeypatch.setattr("mobilecal_cli.solvers.initial.grid_of_starts", lambda: starts)
    estimate = linear_estimate(pairs_of(2, "large_turns"))
    assert largest_error(estimate) < EXACT


@pytest.mark.parametrize("seed", [0, 2])
def test_legs_that_turn_by_more_than_270_degrees(seed):
    pairs = pairs_of(seed, "large_turns")
    right, left = pairs.steps.totals_rad.T
    turns = (WHEELS.radius_right_m * right - WHEELS.radius_left_m * left) / WHEELS.separation_m
    assert np.degrees(np.abs(turns)).max() > 270
    estimate = linear_estimate(pairs)
    assert largest_error(estimate) < EXACT
    assert estimate.rival_point_rms_m > 0.1  # the wrongly unwrapped answers are far worse, and told so


# A start eleven times too large, (5, -5), unwraps wrongly on its own: it needs the grid, as the test above shows.
@pytest.mark.parametrize("start", [(0.0, 0.0), (0.01, -0.01), (-0.44, 0.45), (1.0, -1.0)])
def test_the_bare_iteration_needs_no_grid_when_legs_turn_little(start, monkeypatch):
    monkeypatch.setattr("mobilecal_cli.solvers.initial.grid_of_starts", lambda: [np.array(start)])
    monkeypatch.setattr("mobilecal_cli.solvers.initial._scouted", lambda pairs, starts: starts)
    estimate = linear_estimate(pairs_of(3))
    assert largest_error(estimate) < EXACT


def test_several_logs_join_no_leg_between_them():
    both = dataset_of(joined(drive(0, stations=7), drive(5, stations=6))).pairs
    assert len(both.legs) == 11
    assert largest_error(linear_estimate(both)) < EXACT


def changed_wheels(pairs, right_sign=1, left_sign=1, swapped=False):
    right, left = right_sign * pairs.steps.right_rad, left_sign * pairs.steps.left_rad
    if swapped:
        right, left = left, right
    return replace(pairs, steps=Increments(right, left, pairs.steps.leg, pairs.steps.legs))


@pytest.mark.parametrize(
    ("change", "signs"),
    [
        ({}, (1, 1, 1)),
        ({"right_sign": -1}, (-1, 1, 1)),
        ({"left_sign": -1}, (1, -1, 1)),
        ({"right_sign": -1, "left_sign": -1}, (-1, -1, 1)),
        ({"swapped": True}, (1, 1, -1)),
    ],
)
def test_signs_of_wrong_encoders(change, signs):
    pairs = changed_wheels(pairs_of(0, pixel_px=0.3), **change)
    wheels = linear_estimate(pairs, WHEELS).parameters.wheels
    assert np.sign(wheels.vector).tolist() == list(signs)


def test_history_tells_the_paper_rounds_and_the_fixed_point():
    estimate = linear_estimate(pairs_of(0, pixel_px=0.3))
    assert estimate.history[-1] is estimate.parameters
    assert 1 < estimate.rounds_to_tolerance < estimate.rounds
    before = estimate.history[estimate.rounds_to_tolerance - 2].wheels
    after = estimate.history[estimate.rounds_to_tolerance - 1].wheels
    assert abs(before.separation_m / after.separation_m - 1) < 1e-3
    assert estimate.rival_point_rms_m > 20 * estimate.point_rms_m


@pytest.mark.parametrize("nominal", [None, WHEELS])
def test_wheels_with_identical_readings_have_no_answer(nominal):
    """The iteration ended at wheels without size, and divided by them with a warning of NumPy."""
    pairs = pairs_of(0)
    same = replace(pairs, steps=replace(pairs.steps, left_rad=pairs.steps.right_rad))
    with pytest.raises(SolveError, match=r"found no answer on 11 legs"):
        linear_estimate(same, nominal)
    with pytest.raises(SolveError, match="breaks down"):
        Rounds(same).after(np.array([0.4, -0.4]), 12)


def test_impossible_wheels_are_no_rivals_of_possible_ones(monkeypatch):
    """Mirrored, with negative radii, a solution may be nearly as good."""
    pairs = pairs_of(3)
    known = replace(linear_estimate(pairs), point_rms_m=0.02)
    wheels = WheelGeometry(*(known.parameters.wheels.vector * [-1.0, -1.0, 1.0]))
    mirrored = replace(known, parameters=replace(known.parameters, wheels=wheels), point_rms_m=0.022)
    monkeypatch.setattr(initial, "_answers", lambda *_: [known, mirrored])
    estimate = linear_estimate(pairs)
    assert estimate.parameters is known.parameters
    assert estimate.rival_point_rms_m == np.inf
