"""The cameras in the format of Kalibr."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import pairwise

from mobilecal_cli import se3
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.export.formats import Exported, Source
from mobilecal_cli.export.formats.camera_info import ros_distortion
from mobilecal_cli.export.improved import improved_cameras
from mobilecal_cli.export.text import rendered
from mobilecal_cli.model.rig import Camera, CameraRig

#: Kalibr's reader accepts "none" too, but builds no camera from it.
_KALIBR_MODELS = {"plumb_bob": "radtan", "equidistant": "equidistant"}


def export(of: Source) -> Exported:
    """The cameras as estimated, in the format of Kalibr"""
    rig = of.measurements().rig
    cameras, notes = improved_cameras(rig, of.robot.constants, kalibr=True)
    return Exported(camchain_yaml(cameras, rig.sources.image).encode(), notes)


def camchain_yaml(cameras: CameraRig, topics: Mapping[str, str]) -> str:
    """The cameras in the format of Kalibr: cam0 is the first (left) one, T_cn_cnm1 maps from each to the next.

    Raises:
        ConfigError: Kalibr has no model for the distortion.
    """
    several = "x_cam1 = T_cn_cnm1 x_cam0" if len(cameras.each) == 2 else "x_camN = T_cn_cnm1 x_cam(N-1)"
    return rendered(
        "camchain.yaml",
        rig=cameras,
        topics=topics,
        chain=f"{several}, m; " if len(cameras.each) > 1 else "",
        distortions=[_kalibr_distortion(camera) for camera in cameras.each],
        steps=[se3.inverse(T) @ T_before for T_before, T in pairwise(cameras.T_c_each)],
    )


def _kalibr_distortion(camera: Camera) -> tuple[str, list[float]]:
    model, coefficients = ros_distortion(camera)
    D = coefficients.tolist()
    if model == "plumb_bob" and any(D[4:]):
        raise ConfigError(
            f"camera {camera.frame_id!r}: Kalibr's radtan model has no third radial coefficient; here it is {D[4]:g}",
            "use --to camera_info",
        )
    if model == "rational_polynomial":
        raise ConfigError(
            f"camera {camera.frame_id!r}: Kalibr has no model for rational_polynomial distortion",
            "use --to camera_info",
        )
    return _KALIBR_MODELS[model], D[:4]
