"""Decisions about single measurements, on fits that are spelled out here."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import f as fisher

from mobilecal_cli.likelihood.residual_tests import limit
from mobilecal_cli.solvers.outliers import too_many

STATIONS = 9


def fit(legs=()):
    """A fit without some legs."""
    inliers = SimpleNamespace(
        legs=~np.isin(np.arange(STATIONS - 1), legs),
        views=np.ones(STATIONS, dtype=bool),
        readings=np.ones((STATIONS, 2), dtype=bool),
    )
    return SimpleNamespace(inliers=inliers)


@pytest.mark.parametrize(("legs", "kinds"), [((1, 4), ()), ((1, 4, 6), ("legs",))])
def test_more_than_a_third_of_a_kind_are_too_many(legs, kinds):
    assert too_many(fit(legs).inliers) == kinds


@pytest.mark.parametrize(("stations", "chance"), [(12, 1e-4), (60, 1e-4), (200, 2.5e-5)])
def test_a_good_measurement_is_rejected_in_one_of_ten_thousand_recordings_of_fifty_stations(stations, chance):
    assert limit(stations, 3, 20.0) == pytest.approx(3 * fisher.isf(chance, 3, 20.0), rel=1e-6)
