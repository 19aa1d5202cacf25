"""The stereo pair in the format of Kalibr."""

from __future__ import annotations

from collections.abc import Mapping

from mobilecal_cli import se3
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.export.formats import Exported, Format, Request
from mobilecal_cli.export.improved import camera_constants, cameras_with_notes
from mobilecal_cli.export.text import decimals, quoted
from mobilecal_cli.model import Camera, Side, StereoRig

#: Without distortion, radtan with zeros: Kalibr's reader accepts "none", but builds no camera from it.
_KALIBR_MODELS = {"none": "radtan", "plumb_bob": "radtan", "equidistant": "equidistant"}


class Camchain(Format):
    """The stereo pair as estimated, in the format of Kalibr"""

    def export(self, asked: Request) -> Exported:
        rig = asked.measurements().rig
        cameras, notes = cameras_with_notes(
            rig, camera_constants(rig, asked.robot.constants or {}), kalibr=True
        )
        return Exported(camchain_yaml(cameras, rig.sources.image).encode(), notes)


def camchain_yaml(cameras: StereoRig, topics: Mapping[Side, str]) -> str:
    """The stereo pair in the format of Kalibr: cam0 is the left camera, T_cn_cnm1 maps its coordinates to the right.

    Raises:
        ConfigError: Kalibr has no model for the distortion.
    """
    kind = "rectified" if cameras.rectified else "raw"
    lines = [
        "# Kalibr: x_cam1 = T_cn_cnm1 x_cam0, m; intrinsics fu, fv, pu, pv, px.",
        f"# Frames and intrinsics are those of the {kind} images.",
    ]
    sides: tuple[tuple[str, Side, Camera], ...] = (
        ("cam0", "left", cameras.left),
        ("cam1", "right", cameras.right),
    )
    for number, side, camera in sides:
        model, coefficients = _kalibr_distortion(camera)
        K = camera.K
        lines += [
            f"{number}:",
            "  camera_model: pinhole",
            f"  intrinsics: {decimals([K[0, 0], K[1, 1], K[0, 2], K[1, 2]])}",
            f"  distortion_model: {model}",
            f"  distortion_coeffs: {decimals(coefficients)}",
            f"  resolution: [{camera.width}, {camera.height}]",
            f"  rostopic: {quoted(topics[side])}",
        ]
        if side == "right":
            T_r_c = se3.inverse(cameras.T_c_r)
            lines += ["  T_cn_cnm1:", *(f"  - {decimals(row)}" for row in T_r_c)]
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
