"""The simulated base, against motions worked out by hand and against small steps."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mobilecal_cli.model.rig import WheelGeometry
from mobilecal_cli.simulate.route import Drive, Stretch, moved, wheel_speeds

WHEELS = WheelGeometry(radius_right_m=0.2, radius_left_m=0.25, separation_m=0.5)
QUARTER = math.pi / 2


@pytest.mark.parametrize(
    ("start", "stretch", "end"),
    [
        pytest.param((1.0, 2.0, QUARTER), Stretch(4.0, 0.5), (1.0, 4.0, QUARTER), id="straight on, facing y"),
        pytest.param((1.0, 2.0, 0.0), Stretch(4.0, -0.5), (-1.0, 2.0, 0.0), id="straight back"),
        # Radius 2 m about (0, 2): a quarter to the left ends at (2, 2), facing y.
        pytest.param((0, 0, 0), Stretch(1.0, math.pi, QUARTER), (2.0, 2.0, QUARTER), id="to the left"),
        pytest.param((0, 0, 0), Stretch(1.0, math.pi, -QUARTER), (2.0, -2.0, -QUARTER), id="to the right"),
        # Backwards round the same center.
        pytest.param((0, 0, 0), Stretch(1.0, -math.pi, -QUARTER), (-2.0, 2.0, -QUARTER), id="backwards"),
        pytest.param((3, 4, 1.0), Stretch(2.0, 0.0, 1.5), (3.0, 4.0, 4.0), id="spin"),
        pytest.param((3, 4, 1.0), Stretch(2.0), (3.0, 4.0, 1.0), id="rest"),
    ],
)
def test_motions_worked_out_by_hand(start, stretch, end):
    assert moved(start, stretch, stretch.duration_s) == pytest.approx(end, abs=1e-12)


@pytest.mark.parametrize(
    ("stretch", "right_radps", "left_radps"),
    [
        # v / r: 1 / 0.2 and 1 / 0.25.
        pytest.param(Stretch(1.0, 1.0), 5.0, 4.0, id="straight"),
        # Half the separation times the turning speed: 0.25 m/s forward on the right, backward on the left.
        pytest.param(Stretch(1.0, 0.0, 1.0), 1.25, -1.0, id="spin to the left"),
        # The center of a left turn of radius 0.25 m is under the left wheel, which stands.
        pytest.param(Stretch(1.0, 0.5, 2.0), 5.0, 0.0, id="about the left wheel"),
    ],
)
def test_wheel_speeds_worked_out_by_hand(stretch, right_radps, left_radps):
    assert wheel_speeds(stretch, WHEELS) == pytest.approx((right_radps, left_radps), abs=1e-12)


stretches = st.builds(Stretch, st.floats(0.1, 3.0), st.floats(-1.0, 1.0), st.floats(-1.5, 1.5))


@given(st.lists(stretches, min_size=1, max_size=4))
def test_wheels_and_poses_agree_with_small_steps(parts):
    """The paper's eq. 1 in small steps, from the wheel angles alone, gives the poses."""
    drive = Drive(tuple(parts))
    times_s = np.union1d(np.linspace(0, drive.breaks_s[-1], 4001), drive.breaks_s)
    right, left = np.diff(drive.wheel_angles(times_s, WHEELS), axis=0).T
    run = (WHEELS.radius_right_m * right + WHEELS.radius_left_m * left) / 2
    turn = (WHEELS.radius_right_m * right - WHEELS.radius_left_m * left) / WHEELS.separation_m
    heading = np.concatenate([[0], np.cumsum(turn)])
    middle = heading[:-1] + turn / 2
    x, y = np.sum(run * np.cos(middle)), np.sum(run * np.sin(middle))
    # The midpoint rule is wrong by (w dt)^2 / 24 of the way: under 1e-6 of 12 m here.
    assert drive.poses(times_s[-1:])[0] == pytest.approx((x, y, heading[-1]), abs=1.2e-5)
