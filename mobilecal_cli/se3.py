"""Rigid motions. Every function broadcasts over leading axes.

Tangent order: a twist is (rotation vector [rad], translation part [m]), six numbers
``xi = (rho_x, rho_y, rho_z, tau_x, tau_y, tau_z)``; ``exp`` and ``log`` are the group's exponential and
logarithm. Quaternions are ``xyzw``.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

_LOCKED = 1e-12  # smaller cos(ay): gimbal lock within rounding
_SMALL_ANGLE_RAD = 1e-3  # below this the series' error (angle^6) is less than one ulp


def skew(vector: FloatArray) -> FloatArray:
    """(..., 3) → (..., 3, 3) with skew(a) b = a x b."""
    out = np.zeros((*vector.shape, 3))
    x, y, z = vector[..., 0], vector[..., 1], vector[..., 2]
    out[..., 0, 1], out[..., 0, 2] = -z, y
    out[..., 1, 0], out[..., 1, 2] = z, -x
    out[..., 2, 0], out[..., 2, 1] = -y, x
    return out


def _rodrigues(rotvec_rad: FloatArray) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """skew(v), and sin(a)/a, (1 - cos(a))/a^2, (a - sin(a))/a^3 with a = |v|, (..., 1, 1), by series near zero."""
    angle = np.sqrt(np.sum(rotvec_rad * rotvec_rad, axis=-1))[..., None, None]
    small = angle < _SMALL_ANGLE_RAD
    safe = np.where(small, 1.0, angle)
    sine = np.sin(safe)
    a, b, c = sine / safe, 2 * (np.sin(safe / 2) / safe) ** 2, (safe - sine) / safe**3
    if small.any():
        square = angle**2
        a = np.where(small, 1 - square / 6 * (1 - square / 20), a)
        b = np.where(small, 0.5 - square / 24 * (1 - square / 30), b)
        c = np.where(small, 1 / 6 - square / 120 * (1 - square / 42), c)
    return skew(rotvec_rad), a, b, c


def exp_so3(rotvec_rad: FloatArray) -> FloatArray:
    """Rotation matrix of a rotation vector (Rodrigues): (..., 3) → (..., 3, 3)."""
    hat, a, b, _ = _rodrigues(rotvec_rad)
    return np.eye(3) + a * hat + b * hat @ hat


def quaternion_xyzw(rotation: FloatArray) -> FloatArray:
    """Unit quaternion with w >= 0: (..., 3, 3) → (..., 4)."""
    R = np.asarray(rotation)
    trace = np.trace(R, axis1=-2, axis2=-1)
    # Four times the squares of x, y, z, w; the largest is the numerically safe pivot (Shepperd).
    diagonal = np.diagonal(R, axis1=-2, axis2=-1)
    squares = np.concatenate([1 + 2 * diagonal - trace[..., None], (1 + trace)[..., None]], axis=-1)
    products = np.empty((*R.shape[:-2], 4, 4))
    for i in range(4):
        products[..., i, i] = squares[..., i]
    for i, j, k in ((0, 1, 2), (1, 2, 0), (2, 0, 1)):
        products[..., i, j] = products[..., j, i] = R[..., i, j] + R[..., j, i]
        products[..., 3, k] = products[..., k, 3] = R[..., j, i] - R[..., i, j]
    pivot = np.argmax(squares, axis=-1)
    row = np.take_along_axis(products, pivot[..., None, None], axis=-2)[..., 0, :]
    q: FloatArray = row / np.linalg.norm(row, axis=-1, keepdims=True)
    return np.where(q[..., 3:] < 0, -q, q)


def from_quaternion_xyzw(quaternion: FloatArray) -> FloatArray:
    """Rotation matrix of a quaternion with any nonzero norm: (..., 4) → (..., 3, 3)."""
    q = quaternion / np.linalg.norm(quaternion, axis=-1, keepdims=True)
    vector, w = q[..., :3], q[..., 3]
    hat = skew(vector)
    rotation: FloatArray = np.eye(3) + 2 * (w[..., None, None] * hat + hat @ hat)
    return rotation


def log_so3(rotation: FloatArray) -> FloatArray:
    """Rotation vector with angle in [0, pi]: (..., 3, 3) → (..., 3), rad."""
    q = quaternion_xyzw(rotation)
    sine = np.linalg.norm(q[..., :3], axis=-1)
    half = np.arctan2(sine, q[..., 3])
    small = sine < _SMALL_ANGLE_RAD / 2
    w = np.where(small, q[..., 3], 1.0)
    series = 2 / w * (1 - (sine / w) ** 2 / 3)
    scale = np.where(small, series, 2 * half / np.where(small, 1.0, sine))
    rotvec: FloatArray = scale[..., None] * q[..., :3]
    return rotvec


def left_jacobian_so3(rotvec_rad: FloatArray) -> FloatArray:
    """J with exp(v + d) = exp(J d) exp(v) to first order: (..., 3) → (..., 3, 3)."""
    hat, _, b, c = _rodrigues(rotvec_rad)
    return np.eye(3) + b * hat + c * hat @ hat


def transform(rotation: FloatArray, translation_m: FloatArray) -> FloatArray:
    """Transform from rotation and translation: (..., 3, 3) and (..., 3) → (..., 4, 4)."""
    shape = np.broadcast_shapes(rotation.shape[:-2], translation_m.shape[:-1])
    T = np.zeros((*shape, 4, 4))
    T[..., :3, :3] = rotation
    T[..., :3, 3] = translation_m
    T[..., 3, 3] = 1
    return T


def exp(twist: FloatArray) -> FloatArray:
    """Transform of a twist: (..., 6) → (..., 4, 4)."""
    hat, a, b, c = _rodrigues(twist[..., :3])
    bent = b * hat
    rotation, jacobian = np.eye(3) + a * hat + bent @ hat, np.eye(3) + bent + c * hat @ hat
    return transform(rotation, (jacobian @ twist[..., 3:, None])[..., 0])


def log(T: FloatArray) -> FloatArray:
    """Twist of a transform, rotation angle in [0, pi]: (..., 4, 4) → (..., 6)."""
    rotvec = log_so3(T[..., :3, :3])
    tau = np.linalg.solve(left_jacobian_so3(rotvec), T[..., :3, 3:])[..., 0]
    return np.concatenate([rotvec, tau], axis=-1)


def inverse(T: FloatArray) -> FloatArray:
    """Inverse transform: (..., 4, 4) → (..., 4, 4)."""
    Rt = np.swapaxes(T[..., :3, :3], -1, -2)
    return transform(Rt, -(Rt @ T[..., :3, 3:])[..., 0])


def adjoint(T: FloatArray) -> FloatArray:
    """Adjoint Ad with T exp(xi) = exp(Ad xi) T: (..., 4, 4) → (..., 6, 6)."""
    R = T[..., :3, :3]
    Ad = np.zeros((*T.shape[:-2], 6, 6))
    Ad[..., :3, :3] = R
    Ad[..., 3:, 3:] = R
    Ad[..., 3:, :3] = skew(T[..., :3, 3]) @ R
    return Ad


def act(T: FloatArray, points: FloatArray) -> FloatArray:
    """Transformed points: (..., 4, 4) and (..., M, 3) → (..., M, 3)."""
    return points @ np.swapaxes(T[..., :3, :3], -1, -2) + T[..., None, :3, 3]


def by_twist(points: FloatArray) -> FloatArray:
    """J with exp(xi) x = x + J xi to first order: (..., 3) → (..., 3, 6)."""
    J = np.empty((*points.shape, 6))
    J[..., :3] = -skew(points)
    J[..., 3:] = np.eye(3)
    return J


def rotation_about(axis: FloatArray, angle_rad: FloatArray) -> FloatArray:
    """Rotation by an angle about a unit axis: (3,) and (...) → (..., 3, 3)."""
    return exp_so3(np.asarray(angle_rad)[..., None] * axis)


def rotation_z(angle_rad: FloatArray) -> FloatArray:
    """Rotation Rz(psi) about z: (...) → (..., 3, 3)."""
    angle = np.asarray(angle_rad)
    R = np.zeros((*angle.shape, 3, 3))
    R[..., 0, 0] = R[..., 1, 1] = np.cos(angle)
    R[..., 1, 0] = np.sin(angle)
    R[..., 0, 1] = -R[..., 1, 0]
    R[..., 2, 2] = 1
    return R


def from_rpy(rpy_rad: FloatArray) -> FloatArray:
    """URDF's fixed-axis roll, pitch, yaw: R = Rz(yaw) Ry(pitch) Rx(roll), (3,) → (3, 3)."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy_rad), np.sin(rpy_rad)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def to_rpy(rotation: FloatArray) -> FloatArray:
    """Roll, pitch and yaw, inverse of `from_rpy`: (3, 3) → (3,), rad."""
    return np.asarray(np.radians(euler_zyx_deg(rotation)), dtype=np.float64)


def euler_zyx_deg(rotation: FloatArray) -> tuple[float, float, float]:
    """Angles (ax, ay, az) in degrees with R = Rz(az) Ry(ay) Rx(ax), as in the paper's Table 1.

    For display only: near ay = +-90 degrees, ax and az are not defined individually (see `gimbal_margin_deg`).
    """
    R = np.asarray(rotation)
    ay = np.arctan2(-R[2, 0], np.hypot(R[0, 0], R[1, 0]))
    if np.hypot(R[0, 0], R[1, 0]) < _LOCKED:  # only their sum or difference is defined: assign it to az
        ax, az = 0.0, np.arctan2(-R[0, 1], R[1, 1])
    else:
        ax, az = np.arctan2(R[2, 1], R[2, 2]), np.arctan2(R[1, 0], R[0, 0])
    return float(np.degrees(ax)), float(np.degrees(ay)), float(np.degrees(az))


#: Euler angles closer to gimbal lock are not shown: the noise of x and z is over ten times that of the axis.
NEAR_LOCK_DEG = 5.0


def gimbal_margin_deg(rotation: FloatArray) -> float:
    """Difference of ay of `euler_zyx_deg` from +-90 degrees, in degrees."""
    return 90.0 - abs(euler_zyx_deg(rotation)[1])
