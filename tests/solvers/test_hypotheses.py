"""A mistake in the description is named: every sign, exchanges, units, frozen joints."""

import re
from contextlib import nullcontext, suppress
from dataclasses import replace
from functools import cache

import numpy as np
import pytest

from mobilecal_cli import se3
from mobilecal_cli.errors import SolveError
from mobilecal_cli.kinematics import MotionSeen
from mobilecal_cli.model.rig import SIDES, Nominal, WheelSource
from mobilecal_cli.model.signals import Track
from mobilecal_cli.simulate.robot import FIXED_CAMERA_ROBOT, TICK_ROBOT
from mobilecal_cli.solvers import solve
from mobilecal_cli.solvers.hypotheses import FREE_PARTS, FROZEN, STILL, WHOLE, _free_wheels, _noise_at_rest
from mobilecal_cli.solvers.readings import readings_of
from mobilecal_cli.solvers.search import Search, _two_boards, other_focal_lengths
from tests.bench import imperfect
from tests.extractions import Noise, joined, simulated
from tests.hostile import meaning
from tests.hostile.meaning import (
    PAN,
    WRONG,
    both,
    from_middle,
    joints,
    late,
    late_joints,
    same,
    wheels,
)
from tests.judging import judge
from tests.robots import true_nominal

ROBOT = TICK_ROBOT


NOISE = Noise(0.2, 0.003, 0.0, 1e-3)


@cache
def twelve():
    return simulated("standard", NOISE, ROBOT, seed=4)


@pytest.fixture
def recorded():
    return twelve()


def from_sixth(change):
    """Readings of a wheel that change at station 6."""
    return meaning.after(change, 6, twelve)


def with_tilt_reversed(extraction):
    chain = extraction.rig.chain
    sign = np.where(np.arange(len(chain.joints)) == chain.joints.index(chain.tilt), -1, 1)
    return replace(
        extraction, observations=tuple(replace(o, joints=sign * o.joints) for o in extraction.observations)
    )


STUCK = from_sixth(lambda v: 0 * v)


def test_a_robot_without_joints_has_no_mistake_in_their_readings():
    """A changed wheel was "the joint readings are in degrees": without joints, any such correction changes nothing."""
    robot = FIXED_CAMERA_ROBOT
    readings = readings_of(simulated("standard", NOISE, robot, seed=0))
    families = [family for stages in (WHOLE, FROZEN, FREE_PARTS) for stage in stages for family in stage]
    rows = [row.cause for family in families for row in family(readings)]
    assert rows
    assert not [cause for cause in rows if re.search(r"\bjoints?\b", cause)]


def said_of(extraction):
    """The error's message, or the verdict's reason."""
    try:
        verdict = judge(solve(extraction), extraction)
    except SolveError as error:
        return error.message
    return verdict.reason if verdict.level == "FAIL" else verdict.level


@pytest.mark.parametrize(
    ("factor", "named"), [(0.9, False), (1.0, False), (1.1, False), (0.5, True), (2.0, True), (3.0, True)]
)
def test_focal_lengths_that_the_likelihood_estimates_are_not_named(factor, named):
    diagnosis = other_focal_lengths(meaning.focal(factor, factor)(meaning.recorded()))
    assert (diagnosis is not None) == named
    assert not named or f"focal lengths of about {1 / factor:.2g} times those in" in diagnosis.cause


def test_boards_that_are_seen_alike_hardly_show_the_focal_length():
    """A pair on the base, all constants within their priors: "focal lengths of about 1.3 times those in camera_info"."""
    case = imperfect.Case("pair on the base", motion="moving", images=80, noise=imperfect.USUAL)
    assert other_focal_lengths(case.drawn(outside=imperfect.AS_PRINTED).extraction(0)) is None


def both_late(seconds):
    """Joints and wheels with delayed stamps, and encoders of the joints that are never quite at rest."""
    rng = np.random.default_rng(0)

    def change(made):
        moved = late_joints(seconds)(both(late(seconds))(made))
        noisy = (t.value + 1e-3 * rng.normal(size=t.value.shape) for t in moved.joint_tracks[0])
        tracks = (replace(t, value=v) for t, v in zip(moved.joint_tracks[0], noisy, strict=True))
        return replace(moved, joint_tracks=(tuple(tracks),))

    return change


#: Wrong recordings of `hostile.meaning`, and what must be said about each.
CAUSES = {
    "sign of pan": "the sign of joint pan_joint is reversed",
    "sign of tilt": "the sign of joint tilt_joint is reversed",
    "signs of both joints": "the signs of all head joints are reversed",
    "pan and tilt exchanged": "pan_joint and tilt_joint are exchanged",
    "joints in degrees": "the joint readings are in degrees",
    "joints taken for degrees": "are in radians, but were taken for degrees",
    "pan in degrees": "the readings of pan_joint are in degrees",
    "pan frozen": "the reading of pan_joint never changes",
    "tilt frozen": "the reading of tilt_joint never changes",
    "joints of the previous station": "the joint readings are those of the previous station",
    "both images of the previous station": "the images are those of the previous station",
    "sign of the right wheel": "the right wheel's encoder has the wrong sign",
    "sign of the left wheel": "the left wheel's encoder has the wrong sign",
    "signs of both wheels": "encoders of both wheels have the wrong sign",
    "wheels swapped": "the left and right wheels are swapped",
    "wheels in meters": "readings are in meters",
    "nominal wheels twice as large": "about half of the nominal 0.1640 m",
    "gear ratio 2 of both wheels": "about half of the nominal 0.0820 m",
    "gear ratio 1/2 of both wheels": "about twice the nominal 0.0820 m",
    "right wheel frozen": "the reading of the right wheel never changes",
    "both wheels frozen": "the readings of both wheels never change",
    "wheels 3 s late": "the readings of both wheels are about 3.0 s late",
}
MISTAKES = {name: (WRONG[name].change, cause) for name, cause in CAUSES.items()} | {
    "left wheel 3 s late": (wheels(same, late(3.0)), "the readings of the left wheel are about 3.0 s late"),
    "images 2 s early": (both_late(2.0), "the images are about 2.0 s early against the joints and wheels"),
    "images 2 s late": (both_late(-2.0), "the images are about 2.0 s late against the joints and wheels"),
    "pan stuck": (meaning.stuck(PAN, 6), "the reading of joint pan_joint does not change between"),
    "right wheel stuck": (wheels(STUCK, same), "the reading of the right wheel does not change between"),
    "both wheels stuck": (both(STUCK), "the readings of both wheels do not change between"),
    "pan reversed, joints in degrees": (
        lambda made: WRONG["joints in degrees"].change(WRONG["sign of pan"].change(made)),
        "the sign of joint pan_joint is reversed, and the joint readings are in degrees",
    ),
    "pan and tilt exchanged, right wheel reversed": (
        lambda made: WRONG["sign of the right wheel"].change(WRONG["pan and tilt exchanged"].change(made)),
        "pan_joint and tilt_joint are exchanged, and the right wheel's encoder has the wrong sign",
    ),
    "joints 2 s late, wheels swapped": (
        lambda made: WRONG["wheels swapped"].change(WRONG["joints 2 s late"].change(made)),
        "the joint readings are about 2.0 s late, and the left and right wheels are swapped",
    ),
    "left wheel reversed": (
        wheels(same, from_sixth(lambda v: -v)),
        "on, the left wheel's encoder has the wrong",
    ),
}
#: One of each kind, named by the diagnosis in every run.
QUICK = (
    "both images of the previous station",
    *("left wheel 3 s late", "images 2 s early", "both wheels frozen", "signs of both joints"),
)


@pytest.mark.parametrize(
    ("stations", "named"), [((), False), ((2, 3, 6, 8), True), ((7, 8, 9, 10, 11), False)]
)
def test_two_boards_that_are_in_view_alternately_are_named(recorded, stations, named):
    """They were "the readings of the wheels do not fit the drive"; a board that moved once is another mistake."""
    readings = readings_of(recorded)
    T_c_k = readings.T_c_k.copy()
    T_c_k[list(stations)] = T_c_k[list(stations)] @ se3.transform(np.eye(3), np.array([0.9, 0.0, 0.0]))
    found = _two_boards(replace(readings, T_c_k=T_c_k))
    assert (found is not None and "two boards 0.9 m apart" in found.cause) == named


def test_odometry_whose_poses_never_change_may_have_them_in_its_twist(recorded):
    """It has no encoders to check."""
    readings = readings_of(MISTAKES["both wheels frozen"][0](recorded))
    odometry = WheelSource("/odom", baked_in=ROBOT.nominal_wheels, assumed=True)
    sources = replace(readings.rig.sources, wheels=dict.fromkeys(SIDES, odometry))
    (row,) = _free_wheels(replace(readings, rig=replace(readings.rig, sources=sources)))
    assert row.cause.startswith("the poses of the odometry never change")
    assert "the twist is not read" in row.cure


@pytest.mark.parametrize("name", QUICK)
def test_the_diagnosis_names_the_mistake(recorded, name):
    spoil, cause = MISTAKES[name]
    assert cause in Search(spoil(recorded)).diagnosis.cause


@pytest.mark.parametrize("nominal", [true_nominal(ROBOT), Nominal(None, ROBOT.wheels)])
def test_mirrored_images_of_one_camera_are_named(nominal):
    """It was the sign of the tilt, with which all fits: PASS with the camera 9 cm away and turned around."""
    mirror, pair = np.diag([-1.0, 1, 1, 1]), twelve()
    rig = pair.rig
    alone = replace(
        rig.cameras,
        names=("camera",),
        each=rig.cameras.each[:1],
        T_c_each=np.eye(4)[None],
        R_rect=np.eye(3)[None],
        reference="camera",
        calibrated=False,
    )
    seen = [replace(o, T_c_k=mirror @ o.T_c_k @ mirror, views=o.views[:1]) for o in pair.observations]
    spoilt = replace(pair, observations=tuple(seen), rig=replace(rig, cameras=alone, nominal=nominal))
    cause = Search(spoilt).diagnosis.cause
    assert "the images are mirrored" in cause
    assert (cause == "the images are mirrored") == (nominal.T_h_reference is not None)


@pytest.mark.long
@pytest.mark.parametrize(
    ("name", "stated"),
    [
        ("right wheel frozen", None),
        ("pan frozen", ROBOT.wheels),
        ("pan frozen", None),
        ("tilt frozen", None),
        ("both wheels frozen", None),
    ],
)
def test_a_reading_that_never_changes_is_named_without_a_nominal_camera(recorded, name, stated):
    """It was "no known mistake explains it", or "the iterative linear method found no answer"."""
    spoilt = MISTAKES[name][0](recorded)
    unknown = replace(spoilt, rig=replace(spoilt.rig, nominal=Nominal(None, stated)))
    with pytest.raises(SolveError, match=CAUSES[name]) if "tilt" not in name else nullcontext():
        found = solve(unknown).diagnosis
        assert CAUSES[name] in found.cause


@pytest.mark.long  # of motions: tests/solvers/test_measured.py
@pytest.mark.parametrize("name", MISTAKES)
def test_the_solver_names_the_mistake(recorded, name):
    spoil, cause = MISTAKES[name]
    spoilt = spoil(recorded)
    assert cause in said_of(spoilt)


@pytest.mark.long
@pytest.mark.parametrize(("seed", "images"), [(70, 16), (75, 40), (77, 40)])
def test_a_wheel_whose_readings_stop_under_a_fixed_camera_is_named(seed, images):
    """Most legs fit without the stretch: it was "something changed"."""
    noise = Noise(0.2, 0.003, 0.0, 1e-4, floor_rad=1e-3, floor_m=5e-4)
    made = simulated("moving", noise, "fixed_camera", seed=seed, images=images)
    value = made.wheels[0].right.value.copy()
    value[len(value) * 3 // 4 :] = value[len(value) * 3 // 4]
    stopped = replace(made.wheels[0].right, value=value)
    spoilt = replace(made, wheels=(replace(made.wheels[0], right=stopped),))
    assert "the reading of the right wheel does not change between" in said_of(spoilt)


@pytest.mark.long
def test_encoders_that_change_their_sign_under_a_fixed_camera_are_named():
    """Turned around, the camera fits the others: it was "a wheel, a joint or a camera changes"."""
    made = simulated("standard", NOISE, "fixed_camera", stations=14, seed=3)
    change = meaning.after(np.negative, 7, lambda: made)
    assert re.search("from about .* on, the encoders of both wheels have", said_of(both(change)(made)))


@pytest.mark.long
def test_an_eccentric_wheel_is_not_blamed_on_a_joint_alone(recorded):
    """Pan explains what a short drive shows of a heading error, but the wheels explain more."""

    def eccentric(track):
        return replace(track, value=track.value + 0.15 * np.sin(track.value))

    assert "the readings of the wheels do not fit" in said_of(wheels(eccentric, same)(recorded))


@pytest.mark.long
def test_readings_of_pan_that_say_nothing_are_not_blamed_on_the_wheels():
    """The base turns as pan does: wheels that may read anything explain any readings of pan."""
    made = simulated("standard", NOISE, ROBOT, 9, seed=5)
    random = np.random.default_rng(5)
    off = [o.joints + np.array([random.normal(0, 0.2), 0.0]) for o in made.observations]
    observations = tuple(replace(o, joints=q) for o, q in zip(made.observations, off, strict=True))
    assert "the readings of pan_joint do not fit" in said_of(replace(made, observations=observations))


@pytest.mark.long
def test_the_named_mistake_is_the_only_one(recorded):
    """Wheels are not blamed for a joint: turned pan once said that both wheels were turned."""
    spoilt = WRONG["sign of pan"].change(recorded)
    with pytest.raises(SolveError, match=CAUSES["sign of pan"]) as caught:
        solve(spoilt)
    assert caught.value.explained
    assert "wheel" not in caught.value.message


def test_a_good_recording_has_no_diagnosis(recorded):
    assert Search(recorded).diagnosis is None
    assert solve(recorded).diagnosis is None


@pytest.mark.parametrize(
    ("right", "left", "cause"),
    [
        pytest.param(2.0, 1.0, "the right wheel's readings become 2 times as large", marks=pytest.mark.long),
        pytest.param(
            1.0, 1.3, "the left wheel's readings become 1.3 times as large between ", marks=pytest.mark.long
        ),
        (0.8, 0.8, "0.8 times as large and the left wheel's readings become 0.8 times as large between "),
    ],
)
def test_a_change_of_the_wheels_is_named(recorded, right, left, cause):
    sides = (from_sixth(lambda v, factor=factor: factor * v) for factor in (right, left))
    found = Search(wheels(*sides)(recorded)).diagnosis
    assert cause in found.cause
    assert found.cause.endswith("s: the recording fits before and after, but not as a whole")


@pytest.mark.long
@pytest.mark.parametrize(
    ("change", "cause"),
    [
        (lambda q: q * [-1, 1], "the sign of joint pan_joint is reversed"),
        (np.degrees, "the joint readings are in degrees"),
    ],
)
def test_joints_that_are_wrong_from_the_middle_on(change, cause):
    made = simulated("standard", NOISE, ROBOT, 20, 4)
    found = Search(from_middle(lambda o: replace(o, joints=change(o.joints)))(made)).diagnosis
    assert found.cause.startswith("from ")
    assert f" s on, {cause}" in found.cause


def test_a_board_that_moves_with_the_robot(recorded):
    first = recorded.observations[0]
    same = tuple(replace(o, T_c_k=first.T_c_k, points_c=first.points_c) for o in recorded.observations)
    found = Search(replace(recorded, observations=same)).diagnosis
    assert found.cause == "all stations show the board at the same place, but the base or the head moves"


@pytest.mark.long
def test_the_recording_with_the_mistake_is_named(recorded):
    second = simulated("standard", NOISE, ROBOT, seed=5)
    spoilt = wheels(meaning.times(-1), same)(second)
    found = Search(joined(recorded, spoilt)).diagnosis
    assert "recording 2 of 2: the right wheel's encoder has the wrong sign" in found.cause
    assert found.cure == "negate wheels.right.sign in rig.yaml, for this recording only"


@pytest.mark.long
def test_wheels_of_one_recording_that_fits_by_itself_are_named():
    """With a camera on the base, the base looks turned around: "no known mistake explains it"."""
    first, second = (simulated("standard", NOISE, "fixed_camera", stations=8, seed=seed) for seed in (4, 5))
    for change, cause in (
        (wheels(same, same, swapped=True), "recording 2 of 2: the left and right wheels are swapped"),
        (both(meaning.times(-1)), "recording 2 of 2: the encoders of both wheels have the wrong sign"),
    ):
        assert Search(joined(first, change(second))).diagnosis.cause == cause
    assert Search(joined(first, second)).diagnosis is None


def test_the_recording_with_the_pulled_cable_is_named(recorded):
    """Its seconds alone may be of either recording."""
    second = simulated("standard", NOISE, ROBOT, seed=5)
    (track,) = second.wheels
    half = len(track.left.value) // 2
    still = np.where(np.arange(len(track.left.value)) < half, track.left.value, track.left.value[half])
    spoilt = replace(second, wheels=(replace(track, left=replace(track.left, value=still)),))
    found = Search(joined(recorded, spoilt)).diagnosis
    assert found.cause.startswith("recording 2 of 2: the reading of the left wheel does not change between ")


@pytest.mark.long
def test_the_mistake_of_a_short_recording_beside_a_long_one_is_named():
    """Most legs fit without those of the short one."""
    long, short = simulated("standard", NOISE, ROBOT, 20, 4), simulated("standard", NOISE, ROBOT, 5, 5)
    found = solve(joined(long, with_tilt_reversed(short))).diagnosis
    assert found.cause == "recording 2 of 2: the sign of joint tilt_joint is reversed"


@pytest.mark.long
def test_the_mistake_of_a_recording_that_differs_from_the_other_is_named():
    """The difference alone is a zero of the tilt joint that changed by 11 degrees."""
    first, second = (simulated("standard", NOISE, ROBOT, 14, seed) for seed in (1, 2))
    solution = solve(joined(first, with_tilt_reversed(second)))
    assert [(jump.part, jump.station) for jump in solution.jumps] == [("joint tilt_joint", 14)]
    assert solution.diagnosis.cause == "recording 2 of 2: the sign of joint tilt_joint is reversed"


@pytest.mark.long
@pytest.mark.parametrize(("right_s", "left_s"), [(0.0, 2.0), (3.0, 3.0)])
def test_delays_in_a_short_recording_leave_readings_of_both_wheels(right_s, left_s):
    """A delay longer than the recording left no time that both wheels cover, and an IndexError."""
    short = simulated("standard", NOISE, ROBOT, 5, 0)
    with suppress(SolveError):
        solve(wheels(late(right_s), late(left_s))(short))


# -- causes that are true or absent ----------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "spoil", "cause"),
    [
        pytest.param("paper", late_joints(3.0), "the joint readings are about 3.", marks=pytest.mark.long),
        (
            "paper",
            joints(lambda q: q * [180 / np.pi, 1, 1, 1]),
            "readings of torso_pitch_joint are in degrees",
        ),
    ],
)
def test_a_wrong_sign_is_no_cure_for_another_mistake(name, spoil, cause):
    found = Search(spoil(simulated("standard", NOISE, name, seed=4))).diagnosis
    assert cause in found.cause
    assert "wrong sign" not in found.cause
    assert "sign" not in found.cure


@pytest.mark.parametrize(
    "name",
    [
        "right wheel 2 % larger from the middle",
        "pan 3 degrees off from the middle",
        "right images shifted by 15 px from the middle",
        *(
            pytest.param(name, marks=pytest.mark.long)
            for name in ("right wheel 5 % larger from the middle", "counters of 32 bits wrap in the middle")
        ),
    ],
)
def test_a_change_that_jumps_name_has_no_other_cause(name):
    found = Search(WRONG[name].change(meaning.recorded())).diagnosis
    assert found is None or found.cause.startswith("the readings of the wheels jump")


@pytest.mark.long
@pytest.mark.parametrize(
    "name", ["joints in steps of 5 degrees", "images of two stations exchanged", "board held in a hand"]
)
def test_nothing_is_named_for_what_no_hypothesis_explains(name):
    assert Search(WRONG[name].change(meaning.recorded())).diagnosis is None


@pytest.mark.long
@pytest.mark.parametrize(
    "name", ["right wheel in steps of 1 rad", "wheels of another drive", "wheels wrapped at one turn"]
)
def test_wheels_that_do_not_belong_to_the_recording(name):
    cause = "the readings of the wheels do not fit the drive that the images and the head joints show"
    assert Search(WRONG[name].change(meaning.recorded())).diagnosis.cause == cause


def test_a_head_that_only_pans_fits():
    """The other joints are at rest: their readings are right."""
    made = simulated("pan_only", NOISE, seed=3)
    assert Search(made).misfit is None
    assert Search(made).diagnosis is None


@pytest.mark.long
def test_a_sign_that_nothing_confirms_is_no_cure(recorded):
    """Joint readings of other stations: the linear method finds negative wheels for some orders."""
    order = np.random.default_rng(1).permutation(len(recorded.observations))
    joints = [o.joints for o in recorded.observations]
    mixed = tuple(replace(o, joints=joints[k]) for o, k in zip(recorded.observations, order, strict=True))
    with pytest.raises(SolveError) as caught:
        solve(replace(recorded, observations=mixed, joint_tracks=()))
    assert "no known mistake explains it: the point error is" in caught.value.message
    assert "Tried: signs" in caught.value.message
    assert "wrong sign" not in caught.value.message


def test_a_joint_with_a_single_reading_rests():
    """Published once, or all others without a value: the search for late readings ended in an IndexError."""
    once = Track(np.array([5_000_000_000]), np.array([0.1]))
    assert _noise_at_rest((once,)).tolist() == [STILL]


@pytest.mark.parametrize(("turned_rad", "roams"), [(0.6, False), (1.2, True)])
def test_wheels_that_differ_in_size_do_not_turn_a_base_that_drives_straight(turned_rad, roams):
    """Five meters straight with wheels 1.5 % apart: "the left and right wheels are swapped", it said."""
    readings = readings_of(simulated("standard"))
    vars(readings)["motion"] = MotionSeen(0.3, turned_rad, driven_rad=40.0, together_rad=0.0)
    assert readings.roams == roams


def test_a_wrong_sign_is_named_where_wheels_are_early_in_motion():
    """By 80 ms, as where images are late: the cause was that "the readings of the wheels do not fit the drive"."""
    made = simulated("moving", NOISE, ROBOT, 10, seed=4, images=20)
    (track,) = made.wheels
    right, left = (replace(t, time_ns=t.time_ns - 80_000_000) for t in (track.right, track.left))
    wrong = replace(made, wheels=(replace(track, right=right, left=replace(left, value=-left.value)),))
    with pytest.raises(SolveError, match="the left wheel's encoder has the wrong sign"):
        solve(wrong)
