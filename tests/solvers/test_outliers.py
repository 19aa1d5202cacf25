"""Decisions about single measurements, on fits that are spelled out here."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import f as fisher

from mobilecal_cli.likelihood.residual_tests import limit
from mobilecal_cli.solvers.outliers import too_many

STATIONS = 9


def used(legs=(), views=()):
    """Measurements of two recordings without some legs and views, and these."""
    log = np.repeat([0, 1], STATIONS)
    ends = np.array([(i, i + 1) for i in range(2 * STATIONS - 1) if i + 1 != STATIONS])
    inliers = SimpleNamespace(
        legs=~np.isin(np.arange(len(ends)), legs),
        views=~np.isin(np.arange(len(log)), views),
        readings=np.ones((len(log), 2), dtype=bool),
    )
    return SimpleNamespace(log=log, legs=ends), inliers


@pytest.mark.parametrize(
    ("legs", "views", "kinds"),
    [
        ((1, 3, 5, 9, 13), (), ()),
        ((1, 3, 5, 9, 11, 13), (), ("legs",)),
        ((), (1, 2, 3, 4, 5, 6, 7), ("readings", "views")),
        ((), (3, 4, 5, 6, 7, 8, 9), ()),  # a change before the end of the first recording, and one station
        ((), (0, 1, 2, 3, 13, 14, 15, 16, 17), ()),
        ((), (0, 1, 2, 15, 16, 17), ()),
        ((), (0, 1, 2, 9, 15, 16, 17), ("readings", "views")),  # no stretch is long
    ],
)
def test_more_than_a_third_of_a_kind_are_too_many_unless_something_changed(legs, views, kinds):
    assert too_many(*used(legs, views)) == kinds


@pytest.mark.parametrize(("stations", "chance"), [(12, 1e-4), (50, 1e-4), (60, 1e-4 / 1.2), (200, 2.5e-5)])
def test_a_good_measurement_is_rejected_in_one_of_ten_thousand_recordings_of_fifty_stations(stations, chance):
    assert limit(stations, 3, 20.0) == pytest.approx(3 * fisher.isf(chance, 3, 20.0), rel=1e-6)
