"""Camera models: projection of points in the optical frame to pixels, and back to rays.

Pixel coordinates have (0, 0) at the center of the first pixel. The models and the order of their
coefficients are OpenCV's: `plumb_bob` (k1 k2 p1 p2 k3), `rational_polynomial` (+ k4 k5 k6, + thin prism
s1 s2 s3 s4, + tilt tau_x tau_y) and `equidistant` (k1 k2 k3 k4, Kannala and Brandt 2006, eq. 6).
"""

from __future__ import annotations

import numpy as np

from mobilecal_cli.model.arrays import BoolArray, FloatArray
from mobilecal_cli.model.rig import Camera

_NEWTON_STEPS = 60  # a few are usual; near the edge of a model's range, steps are short
_CONVERGED = 1e-11  # distance in distorted z = 1 coordinates: 1e-8 px at f = 1000 px
_EXACT = 5e-16  # relative rounding error of the distorted coordinates
_CORRECTION_ROUNDS = 6  # Newton's method on a displacement of a few pixels
_MOST_HALF_WAVES = 6  # over the image: a wave of a third of its width
_WAVES = np.array([(k, n - k) for n in range(1, _MOST_HALF_WAVES + 1) for k in range(n, -1, -1)])
_AXIS = 1e-6  # tangent of the angle to the optical axis below which the equidistant model uses its series


def _tilt(tau_x: float, tau_y: float) -> FloatArray:
    """(3, 3) homography of a sensor tilted by tau_x, tau_y (Scheimpflug), rad."""
    cx, sx, cy, sy = np.cos(tau_x), np.sin(tau_x), np.cos(tau_y), np.sin(tau_y)
    R = np.array([[cy, 0, -sy], [0, 1, 0], [sy, 0, cy]]) @ np.array([[1, 0, 0], [0, cx, sx], [0, -sx, cx]])
    onto_plane = np.array([[R[2, 2], 0, -R[0, 2]], [0, R[2, 2], -R[1, 2]], [0, 0, 1]])
    homography: FloatArray = onto_plane @ R
    return homography


def _distort_polynomial(D: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """plumb_bob, rational_polynomial: z = 1 coordinates (..., 2) → distorted, Jacobian (..., 2, 2)."""
    k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4, tau_x, tau_y = (*map(float, D), *(0.0,) * (14 - len(D)))
    x, y = np.ascontiguousarray(np.moveaxis(points, -1, 0))
    xx, yy, xy = x * x, y * y, x * y
    q = xx + yy
    # The radial factor and its derivative by q = r^2; the rational and prism terms are zero in most cameras.
    radial, slope = 1 + q * (k1 + q * (k2 + q * k3)), k1 + q * (2 * k2 + 3 * k3 * q)
    if k4 or k5 or k6:
        denominator = 1 + q * (k4 + q * (k5 + q * k6))
        radial = radial / denominator
        slope = (slope - radial * (k4 + q * (2 * k5 + 3 * k6 * q))) / denominator
    distorted = np.empty_like(points)
    distorted[..., 0] = radial * x + 2 * p1 * xy + p2 * (q + 2 * xx)
    distorted[..., 1] = radial * y + 2 * p2 * xy + p1 * (q + 2 * yy)
    J = np.empty((*points.shape, 2))
    J[..., 0, 0] = radial + 2 * slope * xx + 2 * p1 * y + 6 * p2 * x
    J[..., 1, 1] = radial + 2 * slope * yy + 6 * p1 * y + 2 * p2 * x
    J[..., 0, 1] = J[..., 1, 0] = 2 * slope * xy + 2 * p1 * x + 2 * p2 * y
    if s1 or s2 or s3 or s4:
        distorted += np.stack([q * (s1 + q * s2), q * (s3 + q * s4)], axis=-1)
        prism_slope = np.stack([s1 + 2 * q * s2, s3 + 2 * q * s4], axis=-1)
        J += 2 * prism_slope[..., :, None] * points[..., None, :]
    if tau_x == 0 and tau_y == 0:
        return distorted, J
    H = _tilt(tau_x, tau_y)
    image = distorted @ H[:, :2].T + H[:, 2]
    tilted = image[..., :2] / image[..., 2:]
    J_tilt = (H[:2, :2] - tilted[..., :, None] * H[2, :2]) / image[..., 2, None, None]
    return tilted, J_tilt @ J


def _theta_distorted(D: FloatArray, theta: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Equidistant model: angle to the axis, rad → radius at z = 1, and its derivative."""
    k1, k2, k3, k4 = (*map(float, D), *(0.0,) * (4 - len(D)))
    q = theta * theta
    radius = theta * (1 + q * (k1 + q * (k2 + q * (k3 + q * k4))))
    return radius, 1 + q * (3 * k1 + q * (5 * k2 + q * (7 * k3 + q * 9 * k4)))


def _distorted(camera: Camera, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Points in the optical frame (..., 3) → distorted z = 1 coordinates (..., 2), Jacobian (..., 2, 3)."""
    X, Y, Z = points[..., 0], points[..., 1], points[..., 2]
    J = np.zeros((*points.shape[:-1], 2, 3))
    if camera.distortion != "equidistant":
        flat = points[..., :2] / Z[..., None]
        if camera.distortion == "none" or not np.any(camera.D):
            J[..., 0, 0] = J[..., 1, 1] = 1 / Z
            J[..., :, 2] = -flat / Z[..., None]
            return flat, J
        distorted, J_flat = _distort_polynomial(camera.D, flat)
        # d(X/Z, Y/Z) = (dX - x dZ, dY - y dZ) / Z
        per_Z = J_flat / Z[..., None, None]
        J[..., :2] = per_Z
        J[..., 2] = -(per_Z[..., 0] * flat[..., :1] + per_Z[..., 1] * flat[..., 1:])
        return distorted, J
    r = np.hypot(X, Y)
    square = r * r + Z * Z
    theta = np.arctan2(r, Z)
    radius, slope = _theta_distorted(camera.D, theta)
    near_axis = (r < _AXIS * np.abs(Z)) & (Z > 0)
    safe_r = np.where(near_axis, 1.0, r)
    safe_Z = np.where(near_axis, Z, 1.0)
    scale = np.where(near_axis, 1 / safe_Z, radius / safe_r)
    k1 = camera.D[0] if len(camera.D) else 0.0
    bend = np.where(near_axis, 2 * (k1 - 1 / 3) / safe_Z**3, (slope * Z / square - scale) / safe_r**2)
    XY = points[..., :2]
    J[..., :2] = (
        scale[..., None, None] * np.eye(2) + bend[..., None, None] * XY[..., :, None] * XY[..., None, :]
    )
    J[..., 2] = -XY * (slope / square)[..., None]
    return scale[..., None] * XY, J


def lens_terms(
    camera: Camera, center_px: FloatArray, pixels: FloatArray, shares: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Displacements of pixels by a lens correction of one, term by term, and the Jacobian of a correction.

    With p the offset from the center in shares of half the image's diagonal, the first terms are p |p|^2, p |p|^4,
    (3x^2 + y^2, 2xy) and (2xy, x^2 + 3y^2), each with the length of the image's width at the image corner. The others
    are waves over the image, see `_waves`, of an amplitude of the image's width, along x and along y.

    Args:
        camera: gives the image size.
        center_px: (2,) where the first terms are zero.
        pixels: (..., 2) pixels without the correction.
        shares: (L,) of the correction; L is 4, or with waves, up to `LENS_TERMS`.

    Returns:
        (..., 2, L) px, and (..., 2, 2) derivative of the displacement of the correction by the pixels.
    """
    diagonal = float(np.hypot(camera.width, camera.height))
    p = (pixels - center_px) * (2 / diagonal)
    x, y = p[..., 0], p[..., 1]
    cx, cy = camera.width / diagonal, camera.height / diagonal
    unit = np.array(
        [1.0, 1.0, np.hypot(3 * cx**2 + cy**2, 2 * cx * cy), np.hypot(2 * cx * cy, cx**2 + 3 * cy**2)]
    )
    xx, yy, xy = x * x, y * y, 2 * x * y
    q = xx + yy
    scale, slope = camera.width / unit, 2 * camera.width / diagonal / unit
    terms, J = np.empty((*x.shape, 2, len(shares))), np.empty((4, *x.shape, 2, 2))
    for k, radial, by_q in ((0, q, 1.0), (1, q * q, 2 * q)):
        terms[..., k] = (scale[k] * radial)[..., None] * p
        J[k, ..., 0, 0], J[k, ..., 1, 1] = radial + 2 * by_q * xx, radial + 2 * by_q * yy
        J[k, ..., 0, 1] = J[k, ..., 1, 0] = by_q * xy
    terms[..., 0, 2], terms[..., 1, 2] = scale[2] * (3 * xx + yy), scale[2] * xy
    terms[..., 0, 3], terms[..., 1, 3] = scale[3] * xy, scale[3] * (xx + 3 * yy)
    J[2, ..., 0, 0], J[2, ..., 0, 1], J[2, ..., 1, 0], J[2, ..., 1, 1] = 6 * x, 2 * y, 2 * y, 2 * x
    J[3, ..., 0, 0], J[3, ..., 0, 1], J[3, ..., 1, 0], J[3, ..., 1, 1] = 2 * y, 2 * x, 2 * x, 6 * y
    by_pixels: FloatArray = np.tensordot(slope * shares[:4], J, 1)
    if len(shares) > 4:
        waves, by_pixel = _waves(camera, pixels, (len(shares) - 4) // 2)
        terms[..., 4:] = 0.0
        terms[..., 0, 4::2] = terms[..., 1, 5::2] = camera.width * waves
        by_pixels += camera.width * shares[4:].reshape(-1, 2).T @ by_pixel
    return terms, by_pixels


def lens_terms_up_to(half_waves: int) -> int:
    """Terms of a lens correction: four of the distortion, and waves of at most so many half waves, along x and y."""
    return 4 + 2 * int(np.sum(_WAVES.sum(axis=1) <= half_waves))


def _waves(camera: Camera, pixels: FloatArray, count: int) -> tuple[FloatArray, FloatArray]:
    """cos(pi k u) cos(pi l v), u and v from 0 to 1 over the image, with k + l = 1, 2, and so on.

    Returns:
        (..., W) of the W longest waves, and (..., W, 2) by the pixels.
    """
    along_u, along_v = _WAVES[:count].T
    per_px = np.pi * np.arange(along_u.max() + 1) / np.array([[camera.width], [camera.height]])
    angle = (pixels[..., None] + 0.5) * per_px
    values, slopes = np.cos(angle), -per_px * np.sin(angle)
    x, y = values[..., 0, along_u], values[..., 1, along_v]
    return x * y, np.stack([slopes[..., 0, along_u] * y, x * slopes[..., 1, along_v]], axis=-1)


def corrected(camera: Camera, pixels: FloatArray) -> tuple[FloatArray, FloatArray | None]:
    """Pixels (..., 2) after the camera's lens correction, and their Jacobian (..., 2, 2), None for the identity."""
    if camera.correction is None:
        return pixels, None
    shares = camera.correction.shares
    terms, J = lens_terms(camera, camera.correction.center_px, pixels, shares)
    return pixels + np.tensordot(terms, shares, 1), np.eye(2) + J


def _uncorrected(camera: Camera, pixels: FloatArray) -> FloatArray:
    """Pixels before the camera's lens correction: the inverse of `corrected`."""
    before = pixels
    for _ in range(_CORRECTION_ROUNDS):
        after, J = corrected(camera, before)
        if J is None:
            return pixels
        before = before + np.linalg.solve(J, (pixels - after)[..., None])[..., 0]
    return before


def project_with_jacobian(camera: Camera, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Pixels of points in the camera's optical frame, and their derivatives.

    Args:
        camera: the camera.
        points: (..., 3) in the camera's optical frame, m (any unit: only directions count), z > 0 (for
            equidistant: anywhere but the origin and the negative z axis).

    Returns:
        (..., 2) pixels, px, and (..., 2, 3) their Jacobian by the points, px/m.
    """
    distorted, J = _distorted(camera, points)
    A = camera.K[:2, :2]
    if A[0, 1] == 0 == A[1, 0]:
        at, J = distorted * np.diag(A) + camera.K[:2, 2], np.diag(A)[:, None] * J
    else:
        at, J = distorted @ A.T + camera.K[:2, 2], A @ J
    at, through = corrected(camera, at)
    return at, J if through is None else through @ J


def project(camera: Camera, points: FloatArray) -> FloatArray:
    """Pixels of points in the camera's optical frame: (..., 3) → (..., 2), px."""
    return project_with_jacobian(camera, points)[0]


def _undistort_equidistant(D: FloatArray, target: FloatArray) -> tuple[FloatArray, BoolArray]:
    radius = np.linalg.norm(target, axis=-1)
    theta = np.minimum(radius, np.pi / 2)
    for _ in range(_NEWTON_STEPS):
        value, slope = _theta_distorted(D, theta)
        step = (radius - value) / np.where(slope > 0.05, slope, 1.0)
        # Steps stay in the half space in front of the camera: there is no solution outside.
        theta = np.clip(theta + step, 0.0, np.pi / 2)
    value, slope = _theta_distorted(D, theta)
    good = (np.abs(value - radius) < _CONVERGED) & (slope > 0) & (theta < np.pi / 2 - 1e-6)
    safe = np.where(radius > 0, radius, 1.0)
    scale = np.where(radius > 0, np.tan(np.where(good, theta, 0.0)) / safe, 1.0)
    return scale[..., None] * target, good


def _undistort_polynomial(D: FloatArray, target: FloatArray) -> tuple[FloatArray, BoolArray]:
    points = target.copy()
    value, J = _distort_polynomial(D, points)
    error = np.linalg.norm(value - target, axis=-1)
    exact = _EXACT * (1 + np.linalg.norm(target, axis=-1))
    for _ in range(_NEWTON_STEPS):
        if np.all(error <= exact):  # only rounding remains, which no step reduces
            break
        (a, b), (c, d) = np.moveaxis(J, (-2, -1), (0, 1))
        x, y = np.moveaxis(target - value, -1, 0)
        determinant = a * d - b * c
        adjugate = np.stack([d * x - b * y, a * y - c * x], axis=-1)  # of J, times the residual
        step = adjugate / np.where(np.abs(determinant) > 1e-6, determinant, 1.0)[..., None]
        factor = np.ones(error.shape)
        for _ in range(12):  # shorten a step that increases the error
            trial, trial_J = _distort_polynomial(D, points + factor[..., None] * step)
            trial_error = np.linalg.norm(trial - target, axis=-1)
            worse = ~(trial_error <= error)
            if not worse.any():
                break
            factor = np.where(worse, factor / 4, factor)
        better = trial_error < error
        if not better.any():
            break
        points = np.where(better[..., None], points + factor[..., None] * step, points)
        value = np.where(better[..., None], trial, value)
        J = np.where(better[..., None, None], trial_J, J)
        error = np.where(better, trial_error, error)
    # False roots lie beyond the radius where the polynomial folds back. On the way to them, the determinant of the
    # Jacobian passes through zero.
    way_out = np.linspace(0.1, 1.0, 10)[:, None] * points[..., None, :]
    (a, b), (c, d) = np.moveaxis(_distort_polynomial(D, way_out)[1], (-2, -1), (0, 1))
    close = error < _CONVERGED * (1 + np.linalg.norm(target, axis=-1))
    return points, close & np.all(a * d - b * c > 0, axis=-1)


def undistorted(camera: Camera, pixels: FloatArray) -> tuple[FloatArray, BoolArray]:
    """Coordinates at z = 1 of pixels, and which pixels the camera model can produce.

    Args:
        camera: the camera.
        pixels: (..., 2) px.

    Returns:
        (..., 2) z = 1 coordinates, finite everywhere, to machine precision where the second value is true;
        (...) false where no point in front of the camera projects to the pixel: its distortion model does not reach
        that far (wrong coefficients for this image, or a pixel far outside it).
    """
    A = camera.K[:2, :2]
    target = (_uncorrected(camera, pixels) - camera.K[:2, 2]) @ np.asarray(
        np.linalg.inv(A), dtype=np.float64
    ).T
    if camera.distortion == "equidistant":
        return _undistort_equidistant(camera.D, target)
    if camera.distortion == "none" or not np.any(camera.D):
        return target, np.ones(target.shape[:-1], dtype=np.bool_)
    with np.errstate(over="ignore", invalid="ignore", divide="ignore"):  # a trial step may diverge
        return _undistort_polynomial(camera.D, target)
