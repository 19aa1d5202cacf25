"""The common scale of a description's priors, and the search for noise levels."""

import math
from dataclasses import replace

import numpy as np
import pytest

from mobilecal_cli.calibrate.steps import Data, Report, fitted
from mobilecal_cli.solvers import solve
from mobilecal_cli.solvers.noise import _LOG_FACTORS, expected_factors, widths
from tests.bench import imperfect
from tests.bench.drawn import drawn
from tests.fits import maximum_likelihood


def factors(off, information):
    """Expected factors of kinds of one constant that the measurements put at `off`, in units of its prior."""
    off, information = np.array(off)[:, None], np.array(information)[:, None]
    variance = np.exp(2 * _LOG_FACTORS) + 1 / information
    return expected_factors(np.log(variance) + off**2 / variance)


def test_priors_of_what_nothing_shows_stay_as_stated():
    assert np.all(factors([0.0] * 5, [1e-9] * 5) < 1.05)


def test_constants_as_far_off_as_stated_are_not_wider():
    assert np.all(factors(np.random.default_rng(1).normal(size=20), [1e4] * 20) < 1.1)


def test_one_kind_that_is_off_says_nothing_of_the_others():
    one, *others = factors([20.0, 0.5, 0.0], [1e4, 1e4, 1e-9])
    assert 10 < one < 21
    assert max(others) < 1.2


def test_where_most_kinds_are_off_so_are_those_that_the_data_do_not_show():
    *shown, hidden = factors([3.0, -4.0, 3.0, 5.0, 4.0, 0.0], [1e4] * 5 + [1e-9])
    assert min(shown) > 1.8
    assert hidden > 1.8


def test_wider_only_if_the_measurements_show_so():
    """A gradient of three of its sigmas by a constant that the measurements hardly show widened its prior for ever."""
    (factor,) = factors([28.0], [1 / 88])
    assert factor < 1.2


@pytest.mark.parametrize(("robot", "wider"), [("pan-tilt", True), ("camera on pan-tilt", False)])
def test_squares_of_one_camera_keep_their_prior(robot, wider):
    """With a slow rolling shutter, a slight pull on them grew as it was followed: wheels of 2.5 times their size."""
    fit = maximum_likelihood(imperfect.Case(robot=robot, noise=imperfect.USUAL).extraction(0))
    off = np.where(np.array(fit.data.layout.names) == "square_scale", 0.02, 0.0)
    lin = fit.lin.at(fit.lin.state.plus_shared(off), fit.inliers, fit.noise, fit.lin.priors)
    assert (widths(lin)["square_size"] > 2.0) == wider


@pytest.mark.parametrize(("off_m", "seed"), [(0.05, 4), pytest.param(-0.05, 0, marks=pytest.mark.long)])
def test_a_joint_at_another_place_is_no_noise_of_the_floor(off_m, seed):
    """The images show its place to 15 mm alone, 16 prior sigmas: PASS at ten stated sigmas, on a floor of 2 mm."""
    case = imperfect.Case(stations=24, noise=imperfect.USUAL).drawn(fixed={"tilt_position_x": off_m})
    extraction = case.extraction(seed)
    solution = solve(extraction)
    true = imperfect.true_robot(imperfect.ROBOTS[case.robot], extraction, case.route(seed))
    run = imperfect.judged(solution, extraction, true)
    assert run.level == "FAIL"
    assert np.abs(run.error / run.std).max() < 3.5
    assert solution.uncertainty.noise.floor_m < 0.001
    assert max(solution.contradictions, key=lambda each: each.sigmas).kind == "joint_position"


def test_two_kinds_that_explain_the_same_do_not_take_turns():
    """A servo's horn a tooth off: 8 sigmas, as zero positions and axes were wide in turn, and 23 s in place of 0.5."""
    case = imperfect.Case("camera on pan-tilt", stations=12, noise=imperfect.USUAL)
    case = case.drawn(fixed={"pan_zero": math.radians(7.5)})
    extraction = case.extraction(1)
    solution = solve(extraction)
    true = imperfect.true_robot(imperfect.ROBOTS[case.robot], extraction, case.route(1))
    run = imperfect.judged(solution, extraction, true)
    assert np.abs(run.error / run.std).max() < 3.5
    assert [each.kind for each in solution.contradictions] == ["joint_zero"]
    assert 8 < solution.uncertainty.noise.wider["joint_zero"] < 15


def test_the_search_does_not_amplify_rounding():
    """Correlation lengths moved in steps of a grid: 1e-14 of the joint readings moved a parameter by 0.05 sigma."""
    extraction = drawn("paper's robot, N = 12").extraction(10)
    readings = [o.joints * (1 + 1e-14) for o in extraction.observations]
    joints = zip(extraction.observations, readings, strict=True)
    again = replace(extraction, observations=tuple(replace(o, joints=q) for o, q in joints))
    found, other = maximum_likelihood(extraction), maximum_likelihood(again)
    step = other.lin.state.parameters.minus(found.lin.state.parameters)
    assert np.abs(step / np.sqrt(np.diag(found.covariance)[:9])).max() < 1e-3


def moving(apart_s: float, robot: str = "pan-tilt") -> imperfect.Case:
    """A pair of sharp images, or three, whose exposures vary by so much in motion."""
    noise = replace(imperfect.USUAL, pixel_px=0.03, pair_s=apart_s)
    return imperfect.Case(robot, motion="moving", images=32, noise=noise).drawn()


@pytest.mark.long
@pytest.mark.parametrize(("robot", "seed"), [("pan-tilt", 3), ("three cameras", 1)])
def test_cameras_without_a_common_trigger_leave_the_result_right(robot, seed):
    """Without a level of their own: PASS at nine stated sigmas, or "the right camera moved"."""
    case = moving(0.001, robot)
    extraction = case.extraction(seed)
    solution, exact = solve(extraction), solve(moving(0.0, robot).extraction(seed))
    found = solution.uncertainty.noise
    assert 0.7e-3 < found.pair_s < 1.4e-3
    assert "pair_s" in found.estimated
    assert found.pixel_px == pytest.approx(0.03, rel=0.1)
    true = imperfect.true_robot(imperfect.ROBOTS[robot], extraction, case.route(seed))
    run = imperfect.judged(solution, extraction, true)
    assert run.level == "PASS"
    assert np.abs(run.error / run.std).max() < 3.5
    assert solution.point_rms_m < 1.2 * exact.point_rms_m  # each image counts where it is at one time


@pytest.mark.long
def test_cameras_with_a_common_trigger_lose_little_by_it():
    extraction = replace(moving(0.0), kinds={}).extraction(0)
    free = solve(extraction).uncertainty
    known = solve(replace(extraction, rig=replace(extraction.rig, noise={"pair_s": 1e-8}))).uncertainty
    assert free.noise.pair_s < 1e-4
    assert np.all(free.std < 1.05 * known.std)


@pytest.mark.long
@pytest.mark.parametrize(
    ("robot", "motion", "shift_px"),
    [
        ("pan-tilt", "standard", 0.5),
        ("pan-tilt", "moving", 0.1),
        ("pair on the base", "standard", 0.5),
        ("three cameras", "standard", 0.5),
    ],
)
def test_images_that_shift_are_no_change_of_a_camera(robot, motion, shift_px):
    """Each by itself: "the right camera moved" before, and standard deviations that were up to twice as large."""
    still = imperfect.Case(robot, motion=motion, images=40).drawn()
    shifting = replace(still, noise=replace(still.noise, shift_px=shift_px))
    extraction = shifting.extraction(2)
    solution, exact = solve(extraction), solve(still.extraction(2))
    found = solution.uncertainty.noise
    assert found.shift_px == pytest.approx(shift_px, rel=0.25)
    assert found.pixel_px == pytest.approx(0.1, rel=0.05)
    assert not solution.jumps
    run = imperfect.judged(
        solution, extraction, imperfect.true_robot(imperfect.ROBOTS[robot], extraction, still.route(2))
    )
    assert run.level == "PASS"
    assert np.abs(run.error / run.std).max() < 3.5
    wider = solution.uncertainty.std / exact.uncertainty.std
    assert wider.max() < 2
    assert np.exp(np.mean(np.log(wider))) < 1.2
    assert solution.point_rms_m < 1.2 * exact.point_rms_m  # each image counts where it would not be shifted


@pytest.mark.parametrize(
    "case", [imperfect.Case("camera on pan-tilt", motion="moving", images=16), imperfect.Case(stations=8)]
)
def test_one_camera_and_stops_have_no_such_time(case):
    estimated = maximum_likelihood(case.extraction(0)).components
    assert "pair_s" not in estimated
    assert ("shift_px" in estimated) == (case.robot == "pan-tilt")


@pytest.mark.long
@pytest.mark.parametrize(("late_s", "seed"), [(0.01, 2), (0.02, 1)])
def test_a_late_camera_moves_no_scale(late_s, seed):
    """Squares and baseline that differ made both priors wide, and the world then shrank to a third: 54 and 12 sigmas.

    The rates half-way to the exposure make 20 ms no other than 5 ms.
    """
    case = imperfect.Case(motion="moving", fixed={"time_right": late_s}, noise=imperfect.USUAL)
    run = imperfect.run_of_case(case, seed)
    assert run.level == "PASS"
    assert np.abs(run.error / run.std).max() < 3.5
    assert run.named[0] == "stereo_clock"


def test_stamps_that_vary_where_a_clock_stepped_are_no_fault_of_the_images():
    """Joint states were stamped 50 ms earlier from the middle on: the cause was "images without hardware time stamps"."""
    note = "/joint_states: the clock steps back by up to 0.030 s"
    extraction = replace(moving(0.0).extraction(0), notes=(note,))
    found = fitted(extraction)
    uncertainty = found.solution.uncertainty
    noisy = replace(uncertainty, noise=replace(uncertainty.noise, stamp_s=0.025))
    report = Report(Data(extraction), replace(found, solution=replace(found.solution, uncertainty=noisy)))
    (check,) = [check for check in report.verdict.checks if check.id == "noise.stamp"]
    assert (
        check.next_step
        == f"Check that no clock is adjusted during the recording ({note}). Then record again."
    )
