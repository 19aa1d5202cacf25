"""Several recordings, one of which alone does not determine all nine parameters."""

import json
import re
from dataclasses import replace

import numpy as np
import pytest
from scipy.special import stdtrit

from mobilecal_cli import se3
from mobilecal_cli.errors import SolveError
from mobilecal_cli.likelihood.dataset import dataset_of
from mobilecal_cli.model.calibration import NINE
from mobilecal_cli.model.observations import Corners
from mobilecal_cli.model.rig import WheelGeometry
from mobilecal_cli.report.formats import json_text
from mobilecal_cli.report.motion import motion_gaps
from mobilecal_cli.simulate.robot import PAPER_ROBOT
from mobilecal_cli.simulate.route import Drive, Stretch, plan_route
from mobilecal_cli.solvers import constraints_of, solve
from tests import truth
from tests.extractions import (
    STATION_NOISE,
    Noise,
    extraction_of,
    joined,
    simulated,
)
from tests.fits import maximum_likelihood
from tests.judging import judge
from tests.pairs import with_views
from tests.report.example import made, rows_of
from tests.robots import true_nominal

ROBOT = PAPER_ROBOT
NOISE = Noise(0.2, 0.003, 0.0, np.radians(0.05))
RADIUS = NINE.index("radius_right")


def recorded(motion, seed, robot=ROBOT, noise=NOISE, stations=12, grown_m=0.0):
    wheels = robot.wheels
    radii = wheels.radius_right_m + grown_m, wheels.radius_left_m + grown_m
    robot = replace(robot, wheels=WheelGeometry(*radii, wheels.separation_m))
    whole = simulated(motion, noise, robot, seed=seed)
    return replace(whole, observations=whole.observations[:stations])


def nees(solution):
    return truth.nees(solution.parameters, solution.uncertainty.covariance, ROBOT)


def misread(extraction, station, seed=0, size_px=300.0):
    """The same with all corners of a station wrong by hundreds of pixels."""
    random, seen = np.random.default_rng(seed), list(extraction.observations)

    def wrong(corners):
        pixels = corners.pixels + size_px * random.normal(size=corners.pixels.shape)
        return Corners(pixels, corners.sigma_px, 1)

    seen[station] = with_views(seen[station], *map(wrong, seen[station].views))
    return replace(extraction, observations=tuple(seen))


@pytest.mark.parametrize(
    ("motion", "stations", "hidden"),
    [
        ("straight", 12, ("separation",)),
        *(
            pytest.param(motion, 12, hidden, marks=pytest.mark.long)
            for motion, hidden in (("spin", NINE[6:]), ("base_fixed", NINE[6:]), ("head_fixed", ("t_y",)))
        ),
        pytest.param("standard", 1, NINE, marks=pytest.mark.long),
        pytest.param("standard", 2, NINE[1:], marks=pytest.mark.long),
    ],
)
@pytest.mark.parametrize("first", [True, pytest.param(False, marks=pytest.mark.long)])
def test_a_parameter_that_one_recording_does_not_show(motion, stations, hidden, first):
    parts = [recorded("standard", 1), recorded(motion, 2, stations=stations)]
    poor = 0 if first else 1
    extraction = joined(*(reversed(parts) if first else parts))
    found = solve(extraction)
    assert found.uncertainty.observable.all()
    assert nees(found) < 3
    assert np.all(np.isfinite(found.between.shift))
    assert np.all(np.isfinite(found.between.std))
    assert found.between.shown[1 - poor].all()
    assert {name for name, ok in zip(NINE, found.between.shown[poor], strict=True) if not ok} >= set(hidden)
    if stations == 12:
        assert found.between.shown[poor].sum() == 9 - len(hidden)

    rows = rows_of(made(found, extraction), "limits", "Each recording separately")
    said = dict(zip(NINE, rows[f"recording {poor + 1}"], strict=True))
    assert all(said[name] == "unobservable" for name in hidden)
    assert "nan" not in str(rows)
    assert rows["spread between recordings"][NINE.index(hidden[0])] == "unobservable"
    text = json_text(made(found, extraction))
    logs = json.loads(text, parse_constant=lambda name: pytest.fail(name))["logs"]
    assert logs["shift"][poor][NINE.index(hidden[0])] is None
    assert logs["shown"][poor] == found.between.shown[poor].tolist()


@pytest.mark.long
def test_parameters_that_no_recording_shows_or_that_are_fixed_are_not_shown():
    extraction = joined(recorded("straight", 2), recorded("straight", 3))
    found = solve(extraction, constraints=constraints_of(["t_x"], [], []))
    assert found.between.shown.tolist() == [[name not in ("separation", "t_x") for name in NINE]] * 2
    rows = rows_of(made(found, extraction), "limits", "Each recording separately")
    assert rows["recording 1"][NINE.index("separation")] == "unobservable"
    assert rows["recording 2"][NINE.index("t_x")] == "fixed"


@pytest.fixture(scope="module")
def apart():
    """Two recordings whose radii differ by 6 mm, and their solution."""
    extraction = joined(recorded("standard", 1), recorded("standard", 2, grown_m=0.006))
    return extraction, solve(extraction)


def test_recordings_that_differ_are_as_uncertain_as_they_differ_and_the_wheels_are_named(apart):
    """Half of their difference is 3 mm; Student's t with one degree of freedom makes it 7 times as wide."""
    extraction, found = apart
    assert found.between.between_std[RADIUS] == pytest.approx(0.006 / np.sqrt(2), rel=0.4)
    assert 0.015 < found.uncertainty.std[RADIUS] < 0.03
    mean_m = ROBOT.wheels.radius_right_m + 0.003
    assert found.parameters.wheels.radius_right_m == pytest.approx(mean_m, abs=0.0015)
    verdict = judge(found, extraction)
    assert verdict.level == "FAIL"
    assert re.match(
        r"Between recording 2 and the other, the sizes of both wheels changed by (5\.\d|6\.\d) mm",
        verdict.reason,
    )
    assert "calibrate each recording alone" in verdict.next_step
    camera = found.uncertainty.budget.at_work["along_m_per_m"]
    assert found.uncertainty.budget.sources[int(np.argmax(camera))] == "recordings"


@pytest.mark.long
@pytest.mark.parametrize("seed", [20, 40])
def test_the_recording_of_a_board_with_other_squares_is_named(seed):
    """Beside its shape, which has many numbers, it was not significant: no cause, and NOT ENOUGH."""
    noise = Noise(0.1, 0.003, joint_rad=2e-4, floor_rad=1e-3, floor_m=5e-4)
    parts = [
        simulated("standard", noise, "paper", 12, seed + k, constants={"square_scale": 0.0375 * (k == 2)})
        for k in range(3)
    ]
    extraction = joined(*parts)
    solution = solve(extraction)
    assert [(jump.part, jump.log) for jump in solution.jumps] == [("board's size", 2)]
    verdict = judge(solution, extraction)
    assert verdict.level == "FAIL"
    assert verdict.reason.startswith("Between recording 3 and the others, the size of the squares changed.")


@pytest.mark.long
@pytest.mark.parametrize(
    ("odd", "turn_rad", "stations", "level"),
    [(0, 0.06, 12, "FAIL"), (1, 0.06, 8, "FAIL"), (1, 0.02, 12, "PASS")],
)
def test_a_head_mount_that_differs_in_one_of_three_recordings_is_named(odd, turn_rad, stations, level):
    """A warning where all expected errors are within their limits with the spread included."""
    bumped = replace(ROBOT, T_h_c=ROBOT.T_h_c @ se3.exp(np.array([0.0, 0.0, turn_rad, 0.0, 0.0, 0.0])))
    robots = (bumped if seed == odd else ROBOT for seed in range(3))
    parts = [recorded("standard", seed, robot, stations=stations) for seed, robot in enumerate(robots)]
    extraction = joined(*parts)
    verdict = judge(solve(extraction), extraction)
    assert verdict.level == level
    size = re.search(
        rf"Between recording {odd + 1} and the others, the camera on the head moved by .* and ([\d.]+) degrees",
        verdict.reason if level == "FAIL" else verdict.next_step,
    )
    assert float(size[1]) == pytest.approx(np.degrees(turn_rad), rel=0.3)


@pytest.mark.long
def test_recordings_that_hide_a_parameter_by_their_difference_need_no_more_motion():
    extraction = joined(
        *(recorded("standard", seed, stations=8, grown_m=m) for seed, m in ((1, 0.0), (2, 0.02)))
    )
    check = judge(solve(extraction), extraction).check("observable")
    assert check.why.endswith("not determined: the recordings differ from one another.")
    assert check.next_step.startswith("Calibrate each recording alone")


@pytest.mark.long
@pytest.mark.parametrize("off_m", [-0.001, 0.004])
def test_a_prior_weighs_against_the_spread_between_recordings(apart, off_m):
    """Radii 4 mm apart: a prior on one parameter combines with its pooled estimate as two measurements of it do."""
    extraction, free = apart
    value, std = free.parameters.vector[RADIUS], free.uncertainty.std[RADIUS]
    stated, sigma = ROBOT.wheels.radius_right_m + off_m, 0.0003
    found = solve(extraction, constraints=constraints_of([], [f"radius_right={stated!r}±{sigma}"], []))
    weights = np.array([std, sigma]) ** -2
    # The estimate weighs the recordings by their spread; the stated sigma is wider by the factor for two recordings.
    spread = np.array([std / float(stdtrit(1, 0.97725) / 2), sigma]) ** -2
    assert std > 0.001
    mean = spread @ [value, stated] / spread.sum()
    assert found.parameters.vector[RADIUS] == pytest.approx(mean, abs=0.2 * sigma)
    assert found.uncertainty.std[RADIUS] == pytest.approx(weights.sum() ** -0.5, rel=0.05)


@pytest.mark.parametrize("stations", [1, pytest.param(2, marks=pytest.mark.long)])
def test_a_recording_whose_corners_are_all_wrong_is_left_out(stations):
    extraction = joined(recorded("standard", 1, stations=8), recorded("standard", 2, stations=stations))
    for k in range(stations):
        extraction = misread(extraction, 8 + k, seed=k)
    found = solve(extraction)
    expected = [("station", (8 + k,)) for k in range(stations)]
    assert [(o.kind, o.observations) for o in found.outliers] == expected
    assert not found.between.shown[1].any()
    assert nees(found) < 3


@pytest.mark.parametrize(("recordings", "stations", "method"), [(4, 1, "ml"), (2, 2, "linear")])
def test_too_few_legs(recordings, stations, method):
    extraction = joined(*(recorded("standard", seed, stations=stations) for seed in range(recordings)))
    with pytest.raises(SolveError, match=rf"with {recordings * (stations - 1)} legs .* \(at least 3 legs"):
        solve(extraction, method)


# -- short legs -------------------------------------------------------------------------------------


def short_leg(seed, turn_rad):
    """Two stations 8 mm apart, with the same head pose in all recordings."""
    route = plan_route(ROBOT, "standard", stations=1, seed=0)
    step = Stretch(0.1, np.copysign(0.08, np.random.default_rng(seed).normal()), turn_rad / 0.1)
    drive = Drive((Stretch(1.0), step, Stretch(1.0)))
    rests_s = np.array([[0.0, 1.0], [1.1, 2.1]])
    route = replace(route, drive=drive, knots_s=np.array([0.0, 2.1]), rests_s=rests_s)
    return extraction_of(ROBOT, route, NOISE, seed)


def short_legs(turns_rad):
    """Recordings of two stations each, with the head-eye transform in the description, but no wheels."""
    extraction = joined(*(short_leg(seed, turn) for seed, turn in enumerate(turns_rad)))
    nominal = replace(true_nominal(ROBOT), wheels=None)
    return replace(extraction, rig=replace(extraction.rig, nominal=nominal))


FIX = constraints_of(["head_eye"], [], [])


@pytest.mark.long
def test_many_short_legs_show_the_wheels_together():
    """No leg turns a wheel by 0.1 rad; nominal wheels are not needed."""
    extraction = short_legs(np.random.default_rng(0).uniform(-0.025, 0.025, 40))
    legs = dataset_of(extraction).pairs.steps.totals_rad
    assert np.abs(legs).max() < 0.1
    assert motion_gaps(extraction, FIX.fixed) == ()
    found = solve(extraction, constraints=FIX)
    assert found.uncertainty.observable.tolist() == [False] * 6 + [True] * 3
    off = found.parameters.wheels.vector - ROBOT.wheels.vector
    assert np.all(np.abs(off) < 3 * found.uncertainty.std[6:])
    assert np.all(found.uncertainty.std[6:] < 0.05 * ROBOT.wheels.vector)


def test_many_short_legs_without_a_turn_do_not_show_the_separation():
    extraction = short_legs(np.zeros(5))
    (gap,) = motion_gaps(extraction, FIX.fixed)
    assert "separation" in gap.parameters
    with pytest.raises(SolveError, match="the motion does not show the wheel radii"):
        solve(extraction, constraints=FIX)


@pytest.mark.parametrize("second", [0.02, pytest.param(-0.02, marks=pytest.mark.long)])
def test_recordings_of_different_cameras(second):
    """The right camera is turned by 1.1 degrees against camera_info: in both recordings alike, or to either side."""
    noise = replace(STATION_NOISE, pixel_px=0.05, joint_rad=2e-4, wheel_rad_per_sqrt_rad=0.003)
    turns = enumerate((0.02, second))
    parts = (
        simulated("standard", noise, ROBOT, 8, seed, constants={"stereo_r_x": turn}) for seed, turn in turns
    )
    extraction = joined(*parts)
    found = solve(extraction)
    assert found.diagnosis is None
    if second > 0:
        assert found.contradictions
    else:
        (jump,) = found.jumps
        assert (jump.part, jump.log, jump.turn_rad) == ("right camera", 1, pytest.approx(0.04, rel=0.05))
        assert judge(found, extraction).level == "FAIL"


def test_the_information_of_all_recordings_is_the_sum_of_that_of_each():
    lin = maximum_likelihood(joined(*(recorded("standard", seed) for seed in (1, 2, 3)))).lin
    each = [lin.of_log(log).normal for log in range(3)]
    scale = np.sqrt(np.diag(lin.normal.S))
    assert np.allclose(
        sum(normal.S for normal in each) / np.outer(scale, scale), lin.normal.S / np.outer(scale, scale)
    )
    assert np.allclose(sum(normal.s for normal in each) / scale, lin.normal.s / scale, atol=1e-6)


def test_recordings_without_legs_change_hardly_anything():
    """A single station shows the cameras and the board. Means of recordings were subtracted that these do not have: noise levels up to five times as large."""
    noise = Noise(0.1, 0.003, 0.0, 3.5e-4, floor_rad=0.0017, floor_m=0.0005)
    other, whole = (simulated("standard", noise, stations=10, seed=seed) for seed in (1, 2))
    none, one = (replace(other, observations=other.observations[:count]) for count in (0, 1))
    alone = solve(whole)
    for parts, most in (((none, whole), 1e-3), ((one, one, whole), 0.4), ((whole, one), 0.4)):
        found = solve(joined(*parts))
        assert np.abs(found.parameters.minus(alone.parameters) / alone.uncertainty.std).max() < most
        assert found.uncertainty.std == pytest.approx(alone.uncertainty.std, rel=0.02)
        for level in ("floor_rad", "floor_m", "wheel_share"):
            assert getattr(found.uncertainty.noise, level) == pytest.approx(
                getattr(alone.uncertainty.noise, level), rel=0.05
            )


@pytest.mark.long
def test_nothing_hangs_on_the_limit_beyond_which_recordings_differ():
    """A mount that was moved by 0.3 um more made a standard deviation 16 times as large."""
    noise = Noise(0.1, 0.003, 0.0, 3.5e-4)
    first, second = (plan_route(ROBOT, "standard", stations=8, seed=seed) for seed in (2, 3))
    whole = extraction_of(ROBOT, first, noise, 1)

    def with_mount(by_m):
        T = ROBOT.T_h_c.copy()
        T[0, 3] += by_m
        return solve(joined(whole, extraction_of(replace(ROBOT, T_h_c=T), second, noise, 2)))

    alike, differ = 0.0, 0.1
    assert with_mount(differ).between.between_std.any()
    for _ in range(28):
        middle = (alike + differ) / 2
        if with_mount(middle).between.between_std.any():
            differ = middle
        else:
            alike = middle
    assert alike > 0
    std = [with_mount(by_m).uncertainty.std for by_m in (alike, differ)]
    assert std[1] == pytest.approx(std[0], rel=0.05)
