"""The common scale of a description's priors, and the search for noise levels."""

from dataclasses import replace

import numpy as np
import pytest

from mobilecal_cli.solvers import solve
from mobilecal_cli.solvers.noise import _ALL_TOO_NARROW, _TOO_NARROW, common_variance
from tests.bench import imperfect
from tests.bench.drawn import drawn


def density(u, q, n):
    """Minus twice the logarithm of the posterior density, each kind's own factor at its optimum."""
    alone = np.log(np.maximum(q, 1e-300) / (n + _TOO_NARROW))
    own = np.maximum(alone - u, 0.0)
    return _ALL_TOO_NARROW * u + np.sum(n * (u + own) + q * np.exp(-(u + own)) + _TOO_NARROW * own)


@pytest.mark.parametrize("seed", range(8))
def test_the_common_factor_is_the_likeliest(seed):
    random = np.random.default_rng(seed)
    kinds = int(random.integers(1, 12))
    n = random.choice([0.001, 0.3, 1.0, 2.0, 4.0], kinds)
    q = random.gamma(n / 2, 2.0) * random.choice([1.0, 9.0, 25.0]) * random.choice([1.0, 1.0, 400.0], kinds)
    u = np.linspace(0.0, 12.0, 4001)
    best = u[np.argmin([density(each, q, n) for each in u])]
    assert np.log(common_variance(q, n)) == pytest.approx(best, abs=2 * (u[1] - u[0]))


def test_one_kind_that_is_off_says_nothing_of_the_others():
    assert common_variance(np.array([400.0, 0.5, 0.0]), np.array([1.0, 1.0, 0.0])) == 1.0
    assert common_variance(np.array([400.0]), np.array([1.0])) == 1.0
    assert common_variance(np.array([]), np.array([])) == 1.0


def test_where_most_kinds_are_off_so_are_those_that_the_data_do_not_show():
    q, n = 9.0 * np.array([1.0, 2.0, 1.0, 3.0, 0.0]), np.array([1.0, 2.0, 1.0, 3.0, 0.0])
    assert 6 < common_variance(q, n) < 9


def test_the_search_does_not_amplify_rounding():
    """Correlation lengths moved in steps of a grid: 1e-14 of the joint readings moved a parameter by 0.05 sigma."""
    extraction = drawn("paper's robot, N = 12").extraction(10)
    readings = [o.joints * (1 + 1e-14) for o in extraction.observations]
    joints = zip(extraction.observations, readings, strict=True)
    again = replace(extraction, observations=tuple(replace(o, joints=q) for o, q in joints))
    found, other = solve(extraction), solve(again)
    step = other.parameters.minus(found.parameters)
    assert np.abs(step / found.uncertainty.std).max() < 1e-3


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
    true = imperfect.true_robot(imperfect.ROBOTS[robot](), extraction, case.route(seed))
    run = imperfect.judged(solution, extraction, true)
    assert run.level == "PASS"
    assert np.abs(run.error / run.std).max() < 3.5
    assert solution.point_rms_m < 1.2 * exact.point_rms_m  # each image counts where it is at one time


@pytest.mark.long
def test_cameras_with_a_common_trigger_lose_little_by_it():
    extraction = replace(moving(0.0), kinds={}).extraction(0)
    free = solve(extraction).uncertainty
    known = solve(imperfect.with_noise(extraction, {"pair_s": 1e-8})).uncertainty
    assert free.noise.pair_s < 1e-4
    assert np.all(free.std < 1.05 * known.std)


@pytest.mark.parametrize(
    "case", [imperfect.Case("camera on pan-tilt", motion="moving", images=16), imperfect.Case(stations=8)]
)
def test_one_camera_and_stops_have_no_such_time(case):
    assert "pair_s" not in solve(case.extraction(0)).uncertainty.noise.estimated


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
