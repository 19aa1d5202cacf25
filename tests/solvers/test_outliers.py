"""Decisions about single measurements, on fits that are spelled out here."""

from types import SimpleNamespace

import numpy as np
import pytest
from scipy.stats import f as fisher

from mobilecal_cli.likelihood.residual_tests import limit
from mobilecal_cli.solvers.outliers import too_many


def test_more_than_a_third_of_a_kind_are_too_many():
    """At a station, images or readings are."""
    few, many = np.arange(9) >= 3, np.arange(9) >= 4
    readings = np.ones((9, 2), dtype=bool)
    assert too_many(SimpleNamespace(legs=few, views=few, readings=readings)) == ()
    assert too_many(SimpleNamespace(legs=many, views=few, readings=readings)) == ("legs",)
    assert too_many(SimpleNamespace(legs=few, views=many, readings=readings)) == ("readings", "views")
    readings[3, 1] = False
    assert too_many(SimpleNamespace(legs=few, views=few, readings=readings)) == ("readings", "views")


@pytest.mark.parametrize(("stations", "chance"), [(12, 1e-4), (50, 1e-4), (60, 1e-4 / 1.2), (200, 2.5e-5)])
def test_a_good_measurement_is_rejected_in_one_of_ten_thousand_recordings_of_fifty_stations(stations, chance):
    assert limit(stations, 3, 20.0) == pytest.approx(3 * fisher.isf(chance, 3, 20.0), rel=1e-6)
