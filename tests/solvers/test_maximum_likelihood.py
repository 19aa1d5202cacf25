"""The estimate that uses everything, on observations straight from the truth."""

from dataclasses import replace

import numpy as np
import pytest

from mobilecal_cli import se3
from mobilecal_cli.errors import ConfigError, SolveError
from mobilecal_cli.kinematics import head_pose
from mobilecal_cli.likelihood import between
from mobilecal_cli.likelihood.constants import table
from mobilecal_cli.likelihood.dataset import dataset_of
from mobilecal_cli.model.calibration import NINE
from mobilecal_cli.model.observations import Corners, WheelTrack
from mobilecal_cli.model.rig import Nominal
from mobilecal_cli.model.signals import Track
from mobilecal_cli.model.solution import Noise
from mobilecal_cli.simulate.record import nanoseconds
from mobilecal_cli.simulate.robot import PAPER_ROBOT, TICK_ROBOT
from mobilecal_cli.simulate.route import plan_route
from mobilecal_cli.solvers import constraints_of, solve
from mobilecal_cli.solvers import maximum_likelihood as recipe
from mobilecal_cli.solvers.noise import LevelSearch, Slope, slopes
from tests.bench.simulated import as_described, errors, spoiled
from tests.extractions import Noise as Disturbance
from tests.extractions import joined, simulated
from tests.fits import maximum_likelihood
from tests.pairs import with_views
from tests.robots import chain_of, three_on_pan_tilt
from tests.truth import nees

ROBOT = PAPER_ROBOT
NOISE = Disturbance(0.2, 0.003, 0.0, np.radians(0.05))
GIVEN = {"pixel_px": 0.2, "wheel_rad_per_sqrt_rad": 0.003, "joint_rad": float(np.radians(0.05))}


def extraction_of(motion="standard", seed=1, noise=NOISE, stations=12, **more):
    return simulated(motion, noise, ROBOT, stations, seed, **more)


def misstated(name, by, robot=ROBOT, noise=NOISE, stations=12):
    """A recording of a robot whose description is wrong by so much."""
    return simulated("standard", noise, robot, stations, 1, constants={name: by})


def with_noise(extraction, known=GIVEN):
    return replace(extraction, rig=replace(extraction.rig, noise=known))


def named(solution, name):
    return solution.uncertainty.std[NINE.index(name)], solution.uncertainty.observable[NINE.index(name)]


@pytest.fixture(scope="module")
def noisy():
    return extraction_of()


@pytest.fixture(scope="module")
def solution(noisy):
    return solve(noisy)


def test_exact_observations_give_the_exact_answer():
    """The weak priors of the nine pull by the square of their sigmas' ratio."""
    exact = extraction_of(noise=None)
    described, found = maximum_likelihood(as_described(exact)), maximum_likelihood(exact)
    # Priors pull by as much: stops give way.
    assert np.abs(errors(described.lin.state.parameters, ROBOT)).max() < 1e-6
    std = np.sqrt(np.diag(found.covariance)[:9])
    assert np.abs(errors(found.lin.state.parameters, ROBOT) / std).max() < 0.01


def test_noise_levels_are_those_of_the_simulation_or_as_given(noisy):
    levels = solve(as_described(noisy)).uncertainty.noise
    assert levels.pixel_px == pytest.approx(0.2, rel=0.1)
    assert levels.wheel_rad_per_sqrt_rad == pytest.approx(0.003, rel=0.7)
    assert levels.joint_rad == pytest.approx(np.radians(0.05), rel=0.5)
    assert set(levels.estimated) == {"pixel_px", "wheel_rad_per_sqrt_rad", "joint_rad"}
    every = Noise.limits("guess") | {"encoder_rad": 0.001}
    levels = solve(with_noise(noisy, every)).uncertainty.noise
    assert (levels.estimated, levels.levels) == ((), every)


def test_a_level_at_its_limit_leads_no_further():
    """A perfectly flat floor is alike over any distance."""
    fit, most = maximum_likelihood(extraction_of(noise=None)), Noise.limits("most")["floor_length_m"]
    lin = fit.lin.with_noise(fit.noise.with_levels({"floor_length_m": most}))
    far = replace(fit.noise, floor_length_m=1e6 * most)
    assert slopes(lin, frozenset(), far)["floor_length_m"].rise == 0
    assert slopes(lin, frozenset(), fit.noise)["floor_length_m"].rise > 0


def test_a_search_for_levels_descends_where_two_act_alike():
    """A long valley between two levels, with a hill behind the start: a search for slopes of zero may end there."""
    search, level = LevelSearch(), Noise(**Noise.limits("guess") | {"encoder_rad": 0.0}, wider={})
    names = ("floor_rad", "sway_rad")
    bottom = np.log([getattr(level, name) for name in names]) + np.array([0.6, -0.9])
    for _ in range(40):
        together, apart = np.array([[1.0, 1.0], [1.0, -1.0]]) @ (
            np.log([getattr(level, n) for n in names]) - bottom
        )
        of_valley = np.tanh(apart)
        rise = np.array([200 * together + of_valley, 200 * together - of_valley])
        found = {name: Slope(r, 200.0) for name, r in zip(names, rise.tolist(), strict=True)}
        level = search.next(level, found, {})
    assert np.log([getattr(level, name) for name in names]) == pytest.approx(bottom, abs=1e-3)


def test_a_search_does_not_step_over_the_level_that_it_looks_for():
    """Where nothing fits, one step made a level a hundredth as large, and the next a hundred times, for ever."""
    search, level, bottom = (
        LevelSearch(),
        Noise(**Noise.limits("guess") | {"encoder_rad": 0.0}, wider={}),
        0.002,
    )
    visited = []
    for _ in range(30):
        steep = (bottom / level.wheel_share) ** 2
        # The likelihood's rise, with a bend that is right beyond the bottom alone.
        level = search.next(level, {"wheel_share": Slope(1 - steep, 0.2)}, {})
        visited.append(level.wheel_share)
    assert visited[-1] == pytest.approx(bottom, rel=1e-3)
    assert min(visited) > 1e-3 * bottom


@pytest.mark.long
def test_play_of_the_encoders_is_told_from_noise_of_the_wheels():
    # Every stop is read wrong by whole steps, 2 on average.
    step, random = np.radians(1.2), np.random.default_rng(3)
    extraction = extraction_of(seed=3, noise=replace(NOISE, encoder_step_rad=step), stations=30)
    track, stops = extraction.wheels[0], [o.time_ns for o in extraction.observations]
    play = np.zeros((len(track.time_ns), 2))
    play[np.searchsorted(track.time_ns, stops)] = step * np.round(2 * random.normal(size=(30, 2)))
    both = track.right_rad + play[:, 0], track.left_rad + play[:, 1]
    track = WheelTrack.at_same_times(track.time_ns, *both)
    played = replace(extraction, wheels=(track,))

    levels = solve(played).uncertainty.noise
    assert levels.encoder_rad == pytest.approx(2 * step, rel=0.25)
    assert levels.wheel_rad_per_sqrt_rad == pytest.approx(0.003, rel=0.7)
    assert levels.redundancy["encoder_rad"] > 20

    given = solve(with_noise(played, {"encoder_rad": step})).uncertainty.noise
    assert given.encoder_rad == step
    assert "encoder_rad" not in given.estimated


def on_two_topics(seed, steps_rad):
    """A drive without stops whose wheels have encoders, rates and stamps of their own."""
    route, random = plan_route(ROBOT, "moving", seed=seed), np.random.default_rng(seed)
    wheels = []
    for side, (step, late_s, period_s) in enumerate(zip(steps_rad, (0, 0.0137), (0.02, 0.0231), strict=True)):
        times_s = np.arange(late_s, route.duration_s, period_s)
        angles = route.drive.wheel_angles(times_s, ROBOT.wheels)[:, side]
        slip = 0.003 * np.sqrt(np.abs(np.diff(angles))) * random.normal(size=len(angles) - 1)
        angles = angles + np.append(0, np.cumsum(slip))
        wheels.append(Track(nanoseconds(times_s), np.floor(angles / step) * step if step else angles))
    still = extraction_of("moving", seed, replace(NOISE, wheel_rad_per_sqrt_rad=0.0))
    return replace(still, wheels=(WheelTrack(*wheels),))


@pytest.mark.parametrize(
    "finer_deg", [*(pytest.param(deg, marks=pytest.mark.long) for deg in (2.67, 0.9)), 0.0]
)
def test_encoders_on_two_topics_keep_their_steps(finer_deg):
    """Measured with equal steps, seeds 0 to 5: 0.5 to 4.2 mm, stated 1.3 to 2.1; without the steps 0.1 to 13 mm."""
    steps = np.radians([2.67, finer_deg])
    extraction = on_two_topics(0, steps)
    data = dataset_of(extraction)
    assert data.encoder_step_rad == pytest.approx(steps)
    assert data.encoder_shares == pytest.approx(np.maximum(steps / steps[0], 1e-3))
    fit = maximum_likelihood(extraction)
    assert 0 < fit.lin.noise.encoder_rad < steps[0]
    off, std = errors(fit.lin.state.parameters, ROBOT), np.sqrt(np.diag(fit.covariance)[:9])
    assert np.abs(off / std).max() < 3
    assert abs(off[8]) < 2 * std[8]
    assert std[8] < 2.5e-3


def test_shares_of_the_noise_add_up_to_the_covariance(noisy):
    """The budget adds up exactly; noise levels make up all of it but the weak priors' share."""
    fit = maximum_likelihood(as_described(with_noise(noisy)))
    budget = fit.budget
    total = sum(budget.values())
    assert np.allclose(total, fit.lin.covariance, rtol=1e-9, atol=1e-15)
    assert np.abs(np.diag(budget["other"])[:9] / np.diag(total)[:9]).max() < 1e-4
    assert {"pixel_px", "joint_rad", "wheel_rad_per_sqrt_rad", "nominal"} <= budget.keys()
    assert np.array_equal(fit.covariance, fit.lin.covariance)


def test_the_budget_of_an_unobservable_parameter_is_its_prior():
    fit = maximum_likelihood(with_noise(extraction_of("straight", seed=3)))
    k = NINE.index("separation")
    budget = fit.budget
    assert np.allclose(sum(budget.values()), fit.lin.covariance, rtol=1e-9, atol=1e-15)
    assert budget["unobservable"][k, k] > 0.99 * fit.lin.covariance[k, k]


def test_the_jackknife_agrees_over_many_legs():
    found = solve(extraction_of(seed=2, stations=24)).uncertainty
    assert np.abs(np.log(found.jackknife_std / found.std)).max() < np.log(1.8)


@pytest.mark.parametrize(
    ("motion", "held"),
    [("head_fixed", ("t_y",)), ("straight", ("separation",))],  # others: tests/calibrate/test_gaps.py
)
def test_what_the_motion_hides_is_held_and_the_rest_is_sound(motion, held):
    extraction = with_noise(extraction_of(motion, seed=3))
    found = solve(extraction)
    seen = found.uncertainty.observable
    assert tuple(name for name, ok in zip(NINE, seen, strict=True) if not ok) == held
    ratio = errors(found.parameters, ROBOT)[seen] / found.uncertainty.std[seen]
    assert np.abs(ratio).max() < 4


def test_a_head_held_tilted_hides_the_base_s_vertical_and_no_more():
    """The drawing is wrong by (4, 3, -6) mm: along the vertical it stays so, across it the log puts it right."""
    robot, tilt = TICK_ROBOT, np.array([0.0, np.radians(20)])
    level, tilted = head_pose(chain_of(robot), np.stack([np.zeros(2), tilt]))
    T_h_c = se3.inverse(tilted) @ level @ robot.T_h_c  # the same camera on a tilted head
    wrong = T_h_c.copy()
    wrong[:3, 3] += (0.004, 0.003, -0.006)
    extraction = simulated("head_fixed", NOISE, robot, seed=2)
    seen = tuple(replace(o, joints=o.joints + tilt) for o in extraction.observations)
    nominal = replace(extraction.rig.nominal, T_h_reference=wrong @ extraction.rig.cameras.T_c_reference)
    rig = replace(extraction.rig, nominal=nominal)
    found = solve(replace(extraction, observations=seen, rig=rig, joint_tracks=()))

    vertical_h = tilted[2, :3]
    translation = found.uncertainty.covariance[3:6, 3:6]
    assert translation @ vertical_h == pytest.approx(0.1**2 * vertical_h, abs=1e-4)
    hidden = {name for name, ok in zip(NINE, found.uncertainty.observable, strict=True) if not ok}
    assert {"t_z"} <= hidden <= {"t_x", "t_z"}
    off = found.parameters.T_h_c[:3, 3] - T_h_c[:3, 3]
    assert off @ vertical_h == pytest.approx((wrong - T_h_c)[:3, 3] @ vertical_h, abs=2e-4)
    across = off - off @ vertical_h * vertical_h
    basis = np.linalg.svd(vertical_h[None])[2][1:]
    covariance = basis @ translation @ basis.T
    assert (basis @ across) @ np.linalg.solve(covariance, basis @ across) < 15  # two degrees of freedom


def test_a_head_that_never_moves_needs_a_nominal_height():
    extraction = extraction_of("head_fixed", seed=3, nominal=False)
    with pytest.raises(SolveError, match="is not stated"):
        solve(extraction)


def test_fixed_numbers_stay(noisy):
    found = solve(noisy, constraints=constraints_of(["t_x=0.02", "wheels"], [], []))
    assert found.parameters.T_h_c[0, 3] == pytest.approx(0.02, abs=1e-12)
    assert found.parameters.wheels == noisy.rig.nominal.wheels
    assert found.uncertainty.fixed.tolist() == [name in ("t_x", *NINE[6:]) for name in NINE]
    assert not found.uncertainty.observable[NINE.index("t_x")]


@pytest.mark.long
def test_a_prior_weighs_as_much_as_it_states(noisy):
    """A prior of a tenth of the estimate's own sigma wins by 100 to 1."""
    free = solve(with_noise(noisy))
    std = float(named(free, "separation")[0])
    wanted = free.parameters.wheels.separation_m + 3 * std
    asked = constraints_of([], [f"separation={wanted!r}±{std / 10!r}"], [])
    found = solve(with_noise(noisy), constraints=asked)
    pulled = (found.parameters.wheels.separation_m - free.parameters.wheels.separation_m) / (3 * std)
    assert pulled == pytest.approx(100 / 101, abs=0.01)
    assert named(found, "separation")[0] == pytest.approx(std / np.sqrt(101), rel=0.02)


@pytest.mark.parametrize(
    ("fix", "prior", "estimate", "said"),
    [
        (["radius_rihgt"], [], [], "did you mean radius_right"),
        (["t_x=wide"], [], [], "not a number"),
        (["wheels=0.2"], [], [], "takes no value"),
        ([], ["t_x=0.1"], [], "VALUE±SIGMA"),
        ([], ["t_x=0.1±0"], [], "standard deviation: 0 is not possible"),
        ([], [], ["pan_zeroo"], "did you mean pan_zero"),
        ([], [], ["tilt_zero"], "cannot be estimated separately"),
        (["neck_zero"], [], [], "no such parameter"),
        (["focal_lft"], [], [], "did you mean focal_left"),
        ([], [], ["t_x"], "already estimated, like all nine parameters"),
        (["focal_length"], [], [], "--set priors.focal_length=fixed"),
        ([], ["joint_zero=0±1"], [], "--set priors.joint_zero=NUMBER"),
        (["square_scale=0.08"], [], [], "0.08 of the stated value is not possible (range -0.02 to 0.02"),
        (["square_scale=0.08"], [], [], "as a share (0.01 is 1 %), not the value itself"),
        (["focal_left=0.5"], [], [], "range -0.04 to 0.04 of the stated value"),
        ([], ["principal_left_x=320±1"], [], "range -0.06 to 0.06 of the image width"),
        (["pan_zero=5"], [], [], "range -0.174533 to 0.174533 rad); 5 looks like degrees: 0.08727 rad"),
        ([], ["pan_position_x=1.5±0.1"], [], "1.5 looks like millimeters: 0.0015 m"),
        (["baseline_x=1"], [], [], "1 looks like degrees"),
        (["readout=30"], [], [], "30 looks like milliseconds: 0.03 s"),
        (["r_x=5"], [], [], "5 looks like degrees: 0.08727 rad"),
        (["separation=0.3,,t_x"], [], [], "--fix : no such parameter"),
        (["t_x"], ["t_x=0.1±0.1"], [], "--prior t_x: given twice, also with --fix"),
    ],
)
def test_what_cannot_be_asked_is_said(fix, prior, estimate, said):
    rows = table(ROBOT.rig_cameras, chain_of(ROBOT))
    with pytest.raises(ConfigError) as caught:
        constraints_of(fix, prior, estimate).check([row.name for row in rows], Nominal())
    assert said in f"{caught.value.message} {caught.value.hint}"


def test_each_constant_of_a_robot_can_be_asked_for():
    """Whatever its cameras and joints are called."""
    rows = table(three_on_pan_tilt().rig_cameras, chain_of(ROBOT))
    names = [row.name for row in rows]
    assert any(row.kind == "camera_rotation" for row in rows)
    for row in rows:
        for asked in (([row.name], [], []), ([], [f"{row.name}=0±{row.sigma!r}"], []), ([], [], [row.name])):
            constraints_of(*asked).check(names, Nominal())


def test_bad_stations_and_a_slip_are_found_and_named(noisy):
    spoilt, bad, slip = spoiled(noisy, np.random.default_rng(0))
    found = solve(spoilt)
    left_out = {o.observations for o in found.outliers if o.kind == "station"}
    assert left_out == {(int(i),) for i in bad}
    (text,) = [o.text for o in found.outliers if o.kind == "slip"]
    assert f"between stations {slip} and {slip + 1}" in text
    assert " mm " in text
    assert " s:" in text
    assert nees(found.parameters, found.uncertainty.covariance, ROBOT) < 3


@pytest.mark.long
def test_wrong_readings_of_a_long_log_are_judged_a_few_at_a_time(monkeypatch):
    log = with_noise(extraction_of(stations=220))
    seen, wrong = list(log.observations), (20, 55, 90, 125, 160, 195)
    for at in wrong:
        joints = seen[at].joints.copy()
        joints[3] += 0.008  # nine sigma
        seen[at] = replace(seen[at], joints=joints)
    rounds, decided = [], recipe.once_decided
    monkeypatch.setattr(recipe, "once_decided", lambda *at: rounds.append(1) or decided(*at))
    fit = maximum_likelihood(replace(log, observations=tuple(seen)))
    assert [tuple(at) for at in np.argwhere(~fit.inliers.readings)] == [(at, 3) for at in wrong]
    assert len(rounds) == 3  # three, three, and nothing more


@pytest.mark.long
def test_a_pan_zero_is_found_and_named():
    """Two degrees, where half a degree is usual."""
    off = 0.035
    moved = misstated("pan_zero", off)
    free = solve(moved, constraints=constraints_of([], [], ["pan_zero"]))
    zero = free.constants["pan_zero"]
    assert abs(zero.value - off) < 4 * zero.std
    exact = solve(moved, constraints=constraints_of([f"pan_zero={off}"], [], []))
    assert exact.constants["pan_zero"].value == pytest.approx(off)
    assert exact.constants["pan_zero"].prior == 0
    assert max(exact.evidence, key=lambda e: e.sigmas).sigmas < 4


def test_a_robot_as_described_contradicts_nothing(solution):
    assert not solution.contradictions
    assert max(e.sigmas for e in solution.evidence) < 4
    kinds = {e.kind for e in solution.evidence}
    assert kinds >= {"joint_zero", "joint_position", "focal_length", "square_size"}
    assert not solution.scale.apart
    assert solution.scale.baseline_m == pytest.approx(0.12)


def test_wheels_that_differ_between_recordings_are_compared_by_themselves(monkeypatch):
    """Among all nine, tires of +0.6 and -0.4 % were chance: PASS, with the heading off by four sigmas."""
    seen = {}

    def recorded(dof, chi2):
        seen[dof] = chi2
        return 0.001 if dof == 3 else 0.5

    monkeypatch.setattr(between, "chdtrc", recorded)
    found = solve(joined(extraction_of(seed=1), extraction_of(seed=2))).between
    assert seen.keys() == {6, 3}
    assert found.between_std[6:].any()
    assert not found.between_std[:6].any()


@pytest.mark.parametrize(
    ("name", "kind", "by"),
    [
        *(("baseline_scale", "baseline_length", 0.02), ("backlash_pan", "backlash", 0.03)),
        *(
            pytest.param(*case, marks=pytest.mark.long)
            for case in (
                *(("focal_left", "focal_length", 0.02), ("principal_right_y", "principal_point", 0.03)),
                *(
                    ("stereo_r_y", "stereo_rotation", 0.03),
                    ("torso_pitch_joint_position_x", "joint_position", 0.03),
                ),
            )
        ),
    ],
)
def test_what_is_misstated_is_named_and_does_no_harm(name, kind, by):
    """Ten to thirty-five times the usual error of a description. A wrong baseline looks like wrong squares."""
    found = solve(misstated(name, by))
    named = {e.kind for e in found.contradictions}
    assert kind in named or (name == "baseline_scale" and "square_size" in named)
    assert nees(found.parameters, found.uncertainty.covariance, ROBOT) < 3


def test_a_wrong_link_between_pan_and_tilt_is_named():
    """5 cm along x. Small tilts hardly show it, and the floor's height could take it up: fifty times its prior says no."""
    robot = TICK_ROBOT
    noise = Disturbance(0.1, 0.003, 0.0, 4e-4, floor_rad=1e-3, floor_m=5e-4)
    found = solve(misstated("tilt_position_x", 0.05, robot, noise, stations=20))
    assert {e.kind for e in found.contradictions} == {"joint_position"}
    assert nees(found.parameters, found.uncertainty.covariance, robot) < 2.5


def test_corners_that_were_not_seen_have_no_say():
    """Half of the corners of each picture are hidden: wherever they are said to be, the answer is the same."""
    whole = extraction_of(seed=4, noise=Disturbance(0.2, 0.003, 0.0, 1e-3), stations=8)
    random = np.random.default_rng(4)

    def hidden(corners: Corners, shift_px: float) -> Corners:
        seen = np.random.default_rng(int(corners.pixels[0, 0] * 1e3)).random(len(corners.pixels)) < 0.5
        moved = corners.pixels + shift_px * random.normal(size=corners.pixels.shape) * ~seen[:, None]
        return replace(corners, pixels=moved, seen=seen)

    found = []
    for shift_px in (0.0, 30.0):
        views = [[hidden(view, shift_px) for view in o.views] for o in whole.observations]
        observations = (with_views(o, *each) for o, each in zip(whole.observations, views, strict=True))
        fit = maximum_likelihood(replace(whole, observations=tuple(observations)))
        assert np.array_equal(fit.inliers.corners, fit.data.seen)
        assert 0.4 < fit.data.seen.mean() < 0.6
        found.append(fit)
    a, b = (fit.lin.state.parameters for fit in found)
    np.testing.assert_allclose(a.T_h_c, b.T_h_c, atol=1e-6)
    assert a.wheels.separation_m == pytest.approx(b.wheels.separation_m, abs=1e-6)
    # Fewer corners, larger standard deviations.
    all_seen = maximum_likelihood(whole)
    assert np.all(np.diag(found[0].covariance)[:6] > np.diag(all_seen.covariance)[:6])


def test_commas_separate_several_constraints():
    asked = constraints_of(["t_x=0.02, r_y", "readout=0.03"], ["t_y=0±0.1,t_z=0.1+-0.1"], ["stereo,clock"])
    assert asked.fixed == {"t_x": 0.02, "r_y": None, "readout": 0.03}
    assert asked.priors == {"t_y": (0.0, 0.1), "t_z": (0.1, 0.1)}
    assert asked.constants[-1] == "clock"
