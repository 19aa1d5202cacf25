"""A camera in the format of camera_calibration_parsers."""

from __future__ import annotations

from typing import Any

import numpy as np

from mobilecal_cli.errors import ConfigError
from mobilecal_cli.export.formats import Exported, Source
from mobilecal_cli.export.improved import camera_constants, improved_cameras, rectified_pair
from mobilecal_cli.export.text import rendered
from mobilecal_cli.model import Camera


def export(of: Source, camera: str | None = None) -> Exported:
    """The camera as estimated (`--camera`: another than the reference), with new R and P; only for raw images"""
    rig, constants = of.measurements().rig, of.robot.constants or {}
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


def camera_info_yaml(camera: Camera, R: np.ndarray[Any, Any], P: np.ndarray[Any, Any]) -> str:
    """One camera in the format of camera_calibration_parsers.

    Args:
        camera: K and D.
        R: (3, 3) raw to rectified coordinates.
        P: (3, 4) projection of rectified coordinates, px.
    """
    model = "plumb_bob" if camera.distortion == "none" else camera.distortion
    D = np.array([camera.D if len(camera.D) else np.zeros(5)])
    return rendered("camera_info.yaml", camera=camera, model=model, D=D, R=R, P=P)
