"""Decisions about single measurements, on fits that are spelled out here."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import f as fisher

from mobilecal_cli.likelihood.residual_tests import limit
from mobilecal_cli.solvers.outliers import consistent_legs, too_many

STATIONS = 9


def fit(legs=(), views=(), statistic=0.0):
    """A fit without some legs and views; `statistic` is that of each leg against what the others predict."""
    count = STATIONS - 1
    inliers = SimpleNamespace(
        legs=~np.isin(np.arange(count), legs),
        views=~np.isin(np.arange(STATIONS), views),
        readings=np.ones((STATIONS, 2), dtype=bool),
    )
    legs_of = np.stack([np.arange(count), np.arange(1, STATIONS)], axis=1)
    data = SimpleNamespace(stations=STATIONS, legs=legs_of)
    tests = SimpleNamespace(predicted_legs=np.full(count, statistic))
    return SimpleNamespace(data=data, inliers=inliers, tests=tests)


@pytest.mark.parametrize(("legs", "kinds"), [((1, 4), ()), ((1, 4, 6), ("legs",))])
def test_more_than_a_third_of_a_kind_are_too_many(legs, kinds):
    assert too_many(fit(legs)) == kinds


def test_one_leg_of_a_stretch_without_images_is_restored_at_a_time():
    restored = consistent_legs(fit(legs=(2, 3, 6), views=(3,)))
    assert restored[6]  # both of its stations are seen
    assert restored[[2, 3]].sum() == 1
    assert consistent_legs(fit(legs=(2, 6), statistic=1e3)) is None


@pytest.mark.parametrize(("stations", "chance"), [(12, 1e-4), (60, 1e-4), (200, 2.5e-5)])
def test_a_good_measurement_is_rejected_in_one_of_ten_thousand_recordings_of_fifty_stations(stations, chance):
    assert limit(stations, 3, 20.0) == pytest.approx(3 * fisher.isf(chance, 3, 20.0), rel=1e-6)
