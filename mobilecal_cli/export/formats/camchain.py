"""The cameras in the format of Kalibr."""

from __future__ import annotations

from collections.abc import Mapping

from mobilecal_cli import se3
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.export.formats import Exported, Source
from mobilecal_cli.export.improved import camera_constants, cameras_with_notes
from mobilecal_cli.export.text import decimals, quoted
from mobilecal_cli.model import Camera, CameraRig

#: Without distortion, radtan with zeros: Kalibr's reader accepts "none", but builds no camera from it.
_KALIBR_MODELS = {"none": "radtan", "plumb_bob": "radtan", "equidistant": "equidistant"}


def export(of: Source) -> Exported:
    """The cameras as estimated, in the format of Kalibr"""
    rig = of.measurements().rig
    cameras, notes = cameras_with_notes(rig, camera_constants(rig, of.robot.constants or {}), kalibr=True)
    return Exported(camchain_yaml(cameras, rig.sources.image).encode(), notes)


def camchain_yaml(cameras: CameraRig, topics: Mapping[str, str]) -> str:
    """The cameras in the format of Kalibr: cam0 is the first (left) one, T_cn_cnm1 maps from each to the next.

    Raises:
        ConfigError: Kalibr has no model for the distortion.
    """
    kind = "rectified" if cameras.rectified else "raw"
    several = "x_cam1 = T_cn_cnm1 x_cam0" if len(cameras.each) == 2 else "x_camN = T_cn_cnm1 x_cam(N-1)"
    chain = f"{several}, m; " if len(cameras.each) > 1 else ""
    lines = [
        f"# Kalibr: {chain}intrinsics fu, fv, pu, pv, px.",
        f"# Frames and intrinsics are those of the {kind} images.",
    ]
    for k, (name, camera) in enumerate(zip(cameras.names, cameras.each, strict=True)):
        model, coefficients = _kalibr_distortion(camera)
        K = camera.K
        lines += [
            f"cam{k}:",
            "  camera_model: pinhole",
            f"  intrinsics: {decimals([K[0, 0], K[1, 1], K[0, 2], K[1, 2]])}",
            f"  distortion_model: {model}",
            f"  distortion_coeffs: {decimals(coefficients)}",
            f"  resolution: [{camera.width}, {camera.height}]",
            f"  rostopic: {quoted(topics[name])}",
        ]
        if k:
            T = se3.inverse(cameras.T_c_each[k]) @ cameras.T_c_each[k - 1]
            lines += ["  T_cn_cnm1:", *(f"  - {decimals(row)}" for row in T)]
    return "\n".join(lines) + "\n"


def _kalibr_distortion(camera: Camera) -> tuple[str, list[float]]:
    D = camera.D.tolist()
    if camera.distortion == "plumb_bob" and any(D[4:]):
        raise ConfigError(
            f"camera {camera.frame_id!r}: Kalibr's radtan model has no third radial coefficient; here it is {D[4]:g}",
            "use --to camera_info or json",
        )
    if camera.distortion == "rational_polynomial":
        raise ConfigError(
            f"camera {camera.frame_id!r}: Kalibr has no model for rational_polynomial distortion",
            "use --to camera_info or json",
        )
    return _KALIBR_MODELS[camera.distortion], [*D, 0.0, 0.0, 0.0, 0.0][:4]
