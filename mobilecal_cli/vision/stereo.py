"""Geometry of several cameras: projection into all of them, and triangulation."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mobilecal_cli import camera, se3
from mobilecal_cli.model import CameraRig, FloatArray
from mobilecal_cli.vision.values import Miss, StereoPoints, rms

#: Sigma of one coordinate of all corners, px; or each corner's (M, 2, 2) covariance, px^2.
Noise = float | FloatArray

_STEPS = 12
_MAX_RMS_PX = 20.0  # beyond it the pixels are not the same point, and the linearized covariance is invalid


def reproject(rig: CameraRig, points_c: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Project points (..., 3) into all C cameras: (..., 2 C) px, u v of each; Jacobian (..., 2 C, 3)."""
    pixels, J = [], []
    for lens, T_c_camera in zip(rig.each, rig.T_c_each, strict=True):
        T = se3.inverse(T_c_camera)
        at, by_own = camera.project_with_jacobian(lens, points_c @ T[:3, :3].T + T[:3, 3])
        pixels.append(at)
        J.append(by_own @ T[:3, :3])
    return np.concatenate(pixels, axis=-1), np.concatenate(J, axis=-2)


def whitening(noises: Sequence[Noise], count: int) -> FloatArray:
    """Whitening matrices W, (M, 2 C, 2 C): W^T W is the inverse covariance of `reproject`'s coordinates."""
    W = np.zeros((count, 2 * len(noises), 2 * len(noises)))
    for k, noise in enumerate(noises):
        at = slice(2 * k, 2 * k + 2)
        cov = noise if isinstance(noise, np.ndarray) else noise**2 * np.eye(2)
        W[:, at, at] = np.linalg.inv(np.linalg.cholesky(np.broadcast_to(cov, (count, 2, 2))))
    return W


def depths(rig: CameraRig, points_c: FloatArray) -> FloatArray:
    """Depths of points in the frame of each camera: (..., 3) → (..., C), m."""
    T = [se3.inverse(T_c_camera) for T_c_camera in rig.T_c_each]
    return np.stack([points_c @ each[2, :3] + each[2, 3] for each in T], axis=-1)


def _nearest_to_rays(rig: CameraRig, flat: Sequence[FloatArray]) -> FloatArray:
    """Midpoints between the rays of the first two cameras: (M, 2) z = 1 coordinates of each → (M, 3), m."""
    ones = np.ones((len(flat[0]), 1))
    ray, other = (np.hstack([f, ones]) @ T[:3, :3].T for f, T in zip(flat[:2], rig.T_c_each, strict=False))
    start, end = (T[:3, 3] for T in rig.T_c_each[:2])
    origin = end - start
    aa = np.sum(ray * ray, axis=1)
    bb = np.sum(other * other, axis=1)
    ab = np.sum(ray * other, axis=1)
    # Parallel rays intersect at infinity; a small determinant keeps the result finite.
    determinant = aa * bb - ab * ab
    determinant = np.where(np.abs(determinant) < 1e-14, 1e-14, determinant)
    along = (bb * (ray @ origin) - ab * (other @ origin)) / determinant
    along_other = (ab * (ray @ origin) - aa * (other @ origin)) / determinant
    midpoint: FloatArray = start + 0.5 * (along[:, None] * ray + origin + along_other[:, None] * other)
    return midpoint


def triangulate(rig: CameraRig, pixels: Sequence[FloatArray], noises: Sequence[Noise]) -> StereoPoints | Miss:
    """Triangulate the pixels of two or more cameras by minimizing the reprojection error.

    Starts from the midpoint of two rays and does Gauss-Newton iterations on the residuals of each point,
    weighted by the noise of the corners (the cost of Hartley and Sturm 1997, here for any number of cameras and
    with lens distortion). The covariance of a point is (J^T W J)^-1.

    Args:
        rig: the cameras, raw or rectified.
        pixels: of each camera, (M, 2) the same points, px.
        noises: of each camera, sigma of one coordinate, px, or (M, 2, 2) covariances, px^2.

    Returns:
        The points, or a Miss if they are behind a camera or the pixels are inconsistent.
    """
    flat, good = zip(
        *(camera.undistorted(lens, at) for lens, at in zip(rig.each, pixels, strict=True)), strict=True
    )
    if not all(each.all() for each in good):
        count = sum(int(np.sum(~each)) for each in good)
        return Miss(
            "left and right images inconsistent",
            f"{count} corners are outside the valid range of the cameras' distortion models",
        )
    points = _nearest_to_rays(rig, flat)
    measured = np.hstack(pixels)
    root = whitening(noises, len(points))
    step: FloatArray = np.full_like(points, np.inf)
    for left in reversed(range(_STEPS + 1)):
        if np.any(depths(rig, points) <= 0):
            return Miss("left and right images inconsistent", "triangulated corners are behind a camera")
        predicted, J = reproject(rig, points)
        A, r = root @ J, root @ (measured - predicted)[..., None]
        At = np.swapaxes(A, 1, 2)
        normal = At @ A
        if not left or np.all(np.abs(step) <= 1e-12 * np.abs(points[:, 2:])):
            break
        step = np.asarray(np.linalg.solve(normal, At @ r)[..., 0], dtype=np.float64)
        points = points + step
    residual_px = rms(measured - predicted)
    if residual_px > _MAX_RMS_PX:
        return Miss(
            "left and right images inconsistent",
            f"distance from the epipolar lines {residual_px:.1f} px rms, limit {_MAX_RMS_PX:.0f} px",
        )
    return StereoPoints(points, np.linalg.inv(normal).astype(np.float64), residual_px)
