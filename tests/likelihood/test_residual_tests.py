"""The residual test: the same for a measurement that is used and for one that is left out."""

from dataclasses import replace

import numpy as np
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


def left_out(fit, kind, at):
    """The distance of a measurement from the prediction of all others."""
    inliers = getattr(fit.inliers, kind).copy()
    inliers[at] = False
    lin = fit.lin.with_inliers(replace(fit.inliers, **{kind: inliers}))
    return getattr(ResidualTests(lin.extrapolated(proposed(lin)[0])), kind)[at]


@pytest.mark.parametrize(("kind", "places"), [("legs", [(0,), (4,), (7,)]), ("readings", [(2, 0), (6, 1)])])
def test_a_measurement_has_the_same_distance_used_and_left_out(fit, kind, places):
    used = getattr(ResidualTests(fit.lin), kind)
    assert [left_out(fit, kind, at) for at in places] == pytest.approx([used[at] for at in places], rel=0.05)


def test_images_have_the_same_distance_used_and_left_out(monkeypatch, fit):
    """Constants of cameras and board move the predicted images, too. What the images say of them alone is lost.

    One station alone shows a constant: there the first order is 30 % off.
    """
    monkeypatch.setattr(residual_tests, "_NO_REDUNDANCY", 1e-6)
    stations = range(fit.data.stations)
    ratio = [left_out(fit, "views", (at,)) for at in stations] / ResidualTests(fit.lin).views
    assert 0.98 < np.median(ratio) < 1.02
    assert 0.9 < ratio.min() < np.sort(ratio)[-2] < 1.1
    assert ratio.max() < 1.4


def test_images_of_good_stations_are_as_far_off_as_six_numbers(fit):
    views = ResidualTests(fit.lin).views
    assert 2 < views.mean() < 8
    assert 0.1 < views.min() < views.max() < 30
