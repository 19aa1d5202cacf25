"""Hand-computed motions first: they share no formula with the code under test."""

import dataclasses
import math

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from mobilecal_cli.kinematics import (
    Increments,
    between_steps,
    cut_at,
    encoder_step_rad,
    encoder_steps_rad,
    integrate,
    join,
)
from mobilecal_cli.model.observations import WheelTrack
from mobilecal_cli.model.rig import WheelGeometry
from mobilecal_cli.model.signals import Track

WHEELS = WheelGeometry(radius_right_m=0.2, radius_left_m=0.25, separation_m=0.5)


def one_leg(*steps: tuple[float, float]) -> Increments:
    right, left = np.array(steps, dtype=float).T
    return Increments(right, left, np.zeros(len(steps), dtype=np.int64), 1)


# Base on a circle of radius 1 m for 90 degrees: the right wheel runs on 1.25 m, the left on 0.75 m.
QUARTER = np.array([1.25 * math.pi / 2 / 0.2, 0.75 * math.pi / 2 / 0.25])
# On the spot by 90 degrees, each wheel runs 0.25 m times the angle, forward on the right, back on the left.
TURN = math.pi / 2 * 0.25 * np.array([1 / 0.2, -1 / 0.25])


@pytest.mark.parametrize(
    ("steps", "psi_rad", "t_m"),
    [
        pytest.param([(5.0, 4.0)], 0.0, (1.0, 0.0), id="straight ahead: both wheels roll 1 m"),
        pytest.param([QUARTER], math.pi / 2, (1.0, 1.0), id="quarter circle to the left"),
        pytest.param(
            [s * QUARTER for s in (0.1, 0.25, 0.05, 0.6)], math.pi / 2, (1.0, 1.0), id="in many steps"
        ),
        pytest.param([3 * TURN], 1.5 * math.pi, (0.0, 0.0), id="three quarter turns are not wrapped"),
        pytest.param([TURN, (2 / 0.2, 2 / 0.25)], math.pi / 2, (0.0, 2.0), id="turn, then drive"),
    ],
)
def test_motions_by_hand(steps, psi_rad, t_m):
    motion = integrate(one_leg(*steps), WHEELS)
    assert motion.psi_rad[0] == pytest.approx(psi_rad, abs=1e-15)
    assert motion.t_m[0] == pytest.approx(t_m, abs=1e-14)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None)
def test_jacobian_against_differences(seed):
    random = np.random.default_rng(seed)
    n = 40
    steps = Increments(*random.uniform(-0.5, 0.6, (2, n)), np.sort(random.integers(0, 4, n)), 5)
    at = np.array([0.2, 0.25, 0.5])
    motion = integrate(steps, WheelGeometry(*at))
    by_wheels = motion.by_wheels()
    assert motion.t_m == pytest.approx(integrate(steps, WheelGeometry(*at)).t_m)
    for k in range(3):
        h = 1e-6 * np.eye(3)[k]
        plus, minus = integrate(steps, WheelGeometry(*(at + h))), integrate(steps, WheelGeometry(*(at - h)))
        ends = (np.column_stack([moved.t_m, moved.psi_rad]) for moved in (plus, minus))
        assert by_wheels[:, :, k] == pytest.approx(np.subtract(*ends) / 2e-6, abs=1e-7)


@given(st.integers(0, 2**32 - 1))
@settings(max_examples=25, deadline=None)
def test_sensitivity_against_differences(seed):
    random = np.random.default_rng(seed)
    n = 12
    leg = np.sort(random.integers(0, 4, n))
    steps = Increments(*random.uniform(-0.5, 0.6, (2, n)), leg, 5)
    at = np.array([0, 5, n - 1])
    sensitivity = integrate(steps, WHEELS).sensitivity(at)
    for row, step in zip(sensitivity, at, strict=True):
        for side, name in enumerate(("right_rad", "left_rad")):
            ends = []
            for by in (1e-6, -1e-6):
                rotated = getattr(steps, name) + by * (np.arange(n) == step)
                motion = integrate(dataclasses.replace(steps, **{name: rotated}), WHEELS)
                ends.append(np.append(motion.t_m[leg[step]], motion.psi_rad[leg[step]]))
            assert row[:, side] == pytest.approx((ends[0] - ends[1]) / 2e-6, abs=1e-7)


@given(st.floats(-3, 3), st.floats(-3, 3))
@example(0.4, -0.4)
def test_an_arc_in_pieces_is_the_same_arc(right, left):
    """However little a piece turns: the series for small turns meets the sines."""
    whole = integrate(one_leg((right, left)), WHEELS)
    for pieces in (2, 3, 7, 50):
        cut = integrate(one_leg(*[(right / pieces, left / pieces)] * pieces), WHEELS)
        assert cut.t_m == pytest.approx(whole.t_m, abs=1e-14)


def test_cut_at_interpolates_and_keeps_nanoseconds():
    start = 1_700_000_000_000_000_000
    moments = start + 10 * np.arange(7)
    track = WheelTrack.at_same_times(moments, np.arange(7) ** 2, [0, 1, 2, 3, 3, 3, 3])
    steps = cut_at(track, start + np.array([15, 25, 40, 60]))
    assert steps.legs == 3
    assert steps.totals_rad[:, 0] == pytest.approx([4.0, 9.75, 20.0])
    assert steps.left_rad[:2] == pytest.approx([0.5, 0.625])  # it stops at 30: at once, or braking before
    still = WheelTrack.at_same_times(moments, np.zeros(7), [0, 1, 1, 1, 1, 1, 1])
    assert cut_at(still, start + np.array([5, 35, 55])).leg.tolist() == [0]  # rest leaves no step


def test_legs_are_renumbered_and_one_without_motion_stands_still():
    steps = Increments(np.arange(4.0), np.arange(4.0) + 1, np.array([0, 1, 1, 3]), 4)
    chosen = steps.select(np.array([1, 3]))
    assert chosen.legs == 2
    assert chosen.totals_rad == pytest.approx(np.array([[3.0, 5.0], [3.0, 4.0]]))
    both = join([steps, chosen])
    assert both.legs == 6
    assert both.totals_rad == pytest.approx(np.vstack([steps.totals_rad, chosen.totals_rad]))
    steps = Increments(np.array([1.0]), np.array([1.0]), np.array([1]), 3)
    motion = integrate(steps, WHEELS)
    assert np.all(motion.t_m[[0, 2]] == 0)
    assert np.all(motion.psi_rad[[0, 2]] == 0)


def test_between_its_steps_a_reading_runs_on():
    """At a constant rate the line through the changes is the motion itself; a rest stays where it is read."""
    time_ns = np.arange(0, 400, dtype=np.int64) * 10_000_000
    true_rad = np.clip(0.73 * (np.arange(400) * 0.01 - 1), 0, 1.5)
    step = 0.05
    read = np.floor(true_rad / step) * step + step / 2
    smooth, back = (between_steps(Track(time_ns, values), step).value for values in (read, read[::-1]))
    running = (time_ns > 1.1e9) & (time_ns < 3.0e9)
    assert np.abs(read - true_rad)[running].max() > 0.9 * step / 2
    assert np.abs(smooth - true_rad)[running].max() < 0.73 * 0.01 / 2 + 1e-9  # half a sample
    assert np.allclose(back, smooth[::-1])
    assert np.abs(smooth - true_rad).max() < step
    assert smooth[0] == read[0]
    assert smooth[-1] == read[-1]


def test_where_a_wheel_turns_back_it_is_not_cut_off():
    """Lines through the changes cut off half a step on average: of rides to and fro, 1 % of the way was missing."""
    time_ns, step, off = np.arange(0, 151, dtype=np.int64) * 20_000_000, 0.05, []
    for phase in np.linspace(0, step, 40, endpoint=False):
        true_rad = phase - 0.3 * (time_ns * 1e-9 - 1.5) ** 2
        read = np.floor(true_rad / step) * step + step / 2
        off.append((between_steps(Track(time_ns, read), step).value - true_rad)[75])
    assert abs(np.mean(off)) < 0.05 * step
    assert np.abs(off).max() < 0.55 * step


def test_a_sudden_change_of_speed_is_not_rounded_off():
    """Readings that change by many steps are used as they are: none is wrong by more than its step."""
    time_ns = np.arange(0, 200, dtype=np.int64) * 20_000_000
    at_s = np.arange(200) * 0.02
    true_rad = 2 * np.minimum(at_s, 2.0) - np.maximum(at_s - 2.0, 0.0)
    step = 0.0015
    read = np.floor(true_rad / step) * step + step / 2
    assert np.abs(between_steps(Track(time_ns, read), step).value - true_rad).max() <= step / 2 + 1e-12


def test_the_step_of_an_encoder():
    random = np.random.default_rng(0)
    smooth = np.cumsum(random.uniform(0, 0.1, 500))
    assert encoder_step_rad(np.floor(smooth / 0.021) * 0.021) == pytest.approx(0.021)
    assert encoder_step_rad(smooth) == 0.0
    assert encoder_step_rad(np.zeros(5)) == 0.0
    random = np.random.default_rng(1)
    for ticks in ((2, 3, 5), (6, 10, 15), (4, 9), (20, 21, 23, 26)):
        found = encoder_step_rad(readings(random.choice(ticks, 300)))
        assert found == pytest.approx(0.0021 * np.gcd.reduce(ticks), rel=1e-6), ticks
    assert encoder_step_rad(readings([2, -3, 5])) == pytest.approx(0.0021, rel=1e-6)
    random = np.random.default_rng(2)
    changes = 0.0021 * random.choice([0, 1, 2, 3, 5, 8], 400)
    changes[random.choice(400, 3, replace=False)] = 0.0021 * np.array([0.37, 1.61, 12.4])
    assert encoder_step_rad(np.cumsum(changes)) == pytest.approx(0.0021, rel=1e-6)
    ticks = np.cumsum(random.choice([2, 3, 5, 7], 400))
    assert encoder_step_rad(np.round(0.021 * ticks, 4)) == pytest.approx(0.021, rel=1e-3)
    assert encoder_step_rad((0.021 * ticks).astype(np.float32)) == pytest.approx(0.021, rel=1e-3)


def readings(ticks, step=0.0021):
    """Readings of an encoder whose changes are these numbers of ticks."""
    return step * np.cumsum(np.append(7, ticks))


@pytest.mark.parametrize("count", [5, 10, 30, 100, 5000])
def test_smooth_readings_have_no_step(count):
    random = np.random.default_rng(count)
    for _ in range(50):
        assert encoder_step_rad(np.cumsum(random.uniform(0.01, 0.1, count))) == 0.0
        assert encoder_step_rad(np.cumsum(random.normal(0.05, 0.002, count))) == 0.0


def test_wheels_with_stamps_of_their_own_are_cut_at_the_readings_of_both():
    """The increments between any two stations are those of each wheel's own curve."""
    start = 1_700_000_000_000_000_000
    right = Track(start + np.array([0, 10, 20, 30]), [0.0, 1.0, 1.0, 3.0])
    left = Track(start + np.array([-3, 5, 17, 40]), [0.0, 8.0, 8.0, 31.0])
    track = WheelTrack(right, left)
    assert (track.time_ns - start).tolist() == [0, 5, 10, 17, 20, 30]
    stations = start + np.array([2, 7, 30])
    steps = cut_at(track, stations)
    assert steps.totals_rad == pytest.approx(np.diff([right.at(stations), left.at(stations)]).T)
    right_rad = np.diff(right.at(start + np.array([2, 5, 7, 10, 17, 20, 30])))
    assert steps.right_rad == pytest.approx(np.delete(right_rad, 3))  # both rest from 10 to 17
    assert steps.leg.tolist() == [0, 0, 1, 1, 1]


def test_each_wheel_keeps_the_step_of_its_encoder():
    """Two topics: readings at common times would be between the steps."""
    moments = np.arange(0, 20, 0.02)
    right, left = (
        Track(np.round((moments + late) * 1e9).astype(np.int64), np.floor(3 * np.sin(moments) / step) * step)
        for late, step in ((0.0, 0.0466), (0.007, 0.0211))
    )
    track = WheelTrack(right, left)
    assert encoder_steps_rad((track,)) == pytest.approx([0.0466, 0.0211])
    assert encoder_step_rad(track.right_rad) < 0.01
    assert encoder_steps_rad(()).tolist() == [0.0, 0.0]
