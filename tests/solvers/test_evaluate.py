"""A calibration tried on a recording."""

import math
from dataclasses import replace

import numpy as np
import pytest

from mobilecal_cli import se3
from mobilecal_cli.kinematics import head_pose
from mobilecal_cli.model.calibration import Parameters
from mobilecal_cli.model.observations import WheelTrack
from mobilecal_cli.model.rig import WheelGeometry
from mobilecal_cli.simulate.robot import ROBOTS
from mobilecal_cli.solvers import clock_offsets, evaluate, solve
from tests.bench.imperfect import PERFECT, Case
from tests.extractions import Noise, joined, simulated
from tests.truth import parameters_of

ROBOT = ROBOTS["paper"]
TRUTH = parameters_of(ROBOT)


@pytest.fixture(scope="module")
def exact():
    return simulated(robot=ROBOT, seed=0, nominal=False)


def driven(exact, right_rad, left_rad, T_w_v):
    """Three stations of a drive that is spelled out here, not simulated; the head stays where it is."""
    joints = exact.observations[0].joints
    T_w_c = T_w_v @ head_pose(exact.rig.chain, joints) @ TRUTH.T_h_c
    T_w_k = T_w_c[0] @ exact.observations[0].T_c_k
    stations = zip(exact.observations[:3], se3.inverse(T_w_c) @ T_w_k, strict=True)
    seen = tuple(replace(o, joints=joints, T_c_k=T) for o, T in stations)
    track = WheelTrack.at_same_times(np.array([o.time_ns for o in seen]), right_rad, left_rad)
    return replace(exact, observations=seen, wheels=(track,))


def ahead(exact):
    """One meter straight ahead, with wheels of 100 mm."""
    T_w_v = se3.transform(np.tile(np.eye(3), (3, 1, 1)), np.array([[0, 0, 0], [0.4, 0, 0], [1.0, 0, 0]]))
    return driven(exact, [0.0, 4.0, 10.0], [0.0, 4.0, 10.0], T_w_v)


def test_the_truth_predicts_exactly_and_does_not_drift(exact):
    found = evaluate(exact, TRUTH, None)
    assert found.stations == 12
    assert found.legs.tolist() == [[0, k, k + 1] for k in range(11)]
    for errors in (found.reprojection_px, found.rotation_rad, found.translation_m):
        assert np.abs(errors).max() < 1e-6
    assert found.after.mm_per_m < 1e-6
    assert found.after.deg_per_turn < 1e-6
    assert found.before is None


@pytest.mark.parametrize(
    ("factor", "reference"), [(0.1, None), (10.0, None), (1000.0, WheelGeometry(0.1, 0.1, 0.5))]
)
def test_drift_is_not_measured_against_the_wheels_under_test(exact, factor, reference):
    """Ten times the radius: dead reckoning is off by nine times the way, whatever these wheels call the way."""
    wrong = Parameters(
        TRUTH.T_h_c, WheelGeometry(0.1 * factor, 0.1 * factor, 0.5 * (factor if reference else 1))
    )
    found = evaluate(ahead(exact), wrong, None, reference=reference)
    assert found.driven_m == pytest.approx(1.0)
    assert found.after.mm_per_m == pytest.approx(1e3 * abs(factor - 1), abs=1e-9)
    assert found.after.deg_per_turn is None  # it hardly turned


def test_drift_of_a_narrow_base_turning_in_place(exact):
    """By hand: psi = 2 r phi / b; a base of 500 mm taken for 400 mm turns by a quarter more."""
    turns = np.array([0.0, 0.5, 1.2])
    phi = turns * 0.5 / (2 * 0.1)
    T_w_v = se3.transform(se3.rotation_z(turns), np.zeros((3, 3)))
    extraction = driven(exact, phi, -phi, T_w_v)
    true = Parameters(TRUTH.T_h_c, WheelGeometry(0.1, 0.1, 0.5))
    found = evaluate(extraction, true, WheelGeometry(0.1, 0.1, 0.4))
    assert found.turned_rad == pytest.approx(1.2)
    assert found.before.deg_per_turn == pytest.approx(90)
    assert found.after.deg_per_turn == pytest.approx(0.0, abs=1e-6)
    assert found.before.mm_per_m is None  # it hardly drove


def test_a_turned_camera_is_seen_as_such(exact):
    """A camera that is turned by 1 degree about its own axis, with the head still and a straight drive: no rotation
    is mispredicted, and the way points 1 degree aside for directions across that axis.
    """
    T_w_v = se3.transform(np.tile(np.eye(3), (3, 1, 1)), np.array([[0, 0, 0], [0.5, 0, 0], [1.0, 0, 0]]))
    true = WheelGeometry(0.1, 0.1, 0.5)
    extraction = driven(exact, [0.0, 5.0, 10.0], [0.0, 5.0, 10.0], T_w_v)
    axis_c = np.array([0.0, 0.0, 1.0])
    turn = se3.transform(se3.rotation_about(axis_c, np.array(math.radians(1))), np.zeros(3))
    found = evaluate(extraction, Parameters(TRUTH.T_h_c @ turn, true), None)
    assert found.rotation_rad == pytest.approx(0, abs=1e-9)
    T_v_c = head_pose(exact.rig.chain, extraction.observations[0].joints) @ TRUTH.T_h_c
    across = np.linalg.norm(np.cross(axis_c, T_v_c[:3, :3].T @ [0.5, 0, 0]))
    assert found.translation_m == pytest.approx(2 * math.sin(math.radians(0.5)) * across)


def test_logs_stand_alone():
    two = [simulated("standard", Noise(pixel_px=0.2), ROBOT, seed=seed) for seed in (0, 1)]
    found = evaluate(joined(*two), TRUTH, ROBOT.wheels)
    assert len(found.legs) == 22
    assert set(found.legs[:, 0]) == {0, 1}
    apart = [evaluate(each, TRUTH, None) for each in two]
    assert found.driven_m == pytest.approx(sum(each.driven_m for each in apart))
    assert found.reprojection_px == pytest.approx(np.concatenate([each.reprojection_px for each in apart]))
    assert found.before == found.after


@pytest.mark.long
def test_each_of_two_moving_recordings_is_tested_with_its_clocks():
    """With the offsets that a solution of the recordings gives, a late or early camera clock costs nothing."""
    noise = Noise(pixel_px=0.1, wheel_rad_per_sqrt_rad=0.002, joint_rad=2e-4)

    def recorded(*late_s):
        each = zip((3, 4), late_s, strict=True)
        return joined(
            *(simulated("moving", noise, ROBOT, seed=seed, camera_late_s=s, images=20) for seed, s in each)
        )

    right, late = recorded(0.0, 0.0), recorded(0.03, -0.03)
    offsets = {"joints": -0.03, "wheels": -0.03, "joints_2": 0.06, "wheels_2": 0.06}
    assert clock_offsets(solve(late)) == pytest.approx(offsets, abs=3e-3)
    found, without = evaluate(late, TRUTH, None, offsets_s=offsets), evaluate(right, TRUTH, None)
    as_stamped = evaluate(late, TRUTH, None)
    for name in ("reprojection_px", "rotation_rad", "translation_m"):
        rms = [np.sqrt(np.mean(getattr(e, name) ** 2)) for e in (found, without, as_stamped)]
        assert rms[0] < 1.15 * rms[1]
        assert rms[2] > 1.5 * rms[1]


def test_the_cameras_of_a_calibration_are_those_that_it_found():
    """Another recording of a robot whose principal point is 8 px off, which is 5 % of the depth at 2 m."""
    case = Case(stations=20, fixed={"principal_left_x": 0.0125}, noise=PERFECT)
    solution, other = solve(case.extraction(0)), case.extraction(10)
    constants = {name: constant.value for name, constant in solution.constants.items()}
    stated, found = (evaluate(other, solution.parameters, None, constants=each) for each in (None, constants))
    assert np.median(stated.reprojection_px) > 5
    assert np.median(found.reprojection_px) < 2
    assert np.median(stated.translation_m) > 0.02
    assert np.median(found.translation_m) < 0.006
    assert found.after.mm_per_m < 0.2 * stated.after.mm_per_m
