"""Conversion of sensor_msgs/CameraInfo (ROS 1 and ROS 2) to the calibration of the images as recorded."""

from __future__ import annotations

from typing import Any

import numpy as np

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model import CameraInfo, Distortion, FloatArray
from mobilecal_cli.readers.messages.channels import NOT_ITS_TYPE

#: Coefficient counts of OpenCV's models, in OpenCV's order.
_LENGTHS: dict[Distortion, tuple[int, ...]] = {
    "none": (0,),
    "plumb_bob": (5,),
    "rational_polynomial": (8, 12, 14),
    "equidistant": (4,),
}
_NAMES: dict[str, Distortion] = {
    "plumb_bob": "plumb_bob",
    "radtan": "plumb_bob",
    "radial_tangential": "plumb_bob",
    "brown_conrady": "plumb_bob",
    "rational_polynomial": "rational_polynomial",
    "rational": "rational_polynomial",
    "thin_prism": "rational_polynomial",
    "equidistant": "equidistant",
    "fisheye": "equidistant",
    "kannala_brandt": "equidistant",
    "kannala_brandt4": "equidistant",
    "opencv_fisheye": "equidistant",
    "none": "none",
}
_ADVICE = "calibrate the camera (for example with camera_calibration) and record its camera_info again"


def camera_info(message: Any, topic: str) -> CameraInfo:  # noqa: ANN401 - the type is the recording's
    """Convert a CameraInfo message.

    The message describes the full sensor. A region of interest shifts the principal point, then binning scales both
    rows of K and P, as in image_geometry.

    Args:
        message: decoded message; ROS 1 names the matrices D, K, R, P, ROS 2 d, k, r, p.
        topic: its topic, for error messages.

    Raises:
        RecordingError: K or P is zero, a value is not finite, or the distortion model is unknown.
    """
    try:
        return _converted(message, topic)
    except NOT_ITS_TYPE as error:
        raise RecordingError(f"{topic}: not a valid camera info: {error}", _ADVICE) from error


def _converted(message: Any, topic: str) -> CameraInfo:  # noqa: ANN401
    K = _matrix(message, "K", (3, 3), topic)
    P = _matrix(message, "P", (3, 4), topic)
    R = _matrix(message, "R", (3, 3), topic)
    for name, matrix in (("K", K), ("P", P)):
        if matrix[0, 0] <= 0 or matrix[1, 1] <= 0:
            fact = "is all zeros" if not matrix.any() else "has no positive focal lengths"
            raise RecordingError(f"{topic}: {name} {fact}: the camera is not calibrated", _ADVICE)
    if not R.any():  # omitted by some drivers, meaning no rotation
        R = np.eye(3)
    distortion, D = _distortion(message, topic)

    roi = message.roi
    width, height = int(roi.width) or int(message.width), int(roi.height) or int(message.height)
    for matrix in (K, P):
        matrix[0] -= float(roi.x_offset) * matrix[2]
        matrix[1] -= float(roi.y_offset) * matrix[2]
        matrix[0] /= max(int(message.binning_x), 1)
        matrix[1] /= max(int(message.binning_y), 1)
    return CameraInfo(
        frame_id=str(message.header.frame_id),
        width=width // max(int(message.binning_x), 1),
        height=height // max(int(message.binning_y), 1),
        K=K,
        D=D,
        distortion=distortion,
        R=R,
        P=P,
    )


def _field(message: Any, name: str) -> FloatArray:  # noqa: ANN401
    value = getattr(message, name, None)
    if value is None:
        value = getattr(message, name.lower())
    return np.array(value, dtype=np.float64)


def _matrix(message: Any, name: str, shape: tuple[int, int], topic: str) -> FloatArray:  # noqa: ANN401
    matrix = _field(message, name).reshape(shape)
    if not np.all(np.isfinite(matrix)):
        raise RecordingError(f"{topic}: {name} contains values that are not finite numbers", _ADVICE)
    return matrix


def _distortion(message: Any, topic: str) -> tuple[Distortion, FloatArray]:  # noqa: ANN401
    D = _field(message, "D").ravel()
    name = str(message.distortion_model).strip().lower()
    if not np.all(np.isfinite(D)):
        raise RecordingError(f"{topic}: D contains values that are not finite numbers", _ADVICE)
    if D.size == 0 or (not name and not D.any()):
        return ("equidistant", np.zeros(4)) if _NAMES.get(name) == "equidistant" else ("none", np.zeros(0))
    model = _NAMES.get(name or "plumb_bob")
    if model is None:
        raise RecordingError(
            f"{topic}: unknown distortion model {name!r}; known: {', '.join(_NAMES)}", _ADVICE
        )
    if model == "plumb_bob" and D.size > 5:  # drivers keep the name when they add coefficients
        model = "rational_polynomial"
    if model == "none":
        return model, np.zeros(0)
    length = next((n for n in _LENGTHS[model] if n >= D.size), None)
    if length is None or (model == "equidistant" and D.size != length):
        raise RecordingError(
            f"{topic}: {D.size} distortion coefficients do not match the model {name or model}", _ADVICE
        )
    return model, np.pad(D, (0, length - D.size))
