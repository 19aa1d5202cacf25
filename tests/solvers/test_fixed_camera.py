"""A camera that is fixed to the base: no joint tilts it, so its height is as described."""

import re
from dataclasses import replace

import numpy as np
import pytest

from mobilecal_cli import se3
from mobilecal_cli.calibrate.gaps import require_observable
from mobilecal_cli.calibrate.steps import Data, Report, fitted
from mobilecal_cli.errors import SolveError
from mobilecal_cli.kinematics import unseen_height
from mobilecal_cli.model.calibration import NINE
from mobilecal_cli.model.observations import WheelTrack
from mobilecal_cli.model.rig import FixedLink, HeadChain, JointLink
from mobilecal_cli.report.motion import motion_gaps
from mobilecal_cli.simulate.robot import FIXED_CAMERA_ROBOT, RGBD_ROBOT
from mobilecal_cli.solvers.constraints import Constraints, constraints_of
from mobilecal_cli.solvers.inference import Inference
from tests.extractions import Noise, simulated
from tests.fits import maximum_likelihood
from tests.truth import nees, parameters_of

ROBOT = FIXED_CAMERA_ROBOT
NOISE = Noise(0.1, 0.003, 0.0, 1e-4, floor_rad=1e-3, floor_m=5e-4)


def test_all_but_the_height_is_calibrated_and_the_verdict_is_about_it():
    extraction = simulated("standard", NOISE, ROBOT, 20, 0)
    fit = fitted(extraction)
    found = fit.solution.uncertainty
    height = NINE.index("t_z")
    assert found.described.tolist() == [k == height for k in range(9)]
    assert found.observable.tolist() == [k != height for k in range(9)]
    others = np.arange(9) != height
    assert nees(fit.parameters, found.covariance, ROBOT, others) < 2.5
    assert found.at_work.camera_m < 0.01
    assert found.covariance[height, height] == pytest.approx(0.1**2, rel=0.01)
    report = Report(Data(extraction), fit)
    assert report.verdict.level == "PASS"
    assert re.search(r"0\.10 +m +from the robot description", str(report))
    assert "tilt the head" not in str(report)
    assert "8 that the motion of this robot can show" in report.html
    assert motion_gaps(extraction) == ()
    with pytest.raises(SolveError, match="no joint of the head tilts the camera"):
        require_observable(extraction)


def test_what_turns_the_camera_in_its_mount_shows_no_height():
    """The lever of a base that leans seemed to show it: off by up to 21 sigmas, with a PASS."""
    noise = replace(NOISE, pixel_px=0.02, floor_rad=1e-4, floor_m=1e-4, shift_px=1.0)
    recorded = simulated("standard", noise, RGBD_ROBOT, 12, 0)
    found = fitted(recorded).solution.uncertainty
    assert found.described[NINE.index("t_z")]
    assert np.sqrt(found.covariance[5, 5]) == pytest.approx(0.1, rel=0.01)
    height = constraints_of([], ["t_z=0.55±0.02"], [])
    stated = fitted(recorded, constraints=height).solution
    assert stated.parameters.T_h_c[2, 3] == pytest.approx(0.55)
    assert stated.uncertainty.std[5] == pytest.approx(0.02, rel=0.05)


def test_a_height_that_only_the_users_prior_states_is_named_so():
    """A wide prior was "from the robot description", and refused where nothing is described."""
    height, made = constraints_of([], ["t_z=0.55±0.3"], []), simulated("standard", NOISE, RGBD_ROBOT, 20, 0)
    bare = replace(made, rig=replace(made.rig, nominal=replace(made.rig.nominal, T_h_reference=None)))
    for extraction in (made, bare):
        report = Report(Data(extraction), fitted(extraction, constraints=height))
        assert re.search(r"0\.55 +± 0\.30 +m +from --prior", str(report))
        assert "The camera's height is from --prior: no motion shows it" in report.verdict.reason
    with pytest.raises(SolveError) as refusal:
        fitted(bare)
    assert "or --prior t_z=VALUE±SIGMA" in refusal.value.hint


def rotation_off(extraction):
    """(3,) error of the camera's rotation in standard deviations."""
    found = maximum_likelihood(extraction)
    error = found.lin.state.parameters.minus(parameters_of(ROBOT))[:3]
    return error / np.sqrt(np.diag(found.covariance)[:3])


@pytest.mark.long
def test_a_floor_that_is_a_function_of_the_place_is_no_pitch_of_the_camera():
    """A robot that drives to and fro sees the same slope at the same place: r_y was off by 8 sigmas, with PASS."""
    noise = Noise(0.2, 0.003, 0.0, 1e-4, floor_rad=np.radians(0.1), floor_m=5e-4, floor_place_m=1.0)
    off = rotation_off(simulated("moving", noise, ROBOT, 12, 3, images=80))
    assert np.abs(off).max() < 3.0  # without the shape of the floor, the pitch is off by 5.0 sigmas


@pytest.mark.parametrize(
    ("axes", "height"),
    [
        ((), [0, 0, 1]),
        (([0, 0, 1],), [0, 0, 1]),
        (([0, 0.01, 1],), [0, 0, 1]),
        (([0, 0, 1], [0, 1, 0]), None),
        (([1, 0, 0],), None),
    ],
)
def test_which_heads_show_the_height(axes, height):
    units = (np.array(axis) / np.linalg.norm(axis) for axis in axes)
    links = [JointLink(f"joint_{k}", axis, "revolute") for k, axis in enumerate(units)]
    chain = HeadChain("base", "head", (FixedLink(np.eye(4)), *links))
    found = unseen_height(chain)
    assert found is None if height is None else found == pytest.approx(height)


def test_wheels_of_different_size_do_not_turn_the_base():
    """Slopes of the floor were taken for turns: the start was off by a radian, and "did not converge" the answer."""
    noise = Noise(0.05, 2e-4, 0.0, 0.0, floor_rad=2e-3, floor_m=5e-4)
    extraction = simulated("straight", noise, "rgbd", 12, 8)
    (track,) = extraction.wheels
    wheels = WheelTrack.at_same_times(track.time_ns, track.right_rad, 1.01 * track.left_rad)
    extraction = replace(extraction, wheels=(wheels,))
    inference = Inference.of(extraction, Constraints())
    assert 0.1 < inference.motion.turned_rad < 0.02 * inference.motion.driven_rad
    assert not inference.motion.turns
    assert inference.initial().T_h_c == pytest.approx(inference.nominal.T_h_c)
    verdict = Report(Data(extraction), fitted(extraction)).verdict
    assert verdict.level == "NOT ENOUGH"
    assert "turn the base" in verdict.next_step
    assert "tilt the head" not in verdict.next_step


def test_the_vertical_is_in_the_head_frame():
    turned = FixedLink(se3.transform(se3.from_rpy(np.array([-np.pi / 2, 0, 0])), np.zeros(3)))
    assert unseen_height(HeadChain("base", "head", (turned,))) == pytest.approx([0, -1, 0], abs=1e-12)


@pytest.mark.parametrize(("times", "said"), [(0.25, "4 times"), (8.0, "0.1[23] times"), (57.3, "in degrees")])
def test_wheel_readings_in_another_unit_are_named_at_once(times, said):
    """Four times the ticks: the nominal wheels pulled, and 3.5 times the radius or 3 m of drive were the cause."""
    extraction = simulated("standard", NOISE, ROBOT, 20, 0)
    tracks = [
        WheelTrack(*(replace(side, value=times * side.value) for side in (track.right, track.left)))
        for track in extraction.wheels
    ]
    with pytest.raises(SolveError, match=said):
        fitted(replace(extraction, wheels=tuple(tracks)))
