"""Geometry of several cameras: triangulation, and the board's pose of least reprojection error."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from mobilecal_cli import camera, se3
from mobilecal_cli.model.arrays import BoolArray, FloatArray
from mobilecal_cli.model.observations import Corners
from mobilecal_cli.model.rig import CameraRig
from mobilecal_cli.model.signals import Reason
from mobilecal_cli.vision.values import Miss, rms

_TRIANGULATION_STEPS = 12
_MOST_APART_PX = 20.0  # beyond it the pixels are not the same point, and the linearized covariance is invalid
_POSE_STEPS = 50  # far more than any pose needs
_DAMPING, _FACTOR = 1e-6, 10.0  # at first, hardly shortening a step; and its change after a good or a bad one
_CONVERGED = 1e-10  # relative change of the sum of squares that a step promises


@dataclass(frozen=True, slots=True, eq=False)
class StereoPoints:
    """Corners seen by two or more cameras.

    Attributes:
        points_c: (M, 3) in the first camera's frame, m.
        points_cov: (M, 3, 3) their covariances, m^2.
        rms_px: root mean square of the reprojection residuals (two per point and camera), px; of two cameras' four, one
            is the distance from the epipolar line, the other three are fitted.
    """

    points_c: FloatArray
    points_cov: FloatArray
    rms_px: float


@dataclass(frozen=True, slots=True, eq=False)
class BoardPose:
    """Pose of the board.

    Attributes:
        T_c_k: (4, 4) board coordinates to first camera coordinates, m.
        T_c_k_cov: (6, 6) its covariance, tangent order of `se3`, left perturbation T = exp(delta) T_c_k.
        scale: best factor on the board's points; 1 if it was fixed.
        scale_sigma: its standard deviation; 0 if it was fixed.
        rms_px: root mean square of the reprojection residuals per coordinate, px.
    """

    T_c_k: FloatArray
    T_c_k_cov: FloatArray
    scale: float
    scale_sigma: float
    rms_px: float


def reproject(rig: CameraRig, points_c: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Project points (..., 3) into all C cameras: (..., 2 C) px, u v of each; Jacobian (..., 2 C, 3)."""
    pixels, J = [], []
    for lens, T_c_camera in zip(rig.each, rig.T_c_each, strict=True):
        T = se3.inverse(T_c_camera)
        at, by_own = camera.project_with_jacobian(lens, se3.act(T, points_c))
        pixels.append(at)
        J.append(by_own @ T[:3, :3])
    return np.concatenate(pixels, axis=-1), np.concatenate(J, axis=-2)


def common(views: Sequence[Corners]) -> BoolArray:
    """(M,) corners that all of these cameras see."""
    return np.asarray(np.logical_and.reduce([view.seen for view in views]), dtype=np.bool_)


def _whitening(covariances: Sequence[FloatArray]) -> FloatArray:
    """Whitening matrices W, (M, 2 C, 2 C): W^T W is the inverse covariance of `reproject`'s coordinates."""
    count = 2 * len(covariances)
    W = np.zeros((len(covariances[0]), count, count))
    for k, cov in enumerate(covariances):
        at = slice(2 * k, 2 * k + 2)
        W[:, at, at] = np.linalg.inv(np.linalg.cholesky(cov))
    return W


def depths(rig: CameraRig, points_c: FloatArray) -> FloatArray:
    """Depths of points in the frame of each camera: (..., 3) → (..., C), m."""
    T = [se3.inverse(T_c_camera) for T_c_camera in rig.T_c_each]
    return np.stack([points_c @ each[2, :3] + each[2, 3] for each in T], axis=-1)


def _nearest_to_rays(rig: CameraRig, flat: Sequence[FloatArray]) -> FloatArray:
    """Points of least squared distance from the rays of all cameras: (M, 2) z = 1 coordinates of each → (M, 3), m."""
    normal = np.tile(1e-14 * np.eye(3), (len(flat[0]), 1, 1))  # parallel rays: finite points
    right_side = np.zeros((len(flat[0]), 3, 1))
    for own, T in zip(flat, rig.T_c_each, strict=True):
        ray = np.column_stack([own, np.ones(len(own))]) @ T[:3, :3].T
        across = np.eye(3) - ray[:, :, None] * ray[:, None] / np.sum(ray**2, axis=1)[:, None, None]
        normal += across
        right_side += across @ T[:3, 3:]
    return np.asarray(np.linalg.solve(normal, right_side)[..., 0], dtype=np.float64)


def triangulate(rig: CameraRig, views: Sequence[Corners]) -> StereoPoints | Miss:
    """Triangulate the corners that two or more cameras see by minimizing the reprojection error.

    Starts from the points nearest to the rays and does Gauss-Newton iterations on the residuals of each point,
    weighted by the noise of the corners (the cost of Hartley and Sturm 1997, here for any number of cameras and
    with lens distortion). The covariance of a point is (J^T W J)^-1.

    Args:
        rig: the cameras, raw or rectified.
        views: corners in the image of each camera.

    Returns:
        The points of the `common` corners, or a Miss if they are behind a camera or the pixels are inconsistent.
    """
    seen = common(views)
    pixels = [view.pixels[seen] for view in views]
    flat, good = zip(
        *(camera.undistorted(lens, at) for lens, at in zip(rig.each, pixels, strict=True)), strict=True
    )
    if not all(each.all() for each in good):
        count = sum(int(np.sum(~each)) for each in good)
        return Miss(
            Reason.INCONSISTENT,
            f"{count} corners are outside the valid range of the cameras' distortion models",
        )
    points = _nearest_to_rays(rig, flat)
    measured = np.hstack(pixels)
    root = _whitening([view.cov_px2[seen] for view in views])
    step: FloatArray = np.full_like(points, np.inf)
    for left in reversed(range(_TRIANGULATION_STEPS + 1)):
        if np.any(depths(rig, points) <= 0):
            return Miss(Reason.INCONSISTENT, "triangulated corners are behind a camera")
        predicted, J = reproject(rig, points)
        A, r = root @ J, root @ (measured - predicted)[..., None]
        At = np.swapaxes(A, 1, 2)
        normal = At @ A
        if not left or np.all(np.abs(step) <= 1e-12 * np.abs(points[:, 2:])):
            break
        step = np.asarray(np.linalg.solve(normal, At @ r)[..., 0], dtype=np.float64)
        points = points + step
    residual_px = rms(measured - predicted)
    if residual_px > _MOST_APART_PX:
        return Miss(
            Reason.INCONSISTENT,
            f"distance from the epipolar lines {residual_px:.1f} px rms, limit {_MOST_APART_PX:.0f} px",
        )
    return StereoPoints(points, np.linalg.inv(normal).astype(np.float64), residual_px)


def rotation_between(a: FloatArray, b: FloatArray) -> FloatArray:
    """R that best maps vectors b (N, 3) to a (N, 3), by singular value decomposition (Wahba's problem)."""
    U, _, Vt = np.linalg.svd(a.T @ b)
    R: FloatArray = U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
    return R


def absolute_orientation(points_a: FloatArray, points_b: FloatArray) -> FloatArray:
    """Rigid motion from frame b to frame a that best aligns two sets of points.

    Args:
        points_a, points_b: (M, 3) the same points in frames a and b, not all on one line.

    Returns:
        T_a_b, (4, 4).
    """
    mean_a, mean_b = points_a.mean(axis=0), points_b.mean(axis=0)
    R = rotation_between(points_a - mean_a, points_b - mean_b)
    return se3.transform(R, mean_a - R @ mean_b)


def square_from_points(points_c: FloatArray, grid: FloatArray) -> float:
    """Side of a square from triangulated corners, by least squares.

    The scale of the similarity that best maps the grid of unit squares to the points (Umeyama 1991, eq. 42,
    without the division by the points' own scatter, which noise would inflate).

    Args:
        points_c: (M, 3) corners, m.
        grid: (M, 3) the same corners on the board, in squares.

    Returns:
        The side, m.
    """
    T_c_k = absolute_orientation(points_c, grid)
    centred = grid - grid.mean(axis=0)
    along = np.sum((points_c - points_c.mean(axis=0)) * (centred @ T_c_k[:3, :3].T))
    return float(along / np.sum(centred**2))


def pose_residuals(
    rig: CameraRig, T_c_k: FloatArray, points_k: FloatArray, measured: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Reprojection residuals of the board's corners in all images, and their Jacobian.
    With T = exp(delta) T_c_k a point moves by dx_c = -skew(x_c) rho + tau; the logarithm of a common factor
    on `points_k` moves it by x_c - p_c_k.

    Args:
        rig: the cameras.
        T_c_k: (4, 4) pose.
        points_k: (M, 3) corners on the board, m.
        measured: (M, 2 C) u v of each camera, px.

    Returns:
        (M, 2 C) measured minus predicted, px, and (M, 2 C, 7) derivative of the prediction with respect to (rho,
        tau, log scale).
    """
    points_c = se3.act(T_c_k, points_k)
    predicted, J_point = reproject(rig, points_c)
    moves = np.empty((len(points_c), 3, 7))
    moves[:, :, :6] = se3.by_twist(points_c)
    moves[:, :, 6] = points_c - T_c_k[:3, 3]
    return measured - predicted, J_point @ moves


def board_pose(
    rig: CameraRig,
    points_k: FloatArray,
    views: Sequence[Corners],
    start: FloatArray,
    free_scale: bool = False,
) -> BoardPose:
    """Board pose of least reprojection error in all images (Levenberg-Marquardt, analytic Jacobians).

    Args:
        rig: the cameras.
        points_k: (M, 3) corners on the board, m.
        views: corners in the image of each camera, of which the `common` ones count.
        start: (4, 4) initial T_c_k, in front of the cameras.
        free_scale: also estimate a common factor on `points_k`.

    Returns:
        The pose. Its covariance is (J^T W J)^-1 at the given noise, and includes the uncertainty of a free
        scale.
    """
    seen = common(views)
    points_k, measured = points_k[seen], np.hstack([view.pixels[seen] for view in views])
    root = _whitening([view.cov_px2[seen] for view in views])
    unknowns = 7 if free_scale else 6

    def at(T_c_k: FloatArray, scale: float) -> tuple[float, float, FloatArray, FloatArray]:
        """Cost, rms of the residuals in px, normal matrix and gradient at a pose."""
        residual, J = pose_residuals(rig, T_c_k, scale * points_k, measured)
        A = (root @ J[..., :unknowns]).reshape(-1, unknowns)
        r = (root @ residual[..., None]).ravel()
        return float(r @ r), rms(residual), A.T @ A, A.T @ r

    T_c_k, scale, damping = start, 1.0, _DAMPING
    cost, rms_px, normal, gradient = at(T_c_k, scale)
    for _ in range(_POSE_STEPS):
        step = np.asarray(np.linalg.solve(normal + damping * np.diag(np.diag(normal)), gradient), np.float64)
        if step @ gradient <= _CONVERGED * cost:
            break
        trial_T = se3.exp(step[:6]) @ T_c_k
        trial_scale = scale * float(np.exp(step[6])) if free_scale else 1.0
        ahead = np.all(depths(rig, se3.act(trial_T, trial_scale * points_k)) > 0)
        trial = at(trial_T, trial_scale) if ahead else None
        if trial is not None and trial[0] <= cost:
            T_c_k, scale, damping = trial_T, trial_scale, damping / _FACTOR
            cost, rms_px, normal, gradient = trial
        else:
            damping *= _FACTOR
    covariance = np.asarray(np.linalg.inv(normal), dtype=np.float64)
    scale_sigma = float(np.sqrt(covariance[6, 6])) * scale if free_scale else 0.0
    return BoardPose(T_c_k, covariance[:6, :6], scale, scale_sigma, rms_px)


def pose_from_one(rig: CameraRig, points_k: FloatArray, view: Corners) -> BoardPose | Miss:
    """Board pose by a single camera, from corners in one plane with known distances.

    A board tilted the other way looks nearly the same: both poses (Collins and Bartoli, "Infinitesimal plane-based pose
    estimation", 2014, by OpenCV) are starts.

    Args:
        rig: one camera.
        points_k: (M, 3) corners on the board, m.
        view: corners in its image.

    Returns:
        The pose with the smaller reprojection error, or a Miss if there is none in front of the camera.
    """
    (lens,), (T_c_camera,) = rig.each, rig.T_c_each
    in_view = points_k[view.seen]
    flat, good = camera.undistorted(lens, view.pixels[view.seen])
    if not good.all():
        detail = f"{int(np.sum(~good))} corners are outside the valid range of the camera's distortion model"
        return Miss(Reason.NO_POSE, detail)
    _, turns, places, _ = cv2.solvePnPGeneric(in_view, flat, np.eye(3), None, flags=cv2.SOLVEPNP_IPPE)
    poses = []
    for turn, place in zip(np.reshape(turns, (-1, 3)), np.reshape(places, (-1, 3)), strict=True):
        start = T_c_camera @ se3.transform(
            se3.exp_so3(np.asarray(turn, np.float64)), np.asarray(place, np.float64)
        )
        if np.all(depths(rig, se3.act(start, in_view)) > 0):
            poses.append(board_pose(rig, points_k, [view], start))
    if not poses:
        return Miss(Reason.NO_POSE, "the corners are behind the camera")
    return min(poses, key=lambda pose: pose.rms_px)
