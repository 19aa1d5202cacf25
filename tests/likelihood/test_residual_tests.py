"""The residual test: the same for a measurement that is used and for one that is left out."""

from dataclasses import replace

import pytest

from mobilecal_cli.likelihood import residual_tests
from mobilecal_cli.likelihood.residual_tests import ResidualTests
from mobilecal_cli.solvers.constraints import Constraints
from mobilecal_cli.solvers.inference import Inference
from mobilecal_cli.solvers.maximum_likelihood import robust_fit
from mobilecal_cli.solvers.optimize import proposed
from tests.bench.imperfect import USUAL, Case


@pytest.fixture(scope="module")
def fit():
    """Every constant is drawn from its prior, and estimated."""
    inference = Inference.of(Case(stations=24).drawn(noise=USUAL).extraction(4), Constraints())
    return robust_fit(inference)


@pytest.mark.parametrize("kind", ["views", "legs", "readings"])
def test_a_measurement_has_the_same_distance_used_and_left_out(monkeypatch, fit, kind):
    """Estimated constants of cameras and board move the predicted images, too."""
    monkeypatch.setattr(residual_tests, "_NO_REDUNDANCY", 1e-6)
    used = getattr(ResidualTests(fit.lin), kind)
    for at in [(1,), (4,), (7,)] if kind != "readings" else [(2, 0), (6, 1)]:
        inliers = getattr(fit.inliers, kind).copy()
        inliers[at] = False
        lin = fit.lin.with_inliers(replace(fit.inliers, **{kind: inliers}))
        lin = lin.predicted(proposed(lin)[0])
        assert used[at] == pytest.approx(getattr(ResidualTests(lin), kind)[at], rel=0.05)


def test_images_of_good_stations_are_as_far_off_as_six_numbers(fit):
    views = ResidualTests(fit.lin).views
    assert 2 < views.mean() < 8
    assert 0.1 < views.min() < views.max() < 30
