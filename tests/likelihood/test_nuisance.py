"""One row adds a constant: its derivative, prior, estimate, evidence, budget and line in the report follow."""

from dataclasses import dataclass, replace

import numpy as np
import pytest

from mobilecal_cli.likelihood import nuisance
from mobilecal_cli.likelihood.effects import HeadEffect
from mobilecal_cli.likelihood.nuisance import Constant
from mobilecal_cli.report.findings import evidence_rows, extra_rows
from mobilecal_cli.simulate.ideal import Noise, ideal_extraction
from mobilecal_cli.simulate.robot import paper_robot
from mobilecal_cli.simulate.route import plan_route
from mobilecal_cli.solvers import constraints_of, solve
from mobilecal_cli.solvers.maximum_likelihood import maximum_likelihood
from tests.likelihood.test_normal import Case, reduced


@dataclass(frozen=True)
class ShakyMount(HeadEffect):
    """A made-up constant: the head's mount is further forward than stated, at odd stations only."""

    def apply(self, T_v_h, value):
        T = T_v_h.copy()
        T[1::2, 0, 3] += value
        return T

    def twist(self, T_v_h):
        return np.eye(6)[3] * (np.arange(len(T_v_h)) % 2)[:, None]


SHAKY = Constant("shaky_mount", "shaky", "m", 0.05, "forward shift of the head at odd stations", ShakyMount())


@pytest.fixture
def table(monkeypatch):
    monkeypatch.setattr(nuisance, "CONSTANTS", (*nuisance.CONSTANTS, SHAKY))


def shaken(shift_m):
    """A recording of a robot whose head is further forward at odd stations."""
    robot = paper_robot()
    route = plan_route(robot, "standard", seed=1)
    first = robot.joints[0]
    x, y, z = first.xyz_m
    forward = replace(robot, joints=(replace(first, xyz_m=(x + shift_m, y, z)), *robot.joints[1:]))
    noise = Noise(0.2, 0.003, 0.0, np.radians(0.05))
    still, moved = (ideal_extraction(each, route, noise, 1) for each in (robot, forward))
    pairs = zip(still.observations, moved.observations, strict=True)
    return replace(still, observations=tuple(two[k % 2] for k, two in enumerate(pairs)))


@pytest.mark.usefixtures("table")
def test_a_made_up_constant_is_estimated_and_reported():
    extraction = shaken(0.02)
    offered = {e.group: e for e in solve(extraction).evidence}["shaky"]
    assert offered.state == "offered"
    assert offered.bic > 10
    found = solve(extraction, constraints=constraints_of([], [], ["shaky"]))
    value, std = found.constants["shaky_mount"]
    assert abs(value - 0.02) < 4 * std
    assert {e.group: e.state for e in found.evidence}["shaky"] == "estimated"
    (row,) = extra_rows(found, extraction)
    assert (row.name, row.meaning, row.unit) == ("shaky_mount", SHAKY.meaning, "mm")
    assert any(e.group == "shaky" for e, _, _ in evidence_rows(found, extraction))


@pytest.mark.usefixtures("table")
def test_a_made_up_constant_has_a_prior_and_a_share_of_the_budget():
    extraction = shaken(0.02)
    fit = maximum_likelihood(extraction, constraints_of([], ["shaky_mount=0.0±0.0001"], ["shaky"]))
    k = fit.data.layout.names.index("shaky_mount")
    assert abs(fit.lin.state.value("shaky_mount")) < 0.005  # the prior wins
    budget = fit.lin.budget()
    assert np.allclose(sum(budget.values()), fit.lin.covariance, rtol=1e-9, atol=1e-15)
    assert budget["prior shaky_mount"][k, k] > 0.9 * fit.lin.covariance[k, k]
    free = maximum_likelihood(extraction, constraints_of([], [], ["shaky"]))
    assert free.lin.budget()["prior shaky_mount"][k, k] < 0.01 * free.lin.covariance[k, k]


@pytest.mark.usefixtures("table")
def test_the_derivative_of_a_made_up_constant():
    case = Case("standard", nuisance.CONSTANTS)
    H, g = case.dense()
    S, _ = reduced(case, H, g)
    k = case.data.layout.names.index("shaky_mount")
    assert case.lin.normal.S[k, k] == pytest.approx(S[k, k], rel=1e-6)
