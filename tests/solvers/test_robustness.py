"""Recordings with gross errors, far starts, a base at rest, prismatic joints, and fixed parameters."""

import re
from dataclasses import replace

import numpy as np
import pytest

from mobilecal_cli.kinematics import head_pose
from mobilecal_cli.likelihood.dataset import Inliers, dataset_of
from mobilecal_cli.model.calibration import NINE, Parameters
from mobilecal_cli.model.observations import WheelTrack
from mobilecal_cli.model.rig import FixedLink, JointLink
from mobilecal_cli.report.tables import noise
from mobilecal_cli.simulate.robot import TICK_ROBOT
from mobilecal_cli.solvers import Constraints, constraints_of, solve
from mobilecal_cli.solvers.initial import start_state
from mobilecal_cli.solvers.outliers import gross_corners
from tests.actual import ActualRobot
from tests.bench import imperfect
from tests.bench.simulated import errors, spoiled
from tests.extractions import STATION_NOISE, Noise, simulated, slipped
from tests.fits import maximum_likelihood
from tests.judging import judge
from tests.pairs import measured_anew, with_views
from tests.report.example import case_of, made, rows_of
from tests.robots import true_nominal
from tests.solvers.test_several_logs import NOISE, ROBOT, nees, recorded


@pytest.mark.long
@pytest.mark.parametrize("seed", range(8))
def test_large_turns_with_bad_stations(seed):
    """Headings after an excluded leg are compared modulo a full turn."""
    ideal = simulated("large_turns", NOISE, ROBOT, seed=seed)
    extraction, bad, slip = spoiled(ideal, np.random.default_rng(seed))
    found = solve(extraction)
    assert {o.observations[0] for o in found.outliers if o.kind == "station"} == set(bad)
    excluded = [o.observations for o in found.outliers if o.kind == "slip"]
    # The slip is indistinguishable from one in the next leg where the station between them is bad.
    possible = {slip} | ({slip - 1} if slip in bad else set()) | ({slip + 1} if slip + 1 in bad else set())
    assert len(excluded) <= 1
    assert {i for i, _ in excluded} <= possible
    assert not [o for o in found.outliers if o.kind == "joint"]
    turns = [float(x) for o in found.outliers for x in re.findall(r"([\d.]+) degrees", o.text)]
    assert all(turn <= 180 for turn in turns)
    assert nees(found) < 3


@pytest.mark.long
@pytest.mark.parametrize("number", range(25))
def test_far_starts_lead_to_the_same_estimate(number):
    """Starts that are wrong by 40 degrees, 0.3 m and up to 60 % of the wheels."""
    random = np.random.default_rng(number)
    wheels = ROBOT.wheels.vector * random.uniform(-0.6, 0.6, size=3)
    off = np.concatenate([0.7 * random.normal(size=3), 0.3 * random.normal(size=3), wheels])
    start = Parameters(ROBOT.T_h_c, ROBOT.wheels).plus(off)
    fit = maximum_likelihood(recorded("standard", 1), start=start)
    assert fit.inliers.views.all()
    assert fit.inliers.legs.all()
    e = errors(fit.lin.state.parameters, ROBOT)
    assert e @ np.linalg.solve(fit.covariance[:9, :9], e) / 9 < 3


@pytest.mark.parametrize(
    ("robot", "seed"),
    [("tick", 1), *(pytest.param(*case, marks=pytest.mark.long) for case in (("tick", 2), ("paper", 2)))],
)
def test_a_separation_whose_sign_is_noise_is_not_determined(robot, seed):
    """Refused before: "the wheel separation is -3607.4 mm", or "one of the wheels counts in the other direction"."""
    rough = replace(imperfect.USUAL, wheel_rad_per_sqrt_rad=0.01)
    extraction = simulated("straight", rough, robot, seed=seed)
    verdict = judge(solve(extraction), extraction)
    assert verdict.level == "NOT ENOUGH"
    assert "The wheel separation is not determined: the base turned by" in verdict.reason


@pytest.mark.parametrize("by_px", [pytest.param(1.0, marks=pytest.mark.long), 8.0])
def test_a_base_at_rest_with_constant_encoders_and_a_wrong_camera(by_px):
    lower = {"principal_right_y": by_px / 640}
    extraction = simulated("base_fixed", NOISE, ROBOT, seed=1, constants=lower)
    (track,) = extraction.wheels
    still = (np.full(len(track.time_ns), rad) for rad in (1.234, -3.3))
    extraction = replace(extraction, wheels=(WheelTrack.at_same_times(track.time_ns, *still),))
    found = solve(extraction)
    assert found.uncertainty.noise.wheel_rad_per_sqrt_rad < 0.02
    assert np.all(np.isfinite(found.uncertainty.covariance))
    assert found.uncertainty.observable.tolist() == [True] * 6 + [False] * 3
    verdict = judge(found, extraction)
    assert verdict.level == "NOT ENOUGH"
    assert "turn the base by 20 degrees or more between stops; drive forward" in verdict.next_step


# -- prismatic joints -------------------------------------------------------------------------------


def on_a_lift(extraction, readings_m):
    """The same robot on a lift at the base that does not move, with some readings."""
    rig = extraction.rig
    links = (JointLink("lift", np.array([0.0, 0.0, 1.0]), "prismatic"), *rig.chain.links)
    seen = tuple(
        replace(o, joints=np.append(reading, o.joints), joints_std=np.append(0.0, o.joints_std))
        for o, reading in zip(extraction.observations, readings_m, strict=True)
    )
    rig = replace(rig, chain=replace(rig.chain, links=links))
    return replace(extraction, rig=rig, observations=seen, joint_tracks=())


@pytest.mark.long
def test_a_wrong_reading_of_a_prismatic_joint_is_told_in_mm():
    readings_m = 5e-5 * np.random.default_rng(1).normal(size=12)
    readings_m[5] += 0.04
    extraction = on_a_lift(recorded("standard", 1), readings_m)
    found = solve(extraction)
    (outlier,) = found.outliers
    assert (outlier.kind, outlier.observations) == ("joint", (5,))
    (error_mm,) = re.findall(r"joint lift is wrong by \+([\d.]+) mm", outlier.text)
    assert float(error_mm) == pytest.approx(40, abs=2)
    assert found.uncertainty.noise.joint_rad < 0.002
    rows = rows_of(made(found, extraction), "limits", "Measurement noise")
    assert rows["joint reading, revolute"][1] == "deg"
    assert rows["joint reading, prismatic"][1] == "mm"
    mm, deg = (float(rows[f"joint reading, {kind}"][0]) for kind in ("prismatic", "revolute"))
    assert mm == pytest.approx(100 * np.radians(deg), rel=0.05)


def test_the_joint_noise_of_a_head_with_prismatic_joints_only_is_in_mm():
    extraction = recorded("standard", 1)
    found = solve(extraction)
    lift = JointLink("lift", np.array([0.0, 0.0, 1.0]), "prismatic")
    chain = replace(extraction.rig.chain, links=(lift,), pan="", tilt="")
    lifted = replace(extraction, rig=replace(extraction.rig, chain=chain))
    (table,) = noise(case_of(found, lifted))
    assert [unit for meaning, _, unit, _ in table.rows if meaning == "joint reading"] == ["mm"]
    check = judge(found, lifted).check("noise.sliding_joint")
    assert (check.limit, check.unit, check.outcome) == (0.7, "mm", "pass")


# -- fixed parameters -------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("motion", "fixed", "wanted"),
    [
        ("base_fixed", "wheels", None),
        ("straight", "head_eye", "turn the base"),
        # The gaps of each motion: tests/calibrate/test_gaps.py.
        *(
            pytest.param(*case, marks=pytest.mark.long)
            for case in (("standard", "head_eye", None), ("head_fixed", "wheels", "tilt the head"))
        ),
    ],
)
def test_the_verdict_asks_for_the_motion_that_free_parameters_need(motion, fixed, wanted):
    extraction = recorded(motion, 2)
    extraction = replace(extraction, rig=replace(extraction.rig, nominal=true_nominal(ROBOT)))
    found = solve(extraction, constraints=constraints_of([fixed], [], []))
    verdict = judge(found, extraction)
    if wanted:
        assert verdict.level == "NOT ENOUGH"
        assert wanted in verdict.next_step
    else:
        assert verdict.level == "PASS", verdict.reason
        assert found.diagnosis is None


@pytest.mark.long
@pytest.mark.parametrize(
    ("case", "seed", "count"),
    [
        (imperfect.Case(stations=24), 2, 5),
        (imperfect.Case(stations=40), 2, 8),
        (imperfect.Case(motion="moving"), 5, 8),
    ],
)
def test_slips_that_are_scattered_are_no_jump(case, seed, count):
    """A jump that explained two of eight was named: "the board moved by 185 mm and 4.8 degrees"."""
    extraction = case.drawn(noise=imperfect.CORRELATED).extraction(seed)
    random = np.random.default_rng(seed)
    for leg in random.choice(len(extraction.observations) - 1, count, replace=False).tolist():
        turn = random.choice([-1, 1]) * random.uniform(0.05, 0.3)
        extraction = slipped(extraction, leg, *((turn, 0.0) if random.random() < 0.5 else (0.0, turn)))
    solution = solve(extraction)
    assert len([o for o in solution.outliers if o.kind == "slip"]) >= count - 1
    assert not solution.jumps
    assert judge(solution, extraction).level == "PASS"


@pytest.mark.long
def test_many_outliers_of_a_kind_are_noise():
    """Pan and tilt read wrong by about a degree at half of the stations, where 0.05 degrees are usual."""
    extraction, random = recorded("standard", 1), np.random.default_rng(0)
    seen = list(extraction.observations)
    for k in range(0, len(seen), 2):
        seen[k] = replace(seen[k], joints=seen[k].joints + np.radians(1.0) * random.normal(size=4))
    found = solve(replace(extraction, observations=tuple(seen)))
    assert not found.outliers
    assert found.uncertainty.noise.joint_rad > np.radians(0.3)
    assert nees(found) < 3


def test_discrepancies_that_do_not_matter_are_no_outliers():
    """Corners of 0.002 px and exact wheels, and one leg that is wrong by a fifth of a millimeter."""
    noise = Noise(0.002, 1e-5, 0.0, 1e-6)
    found = solve(slipped(recorded("standard", 1, noise=noise), 5, 5e-4, 5e-4))
    assert not [o for o in found.outliers if o.kind == "slip"]


def test_corners_that_only_the_stated_camera_rejects_are_used():
    """The left camera's radial distortion is 20 times its usual error: corners near the edges miss a flat board."""
    robot = TICK_ROBOT
    noise = replace(STATION_NOISE, pixel_px=0.05, joint_rad=2e-4, wheel_rad_per_sqrt_rad=0.003)
    extraction = simulated(noise=noise, robot=robot, constants={"distortion_left_radial_1": 0.016})
    data = dataset_of(extraction)
    truth = Parameters(robot.T_h_c, robot.wheels)
    corners, _, _ = gross_corners(start_state(data, truth, Inliers.all_of(data)))
    assert not corners.all()
    found = solve(extraction)
    assert not found.outliers
    assert "distortion" in {e.kind for e in found.contradictions}


def test_gross_corners_that_the_stated_pair_accepts():
    """The right camera is rolled by 0.05 degrees: every board misses by as much as the few corners that are 3 px off."""
    robot, random = TICK_ROBOT, np.random.default_rng(5)
    noise = replace(STATION_NOISE, pixel_px=0.1, joint_rad=4e-4, wheel_rad_per_sqrt_rad=0.003)
    ideal = simulated(noise=noise, robot=robot, constants={"stereo_r_x": 0.001})
    bad = random.random((len(ideal.observations), 2, ideal.board.corners)) < 0.05
    moved = 3.0 * np.exp(2j * np.pi * random.random(bad.shape)) * bad
    observations = []
    for o, of_station in zip(ideal.observations, moved, strict=True):
        left, right = (
            replace(view, pixels=view.pixels + np.column_stack([at.real, at.imag]))
            for view, at in zip(o.views, of_station, strict=True)
        )
        points_k = ideal.board.grid() * ideal.board.square_m
        observations.append(measured_anew(ideal.rig.cameras, o, points_k, left, right))
    extraction = replace(ideal, observations=tuple(observations))
    found = solve(extraction)
    assert sum(o.kind == "corners" for o in found.outliers) == np.sum(bad.any(axis=(1, 2)))
    assert np.abs(errors(found.parameters, robot) / found.uncertainty.std).max() < 4
    assert judge(found, extraction).level == "PASS"


@pytest.mark.parametrize("fixed", [pytest.param(NINE[:6], marks=pytest.mark.long), ("t_x", "r_z")])
def test_fixed_values_are_those_of_the_reference_camera(fixed):
    """The stereo pair is 0.3 degrees off: the right camera stays, and the left one moves with the estimated pair."""
    robot = TICK_ROBOT
    noise = replace(STATION_NOISE, pixel_px=0.05, joint_rad=2e-4, wheel_rad_per_sqrt_rad=0.003)
    pair = {"stereo_r_y": 0.005, "baseline_scale": 0.02}
    ideal = simulated(noise=noise, robot=robot, constants=pair)
    cameras = replace(ideal.rig.cameras, reference="right")
    true_pair = ActualRobot(robot, pair).rig_cameras
    T_h_right = robot.T_h_c @ true_pair.T_c_each[1]
    nominal = replace(ideal.rig.nominal, T_h_reference=T_h_right)
    extraction = replace(ideal, rig=replace(ideal.rig, cameras=cameras, nominal=nominal))
    found = solve(extraction, constraints=Constraints(fixed=dict.fromkeys(fixed)))
    right = Parameters(found.parameters.T_h_c @ found.cameras.T_c_each[1], found.parameters.wheels)
    off = right.minus(Parameters(T_h_right, robot.wheels))
    std = np.sqrt(np.diag(found.uncertainty.reference_covariance))
    exact = np.isin(NINE, fixed)
    assert np.abs(off[exact]).max() < 1e-8
    assert not std[exact].any()
    assert np.all(np.abs(off[~exact]) < 4 * std[~exact])


def test_corners_are_triangulated_again_in_cameras_far_from_the_stated():
    """Principal points many pixels off: undamped steps from far points ended in a singular matrix."""
    off = imperfect.Case(kinds={"principal_point": 5.0})
    run = imperfect.run_of(off.extraction(26), imperfect.ROBOTS["pan-tilt"])
    assert set(run.named) == {"principal_point"}
    assert run.nees[3] < 2


@pytest.mark.long
def test_a_camera_fixed_to_the_base_with_a_bad_station():
    """Without joints no reading can be rejected instead of the images: the minimum of nothing raised ValueError."""
    drive = simulated("head_fixed", Noise(0.1, 0.003), "tick", 14, seed=0)
    T_v_h = head_pose(drive.rig.chain, drive.observations[0].joints[None])[0]
    fixed = replace(drive.rig.chain, links=(FixedLink(T_v_h),), pan="", tilt="")
    seen = [replace(o, joints=np.zeros(0), joints_std=np.zeros(0)) for o in drive.observations]
    left, right = (replace(c, pixels=c.pixels + 25) for c in (seen[5].views[0], seen[5].views[1]))
    seen[5] = with_views(seen[5], left=left, right=right)
    rig = replace(drive.rig, chain=fixed)
    solution = solve(replace(drive, rig=rig, observations=tuple(seen), joint_tracks=((),)))
    assert [outlier.observations for outlier in solution.outliers] == [(5,)]


@pytest.mark.long
def test_a_prior_of_the_user_that_the_data_contradict_is_told_once():
    extraction = imperfect.Case(stations=12).extraction(0)
    found = solve(extraction, constraints=Constraints(priors={"focal_left": (0.02, 0.0005)}))
    named = [(e.kind, e.part) for e in found.contradictions]
    assert named[0] == ("focal_length", "left camera")
    assert named.count(named[0]) == 1


def test_the_scale_is_compared_with_the_mean_of_the_users_prior():
    """Squares that the user measured as 1 % larger than stated, and that are: nothing is contradicted."""
    extraction = imperfect.Case(stations=12, fixed={"square_scale": 0.01}).extraction(0)
    found = solve(extraction, constraints=Constraints(priors={"square_scale": (0.01, 0.0005)}))
    assert found.contradictions == ()
    assert not found.scale.apart
    assert found.scale.ratio == pytest.approx(1.01, abs=4 * found.scale.std)


def carried(extraction, *legs):
    """The robot is picked up and put elsewhere on some legs: its wheels stand still meanwhile."""
    (track,) = extraction.wheels
    times, rolled = track.time_ns, np.stack([track.right_rad, track.left_rad])
    for leg in legs:
        ends = [extraction.observations[k].time_ns for k in (leg, leg + 1)]
        here, there = (np.array([np.interp(at, times, each) for each in rolled])[:, None] for at in ends)
        during = np.where(times < ends[1], here, rolled - (there - here))
        rolled = np.where(times <= ends[0], rolled, during)
    return replace(extraction, wheels=(WheelTrack.at_same_times(times, *rolled),))


@pytest.mark.parametrize(
    ("robot", "stations", "legs"),
    [
        ("pan-tilt", 12, (5,)),
        pytest.param("camera on the base", 18, (8,), marks=pytest.mark.long),
        pytest.param("pan-tilt", 18, (3, 8, 14), marks=pytest.mark.long),
        pytest.param("pair on the base", 18, (3, 8, 14), marks=pytest.mark.long),
    ],
)
def test_a_robot_that_is_carried_slips_and_changes_nothing(robot, stations, legs):
    """Refused, or FAIL with a camera that moved by 276 mm, before: legs without motion had no part in any decision."""
    case = imperfect.Case(robot, stations=stations)
    extraction = carried(case.extraction(1), *legs)
    solution = solve(extraction)
    assert [o.observations for o in solution.outliers if o.kind == "slip"] == [(k, k + 1) for k in legs]
    assert not solution.jumps
    run = imperfect.judged(
        solution, extraction, imperfect.true_robot(imperfect.ROBOTS[robot], extraction, case.route(1))
    )
    assert run.level == "PASS"
    assert np.abs(run.error / run.std).max() < 4


@pytest.mark.parametrize(
    ("stations", "station"), [(10, 9), *(pytest.param(14, at, marks=pytest.mark.long) for at in (0, 12, 13))]
)
def test_a_station_that_shows_another_board_is_left_out(stations, station):
    """The last one: no convergence after 100 s. To first order, its own misfit was hundreds of times as large as it is."""
    noise = Noise(0.1, 0.003, 0.0, 3.5e-4)
    whole, other = (simulated("standard", noise, stations=stations, seed=seed) for seed in (1, 9))
    seen, elsewhere = list(whole.observations), other.observations[station]
    mine = {name: getattr(seen[station], name) for name in ("joints", "time_ns", "station")}
    seen[station] = replace(elsewhere, **mine)
    found = solve(replace(whole, observations=tuple(seen)))
    assert [(o.kind, o.observations) for o in found.outliers] == [("station", (station,))]
    assert np.abs(errors(found.parameters, ROBOT) / found.uncertainty.std).max() < 4
