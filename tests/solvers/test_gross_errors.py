"""One gross error in the recording of a robot drawn from its priors: it is left out, and the result is right."""

import re
from dataclasses import replace

import numpy as np
import pytest

from mobilecal_cli.likelihood.dataset import dataset_of
from mobilecal_cli.model.observations import WheelTrack
from mobilecal_cli.model.signals import Track
from mobilecal_cli.simulate.robot import TICK_ROBOT
from mobilecal_cli.solvers import solve
from mobilecal_cli.solvers.initial import linear_estimate
from tests.bench.imperfect import ROBOTS, USUAL, Case, true_robot
from tests.extractions import STATION_NOISE, simulated, slipped
from tests.judging import judge
from tests.truth import errors

SEED = 50


def one_turn(extraction, station):
    return slipped(extraction, station, 2 * np.pi)


def reset(extraction, station):
    return slipped(extraction, station, -300.0, -300.0)


def early_reset(extraction, _station):
    """The linear method finds negative wheels, nearly nothing, which fit the one leg and no other."""
    return slipped(extraction, 4, -300.0, -300.0)


def misread(extraction, station):
    observations = list(extraction.observations)
    o = observations[station]
    tilt = np.arange(len(o.joints)) == len(o.joints) - 1
    observations[station] = replace(o, joints=o.joints + 0.17 * tilt)
    return replace(extraction, observations=tuple(observations))


def exchanged(extraction, station):
    """The images of two stations."""
    observations = list(extraction.observations)
    at = [0, station]
    first, second = (observations[k] for k in at)
    for k, own, other in ((0, first, second), (station, second, first)):
        images = {name: getattr(other, name) for name in ("views", "points_c", "points_cov", "T_c_k")}
        observations[k] = replace(own, **images)
    return replace(extraction, observations=tuple(observations))


@pytest.mark.parametrize(
    ("name", "stations", "spoil", "kind", "said"),
    [
        # Far images of one camera: no half of the legs is near.
        pytest.param("camera on the base", 20, one_turn, "slip", "excluded", marks=pytest.mark.long),
        pytest.param("pan-tilt", 20, reset, "slip", "excluded", marks=pytest.mark.long),
        pytest.param("pan-tilt", 14, early_reset, "slip", "excluded", marks=pytest.mark.long),
        # The reading as it was is no error of the calibration.
        ("camera on pan-tilt", 20, misread, "joint", r"wrong by \+9\.[678]\d degrees"),
        # Also of the first one, which only its leg holds.
        pytest.param("three cameras", 14, exchanged, "station", "excluded", marks=pytest.mark.long),
    ],
)
def test_it_is_left_out(name, stations, spoil, kind, said):
    case = Case(name, stations).drawn(noise=USUAL)
    extraction = case.extraction(SEED)
    robot = true_robot(ROBOTS[name], extraction, case.route(SEED))
    spoilt = spoil(extraction, 2 * stations // 3)
    solution = solve(spoilt)
    outliers = [outlier for outlier in solution.outliers if outlier.kind != "corners"]
    assert {outlier.kind for outlier in outliers} == {kind}
    assert all(re.search(said, outlier.text) for outlier in outliers)
    assert np.max(np.abs(errors(solution.parameters, robot)) / solution.uncertainty.std) < 4
    assert judge(solution, spoilt).level == "PASS"


def spun(extraction, lost):
    """The right wheel turns on by half a radian, evenly over leg 5; without its readings there, if they are lost."""
    (track,), (first, second) = extraction.wheels, extraction.observations[5:7]
    begin, end = first.time_ns, second.time_ns
    further = 0.5 * np.clip((track.time_ns - begin) / (end - begin), 0, 1)
    kept = (track.time_ns <= begin) | (track.time_ns >= end) | (not lost)
    right = Track(track.time_ns[kept], (track.right_rad + further)[kept])
    return replace(extraction, wheels=(WheelTrack(right, track.left),))


def restarted(extraction):
    """Neither wheel has readings over leg 5, and after it, both go on where they were."""
    (track,), (first, second) = extraction.wheels, extraction.observations[5:7]
    later = track.time_ns >= second.time_ns
    kept = (track.time_ns <= first.time_ns) | later
    sides = (
        t.value - later * np.diff(t.at(np.array([first.time_ns, second.time_ns])))
        for t in (track.right, track.left)
    )
    return replace(extraction, wheels=(WheelTrack(*(Track(track.time_ns[kept], v[kept]) for v in sides)),))


@pytest.mark.parametrize(
    ("spoil", "said"),
    [
        (restarted, r"A gap of \d+\.\d s in the readings of both wheels between stations 5 and 6"),
        (
            lambda e: spun(e, True),
            r"A gap of \d+\.\d s in the readings of the right wheel between stations 5 and 6",
        ),
        (lambda e: spun(e, False), "Wheel slip or moved board between stations 5 and 6"),
    ],
)
def test_a_leg_without_readings_is_no_slip(spoil, said):
    """It was "Wheel slip or moved board", beside a note on the gap."""
    noise = replace(STATION_NOISE, pixel_px=0.1, joint_rad=2e-4, wheel_rad_per_sqrt_rad=0.003)
    extraction = spoil(simulated("standard", noise, TICK_ROBOT, 9))
    (outlier,) = solve(extraction).gross_outliers
    assert re.match(said, outlier.text)
    assert ("Check the driver" in outlier.text) == ("slip" not in said)


def test_a_jump_by_millions_of_turns_makes_no_second_solution():
    """The linear method settles at wheels that differ by a percent, wherever it starts."""
    extraction = Case("pan-tilt", 20).drawn(noise=USUAL).extraction(SEED)
    pairs = dataset_of(slipped(extraction, 10, 2**32 * 2 * np.pi / 4096)).pairs
    linear = linear_estimate(pairs, extraction.rig.nominal.wheels)
    assert linear.rival_point_rms_m > 1.5 * linear.point_rms_m
