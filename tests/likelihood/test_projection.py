"""Errors of projected points, against samples of the covariance."""

from __future__ import annotations

import numpy as np
import pytest

from mobilecal_cli import se3
from mobilecal_cli.camera import project
from mobilecal_cli.likelihood.nuisance import camera_change, table
from mobilecal_cli.likelihood.predict import ahead_std_m, projection_std_px
from tests.report.example import drawn

SAMPLES = 20_000


@pytest.fixture(scope="module")
def sampled():
    """A solution with estimated cameras, and samples of the camera's pose (right twists) and of its constants."""
    solution, extraction = drawn()
    C = solution.uncertainty.camera
    rng = np.random.default_rng(7)
    samples = rng.multivariate_normal(np.zeros(len(C)), C, SAMPLES, method="svd")
    return solution, extraction, samples


def test_pixels_spread_as_predicted(sampled):
    solution, extraction, samples = sampled
    cameras, chain = extraction.rig.cameras, extraction.rig.chain
    points = np.array([[0.0, 0, 2], [0.8, 0.5, 2], [-0.8, -0.3, 1.5], [0.1, 0.2, 0.4], [1.5, -1, 6]])
    rows, values = table(cameras, chain), {c.name: c.value for c in solution.constants.values()}
    names = solution.uncertainty.camera_constants
    assert len(names) >= 8
    in_camera = se3.act(se3.inverse(se3.exp(samples[:, :6])), points[None])
    pixels = np.empty((SAMPLES, len(points), 2))
    for k, sample in enumerate(samples):
        constants = values | {name: values[name] + sample[6 + i] for i, name in enumerate(names)}
        camera = camera_change(cameras, rows, constants).apply(cameras).each[0]
        pixels[k] = project(camera, in_camera[k])
    spread = [np.sqrt(np.linalg.eigvalsh(np.cov(pixels[:, i].T))[-1]) for i in range(len(points))]
    predicted = projection_std_px(solution, cameras, points)
    np.testing.assert_allclose(predicted, spread, rtol=0.025)  # four standard deviations of a sampled sigma
    assert max(predicted) > 1.2 * min(predicted)


def test_points_ahead_spread_as_predicted(sampled):
    solution, _, samples = sampled
    distances = np.array([0.3, 2.0, 5.0])
    ahead = np.column_stack([np.zeros((3, 2)), distances])
    moved = se3.act(se3.exp(samples[:, :6]), ahead[None])
    spread = np.sqrt(moved.var(axis=0).sum(axis=-1))
    predicted = ahead_std_m(solution, distances)
    np.testing.assert_allclose(predicted, spread, rtol=0.025)
    assert predicted[1] == pytest.approx(solution.uncertainty.at_work.point_m, rel=1e-9)


def test_its_covariance_is_that_of_the_expected_errors(sampled):
    solution = sampled[0]
    C, at_work = solution.uncertainty.camera, solution.uncertainty.at_work
    assert np.sqrt(np.trace(C[:3, :3])) == pytest.approx(at_work.camera_rad, rel=1e-9)
    assert np.sqrt(np.trace(C[3:6, 3:6])) == pytest.approx(at_work.camera_m, rel=1e-9)
    stds = [solution.constants[name].std for name in solution.uncertainty.camera_constants]
    np.testing.assert_allclose(np.sqrt(np.diag(C)[6:]), stds, rtol=1e-9)
