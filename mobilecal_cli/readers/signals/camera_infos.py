"""Camera infos: the calibration of the images as recorded, and what is used where it changes."""

from __future__ import annotations

from array import array

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.camera import project
from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model.arrays import FloatArray, IntArray
from mobilecal_cli.model.rig import Camera, CameraInfo, Distortion
from mobilecal_cli.model.signals import CAMERA_INFO_CHANGES
from mobilecal_cli.ranges import FOCAL_LENGTH, Range
from mobilecal_cli.readers.messages import NOT_ITS_TYPE, Channel, frame_of
from mobilecal_cli.readers.messages.types import Decoded, Payload

#: Coefficient counts of OpenCV's models, in OpenCV's order.
_LENGTHS: dict[Distortion, tuple[int, ...]] = {
    "none": (0,),
    "plumb_bob": (5,),
    "rational_polynomial": (8, 12, 14),
    "equidistant": (4,),
}
_NAMES: dict[str, Distortion] = {
    **dict.fromkeys(("plumb_bob", "radtan", "radial_tangential", "brown_conrady"), "plumb_bob"),
    **dict.fromkeys(("rational_polynomial", "rational", "thin_prism"), "rational_polynomial"),
    **dict.fromkeys(
        ("equidistant", "fisheye", "kannala_brandt", "kannala_brandt4", "opencv_fisheye"), "equidistant"
    ),
    "none": "none",
}
#: Of the focal lengths fx / fy, and of those in P / those in K.
_ASPECT, _RECTIFIED = Range(0.2, 5.0), Range(0.2, 5.0)
#: Of the principal point, in image sizes from the first pixel.
_PRINCIPAL = Range(-2.0, 3.0)
#: Of the principal point, in halves of the image; beyond it, alike along x and y, it is that of another image size.
_SIZE, _ALIKE = Range(0.6, 1.7), 1.1
#: Of the distance of a point half way to the edge from the principal point, with distortion / without.
_DISTORTION = Range(0.4, 2.5)
#: Largest difference of R from a rotation matrix.
_ROTATION = 1e-3
_ADVICE = "calibrate the camera (for example with camera_calibration) and record its camera_info again"


def camera_info(message: Decoded, topic: str) -> CameraInfo:
    """Convert a CameraInfo message.

    The message describes the full sensor. A region of interest shifts the principal point, then binning scales both
    rows of K and P, as in image_geometry.

    Args:
        message: decoded message; ROS 1 names the matrices D, K, R, P, ROS 2 d, k, r, p.
        topic: its topic, for error messages.

    Raises:
        RecordingError: K is zero, a value is not finite or not possible, or the distortion model is unknown.
    """
    try:
        return _converted(message, topic)
    except NOT_ITS_TYPE as error:
        raise RecordingError(f"{topic}: not a valid camera info: {error}", _ADVICE) from error


def _converted(message: Decoded, topic: str) -> CameraInfo:
    K = _matrix(message, "K", (3, 3), topic)
    P = _matrix(message, "P", (3, 4), topic)
    R = _matrix(message, "R", (3, 3), topic)
    for name, matrix in (("K", K), ("P", P)):
        if name == "P" and not P.any():
            continue  # a camera that was calibrated alone: its raw images need only K
        if matrix[0, 0] <= 0 or matrix[1, 1] <= 0:
            fact = "is all zeros" if not matrix.any() else "has no positive focal lengths"
            raise RecordingError(f"{topic}: {name} {fact}: the camera is not calibrated", _ADVICE)
    if not R.any():  # omitted by some drivers, meaning no rotation
        R = np.eye(3)
    distortion, D = _distortion(message, topic)
    frame_id, size = frame_of(message.header), (int(message.width), int(message.height))
    problem = _impossible(Camera(frame_id, *size, K, D, distortion), R, P)
    if problem:
        raise RecordingError(f"{topic}: {problem}", _ADVICE)

    roi = message.roi
    width, height = int(roi.width) or int(message.width), int(roi.height) or int(message.height)
    binned_x, binned_y = max(int(message.binning_x), 1), max(int(message.binning_y), 1)
    for matrix in (K, P):
        matrix[:2] -= np.outer([float(roi.x_offset), float(roi.y_offset)], matrix[2])
        matrix[:2] /= [[binned_x], [binned_y]]
    return CameraInfo(frame_id, width // binned_x, height // binned_y, K, D, distortion, R, P)


def _impossible(camera: Camera, R: FloatArray, P: FloatArray) -> str:
    """A value that no camera (of the whole sensor) has, with its name and range; "" for none. P may be zeros."""
    K = camera.K
    values = []
    for name, matrix in (("K", K), ("P", P)) if P.any() else (("K", K),):
        fx, fy = float(matrix[0, 0]), float(matrix[1, 1])
        values += [(f"{name}: fx", fx, FOCAL_LENGTH), (f"{name}: fy", fy, FOCAL_LENGTH)]
        values.append((f"{name}: fx / fy", fx / fy, _ASPECT))
    for k, (axis, length) in enumerate(zip("xy", (camera.width, camera.height), strict=True)):
        if P.any():
            ratio = float(P[k, k] / K[k, k])
            values.append((f"focal length f{axis} in P over that in K", ratio, _RECTIFIED))
        if length:
            share = float(K[k, 2]) / length
            values.append((f"K: principal point c{axis} over the image size {length}", share, _PRINCIPAL))
    for name, value, possible in values:
        if value not in possible:
            return f"{name} is {value:.6g} (range {possible})"
    if camera.width and camera.height:
        factors = 2 * K[:2, 2] / [camera.width, camera.height]
        if factors.max() < _ALIKE * factors.min() and factors.mean() not in _SIZE:
            (x, y), (w, h) = K[:2, 2].tolist(), (2 * K[:2, 2]).tolist()
            return (
                f"the principal point ({x:.0f}, {y:.0f}) in K is the middle of an image of about {w:.0f} x {h:.0f} "
                f"pixels, but the image size in camera_info is {camera.width} x {camera.height}"
            )
    if abs(K[0, 1]) > _ROTATION * K[0, 0] or K[1, 0] or K[2, :2].any():
        return "K is not of the form [fx 0 cx; 0 fy cy; 0 0 1]"
    if np.abs(R @ R.T - np.eye(3)).max() > _ROTATION or np.linalg.det(R) < 0:
        return "R is not a rotation matrix"
    half = np.array([camera.width / K[0, 0], camera.height / K[1, 1]]) / 4
    for at in np.diag(half):
        if at.any():
            distorted = project(camera, np.array([*at, 1.0])) - K[:2, 2]
            share = float(np.linalg.norm(distorted) / np.linalg.norm(K[[0, 1], [0, 1]] * at))
            if share not in _DISTORTION:
                return f"D moves a point half way to the edge to {share:.3g} of its distance (range {_DISTORTION})"
    return ""


def _matrix(message: Decoded, name: str, shape: tuple[int, ...], topic: str) -> FloatArray:
    value = getattr(message, name, None)
    if value is None:  # ROS 2
        value = getattr(message, name.lower())
    matrix = np.array(value, dtype=np.float64).reshape(shape)
    if not np.all(np.isfinite(matrix)):
        raise RecordingError(f"{topic}: {name} contains values that are not finite numbers", _ADVICE)
    return matrix


def _distortion(message: Decoded, topic: str) -> tuple[Distortion, FloatArray]:
    D = _matrix(message, "D", (-1,), topic)
    name = str(message.distortion_model).strip().lower()
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
    most = _LENGTHS[model][-1]
    D = D if D[most:].any() else D[:most]  # zeros that drivers add
    length = next((n for n in _LENGTHS[model] if n >= D.size), None)
    if length is None or (model == "equidistant" and D.size != length):
        raise RecordingError(
            f"{topic}: {D.size} distortion coefficients do not match the model {name or model}", _ADVICE
        )
    return model, np.pad(D, (0, length - D.size))


#: In both encodings of ROS, the time stamp and the counter are within the first bytes.
_STAMP_BYTES = 12
_SAME_RELATIVE, _SAME = 1e-6, 1e-9
#: Calibrations kept of one topic; a topic with more is that of several cameras.
_MOST_KEPT = 16
_UNUSABLE = -1


class InfoChanges:
    """Compares the camera infos of one topic with one another.

    Attributes:
        infos: the different calibrations, in order of appearance.
    """

    def __init__(self, topic: str) -> None:
        self.topic = topic
        self.infos: list[CameraInfo] = []
        #: Why the first message that cannot be used cannot.
        self._problem = ""
        #: Calibration in each message, and the log time.
        self._which, self._log_ns = array("q"), array("q")
        #: Bytes of the last message after its stamp, None before the first.
        self._last: bytes | None = None

    def add(self, channel: Channel, log_ns: int, payload: Payload) -> None:
        """Take one message. Only one that differs from the one before is decoded."""
        own = bytes(payload[_STAMP_BYTES:])
        which = self._which[-1] if self._last == own else self._index(channel, payload)
        if which is not None:
            self._last = own
            self._which.append(which)
            self._log_ns.append(log_ns)

    def _index(self, channel: Channel, payload: Payload) -> int | None:
        """Index of the calibration that a message states, which is kept if it is new; None if it states none."""
        try:
            message = channel.decode(payload)
            if not _matrix(message, "K", (3, 3), self.topic).any():
                return None
        except (RecordingError, *NOT_ITS_TYPE):
            return None
        try:
            stated = camera_info(message, self.topic)
        except RecordingError as error:
            self._problem = self._problem or error.message.removeprefix(f"{self.topic}: ")
            return _UNUSABLE
        known = next((k for k, info in enumerate(self.infos) if not _difference(info, stated)), None)
        if known is None and len(self.infos) < _MOST_KEPT:
            self.infos.append(stated)
            return len(self.infos) - 1
        return known

    @property
    def usual(self) -> int:
        """Index of the calibration in most of the messages that can be used; 0 without any."""
        which = np.array(self._which)
        return int(np.argmax(np.bincount(which[which != _UNUSABLE], minlength=1)))

    def usual_at(self, log_ns: IntArray) -> IntArray:
        """(n,) indices of those of some log times at which the topic states its usual calibration."""
        if not self.infos:
            return np.arange(len(log_ns))
        last = np.maximum(np.searchsorted(self._log_ns, log_ns, side="right") - 1, 0)
        return np.flatnonzero(np.array(self._which)[last] == self.usual)

    def notes(self, start_ns: int | None) -> list[str]:
        """A sentence on a calibration that changes; `start_ns` is when the recording starts."""
        others = len(self._which) - self._which.count(self.usual)
        if not self.infos or not others:
            return []
        changed = len(self.infos) > 1
        at_ns = self._log_ns[self._which.index(1 if changed else _UNUSABLE)]
        since_s = (at_ns - (start_ns or at_ns)) * 1e-9
        what = _difference(*self.infos[:2]) if changed else self._problem
        return [
            f"{self.topic}: {CAMERA_INFO_CHANGES} {since_s:.1f} s after the start: {what}; "
            f"{others} of {len(self._which)} messages differ from the others, which are used; images recorded while "
            "it differs are left out"
        ]


def _difference(first: CameraInfo, other: CameraInfo) -> str:
    """What differs beyond rounding, with numbers; "" if nothing does."""
    if (first.width, first.height) != (other.width, other.height):
        return f"image size {first.width} x {first.height} to {other.width} x {other.height}"
    if (first.distortion, len(first.D)) != (other.distortion, len(other.D)):
        return f"distortion model {first.distortion} ({len(first.D)}) to {other.distortion} ({len(other.D)})"
    parts = [
        f"{name} by up to {np.abs(after - before).max():.3g}{unit}"
        for name, before, after, unit in (
            ("K", first.K, other.K, " px"),
            ("D", first.D, other.D, ""),
            ("P", first.P, other.P, " px"),
        )
        if not np.allclose(after, before, rtol=_SAME_RELATIVE, atol=_SAME)
    ]
    angle_rad = float(np.linalg.norm(se3.log_so3(first.R.T @ other.R)))
    if angle_rad > _SAME_RELATIVE:
        parts.append(f"R by {np.degrees(angle_rad):.3g} deg")
    return ", ".join(parts)
