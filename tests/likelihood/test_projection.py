"""Errors of projected points, against steps along the axes of the covariance."""

import numpy as np
import pytest

from mobilecal_cli import se3
from mobilecal_cli.camera import project
from mobilecal_cli.likelihood.constants import camera_change, table
from mobilecal_cli.likelihood.predict import AHEAD_M, projection_std_px
from tests.report.example import drawn

STEP = 0.1  # sigmas; derivatives are exact to its square


@pytest.fixture(scope="module")
def moved():
    """A solution with estimated cameras, and steps of the camera's pose (right twists) and of its constants.

    The covariance is the sum of the outer products of the steps, over `STEP` squared.
    """
    solution, extraction = drawn()
    values, vectors = np.linalg.eigh(solution.uncertainty.camera)
    return solution, extraction, STEP * (vectors * np.sqrt(np.maximum(values, 0))).T


def spread_of(at, steps):
    """Root of the covariance of a function of the steps, (..., n) for a function with values (..., d)."""
    return np.stack([(at(step) - at(-step)) / (2 * STEP) for step in steps], axis=-1)


def test_pixels_spread_as_predicted(moved):
    solution, extraction, steps = moved
    cameras, chain = extraction.rig.cameras, extraction.rig.chain
    points = np.array([[0.0, 0, 2], [0.8, 0.5, 2], [-0.8, -0.3, 1.5], [0.1, 0.2, 0.4], [1.5, -1, 6]])
    rows, values = table(cameras, chain), {c.name: c.value for c in solution.constants.values()}
    names = solution.uncertainty.camera_constants
    assert len(names) >= 8

    def pixels(step):
        constants = values | {name: values[name] + step[6 + i] for i, name in enumerate(names)}
        camera = camera_change(cameras, rows, constants).apply(cameras).each[0]
        return project(camera, se3.act(se3.inverse(se3.exp(step[:6])), points))

    largest = np.linalg.svd(spread_of(pixels, steps), compute_uv=False)[:, 0]
    predicted = projection_std_px(solution, cameras, points)
    np.testing.assert_allclose(predicted, largest, rtol=1e-3)
    assert max(predicted) > 1.2 * min(predicted)


def test_a_point_ahead_spreads_as_predicted_and_the_covariance_is_that_of_expected_errors(moved):
    solution, _, steps = moved
    ahead = np.array([[0.0, 0.0, AHEAD_M]])
    spread = spread_of(lambda step: se3.act(se3.exp(step[:6]), ahead), steps)
    assert np.linalg.norm(spread) == pytest.approx(solution.uncertainty.at_work.point_m, rel=1e-3)
    C, at_work = solution.uncertainty.camera, solution.uncertainty.at_work
    assert np.sqrt(np.trace(C[:3, :3])) == pytest.approx(at_work.camera_rad, rel=1e-9)
    assert np.sqrt(np.trace(C[3:6, 3:6])) == pytest.approx(at_work.camera_m, rel=1e-9)
    stds = [solution.constants[name].std for name in solution.uncertainty.camera_constants]
    np.testing.assert_allclose(np.sqrt(np.diag(C)[6:]), stds, rtol=1e-9)
