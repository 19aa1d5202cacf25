"""Stereo geometry: projection into both cameras, and triangulation."""

from __future__ import annotations

import numpy as np

from mobilecal_cli import camera, se3
from mobilecal_cli.model import FloatArray, StereoRig
from mobilecal_cli.vision.values import Miss, StereoPoints, rms

#: Sigma of one coordinate of all corners, px; or each corner's (M, 2, 2) covariance, px^2.
Noise = float | FloatArray

_STEPS = 12
_MAX_RMS_PX = 20.0  # beyond it the pixels are not the same point, and the linearized covariance is invalid


def reproject(rig: StereoRig, points_c: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Project points (..., 3) into both cameras: (..., 4) px, left u v, right u v; Jacobian (..., 4, 3)."""
    T_r_c = se3.inverse(rig.T_c_r)
    left, J_left = camera.project_with_jacobian(rig.left, points_c)
    right, J_right = camera.project_with_jacobian(rig.right, points_c @ T_r_c[:3, :3].T + T_r_c[:3, 3])
    return np.concatenate([left, right], axis=-1), np.concatenate([J_left, J_right @ T_r_c[:3, :3]], axis=-2)


def whitening(noise_left: Noise, noise_right: Noise, count: int) -> FloatArray:
    """Whitening matrices W, (M, 4, 4): W^T W is the inverse covariance of `reproject`'s four coordinates."""
    W = np.zeros((count, 4, 4))
    for at, noise in ((slice(0, 2), noise_left), (slice(2, 4), noise_right)):
        cov = noise if isinstance(noise, np.ndarray) else noise**2 * np.eye(2)
        W[:, at, at] = np.linalg.inv(np.linalg.cholesky(np.broadcast_to(cov, (count, 2, 2))))
    return W


def depths(rig: StereoRig, points_c: FloatArray) -> FloatArray:
    """Depths of points in the left and right camera frame: (..., 3) → (..., 2), m."""
    T_r_c = se3.inverse(rig.T_c_r)
    return np.stack([points_c[..., 2], points_c @ T_r_c[2, :3] + T_r_c[2, 3]], axis=-1)


def _nearest_on_left_rays(rig: StereoRig, flat_left: FloatArray, flat_right: FloatArray) -> FloatArray:
    """Midpoints between pairs of rays: (M, 2) and (M, 2) z = 1 coordinates → (M, 3), m."""
    ones = np.ones((len(flat_left), 1))
    ray_left = np.hstack([flat_left, ones])
    ray_right = np.hstack([flat_right, ones]) @ rig.T_c_r[:3, :3].T
    origin = rig.T_c_r[:3, 3]
    ll = np.sum(ray_left * ray_left, axis=1)
    rr = np.sum(ray_right * ray_right, axis=1)
    lr = np.sum(ray_left * ray_right, axis=1)
    # Parallel rays intersect at infinity; a small determinant keeps the result finite.
    determinant = ll * rr - lr * lr
    determinant = np.where(np.abs(determinant) < 1e-14, 1e-14, determinant)
    along_left = (rr * (ray_left @ origin) - lr * (ray_right @ origin)) / determinant
    along_right = (lr * (ray_left @ origin) - ll * (ray_right @ origin)) / determinant
    midpoint: FloatArray = 0.5 * (along_left[:, None] * ray_left + origin + along_right[:, None] * ray_right)
    return midpoint


def triangulate(
    rig: StereoRig,
    pixels_left: FloatArray,
    pixels_right: FloatArray,
    noise_left: Noise,
    noise_right: Noise,
) -> StereoPoints | Miss:
    """Triangulate pairs of pixels by minimizing the reprojection error.

    Starts from the midpoint of the rays and does Gauss-Newton iterations on the four residuals of each point,
    weighted by the noise of the corners (the cost of Hartley and Sturm 1997, here for any stereo geometry and
    with lens distortion). The covariance of a point is (J^T W J)^-1.

    Args:
        rig: the stereo pair, raw or rectified.
        pixels_left, pixels_right: (M, 2) the same points in each image, px.
        noise_left, noise_right: sigma of one coordinate, px, or (M, 2, 2) covariances, px^2.

    Returns:
        The points, or a Miss if they are behind a camera or the pairs are inconsistent.
    """
    flat_left, good_left = camera.undistorted(rig.left, pixels_left)
    flat_right, good_right = camera.undistorted(rig.right, pixels_right)
    if not (good_left.all() and good_right.all()):
        count = int(np.sum(~good_left) + np.sum(~good_right))
        return Miss(
            "left and right images inconsistent",
            f"{count} corners are outside the valid range of the cameras' distortion models",
        )
    points = _nearest_on_left_rays(rig, flat_left, flat_right)
    behind = Miss("left and right images inconsistent", "triangulated corners are behind a camera")
    measured = np.hstack([pixels_left, pixels_right])
    root = whitening(noise_left, noise_right, len(points))
    for _ in range(_STEPS):
        if np.any(depths(rig, points) <= 0):
            return behind
        predicted, J = reproject(rig, points)
        A, r = root @ J, root @ (measured - predicted)[..., None]
        At = np.swapaxes(A, 1, 2)
        step = np.linalg.solve(At @ A, At @ r)[..., 0]
        points = points + step
        if np.all(np.abs(step) <= 1e-12 * np.abs(points[:, 2:])):
            break
    if np.any(depths(rig, points) <= 0):
        return behind
    predicted, J = reproject(rig, points)
    residual_px = rms(measured - predicted)
    if residual_px > _MAX_RMS_PX:
        return Miss(
            "left and right images inconsistent",
            f"distance from the epipolar lines {residual_px:.1f} px rms, limit {_MAX_RMS_PX:.0f} px",
        )
    A = root @ J
    covariance = np.linalg.inv(np.swapaxes(A, 1, 2) @ A).astype(np.float64)
    return StereoPoints(points, covariance, residual_px)
