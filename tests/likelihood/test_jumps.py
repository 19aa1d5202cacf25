"""Jumps inside a recording: found with part and station, and not mistaken for one bad station."""

import re
from dataclasses import replace

import numpy as np
import pytest

from mobilecal_cli import se3
from mobilecal_cli.likelihood import jumps
from mobilecal_cli.model.findings import Evidence, EvidenceValue
from mobilecal_cli.simulate.robot import TICK_ROBOT
from mobilecal_cli.simulate.route import plan_route
from mobilecal_cli.solvers import findings, solve
from mobilecal_cli.solvers.constraints import Constraints
from mobilecal_cli.solvers.findings import jumps_of
from mobilecal_cli.solvers.inference import Inference
from mobilecal_cli.solvers.maximum_likelihood import robust_fit
from tests.actual import STATION_NOISE, draw
from tests.bench.imperfect import CORRELATED, ROBOTS, USUAL, Case, judged
from tests.bench.jumps import RECORDINGS
from tests.bench.jumps import changed as changed_recording
from tests.extractions import (
    Noise,
    extraction_of,
    joined,
    simulated,
    slipped,
)
from tests.fits import maximum_likelihood as fit_of
from tests.judging import judge
from tests.pairs import with_views
from tests.truth import parameters_of

ROBOT, STATIONS, HALF = TICK_ROBOT, 16, 8
ROUTE = plan_route(ROBOT, "standard", stations=STATIONS, seed=2)
NOISE = Noise(0.1, 0.003, 0.0, 3.5e-4)


@pytest.fixture(scope="module")
def whole():
    return extraction_of(ROBOT, ROUTE, NOISE, 1)


@pytest.fixture(scope="module")
def fitted(whole):
    inference = Inference.of(whole, Constraints())
    return inference, robust_fit(inference)


def turned(angle_rad):
    T = ROBOT.T_h_c.copy()
    T[:3, :3] = se3.exp_so3(angle_rad * np.array([0.6, 0.0, 0.8])) @ T[:3, :3]
    return extraction_of(replace(ROBOT, T_h_c=T), ROUTE, NOISE, 1)


def spliced(first, second, at=HALF):
    return replace(first, observations=first.observations[:at] + second.observations[at:])


@pytest.mark.parametrize(
    ("at", "degrees"),
    [(2, 0.8), *(pytest.param(at, 1.5, marks=pytest.mark.long) for at in (2, HALF, STATIONS - 2))],
)
def test_a_mount_that_turns_is_found(whole, at, degrees):
    (jump,) = solve(spliced(whole, turned(np.radians(degrees)), at)).jumps
    assert (jump.part, jump.station, jump.rejected) == ("head mount", at, (0, 0))
    assert jump.turn_rad == pytest.approx(np.radians(degrees), rel=0.2)
    assert jump.shift_sigmas > 2


def test_a_jump_that_does_not_matter_conceals_no_other(monkeypatch, fitted):
    """A board that is moved, in a recording in which the mount turns too."""

    def jump(part, station, shift_sigmas):
        return jumps.ScoredJump(part, station, 200.0, 6, 1, 10.0, shift_sigmas, np.full(6, 0.01))

    left = [jump("board", 5, 0.7), jump("head mount", 11, 5.0), jump("joint pan_joint", 12, 9.0)]

    inference, fit = fitted
    monkeypatch.setattr(Inference, "_likeliest_jump", lambda *_: (left.pop(0), fit) if left else None)
    found = inference.jump(fit)
    assert (found.part, found.station) == ("head mount", 11)
    assert [each.part for each in left] == ["joint pan_joint"]


@pytest.fixture(scope="module", params=[pytest.param(3, marks=pytest.mark.long), 5])
def moved_board(request):
    """A board that moves by ten standard deviations, in the middle of a recording, and the robot."""
    case = RECORDINGS["20 stations"]
    extraction, after, _, _ = changed_recording(
        case, "board", 10.0, request.param, solve(case.extraction(request.param))
    )
    return extraction, after.robot


@pytest.mark.long
@pytest.mark.parametrize(
    ("recording", "part", "sigmas", "seed"),
    [
        # Beside a single station whose right image is off, which a jump of this camera would explain best.
        ("40 images in motion", "head mount", 10.0, 0),
        # The nine stay, but the pair is that of before the move.
        ("20 stations", "right camera", 10.0, 6),
        # 8 degrees and 0.2 m: the stations after it look like noise, or all like slips.
        *(("20 stations", part, 100.0, 0) for part in ("head mount", "board", "right wheel")),
    ],
)
def test_a_change_is_named_and_no_other_cause(recording, part, sigmas, seed):
    case = RECORDINGS[recording]
    extraction, _, first, _ = changed_recording(case, part, sigmas, seed, solve(case.extraction(seed)))
    solution = solve(extraction)
    (jump,) = solution.jumps
    assert (jump.part, jump.station) == (part, first)
    if sigmas > 10:
        assert (solution.noisy, solution.contradictions) == ((), ())
    else:
        assert judge(solution, extraction).level == "FAIL"


def test_a_moved_board_is_no_mistake_of_a_result_that_is_right(moved_board):
    """The leg across it is rejected: what the board moved beside the base, along the floor, does not show."""
    extraction, robot = moved_board
    solution = solve(extraction)
    run = judged(solution, extraction, robot)
    (check,) = (check for check in judge(solution, extraction).checks if check.id == "jump")
    assert check.outcome == "warning"
    assert re.search(r"the board moved by .* That moves the result by [01]\.\d+ sigma only\.", check.why)
    assert np.all(np.abs(run.error) < 3 * run.std)
    assert (run.level, {jump.part for jump in run.jumps}) == ("PASS", {"board"})


def test_of_parts_that_explain_the_same_the_worse_one_counts(monkeypatch, moved_board):
    extraction, _ = moved_board
    monkeypatch.setattr(jumps, "_ALIKE", np.inf)
    solution = solve(extraction)
    (jump,) = solution.jumps
    assert (jump.part != "board", jump.also, jump.shift_sigmas > 2) == (True, "board", True)
    verdict = judge(solution, extraction)
    assert verdict.level == "FAIL"
    assert " or the board " in verdict.reason
    assert "Fasten the board." in verdict.next_step


def test_noise_levels_that_a_jump_makes_small_do_not_confirm_it():
    """A healthy robot: at the levels without it, a move of the board has a chance of one in 100,000."""
    extraction = Case(stations=20).drawn(noise=USUAL).extraction(9)
    inference = Inference.of(extraction, Constraints())
    assert inference.jump(robust_fit(inference)) is None


def test_what_a_moved_camera_explains_contradicts_nothing(whole):
    """The right camera turns by 0.4 degrees half-way: squares, baseline and lenses are as stated."""
    turns = dict(zip(("stereo_r_x", "stereo_r_y", "stereo_r_z"), np.radians([0.2, 0.28, 0.2]), strict=True))
    after = extraction_of(ROBOT, ROUTE, NOISE, 1, constants=turns)
    solution = solve(spliced(whole, after))
    (jump,) = solution.jumps
    assert (jump.part, jump.station) == ("right camera", HALF)
    assert jump.turn_rad == pytest.approx(np.radians(0.4), rel=0.1)
    assert solution.contradictions == ()
    assert not solution.scale.apart


@pytest.mark.parametrize(("roll_rad", "parts"), [(0.0035, []), (0.01, ["board"])])
def test_a_board_that_turns_by_no_more_than_a_floor_makes_is_not_named(roll_rad, parts):
    """A floor of another slope, where the robot drives next, looks the same: the camera on the head was named, a FAIL."""
    flat = replace(NOISE, pixel_px=0.02, floor_rad=1e-4, floor_m=1e-4)
    rolled = ROUTE.T_w_k @ se3.exp(np.array([0.0, 0.0, roll_rad, 0.0, 0.0, 0.0]))
    before, after = (extraction_of(ROBOT, replace(ROUTE, T_w_k=T), flat, 1) for T in (ROUTE.T_w_k, rolled))
    assert [jump.part for jump in solve(spliced(before, after)).jumps] == parts


def test_a_base_that_leans_over_moves_no_camera():
    """As under a load: it was the camera on the head, a FAIL of a result that is right."""
    flat = replace(NOISE, pixel_px=0.02, floor_rad=1e-4, floor_m=1e-4)
    level, leaning = (
        extraction_of(ROBOT, ROUTE, flat, 1, constants={"lean_roll": roll}) for roll in (0.0, 0.015)
    )
    changed = spliced(level, leaning)
    solution = solve(changed)
    (jump,) = solution.jumps
    assert (jump.part, jump.station, jump.also) == ("lean of the base", HALF, "")
    assert jump.turn_rad == pytest.approx(0.015, rel=0.2)
    verdict = judge(solution, changed)
    assert verdict.level == "PASS"
    (check,) = (check for check in verdict.checks if check.id == "jump")
    assert "the base leaned over by" in check.why


def test_nothing_jumps_nor_one_station_that_does_not_fit(whole, fitted):
    """The right camera is off by 3 px at the fourth station from the end alone."""
    at = STATIONS - 4
    o = whole.observations[at]
    off = with_views(o, right=replace(o.views[1], pixels=o.views[1].pixels + np.array([3.0, 0.0])))
    seen = (*whole.observations[:at], off, *whole.observations[at + 1 :])
    inference = Inference.of(replace(whole, observations=seen), Constraints())
    assert inference.jump(robust_fit(inference)) is None
    inference, fit = fitted
    assert inference.jump(fit) is None


def test_a_camera_that_moves_by_nothing_that_matters_is_not_named(whole, fitted):
    """Sharp images show 0.003 degrees at 6 sigmas, where exposures vary by a millisecond."""
    _, fit = fitted
    turn = np.array([*np.radians([0.003, 0.002, 0.002]), 0.0, 0.0])
    small = jumps.ScoredJump("right camera", HALF, 60.0, 5, 1, 6.0, 0.5, turn)
    assert jumps_of(whole, fit, small) == ()
    (larger,) = jumps_of(whole, fit, replace(small, value=2 * turn))
    assert larger.part == "right camera"


def test_a_late_camera_comes_before_stronger_contradictions_and_fails_with_them(monkeypatch):
    """They may follow from it."""
    late = {"time_right": EvidenceValue(0.033, 5e-5, 5e-3)}
    longer = {"focal_left": EvidenceValue(0.03, 1e-3, 2e-3)}
    found = [
        Evidence("focal_length", "left camera", longer, chi2=1400.0, sigmas=37.0, shift_sigmas=9.0),
        Evidence("stereo_clock", "right camera", late, chi2=300.0, sigmas=17.0, shift_sigmas=0.1),
    ]
    monkeypatch.setattr(findings, "evidence", lambda lin, parts=True: found)
    extraction = Case(motion="moving", images=20, noise=USUAL).extraction(0)
    solution = solve(extraction)
    assert solution.contradictions == (found[1], found[0])
    verdict = judge(solution, extraction)
    assert verdict.level == "FAIL"
    assert verdict.reason.startswith("Right camera: delay against the left camera differs by +33.000 ± ")


def test_a_camera_that_shakes_has_to_move_further(whole):
    """Each right image is turned about its middle by itself: by 2 mrad, where 54 corners of 0.1 px show 0.2 mrad."""
    random, shaken = np.random.default_rng(3), []
    for o in whole.observations:
        pixels = o.views[1].pixels
        turned = (pixels - pixels.mean(axis=0)) @ (
            0.002 * random.normal() * np.array([[0.0, -1.0], [1.0, 0.0]])
        )
        shaken.append(with_views(o, right=replace(o.views[1], pixels=pixels + turned)))
    inference = Inference.of(replace(whole, observations=tuple(shaken)), Constraints())
    fit = robust_fit(inference)
    lin = jumps.traced(fit.lin)
    jump = next(jump for jump in jumps.likeliest(lin) if jump.part == "right camera")
    assert jumps.scatter(lin, jump) > 2
    assert inference.jump(fit) is None


def with_wheel(whole, side, from_ns, change):
    """A recording in which the radius of a wheel becomes so many times as large at some time."""
    (wheels,) = whole.wheels
    track = getattr(wheels, side)
    rolled = np.diff(track.value, prepend=track.value[0])
    rolled[track.time_ns > from_ns] /= change
    changed = replace(track, value=track.value[0] + np.cumsum(rolled))
    return replace(whole, wheels=(replace(wheels, **{side: changed}),))


@pytest.fixture(scope="module")
def on_base():
    """A camera on the base before a board, without and with a mount that rolls by a degree and gives by 10 mm."""
    noise = replace(NOISE, pixel_px=0.02, floor_rad=1e-4, floor_m=1e-4, shift_px=1.0)
    robot = ROBOTS["camera on the base"]
    given = se3.exp(np.array([0.02, 0.0, 0.0, 0.0, 0.0, 0.01])) @ robot.T_h_c
    route = plan_route(robot, "standard", 20, seed=0)
    return [extraction_of(each, route, noise, 0) for each in (robot, replace(robot, T_h_c=given))]


def test_a_camera_that_never_tilts_does_not_move_upward_between_recordings(on_base):
    """On springs, the lever of the base showed a height: of a camera that was bumped by 5 mm, it said 212 mm."""
    lin = jumps.traced(fit_of(joined(*on_base)).lin)
    mount = next(jump for jump in jumps.likeliest(lin) if jump.part == "head mount")
    assert abs(mount.value[5]) < 1e-12
    assert np.abs(mount.value[:5]).min() > 1e-6


def test_a_camera_that_never_tilts_moves_upward_before_the_same_board(on_base):
    """Without its height, the mount explained less than a board that moved, which was named instead."""
    (jump,) = solve(spliced(*on_base, at=10)).jumps
    assert (jump.part, jump.station, jump.also) == ("head mount", 10, "")
    assert jump.move_m == pytest.approx(0.01, rel=0.2)


@pytest.mark.long
def test_a_wheel_that_changes_under_a_fixed_camera_is_no_exchange_of_both():
    """With the camera turned around, reversed wheels fit as well as the right ones: refused as swapped or reversed."""
    case = Case(robot="camera on the base", stations=12).drawn(noise=CORRELATED)
    robot, constants = ROBOTS[case.robot], case.constants(1000)
    whole = extraction_of(robot, case.route(1000), case.noise, 1000, constants=constants)
    half_way_ns = (whole.observations[3].time_ns + whole.observations[4].time_ns) // 2
    (jump,) = solve(with_wheel(whole, "right", half_way_ns, 0.925)).jumps
    assert (jump.part, abs(jump.station - 4) <= 1) == ("right wheel", True)


@pytest.mark.parametrize(
    ("seed", "first", "change", "outliers"),
    [
        (3, 20, 1.08, 3),
        # Two legs alone: both were slips, and a PASS with the size before.
        pytest.param(3, 22, 0.5, 2, marks=pytest.mark.long),
        *(
            pytest.param(*case, 0, marks=pytest.mark.long)
            for case in ((3, 4, 1.1), (4, 19, 1.06), (6, 18, 1.04), (3, 12, 1.1))
        ),
    ],
)
def test_a_wheel_that_changes_is_named(seed, first, change, outliers):
    """Near an end its legs look like slips, or the stations between them like wrong ones: the result is that of the other part."""
    whole = simulated("standard", NOISE, ROBOT, 24, seed)
    changed = with_wheel(whole, "left", whole.observations[first - 1].time_ns, change)
    solution = solve(changed)
    (jump,) = solution.jumps
    assert (jump.part, judge(solution, changed).level) == ("left wheel", "FAIL")
    assert abs(jump.station - first) <= 1  # the leg across it may look like a slip
    assert sum(o.kind in ("slip", "station") for o in solution.outliers) >= outliers
    assert jump.move_m == pytest.approx((change - 1) * ROBOT.wheels.radius_left_m, rel=0.2)
    assert solution.contradictions == ()
    # The jump explains the misfit; or the table of mistakes names the same, where noise took up most of it.
    assert solution.diagnosis is None or "the left wheel's readings become" in solution.diagnosis.cause


def test_a_wheel_that_changes_on_the_last_leg_looks_like_a_slip():
    whole = simulated("standard", NOISE, ROBOT, STATIONS, 3)
    solution = solve(with_wheel(whole, "left", whole.observations[-2].time_ns, 1.3))
    (outlier,) = solution.outliers
    assert (solution.jumps, outlier.kind, outlier.observations[-1]) == ((), "slip", STATIONS - 1)
    assert outlier.text.endswith("A wheel whose size changes on the last leg looks the same.")


@pytest.mark.parametrize(
    ("cameras", "by"), [pytest.param(("left",), 0.01, marks=pytest.mark.long), (("left", "right"), 0.03)]
)
def test_a_camera_that_focuses_anew_has_not_moved(whole, cameras, by):
    """It was "the right camera against the left camera moved", or wheel noise where both cameras do so."""
    refocused = extraction_of(ROBOT, ROUTE, NOISE, 1, constants={f"focal_{name}": by for name in cameras})
    changed = spliced(whole, refocused)
    solution = solve(changed)
    (jump,) = solution.jumps
    which = "the left camera" if len(cameras) == 1 else "all cameras"
    assert (jump.part, jump.station, jump.move_m) == (f"focal length of {which}", HALF, 0)
    assert f"the focal length of {which} changed" in judge(solution, changed).reason


def slipping(whole, legs):
    """The left wheel of a recording turns by 2 rad without the robot on some legs."""
    for leg in legs:
        whole = slipped(whole, leg, 0.0, (-1) ** leg * 2.0)
    return whole


@pytest.mark.long
def test_legs_that_slip_one_after_another(whole):
    extraction = slipping(whole, (6, 7))
    inference = Inference.of(extraction, Constraints())
    fit = robust_fit(inference)
    assert jumps_of(extraction, fit, inference.jump(fit)) == ()
    # Nor the values that the other legs had: the wheels differ for too long.
    (jump,) = solve(slipping(whole, (7, 8, 9, 10))).jumps
    assert (jump.part, jump.station, sum(jump.rejected)) == ("", 8, 4)


@pytest.mark.long
def test_a_board_that_moves_twice_is_named_with_one_of_its_moves():
    """The search for noise levels ended where rounding decides: "do not determine all parameters", record more stations."""
    robot, random, parts = TICK_ROBOT, np.random.default_rng(3), []
    route = plan_route(robot, "standard", 24, seed=3)
    noise = replace(STATION_NOISE, pixel_px=0.1, joint_rad=1e-4, wheel_rad_per_sqrt_rad=0.002)
    for _ in range(3):
        parts.append(extraction_of(robot, route, noise, 3))
        route = replace(route, T_w_k=route.T_w_k @ se3.exp(0.02 * random.normal(size=6)))
    first, second, third = parts
    solution = solve(spliced(spliced(first, second, 8), third, 16))
    assert solution.jumps[0].part == "board"
    assert solution.jumps[0].station in (8, 16)
    off = solution.parameters.minus(parameters_of(robot)) / solution.uncertainty.std
    assert np.abs(off).max() < 4


@pytest.mark.parametrize("other", [pytest.param(False, marks=pytest.mark.long), True])
def test_recordings_of_two_boards_differ_in_the_boards_shape(other):
    case, robot = Case(stations=12).drawn(noise=CORRELATED), TICK_ROBOT
    constants = case.constants(1000)
    redrawn = draw(robot, np.random.default_rng(24), 1.0, {"square_size", "board_bend"})
    both = [
        extraction_of(robot, case.route(seed), case.noise_of(seed), seed, constants=drawn)
        for seed, drawn in ((23, constants), (123, constants | redrawn if other else constants))
    ]
    solution = solve(joined(*both))
    assert [(jump.part, jump.log) for jump in solution.jumps] == [(jumps.SHAPE, 1)] * other


@pytest.mark.parametrize("larger", [1.01, pytest.param(1.15, marks=pytest.mark.long)])
def test_both_wheels_that_differ_between_recordings_are_named_together(larger):
    """As by more pressure: the left wheel alone was named; or all legs of one recording were slips, and a warning."""
    case, robot = Case(stations=12).drawn(noise=CORRELATED), TICK_ROBOT
    one, other = (extraction_of(robot, case.route(seed), NOISE, seed) for seed in (23, 123))
    both = joined(one, with_wheel(with_wheel(other, "right", 0, larger), "left", 0, larger))
    solution = solve(both)
    (jump,) = solution.jumps
    assert (jump.part, jump.log) == ("both wheels", 1)
    assert abs(jump.move_m) == pytest.approx((larger - 1) * robot.wheels.radius_right_m, rel=0.2)
    verdict = judge(solution, both)
    assert (verdict.level, "sizes of both wheels" in verdict.reason) == ("FAIL", True)
