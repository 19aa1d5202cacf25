"""Any number of cameras from one: one alone, three of which some do not show the board, and each of a pair alone."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from mobilecal_cli.calibrate.steps import Data, Report, fitted
from mobilecal_cli.kinematics import unseen_height
from mobilecal_cli.likelihood.constants import table
from mobilecal_cli.likelihood.dataset import dataset_of
from mobilecal_cli.model.calibration import NINE
from mobilecal_cli.simulate.robot import ROBOTS
from mobilecal_cli.solvers.residuals import at_constants, residuals_of
from tests.bench.simulated import as_described
from tests.extractions import STATION_NOISE, Noise, simulated
from tests.robots import (
    CONFIGURATIONS,
    alone,
    chain_of,
    one_on_pan_tilt,
    three_on_pan_tilt,
    with_one_view,
)
from tests.truth import nees, parameters_of

NOISE = Noise(0.1, 0.003, 0.0, 1e-4, floor_rad=1e-3, floor_m=5e-4)
UNEVEN = replace(STATION_NOISE, pixel_px=0.1, joint_rad=1e-4)


def shown(robot):
    """Which of the nine parameters the motion of a robot shows: all but the height, where no joint tilts."""
    hidden = unseen_height(chain_of(robot))
    return np.array([name != "t_z" or hidden is None for name in NINE])


@cache
def recorded(robot, seed):
    """A recording of a robot, and its fit."""
    extraction = simulated("standard", NOISE, robot, 20, seed)
    return extraction, fitted(extraction)


#: One of each number of cameras, and of each head; the others are with the long tests.
_ALWAYS = {(1, "none"), (2, "pan-tilt"), (3, "pan")}


@pytest.mark.parametrize(
    ("cameras", "chain"),
    [pytest.param(*key, marks=[pytest.mark.long] * (key not in _ALWAYS)) for key in CONFIGURATIONS],
)
def test_exact_measurements_give_the_true_robot(cameras, chain):
    robot = CONFIGURATIONS[cameras, chain]
    extraction = simulated(robot=robot, stations=14, seed=1)
    assert len(extraction.rig.cameras.each) == cameras
    found = fitted(as_described(extraction))
    error = found.parameters.minus(parameters_of(robot))
    assert error[shown(robot)] == pytest.approx(0, abs=1e-6)  # priors pull by as much: stops give way


@pytest.mark.parametrize(
    ("cameras", "chain", "seed"),
    [
        pytest.param(*key, seed, marks=[pytest.mark.long] * (seed > 0 or key not in _ALWAYS))
        for key in CONFIGURATIONS
        for seed in (0, 1)
    ],
)
def test_stated_sigmas_are_true(cameras, chain, seed):
    robot = CONFIGURATIONS[cameras, chain]
    _, found = recorded(CONFIGURATIONS[cameras, chain], seed)
    assert nees(found.parameters, found.covariance, robot, shown(robot)) < 2.7  # chance 0.5 % of 8 or 9


@pytest.mark.long
@pytest.mark.parametrize("name", ["tick", "paper", "fixed_camera"])
def test_each_camera_of_a_pair_alone_agrees_with_both(name):
    robot = ROBOTS[name]
    both, pair = recorded(ROBOTS[name], 3)
    for k, T_c_camera in enumerate(both.rig.cameras.T_c_each):
        one, expected = fitted(alone(both, k)), pair.parameters.seen_from(T_c_camera)
        difference = one.parameters.minus(expected)[shown(robot)]
        std = np.sqrt(np.diag(one.covariance))[shown(robot)]
        assert np.abs(difference / std).max() < 3


@pytest.mark.long
def test_a_station_counts_with_the_cameras_that_show_the_board():
    extraction, found = recorded(three_on_pan_tilt(), 0)
    seen = dataset_of(extraction).seen.any(axis=2)
    assert seen[:, 0].all()
    assert seen[:, 1].any()
    assert 0 < seen[:, 2].sum() < len(seen)  # the third camera looks aside
    moved = [
        replace(o, views=tuple(replace(v, pixels=v.pixels + 1000 * ~v.seen[:, None]) for v in o.views))
        for o in extraction.observations
    ]
    again = fitted(replace(extraction, observations=tuple(moved)))
    # Unseen pixels mean nothing.
    np.testing.assert_allclose(found.parameters.vector, again.parameters.vector, atol=1e-12)


@pytest.mark.parametrize(("cameras", "chain"), [(1, "none"), (1, "pan-tilt"), (2, "pan-tilt")])
def test_a_board_that_one_camera_shows_is_where_the_estimated_camera_has_it(cameras, chain):
    """Its pose is that of the stated camera: projected by the estimated one, it was 17 px off, and the result FAIL."""
    robot = CONFIGURATIONS[cameras, chain]
    names = ("principal_camera_x", "principal_camera_y", "focal_camera")
    names = names if cameras == 1 else tuple(name.replace("camera", "right") for name in names)
    off = dict(zip(names, (0.02, -0.015, 0.02), strict=True))
    extraction = simulated(robot=robot, seed=1, constants=off)
    if cameras == 2:
        extraction = with_one_view(extraction, {2: 1, 3: 1, 8: 0})
    true = parameters_of(robot)
    residuals = residuals_of(at_constants(extraction, true, off), true)
    assert residuals.leg_reprojection_px.max() < 0.1
    assert residuals.leg_point_rms_m.max() < 1e-3


@pytest.mark.parametrize(
    ("name", "square_m"), [("tick", None), pytest.param("fixed_camera", 0.08, marks=pytest.mark.long)]
)
def test_a_pair_of_which_one_camera_sees_the_board(name, square_m):
    """Stations with one camera add to those with both; half of them with each camera alone."""
    robot = ROBOTS[name]
    both, whole = recorded(ROBOTS[name], 0)
    single = with_one_view(both, {i: (i // 2) % 2 for i in range(1, 20, 2)})
    pairs = tuple(o for o in single.observations if o.several)
    assert len(pairs) == 10
    stds = []
    for observations in (both.observations, single.observations, pairs):
        part = replace(both, observations=observations, board=replace(both.board, square_m=square_m))
        same = observations is both.observations and square_m == both.board.square_m
        found = whole if same else fitted(part)
        assert nees(found.parameters, found.covariance, robot, shown(robot)) < 2.7  # chance 0.5 % of 8 or 9
        stds.append(np.sqrt(np.diag(found.covariance))[shown(robot)])
    every, mixed, half = stds
    assert np.median(every / mixed) < 1
    assert np.median(mixed / half) < 0.9


@pytest.mark.long
def test_other_cameras_have_priors_of_a_drawing():
    """Cameras that stand 0.6 degrees and 4 mm from where they are drawn do not move the result beyond its sigmas."""
    robot = three_on_pan_tilt()
    rows = {row.name: row for row in table(robot.rig_cameras, chain_of(robot))}
    assert rows["turn_aside_x"].kind == "camera_rotation"
    assert rows["shift_beside_z"].kind == "camera_position"
    assert "baseline_scale" not in rows
    constants = {"turn_beside_x": 0.01, "shift_beside_z": 0.004, "turn_aside_y": -0.01, "focal_aside": 0.002}
    found = fitted(simulated("standard", UNEVEN, robot, 24, 2, constants=constants))
    assert nees(found.parameters, found.covariance, robot) < 2.7
    for name in ("turn_beside_x", "turn_aside_y", "shift_beside_z"):
        constant = found.solution.constants[name]
        assert abs(constant.value - constants[name]) < 4 * constant.std < 2 * abs(constants[name])


@pytest.mark.parametrize(
    ("name", "wrong", "words"),
    [
        pytest.param(
            "turn_aside_y",
            0.14,
            "Aside camera: rotation about the front camera's y differs by +7.9",
            marks=pytest.mark.long,
        ),
        ("shift_beside_z", 0.06, "Beside camera: position along the front camera's z differs by +60.1"),
    ],
)
def test_a_camera_that_is_not_where_it_is_drawn_is_named_and_does_no_harm(name, wrong, words):
    robot = three_on_pan_tilt()
    extraction = simulated("standard", UNEVEN, robot, 24, 2, constants={name: wrong})
    found = fitted(extraction)
    assert nees(found.parameters, found.covariance, robot) < 2.7
    assert not found.solution.outliers
    verdict = Report(Data(extraction), found).verdict
    assert verdict.level == "PASS"
    (check,) = [check for check in verdict.checks if check.id.startswith("contradiction.camera")]
    assert check.outcome == "warning"
    assert words in check.why
    assert "Correct the pose of this camera" in check.next_step


def test_the_report_of_one_camera_speaks_of_one():
    robot = one_on_pan_tilt()
    robot = replace(robot, infos=(replace(robot.infos[0], frame_id="optical"),))
    extraction = simulated("standard", NOISE, robot, 20, 0)
    report = Report(Data(extraction), fitted(extraction))
    assert report.verdict.level == "PASS"
    shown = report.html.replace("stereo_error", "").replace("stereo_reprojection_px", "")  # names in the JSON
    for word in ("stereo", "left camera", "right camera", "both cameras", "both images"):
        assert word not in str(report), word
        assert word not in shown, word


def test_gross_corners_are_named_by_their_camera():
    extraction = simulated("standard", NOISE, three_on_pan_tilt(), 20, 1)
    observations, first = list(extraction.observations), extraction.rig.cameras.names[0]
    view, *others = observations[4].views
    pixels = view.pixels.copy()
    pixels[7] += 40
    observations[4] = replace(observations[4], views=(replace(view, pixels=pixels), *others))
    found = fitted(replace(extraction, observations=tuple(observations)))
    (outlier,) = [one for one in found.solution.outliers if one.kind == "corners"]
    assert f"1 corners of the {first} image" in outlier.text
