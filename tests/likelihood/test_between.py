"""The spread between logs, and predicted errors, by hand."""

import numpy as np
import pytest

from mobilecal_cli.likelihood.between import between_variance
from mobilecal_cli.likelihood.predict import predicted
from mobilecal_cli.model import Parameters, WheelGeometry


def test_between_variance_of_two_equal_weights():
    """Values 0 and 4, own variance 1: the sample variance 8 less the own variance."""
    assert between_variance(np.array([0.0, 4.0]), np.array([1.0, 1.0])) == pytest.approx(7.0)


def test_between_variance_of_unequal_weights():
    """Weights 1, 1/4, 1/4 and values 0, 3, 6: mean 1.5, Q = 2.25 + 0.5625 + 5.0625, spare = 1.5 - 1.125 / 1.5."""
    found = between_variance(np.array([0.0, 3.0, 6.0]), np.array([1.0, 2.0, 2.0]))
    assert found == pytest.approx((7.875 - 2) / 0.75)


@pytest.mark.parametrize("values", [[1.0, 1.5], [np.nan, 7.0], [3.0]])
def test_no_between_variance_without_signs_of_it(values):
    assert between_variance(np.array(values), np.ones(len(values))) == 0.0


def test_predicted_errors_by_hand():
    """Radii 0.1 m, separation 0.5 m; sigma of a radius 0.1 mm, of the separation 1 mm, all independent."""
    covariance = np.diag([1e-6, 0, 0, 9e-6, 16e-6, 0, 1e-8, 1e-8, 1e-6])
    parameters = Parameters(np.eye(4), WheelGeometry(0.1, 0.1, 0.5))
    found = predicted(parameters, covariance)
    assert found.camera_m == pytest.approx(5e-3)
    assert found.camera_rad == pytest.approx(1e-3)
    assert found.point_m == pytest.approx(np.sqrt(25e-6 + (2 * 1e-3) ** 2))
    # One wheel goes 0.1 % further: the middle goes 0.05 % further, the heading turns by 0.001 / 0.5 rad a metre.
    assert found.along_m_per_m == pytest.approx(np.hypot(5e-4, 5e-4))
    assert found.heading_rad_per_m == pytest.approx(np.hypot(2e-3, 2e-3))
    assert found.sideways_m_per_m == pytest.approx(found.heading_rad_per_m / 2)
    assert found.heading_rad_per_turn == pytest.approx(2 * np.pi * np.sqrt(2 * 5e-4**2 + 2e-3**2))
