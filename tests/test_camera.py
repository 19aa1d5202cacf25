"""Camera models against OpenCV's, their Jacobians against differences, and there and back."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from mobilecal_cli.camera import lens_terms_up_to, project, project_with_jacobian, undistorted
from mobilecal_cli.model.rig import Camera, LensCorrection

K = np.array([[533.5, 0.0, 341.6], [0.0, 531.0, 235.2], [0.0, 0.0, 1.0]])
TILTED = [0.31, -0.12, 0.001, -0.0007, 0.01, 0.6, -0.05, 0.02, 0.002, -0.001, 0.003, 0.0007, 0.03, -0.02]
MODELS = {
    "none": ("none", []),
    "plumb_bob": ("plumb_bob", [-0.288, 0.097, 0.001, -0.0003, 0.02]),
    "rational8": ("rational_polynomial", TILTED[:8]),
    "prism12": ("rational_polynomial", TILTED[:12]),
    "tilted14": ("rational_polynomial", TILTED),
    "equidistant": ("equidistant", [-0.02, 0.004, -0.003, 0.0007]),
}


def camera(name: str) -> Camera:
    distortion, D = MODELS[name]
    return Camera("optical", 640, 480, K, np.array(D), distortion)


def directions(seed: int, n: int = 60) -> np.ndarray:
    rng = np.random.default_rng(seed)
    depth = rng.uniform(0.4, 5, n)
    return np.column_stack([rng.uniform(-0.6, 0.6, n) * depth, rng.uniform(-0.5, 0.5, n) * depth, depth])


@pytest.mark.parametrize("name", MODELS)
def test_pixels_are_those_of_opencv(name: str) -> None:
    points = directions(1)
    zero = np.zeros(3)
    D = np.array(MODELS[name][1] or [0.0] * 5)
    if name == "equidistant":
        expected = cv2.fisheye.projectPoints(points[:, None], zero, zero, K, D)[0]
    else:
        expected = cv2.projectPoints(points, zero, zero, K, D)[0]
    np.testing.assert_allclose(project(camera(name), points), expected.reshape(-1, 2), atol=1e-9)


@pytest.mark.parametrize("name", MODELS)
@given(x=st.floats(-0.6, 0.6), y=st.floats(-0.6, 0.6), z=st.floats(0.3, 8))
def test_jacobian_against_differences(name: str, x: float, y: float, z: float) -> None:
    point = np.array([x * z, y * z, z])
    h = 1e-6 * z
    steps = h * np.eye(3)
    ahead, behind = (project(camera(name), point + sign * steps) for sign in (1, -1))
    pixels, J = project_with_jacobian(camera(name), point)
    np.testing.assert_array_equal(pixels, project(camera(name), point))
    np.testing.assert_allclose(J, ((ahead - behind) / (2 * h)).T, atol=2e-5 / z, rtol=1e-6)


@pytest.mark.parametrize("name", MODELS)
def test_pixels_to_rays_and_rays_to_pixels_and_back(name: str) -> None:
    u, v = np.meshgrid(np.linspace(0, 639, 23), np.linspace(0, 479, 17))
    pixels = np.stack([u, v], axis=-1)
    flat = undistorted(camera(name), pixels)[0]
    points = np.concatenate([flat, np.ones((*flat.shape[:-1], 1))], axis=-1)
    assert flat.shape == pixels.shape
    np.testing.assert_allclose(project(camera(name), points), pixels, atol=1e-9)
    points = directions(2)
    flat = undistorted(camera(name), project(camera(name), points))[0]
    np.testing.assert_allclose(flat, points[:, :2] / points[:, 2:], atol=1e-12)


def test_the_waves_of_a_lens_are_small_over_the_image_and_have_their_derivatives() -> None:
    random = np.random.default_rng(0)
    shares = np.append(np.zeros(4), 1e-4 * random.normal(size=lens_terms_up_to(6) - 4))
    K = np.array([[500.0, 0.0, 320.0], [0.0, 500.0, 240.0], [0.0, 0.0, 1.0]])
    plain = Camera("c", 640, 480, K, np.zeros(5), "plumb_bob")
    waving = replace(plain, correction=LensCorrection(shares, K[:2, 2]))
    points = np.column_stack([random.uniform([-0.6, -0.45], [0.6, 0.45], (50, 2)), np.ones(50)])
    moved = project(waving, points) - project(plain, points)
    amplitudes = 640 * np.abs(shares[4:].reshape(-1, 2)).sum(axis=0)
    assert np.all(np.abs(moved) <= amplitudes)
    assert moved.std() > 0.01 * amplitudes.max()
    _, J = project_with_jacobian(waving, points)
    h = 1e-6
    numeric = [
        (project(waving, points + h * e) - project(waving, points - h * e)) / (2 * h) for e in np.eye(3)
    ]
    np.testing.assert_allclose(J, np.stack(numeric, axis=-1), atol=1e-5)
    rays, good = undistorted(waving, project(waving, points))
    assert good.all()
    np.testing.assert_allclose(rays, points[:, :2], atol=1e-9)


def test_pixel_out_of_the_models_reach_is_told() -> None:
    # With k1 = -0.3 alone r (1 - 0.3 r^2) is never above 0.703: nothing is imaged farther out.
    barrel = Camera("optical", 640, 480, K, np.array([-0.3, 0, 0, 0, 0]), "plumb_bob")
    pixels = np.array([[341.6 + 533.5 * 0.69, 235.2], [341.6 + 533.5 * 0.72, 235.2]])
    points, good = undistorted(barrel, pixels)
    assert good.tolist() == [True, False]
    assert np.isfinite(points).all()
    np.testing.assert_allclose(points[0, 0] * (1 - 0.3 * points[0, 0] ** 2), 0.69, atol=1e-12)
