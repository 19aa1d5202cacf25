"""Simulated stereo pair: two slightly different cameras, with the rectification of a ROS driver."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from mobilecal_cli.model import Camera, CameraInfo, FloatArray, StereoRig

WIDTH, HEIGHT = 640, 480
BASELINE_M = 0.12
_DISPLACEMENT_ROUNDS = (
    5  # displaced by 0.4 % of the width: to 1e-8 px, because each shrinks the error 50 times
)


def stereo_infos(
    prefix: str, focal_px: float = 550.0, shift_px: float = 0.0
) -> tuple[CameraInfo, CameraInfo]:
    """CameraInfo of the left and right camera: 640x480, 0.12 m baseline, moderate plumb_bob distortion.

    Args:
        prefix: of the frame names, "<prefix>_left_optical" and "<prefix>_right_optical".
        focal_px: approximate focal length of both cameras, px.
        shift_px: offset of the principal points, so that two robots have different cameras, px.

    Returns:
        Left and right, with R and P as in ROS: P[0, 3] of the right camera is -f * baseline.
    """
    K_left = np.array([[focal_px, 0, 322.4 + shift_px], [0, focal_px + 0.8, 236.1 - shift_px], [0, 0, 1]])
    K_right = np.array(
        [[focal_px + 2.9, 0, 316.8 - shift_px], [0, focal_px + 3.3, 243.5 + shift_px], [0, 0, 1]]
    )
    D_left = np.array([-0.268, 0.087, 0.0006, -0.0004, 0.0])
    D_right = np.array([-0.274, 0.094, -0.0003, 0.0007, 0.0])
    R_c_r = Rotation.from_rotvec([0.0063, -0.0081, 0.0047])
    p_c_r = np.array([BASELINE_M, -0.0011, 0.0018])
    p_c_r *= BASELINE_M / np.linalg.norm(p_c_r)
    # Rectified axes: x along the baseline, z as near as possible to the mean of both optical axes.
    x = p_c_r / np.linalg.norm(p_c_r)
    forward = np.array([0.0, 0.0, 1.0]) + R_c_r.as_matrix()[:, 2]
    y = np.cross(forward, x)
    y /= np.linalg.norm(y)
    R_rect_c = np.stack([x, y, np.cross(x, y)])
    P_left = np.array([[focal_px, 0, 320.0, 0], [0, focal_px, 240.0, 0], [0, 0, 1, 0]])
    P_right = P_left.copy()
    P_right[0, 3] = -focal_px * BASELINE_M
    left = CameraInfo(f"{prefix}_left_optical", WIDTH, HEIGHT, K_left, D_left, "plumb_bob", R_rect_c, P_left)
    R_rect_r = R_rect_c @ R_c_r.as_matrix()
    right = CameraInfo(
        f"{prefix}_right_optical", WIDTH, HEIGHT, K_right, D_right, "plumb_bob", R_rect_r, P_right
    )
    return left, right


def stereo_rig(left: CameraInfo, right: CameraInfo) -> StereoRig:
    """Stereo pair for raw images: x_c = R_rect_c^T (R_rect_r x_r + (baseline, 0, 0))."""
    T_c_r = np.eye(4)
    T_c_r[:3, :3] = left.R.T @ right.R
    T_c_r[:3, 3] = left.R.T @ np.array([-right.P[0, 3] / right.P[0, 0], 0, 0])
    cameras = [
        Camera(info.frame_id, info.width, info.height, info.K, info.D, info.distortion)
        for info in (left, right)
    ]
    return StereoRig(cameras[0], cameras[1], T_c_r, False, left.R, right.R)


def distort(D: FloatArray, flat: FloatArray) -> FloatArray:
    """Apply plumb_bob distortion to z = 1 coordinates (..., 2); independent of the solver's code."""
    k1, k2, p1, p2, k3 = D
    x, y = flat[..., 0], flat[..., 1]
    r2 = x**2 + y**2
    radial = 1 + k1 * r2 + k2 * r2**2 + k3 * r2**3
    return np.stack(
        [
            x * radial + 2 * p1 * x * y + p2 * (r2 + 2 * x**2),
            y * radial + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y,
        ],
        axis=-1,
    )


def undistort(D: FloatArray, distorted: FloatArray, rounds: int = 40) -> FloatArray:
    """Inverse of `distort` by fixed-point iteration, which converges for moderate distortion."""
    flat = distorted
    for _ in range(rounds):
        flat = flat + (distorted - distort(D, flat))
    return flat


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class Lens(Camera):
    """A camera whose pixels are displaced from those of its model.

    Attributes:
        center_px: (2,) origin of the displacement.
        shares: (4,) displacement at the image corner by the radial terms of third and fifth order and by the
            tangential terms along x and y, in shares of the image width.
    """

    center_px: FloatArray
    shares: FloatArray

    def displacement(self, at: FloatArray) -> FloatArray:
        """Displacement of pixels, (..., 2) px → (..., 2) px."""
        half_px = np.hypot(self.width, self.height) / 2
        x, y = np.ascontiguousarray(np.moveaxis((at - self.center_px) / half_px, -1, 0))
        corner_x, corner_y = np.array([self.width, self.height]) / (2 * half_px)
        radial_1, radial_2, *tangential = self.shares
        n_x = np.hypot(3 * corner_x**2 + corner_y**2, 2 * corner_x * corner_y)
        n_y = np.hypot(2 * corner_x * corner_y, corner_x**2 + 3 * corner_y**2)
        along_x, along_y = tangential[0] / n_x, tangential[1] / n_y
        r2 = x**2 + y**2
        # The tangential terms are r^2 e + 2 (e p) p, with e the axis.
        common = r2 * (radial_1 + radial_2 * r2) + 2 * (along_x * x + along_y * y)
        return self.width * np.stack([common * x + along_x * r2, common * y + along_y * r2], axis=-1)


def pixels(camera: Camera, points: FloatArray) -> FloatArray:
    """Project points in the camera frame, (..., 3), to (..., 2) px; independent of the solver's code."""
    flat = points[..., :2] / points[..., 2:]
    if np.any(camera.D):
        flat = distort(camera.D, flat)
    result: FloatArray = flat @ camera.K[:2, :2].T + camera.K[:2, 2]
    return result + camera.displacement(result) if isinstance(camera, Lens) else result


def rays(camera: Camera, at: FloatArray, rounds: int = 40) -> FloatArray:
    """Inverse of `pixels`: (..., 2) px → z = 1 coordinates (..., 2)."""
    if isinstance(camera, Lens):
        target = at
        for _ in range(_DISPLACEMENT_ROUNDS):
            at = target - camera.displacement(at)
    flat = (at - camera.K[:2, 2]) / np.diagonal(camera.K)[:2]
    return undistort(camera.D, flat, rounds) if np.any(camera.D) else flat
