"""A camera in the format of camera_calibration_parsers."""

from __future__ import annotations

import cv2
import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.export.formats import Exported, Source
from mobilecal_cli.export.improved import camera_constants, improved_cameras
from mobilecal_cli.export.text import rendered
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.rig import Camera, CameraRig


def export(of: Source, camera: str | None = None) -> Exported:
    """The camera as estimated (`--camera`: another than the reference), with new R and P; only for raw images"""
    rig, constants = of.measurements().rig, of.robot.constants
    cameras, notes = improved_cameras(rig, constants)
    what = "the stereo pair was" if cameras.calibrated else "the cameras were"
    if not camera_constants(rig, constants):
        raise ConfigError(
            f"{of.params}: {what} not estimated, so its camera_info does not change",
            "calibrate extraction.npz again with this version, --method ml, and priors that are not fixed",
        )
    if rig.cameras.rectified:
        raise ConfigError(
            "the calibration was made from rectified images, so it gives no camera_info of the raw images",
            "calibrate from the raw images",
        )
    name = camera or cameras.reference
    if name not in cameras.names:
        raise ConfigError(
            f"the robot has no camera {name!r}; it has {', '.join(cameras.names)}",
            f"use --to camera_info --camera {cameras.reference}",
        )
    own = cameras.each[cameras.names.index(name)]
    alone = np.eye(3), np.hstack([own.K, np.zeros((3, 1))])
    R, P = rectified_pair(cameras)[name] if cameras.calibrated else alone
    return Exported(camera_info_yaml(own, R, P).encode(), notes)


def rectified_pair(cameras: CameraRig) -> dict[str, tuple[FloatArray, FloatArray]]:
    """Rectification of raw cameras by Bouguet's method (OpenCV, alpha 0: only valid pixels).

    Returns:
        Camera → R, (3, 3) raw to rectified coordinates, and P, (3, 4) projection of rectified coordinates, px.
    """
    T_r_c = se3.inverse(cameras.T_c_each[1])
    R, t = np.ascontiguousarray(T_r_c[:3, :3]), np.ascontiguousarray(T_r_c[:3, 3:])
    left, right = cameras.each
    pair = (left.K, left.D, right.K, right.D, (left.width, left.height), R, t)
    if left.distortion == "equidistant":
        R1, R2, P1, P2, _ = cv2.fisheye.stereoRectify(*pair, cv2.CALIB_ZERO_DISPARITY)
    else:
        R1, R2, P1, P2, *_ = cv2.stereoRectify(*pair, alpha=0)
    of_each = ((np.array(R, np.float64), np.array(P, np.float64)) for R, P in ((R1, P1), (R2, P2)))
    return dict(zip(cameras.names, of_each, strict=True))


def ros_distortion(camera: Camera) -> tuple[str, FloatArray]:
    """Model and coefficients of sensor_msgs/CameraInfo, which has no model without distortion."""
    return ("plumb_bob", np.zeros(5)) if camera.distortion == "none" else (camera.distortion, camera.D)


def camera_info_yaml(camera: Camera, R: FloatArray, P: FloatArray) -> str:
    """One camera in the format of camera_calibration_parsers.

    Args:
        camera: K and D.
        R: (3, 3) raw to rectified coordinates.
        P: (3, 4) projection of rectified coordinates, px.
    """
    model, D = ros_distortion(camera)
    return rendered("camera_info.yaml", camera=camera, model=model, D=D[None], R=R, P=P)
