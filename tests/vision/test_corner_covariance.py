"""Covariances of corners, from the fit to the observation."""

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.model.rig import Board
from mobilecal_cli.vision import Detection, Miss
from mobilecal_cli.vision.corner_model import fit_corners
from mobilecal_cli.vision.observing import StationCorners
from mobilecal_cli.vision.values import Appearance
from tests.pairs import board_pose, triangulate
from tests.vision.scenes import pose, seen, stereo_rig

BOARD = Board(9, 6, 0.05)


def covariances(random: np.random.Generator, count: int) -> np.ndarray:
    """Of very different sizes and directions, px^2."""
    size = 0.02 * np.exp(random.normal(0, 1, (count, 2)))
    angle = random.uniform(0, np.pi, count)
    turn = np.moveaxis(np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]), -1, 0)
    return turn @ (size[:, :, None] ** 2 * np.eye(2)) @ np.swapaxes(turn, 1, 2)


def test_points_and_pose_use_every_corner_for_what_it_is_worth():
    rig, random = stereo_rig("raw"), np.random.default_rng(1)
    T = pose(0.05, 0.02, 1.2, (0.3, -0.2, 0.1), BOARD, 0.05)
    _, left, right = seen(rig, T, BOARD, 0.05)
    cov = covariances(random, 54), covariances(random, 54)
    roots = [np.linalg.cholesky(c) for c in cov]
    nees, plain = [], []
    for _ in range(60):
        both = zip((left, right), roots, strict=True)
        a, b = (p + (r @ random.normal(size=(54, 2, 1)))[..., 0] for p, r in both)
        for noise, errors in ((cov, nees), ((0.03, 0.03), plain)):
            points = triangulate(rig, a, b, *noise)
            assert not isinstance(points, Miss)
            found = board_pose(rig, BOARD.grid() * 0.05, a, b, *noise, T)
            off = se3.log(found.T_c_k @ np.linalg.inv(T))
            errors.append((off @ np.linalg.solve(found.T_c_k_cov, off) / 6, np.linalg.norm(off[:3])))
    assert 0.75 < np.mean([n for n, _ in nees]) < 1.3
    # Corners that differ by a factor of several are worth more when that is known.
    assert np.mean([e for _, e in nees]) < 0.8 * np.mean([e for _, e in plain])


def test_an_average_keeps_the_claims_apart():
    rig, random = stereo_rig("raw"), np.random.default_rng(2)
    T = pose(0.05, 0.02, 1.2, (0.3, -0.2, 0.1), BOARD, 0.05)
    _, left, _ = seen(rig, T, BOARD, 0.05)
    cov = covariances(random, 54)
    root = np.linalg.cholesky(cov)
    noisy = (left + (root @ random.normal(size=(54, 2, 1)))[..., 0] for _ in range(400))
    found = [Detection(pixels, 0.03, cov=cov) for pixels in noisy]
    average = StationCorners.of(found, BOARD).average(BOARD, rig.each[0])
    usual = np.median(np.trace(cov, axis1=1, axis2=2)) / 2
    own = average.cov_px2 - cov / 400
    # What the average is noisier than claimed, if it is, is the same for all corners and both directions.
    assert np.allclose(own, own[0, 0, 0] * np.eye(2), atol=1e-12)
    assert own[0, 0, 0] >= -1e-12
    assert average.sigma_px**2 >= usual / 400


def test_no_grid_at_all_is_no_corners_and_no_warning():
    image = np.full((200, 200), 100, np.uint8)
    points = np.tile(np.linspace(20, 180, 9)[:, None], (6, 1, 2)).reshape(6, 9, 2)  # all on one line
    fit = fit_corners(image, points, Appearance())
    assert not fit.fitted.any()
