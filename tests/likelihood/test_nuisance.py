"""One row adds a constant: its derivative, prior, estimate, evidence, budget and line in the report follow."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from mobilecal_cli.likelihood import nuisance
from mobilecal_cli.likelihood.effects import JointReading
from mobilecal_cli.likelihood.nuisance import KINDS, Constant, Kind
from mobilecal_cli.simulate.robot import paper_robot, tick_robot
from mobilecal_cli.solvers import constraints_of, solve
from tests.extractions import Noise, simulated
from tests.fits import maximum_likelihood
from tests.likelihood.test_normal import Case, reduced
from tests.report.example import made, rows_of
from tests.robots import chain_of, three_on_pan_tilt

SHIFT_RAD = 0.02


@dataclass(frozen=True)
class ShakyJoint(JointReading):
    """A made-up constant: the first joint is further than read, at odd stations only."""

    def rate(self, data):
        rate = np.zeros_like(data.joints)
        rate[1::2, 0] = 1.0
        return rate


SHAKY = Constant(
    "shaky_joint", "shaky", "torso", "shift of the torso at odd stations", ShakyJoint(0, "zero"), 0.005
)


@pytest.fixture
def table(monkeypatch):
    monkeypatch.setattr(nuisance, "CONSTANTS", (*nuisance.CONSTANTS, SHAKY))
    kind = Kind("shaky", "rad", "deg", 180 / np.pi, 0.005, "a made-up kind")
    monkeypatch.setattr(nuisance, "_BY_NAME", {**nuisance._BY_NAME, "shaky": kind})


def shaken():
    """A recording of a robot whose torso is pitched further than it reads at odd stations."""
    extraction = simulated("standard", Noise(0.2, 0.003, 0.0, np.radians(0.05)), seed=1)
    seen = list(extraction.observations)
    for k in range(1, len(seen), 2):
        seen[k] = replace(seen[k], joints=seen[k].joints - SHIFT_RAD * np.eye(len(seen[k].joints))[0])
    return replace(extraction, observations=tuple(seen))


@pytest.mark.usefixtures("table")
def test_a_made_up_constant_is_estimated_and_reported():
    extraction = shaken()
    solution = solve(extraction)
    found = solution.constants["shaky_joint"]
    assert abs(found.value - SHIFT_RAD) < 4 * found.std
    assert found.std < 0.3 * found.prior
    assert next(e for e in solution.evidence if e.kind == "shaky").part == "torso"
    rows = rows_of(made(solution, extraction), "description", "Estimated constants")
    meaning, value, _, _, unit, *_ = rows["shaky_joint"]
    assert SHAKY.meaning in meaning
    assert (unit, float(value)) == ("deg", pytest.approx(np.degrees(found.value), rel=0.01))


@pytest.mark.long
@pytest.mark.usefixtures("table")
def test_a_made_up_constant_has_a_prior_and_a_share_of_the_budget():
    fit = maximum_likelihood(shaken(), constraints_of([], [], []), None)
    narrow = replace(shaken(), rig=replace(shaken().rig, prior_sigmas={"shaky": 1e-5}))
    held = maximum_likelihood(narrow)
    assert abs(held.lin.state.value("shaky_joint")) < 0.1 * SHIFT_RAD  # the prior wins
    for each in (fit, held):
        budget = each.budget
        assert np.allclose(sum(budget.values()), each.lin.covariance, rtol=1e-9, atol=1e-15)
    k = held.data.layout.names.index("shaky_joint")
    assert held.budget["shaky"][k, k] > 0.9 * held.lin.covariance[k, k]


@pytest.mark.usefixtures("table")
def test_the_derivative_of_a_made_up_constant():
    robot = paper_robot()
    rows = nuisance.table(robot.rig_cameras, chain_of(robot))
    case = Case("standard", [row for row in rows if row.kind in ("shaky", "stereo_clock")])
    H, g = case.dense
    S, _ = reduced(case, H, g)
    k = case.data.layout.names.index("shaky_joint")
    assert case.lin.normal.S[k, k] == pytest.approx(S[k, k], rel=1e-6)


def test_every_kind_of_the_table_has_rows():
    of_others = {"camera_rotation", "camera_position"}
    of_pairs = {"stereo_rotation", "baseline_direction", "baseline_length"}
    lacking = ((paper_robot(), of_others), (tick_robot(), of_others), (three_on_pan_tilt(), of_pairs))
    for robot, lacks in lacking:
        rows = (*nuisance.table(robot.rig_cameras, chain_of(robot)), *nuisance.floors_of([0, 1]))
        assert {row.kind for row in rows} | nuisance.PATTERNS == {kind.name for kind in KINDS} - lacks
        names = [row.name for row in rows]
        assert len(set(names)) == len(names)
        assert "tilt_zero" not in names  # the head-eye transform absorbs the last zero


def test_priors_narrow_widen_fix_and_free():
    robot = tick_robot()
    rows = nuisance.table(robot.rig_cameras, chain_of(robot))
    given = {"focal_length": 0.01, "focal_left": 0.0, "joint_zero": np.inf, "pan_scale": 2e-5}
    sigmas = {row.name: row.sigma for row in nuisance.with_priors(rows, given)}
    default = {row.name: row.sigma for row in rows}
    assert "focal_left" not in sigmas
    assert sigmas["focal_right"] == 0.01
    assert sigmas["pan_zero"] == nuisance.FREE * default["pan_zero"]
    assert sigmas["pan_scale"] == 2e-5
    assert sigmas["stereo_r_x"] == default["stereo_r_x"]
    assert not list(nuisance.with_priors(rows, {"all": 0.0}))
    assert [r.name for r in nuisance.with_priors(rows, {"all": 0.0, "square_size": 1e-3})] == ["square_scale"]
