"""What wheels do beside their noise: drift on a carpet, turns that differ, delays, paths between rare readings."""

from dataclasses import replace

import numpy as np
import pytest

from mobilecal_cli.calibrate.steps import Data, Report, fitted
from mobilecal_cli.kinematics.wheels import cut_at
from mobilecal_cli.likelihood.effects import WheelSmoothing
from mobilecal_cli.model.observations import WheelTrack
from mobilecal_cli.simulate.robot import PAPER_ROBOT, TICK_ROBOT
from tests.actual import STATION_NOISE
from tests.extractions import Outside, simulated
from tests.truth import nees, parameters_of

NOISE = replace(STATION_NOISE, pixel_px=0.1, joint_rad=1e-4, wheel_rad_per_sqrt_rad=0.002)


def calibrated(motion, **outside):
    """A report whose robot is right, and its result."""
    robot = TICK_ROBOT
    extraction = simulated(motion, NOISE, robot, 20, 4, outside=Outside(**outside))
    found = fitted(extraction)
    report = Report(Data(extraction), found)
    assert report.verdict.level == "PASS"
    assert not found.solution.outliers
    assert not found.solution.jumps
    assert nees(found.parameters, found.covariance, robot) < 2.7
    return report, found


def test_a_carpet_that_carries_the_base_is_no_camera_that_moved():
    """Two of three such recordings were FAIL, half of them with a camera, a joint or the board."""
    _, found = calibrated("moving", drift=(0.008, -0.006))
    constants = found.solution.constants
    # The world's frame is the base at the first station, not at the start.
    size = np.hypot(constants["drift_x"].value, constants["drift_y"].value)
    assert size == pytest.approx(0.01, abs=4 * constants["drift_x"].std)
    assert constants["drift_x"].std < 0.002


def test_turns_that_differ_from_side_to_side_are_named_and_do_no_harm():
    """Three of four such robots were FAIL: the wheels did not fit the drive."""
    report, found = calibrated("standard", turn_sides=-0.01)
    constant = found.solution.constants["turn_sides"]
    assert constant.value == pytest.approx(-0.01, abs=4 * constant.std)
    assert constant.std < 0.001
    (check,) = [check for check in report.verdict.checks if check.id.startswith("contradiction.turn_sides")]
    assert check.outcome == "warning"
    assert "Check tires, casters and load" in check.next_step


@pytest.mark.parametrize(
    ("motion", "delay_s"), [pytest.param("standard", 0.01, marks=pytest.mark.long), ("moving", -0.03)]
)
def test_wheels_that_are_read_one_after_the_other_are_named_and_do_no_harm(motion, delay_s):
    """With 10 ms between them, sigmas were up to three times as wide; with 30 ms, most were FAIL by noise of the wheels."""
    report, found = calibrated(motion, wheel_delay_s=delay_s)
    constant = found.solution.constants["wheel_delay"]
    assert constant.value == pytest.approx(delay_s, abs=4 * constant.std)
    assert constant.std < 0.003
    (check,) = [check for check in report.verdict.checks if check.id.startswith("contradiction")]
    assert (check.id, check.outcome) == ("contradiction.wheel_delay.wheels", "warning")
    assert "Read both wheels in one message" in check.next_step


def test_a_driver_that_smooths_the_wheels_is_named_and_does_no_harm():
    """With smooth drives, separations were 1 to 3 sigmas too small with 50 ms, and 4 with 100 ms, with a PASS."""
    robot = PAPER_ROBOT
    found = fitted(simulated("moving", NOISE, robot, 20, 5, outside=Outside(wheel_smoothing_s=0.05)))
    constant = found.solution.constants["wheel_smoothing"]
    assert constant.value > 5 * constant.std
    assert nees(found.parameters, found.covariance, robot) < 2.7
    verdict = Report(Data(found.extraction), found).verdict
    (check,) = [check for check in verdict.checks if check.id.startswith("contradiction")]
    assert (verdict.level, check.id, check.outcome) == (
        "PASS", "contradiction.wheel_smoothing.wheels", "warning",
    )  # fmt: skip
    assert "without a filter" in check.next_step


@pytest.mark.parametrize("window_s", [0.02, 0.05])
def test_smoothing_is_undone_by_accelerations(window_s):
    """A window of variance v multiplies a sine of the frequency w by exp(-v w^2 / 2)."""
    at_ns, stations_ns = (np.arange(0, 4_000_000_001, step) for step in (10_000_000, 500_000_000))
    turned = 3.0 * np.sin(2 * at_ns * 1e-9)[:, None] * [1.0, 0.7]
    read = turned * np.exp(-(window_s**2) * 2**2 / 2)
    true, steps = (
        cut_at(WheelTrack.at_same_times(at_ns, *each.T), stations_ns, motion=True) for each in (turned, read)
    )
    right, left = WheelSmoothing().further(steps, window_s**2)
    after = np.stack([steps.total(steps.right_rad + right), steps.total(steps.left_rad + left)], axis=1)
    before, after = np.abs(steps.totals_rad - true.totals_rad)[1:-1], np.abs(after - true.totals_rad)[1:-1]
    assert after.max() < 0.03 * before.max()


def test_rare_readings_of_wheels_do_not_tell_the_path_between_them():
    """At 2 Hz, each turn and drive within half a second was an arc: separations 4 to 7 sigmas too small, all PASS."""
    robot = PAPER_ROBOT
    extraction = simulated("standard", NOISE, robot, 30, seed=1)
    (track,) = extraction.wheels
    rare_ns = np.arange(track.time_ns[0], track.time_ns[-1], 500_000_000)
    rare = WheelTrack.at_same_times(rare_ns, track.right.at(rare_ns), track.left.at(rare_ns))
    seen = tuple(o for o in extraction.observations if o.time_ns <= rare_ns[-1])
    found = fitted(replace(extraction, wheels=(rare,), observations=seen))
    off = found.parameters.minus(parameters_of(robot)) / found.solution.uncertainty.std
    assert np.abs(off).max() < 3
    assert not found.solution.outliers
