"""Readings of wheels and joints at moments between two messages."""

import numpy as np
import pytest

from mobilecal_cli.likelihood.dataset import between_readings
from mobilecal_cli.model import Track

TIMES_NS = np.arange(0, 2_000_000_001, 100_000_000)
AT_S = TIMES_NS * 1e-9
BETWEEN_NS = np.array([950_000_000])


def sigma(values, moving=True):
    tracks = [[Track(TIMES_NS, values)]]
    return float(between_readings(tracks, np.zeros(1, int), BETWEEN_NS, np.array([moving]), 1)[0, 0])


@pytest.mark.parametrize(
    ("values", "exact", "least", "most"),
    [
        (3 * AT_S, 3 * 0.95, 0.0, 1e-12),  # a steady rate
        (0.5 * AT_S**2, 0.5 * 0.95**2, 1.0, 2.5),  # a steady acceleration
        (np.abs(AT_S - 0.95), 0.0, 0.4, 0.6),  # a sudden one, in the middle between two readings
    ],
)
def test_the_sigma_is_of_the_size_of_the_error(values, exact, least, most):
    error = abs(float(Track(TIMES_NS, values).at(BETWEEN_NS)[0]) - exact)
    assert least * error <= sigma(values) <= most * error + 1e-12


def test_at_rest_and_without_tracks_nothing_is_interpolated():
    assert sigma(np.abs(AT_S - 0.95), moving=False) == 0
    assert not between_readings([], np.zeros(1, int), BETWEEN_NS, np.array([True]), 2).any()
