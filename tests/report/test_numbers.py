"""Numbers as the terminal and the reports show them."""

from dataclasses import replace

import numpy as np
import pytest

from mobilecal_cli import se3
from mobilecal_cli.model.rig import SIDES, WheelSource
from mobilecal_cli.model.text import visible
from mobilecal_cli.report.numbers import decimals_of, percent_text, std_text, value_text
from mobilecal_cli.simulate.robot import ROBOTS
from mobilecal_cli.solvers import solve
from tests.extractions import Noise, simulated
from tests.report.example import made
from tests.robots import true_nominal


@pytest.mark.parametrize("name", ["tick", "paper"])
def test_sigmas_of_the_rotation_are_those_of_the_printed_components(name):
    """Monte Carlo: rotations drawn from the covariance spread as printed, component by component."""
    extraction = simulated(noise=Noise(pixel_px=0.2, joint_rad=1e-3), robot=name, seed=1)
    solution = solve(extraction)
    R = solution.T_h_reference[:3, :3]
    rotation = made(solution, extraction).parameters
    assert se3.exp_so3(np.radians(rotation.rotation_vector_deg)) == pytest.approx(R, abs=1e-12)
    assert se3.from_quaternion_xyzw(rotation.quaternion_xyzw) == pytest.approx(R, abs=1e-12)

    small = np.random.default_rng(0).multivariate_normal(
        np.zeros(3), solution.uncertainty.covariance[:3, :3], 4000
    )
    drawn = se3.exp_so3(small) @ R
    vectors = np.degrees(se3.log_so3(drawn))
    assert rotation.rotation_vector_std_deg == pytest.approx(vectors.std(axis=0), rel=0.05)
    # They differ from the sigmas of a small rotation about the head's axes, which have another label.
    assert rotation.rotation_vector_std_deg != pytest.approx(
        np.degrees(solution.uncertainty.std[:3]), rel=0.05
    )
    if name == "paper":  # 0.6 degrees from gimbal lock
        assert rotation.euler_zyx_deg is None
        assert rotation.euler_zyx_std_deg is None
    else:
        angles = np.array([se3.euler_zyx_deg(one) for one in drawn])
        assert rotation.euler_zyx_deg == pytest.approx(angles.mean(axis=0), abs=0.01)
        assert rotation.euler_zyx_std_deg == pytest.approx(angles.std(axis=0), rel=0.05)


@pytest.mark.parametrize(
    ("std", "text", "decimals"),
    [
        (0.00645, "0.0065", 4),
        (0.0996, "0.10", 2),
        (0.004, "0.0040", 4),
        (1.113, "1.1", 1),
        (123.4, "123", 0),
        (3.21e-9, "3.2e-09", 6),
    ],
)
def test_a_standard_deviation_has_two_significant_digits(std, text, decimals):
    assert std_text(std) == text
    assert decimals_of(std) == decimals


@pytest.mark.parametrize(
    ("value", "std", "shown"),
    [(12.3456, 0.0073, "12.3456"), (223.06, 0.67, "223.06"), (1234.5, 31.0, "1234"), (2.0, None, "2.000")],
)
def test_values_have_the_digits_of_their_sigma(value, std, shown):
    assert value_text(value, std, 3) == shown


def test_visible_escapes_what_steers():
    assert visible("a\x1b[31mé\u202e\udcff\n") == "a\\x1b[31mé\\u202e\\udcff\\n"


@pytest.mark.parametrize(
    ("share", "said"), [(0.998, "100 %"), (0.453, "45 %"), (0.0123, "1.2 %"), (1e-7, "below 0.0001 %")]
)
def test_a_probability_has_two_digits_and_no_exponent(share, said):
    assert percent_text(share) == said


@pytest.mark.parametrize(
    ("motion", "unknown"),
    [("straight", ["separation", "angular"]), ("spin", ["right", "left", "separation", "linear"])],
)
def test_a_scale_of_odometry_may_be_known_where_a_factor_is_not(motion, unknown):
    """A straight drive shows the linear scale, which was "not determined" as the separation; a spin the angular one."""
    extraction = simulated(motion, Noise(pixel_px=0.2, joint_rad=1e-4), "tick", seed=1)
    robot, rig = ROBOTS["tick"], extraction.rig
    source = WheelSource("/odom", assumed=True, baked_in=robot.nominal_wheels)
    sources = replace(rig.sources, wheels=dict.fromkeys(SIDES, source))
    extraction = replace(extraction, rig=replace(rig, sources=sources, nominal=true_nominal(robot)))
    numbers = made(solve(extraction), extraction).numbers
    shown = [
        number.name.partition("_")[0].replace("wheel", "separation") for number in numbers if number.state
    ]
    assert [name for name in shown if name not in "rt"] == unknown
