"""The spread between logs, and predicted errors, by hand."""

import numpy as np
import pytest

from mobilecal_cli.likelihood.between import between_variance, few_logs_factor
from mobilecal_cli.model.calibration import Parameters
from mobilecal_cli.model.rig import WheelGeometry
from tests.truth import predicted


@pytest.mark.parametrize(
    ("values", "std", "variance"),
    [
        # The sample variance 8 less the own variance.
        ([0.0, 4.0], [1.0, 1.0], 7.0),
        # Weights 1, 1/4, 1/4: mean 1.5, Q = 2.25 + 0.5625 + 5.0625, spare = 1.5 - 1.125 / 1.5.
        ([0.0, 3.0, 6.0], [1.0, 2.0, 2.0], (7.875 - 2) / 0.75),
        ([1.0, 1.5], [1.0, 1.0], 0.0),
        ([3.0], [1.0], 0.0),
    ],
)
def test_between_variance_by_hand(values, std, variance):
    assert between_variance(np.array(values), np.array(std)) == pytest.approx(variance, abs=1e-15)
    assert few_logs_factor(np.array([3.0]), np.array([1.0]), 0.0) == 1.0


@pytest.mark.parametrize(("spread", "most"), [(2.0, 1.0), (20.0, 0.97)])
@pytest.mark.parametrize("logs", [2, 3, 5])
def test_few_recordings_that_differ_are_as_uncertain_as_stated(logs, spread, most):
    """|z| < 2 in 95.4 % of cases where the spread is large, and in no fewer where it is small.

    Spread of twice the recordings' own sigma: 100, 99 and 96 % of 20,000; the normal distribution gives 71 to 85 %.
    """
    random = np.random.default_rng(logs)
    inside, naive, alike = [], [], []
    for _ in range(4000):
        std = random.uniform(0.7, 1.4, size=logs)
        values = spread * random.normal(size=logs) + std * random.normal(size=logs)
        variance = between_variance(values, std)
        weight = 1 / (std**2 + variance)
        mean, sigma = np.sum(weight * values) / weight.sum(), weight.sum() ** -0.5
        factor = few_logs_factor(values, std, variance)
        inside.append(abs(mean) < 2 * sigma * factor)
        naive.append(abs(mean) < 2 * sigma)
        if (
            np.sum(((values - mean) / std) ** 2) > 10 * logs
        ):  # what is more than chance: the spread alone is wider
            spread_alone = np.sum(1 / (std**2 + factor**2 * variance)) ** -0.5
            alike.append((abs(mean) < 2 * sigma * factor) == (abs(mean) < 2 * spread_alone))
    assert 0.94 < np.mean(inside) <= most
    assert np.mean(alike) > 0.985
    assert np.mean(naive) < 0.9


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
