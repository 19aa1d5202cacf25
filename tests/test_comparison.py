"""Calibrations side by side."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

from mobilecal_cli import se3
from mobilecal_cli.comparison import broken_limits, difference, history
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.model.calibration import NINE, CalibratedRobot, Knowledge
from mobilecal_cli.model.observations import LogSource
from mobilecal_cli.model.rig import FixedLink, HeadChain, JointLink, Nominal, WheelGeometry
from mobilecal_cli.report.comparison import (
    Comparison,
    change_from_nominal,
    change_since,
    comparison_json,
    comparison_text,
)

WHEELS = WheelGeometry(0.1, 0.1, 0.5)
STD = np.array([1e-3, 1e-3, 1e-3, 2e-3, 2e-3, 2e-3, 1e-4, 1e-4, 5e-4])


def robot(T=None, wheels=WHEELS, std=STD, observable=(True,) * 9, head="head", log="a"):
    knowledge = None if std is None else Knowledge(np.diag(np.square(std)), np.array(observable))
    T = np.eye(4) if T is None else T
    return CalibratedRobot(head, "camera", T, wheels, knowledge, logs=(LogSource("log", log),))


def test_a_calibration_is_no_other_than_itself():
    found = difference(robot(), robot())
    assert not found.change.any()
    assert found.chi2 == 0
    assert found.chance == 1
    assert found.shared
    assert (found.ray_m, found.along_m_per_m, found.heading_rad_per_m, found.heading_rad_per_turn) == (0,) * 4


def test_by_hand():
    """A camera turned by 0.01 rad about the head's x moves what is 2 m along its z by 2 * 2 sin(0.005) m."""
    turned = se3.transform(se3.exp_so3(np.array([0.01, 0, 0])), np.zeros(3))
    found = difference(robot(), robot(turned, WheelGeometry(0.102, 0.1, 0.5), log="b"))
    assert found.change == pytest.approx([0.01, 0, 0, 0, 0, 0, 0.002, 0, 0])
    assert found.std == pytest.approx(math.sqrt(2) * STD)
    assert found.sigmas[[0, 6]] == pytest.approx([10 / math.sqrt(2), 20 / math.sqrt(2)])
    assert found.chi2 == pytest.approx(10**2 / 2 + 20**2 / 2)
    assert found.chance < 1e-9
    assert not found.shared
    assert found.ray_m == pytest.approx(2 * 2 * math.sin(0.005))
    # One metre by the first's wheels: the right one makes 1.02 m, the left one 1 m.
    assert found.along_m_per_m == pytest.approx(0.01)
    assert found.heading_rad_per_m == pytest.approx(0.02 / 0.5)
    # A turn on the spot: the wheels roll 0.25 * 2 pi each, the right one 2 % more.
    assert found.heading_rad_per_turn == pytest.approx(2 * math.pi * 0.01)


def test_a_height_that_both_have_from_the_description_did_not_change():
    """No camera without a tilt could pass a limit in sigma, not even against itself."""
    nominal = robot(observable=(True,) * 5 + (False,) + (True,) * 3)
    assert broken_limits(difference(nominal, nominal), 5) == []
    shown = robot(se3.transform(np.eye(3), np.array([0, 0, 1e-3])))
    assert broken_limits(difference(nominal, shown), 5) == ["no conclusion about t_z: unobservable or fixed"]


def with_chain(zero_rad, std_rad=0.002, height_m=0.1):
    """A calibration whose head pans 1 m above the base; the tilt follows `height_m` above it."""
    links = (
        FixedLink(se3.transform(np.eye(3), np.array([0, 0, 1.0]))),
        JointLink("pan_joint", np.array([0.0, 0, 1])),
        FixedLink(se3.transform(np.eye(3), np.array([0, 0, height_m]))),
        JointLink("tilt_joint", np.array([0.0, 1, 0])),
    )
    chain = HeadChain("base", "head", links, "pan_joint", "tilt_joint")
    facing = se3.transform(se3.exp_so3(np.array([0, np.pi / 2, 0])), np.zeros(3))  # its z is the base's x
    known = {"pan_zero": zero_rad, "tilt_scale": 0.0}, {"pan_zero": std_rad, "tilt_scale": 0.001}
    return replace(robot(facing), constants=known[0], constants_std=known[1], chain=chain)


def test_a_head_joint_whose_zero_moved():
    """The nine are the same. It was "Unchanged"."""
    found = difference(with_chain(0.001), with_chain(0.021))
    sigmas = 0.02 / (0.002 * math.sqrt(2))
    assert found.moved_joints == {"pan_zero": pytest.approx(sigmas)}
    assert found.ray_m == pytest.approx(2 * 2 * math.sin(0.01))
    text = comparison_text(Comparison(("a", "b"), (with_chain(0.001), with_chain(0.021))))
    said = f"Changed: from a to b, in the head chain, pan_zero +1.1 deg ({sigmas:.1f} sigma); of the nine parameters,"
    assert " ".join(text.split()).startswith(f"{said} largest change 0.0 sigma")
    other = replace(with_chain(0.001), head_joints=("lift_joint",))
    with pytest.raises(ConfigError, match="its head has the joints lift_joint, the recording's pan_joint"):
        change_since(replace(with_chain(0.001), head_joints=("pan_joint",)), other, "last.yaml")
    assert broken_limits(found, max_sigma=5.0) == [f"pan_zero by {sigmas:.1f} sigma (limit 5)"]
    assert not difference(with_chain(0.001), with_chain(0.008)).moved_joints
    # Corrected in the URDF meanwhile: the constants count from another chain.
    assert not difference(with_chain(0.001), with_chain(0.021, height_m=0.2)).moved_joints


@pytest.mark.parametrize(("radius_m", "broken"), [(0.101, 0), (0.2, 1)])
def test_an_unobservable_radius_that_no_nominal_value_explains(radius_m, broken):
    std = np.array([*STD[:6], 3e-3, *STD[7:]])
    observable = (True,) * 6 + (False, True, True)
    blind = robot(observable=observable, wheels=WheelGeometry(radius_m, 0.1, 0.5), std=std)
    found = broken_limits(difference(robot(), blind))
    assert len(found) == broken
    if broken:
        assert found[0] == "radius_right, unobservable or fixed in one calibration, by 33.3 sigma (limit 5)"


def test_no_conclusion_about_an_unobservable_parameter():
    wide = np.array([*STD[:8], 0.1])
    blind = robot(observable=(True,) * 8 + (False,), wheels=WheelGeometry(0.1, 0.1, 1.0), std=wide)
    found = difference(robot(), blind)
    assert found.known.tolist() == [True] * 8 + [False]
    assert found.unobservable.tolist() == [False] * 8 + [True]
    assert np.isnan(found.sigmas[8])
    assert found.chi2 == 0
    text = " ".join(comparison_text(Comparison(("one", "other"), (robot(), blind))).split())
    assert text.startswith("Unchanged: from one to other")
    assert "No conclusion about separation: at least one calibration does not determine it." in text


def test_another_robot_is_refused():
    with pytest.raises(ConfigError, match="'head' in one and 'neck'"):
        difference(robot(), robot(head="neck"))


def test_nominal_values_have_no_sigma():
    change = change_from_nominal(robot(), Nominal(wheels=WheelGeometry(0.11, 0.1, 0.5)))
    k = NINE.index("radius_right")
    assert (1e3 * change.value[k], change.percent[k]) == (pytest.approx(-10), pytest.approx(-100 / 11))
    assert np.isnan(change.value[:6]).all()
    assert np.isnan(change.sigmas).all()
    assert change.p_value is None


def test_the_text_has_digits_that_match_the_sigma():
    moved = se3.transform(np.eye(3), np.array([0.00123, 0.0, 0.0]))
    text = comparison_text(Comparison(("a", "b"), (robot(), robot(moved, log="b"))))
    row = next(line.split() for line in text.splitlines() if line.startswith("  t_x"))
    assert row == ["t_x", "+1.2", "2.8", "+0.4", "mm"]
    assert "Change from a to b" in text
    assert "Probability by chance 100 %" in " ".join(text.split())


def test_other_head_joints_are_another_robot():
    first, other = (
        replace(robot(log=joints[0]), head_joints=joints) for joints in (("pan", "tilt"), ("neck",))
    )
    text = comparison_text(Comparison(("a", "b"), (first, other)))
    assert "Note: These are two robots: the head joints differ (pan, tilt in a, neck in b)." in text
    assert "Note" not in comparison_text(Comparison(("a", "b"), (first, first)))


NOTHING_SHARED = "have no parameter that both determine with a standard deviation"


@pytest.mark.parametrize(
    ("t_x", "std", "said", "value"),
    [
        (2.8, STD, "Changed: from a to b, largest change 989.9 sigma (t_x).", True),
        (0.003, STD, "Unchanged: from a to b, largest change 1.1 sigma (t_x).", False),
        (2.8, None, f"Unknown: a and b {NOTHING_SHARED}.", None),
    ],
)
def test_the_first_line_says_whether_the_robot_changed(t_x, std, said, value):
    first = robot(std=std)
    other = robot(se3.transform(np.eye(3), np.array([t_x, 0.0, 0.0])), log="b", std=std)
    comparison = Comparison(("a", "b"), (first, other))
    assert " ".join(comparison_text(comparison).split()).startswith(said)
    plain = json.loads(comparison_json(comparison))
    assert plain["against_first"][0]["changed"] is value


def test_history_tells_what_moves():
    rng = np.random.default_rng(0)
    robots = []
    for k in range(12):
        t = np.array([0.0, 0.0, 0.01 * (k > 8)]) + rng.normal(size=3) * 2e-3
        robots.append(robot(se3.transform(np.eye(3), t)))
    past = history(robots)
    assert past.change.shape == past.std.shape == (12, 9)
    assert past.chance[5] < 1e-6
    assert np.all(past.chance[[3, 4]] > 0.01)
    assert past.chance[0] == 1  # they do not differ at all


def test_chance_is_uniform_over_unchanged_robots():
    """The p-value of a test that is true is below 0.1 in a tenth of the cases."""
    rng = np.random.default_rng(1)
    chances = []
    for _ in range(400):
        moved = [se3.transform(np.eye(3), rng.normal(size=3) * 2e-3) for _ in range(2)]
        pair = [robot(T, observable=[False] * 3 + [True] * 3 + [False] * 3) for T in moved]
        chances.append(difference(*pair).chance)
    assert 0.06 < np.mean(np.array(chances) < 0.1) < 0.14
