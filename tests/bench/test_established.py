"""What the established solvers are given, against the product's own likelihood."""

from dataclasses import replace

import numpy as np
import pytest

from mobilecal_cli.likelihood.dataset import Inliers, dataset_of
from mobilecal_cli.simulate.robot import PAPER_ROBOT
from mobilecal_cli.solvers.initial import start_state
from tests.bench.established import likelihood_at
from tests.bench.established_terms import Terms
from tests.bench.simulated import DISTURBED, route_of
from tests.extractions import extraction_of
from tests.truth import parameters_of


@pytest.fixture(scope="module")
def case():
    """Terms at a start, and all unknowns a little away from it."""
    robot = PAPER_ROBOT
    extraction = extraction_of(robot, route_of(5, 0), DISTURBED, 0)
    data = dataset_of(extraction)
    start = start_state(data, parameters_of(robot), Inliers.all_of(data))
    terms = Terms(data, start)
    random = np.random.default_rng(0)
    first = terms.first()
    near = replace(
        first,
        **{name: getattr(first, name) + 1e-3 * random.normal(size=len(getattr(first, name)))
           for name in ("head_eye", "board", "wheels")},
        bases=[first.bases[0], *(base + 1e-3 * random.normal(size=3) for base in first.bases[1:])],
        errors=[1e-3 * random.normal(size=terms.joints) for _ in first.errors],
    )  # fmt: skip
    return terms, near


def all_terms(terms, at):
    """(function, number, blocks) of every term."""
    for station, (base, error) in enumerate(zip(at.bases, at.errors, strict=True)):
        yield terms.views, station, [at.head_eye, at.board, base, error]
        yield terms.reading, station, [error]
    for leg, (i, j) in enumerate(terms.data.legs):
        yield terms.leg, leg, [at.bases[i], at.bases[j], at.wheels]


def test_the_sum_of_squares_is_the_products(case):
    terms, at = case
    total = sum(np.sum(term(False, number, *blocks)[0] ** 2) for term, number, blocks in all_terms(terms, at))
    ours = replace(likelihood_at(terms.data, terms.start), state=terms.state(at)).cost
    assert ours == pytest.approx(total, rel=1e-9)  # the product's floor may be off by a microradian here
