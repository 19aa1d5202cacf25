"""`mobilecal export`: a calibration in another program's format."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from mobilecal_cli.config import LARGEST_URDF_BYTES
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.export import (
    camchain_yaml,
    camera_info_yaml,
    diff_drive_yaml,
    extraction_from_npz,
    patched_urdf,
    plain_json,
    rectified_pair,
    static_transform_launch,
    static_transform_yaml,
    xacro_properties,
)
from mobilecal_cli.likelihood.problem import cameras_with
from mobilecal_cli.model import CalibratedRobot, Extraction, Side, StereoRig
from mobilecal_cli.pipeline.evaluating import read_params
from mobilecal_cli.targets import Target
from mobilecal_cli.yaml_input import read_text

_LARGEST_REPORT_BYTES = 2**26
_SIDES: tuple[Side, Side] = ("left", "right")


@dataclass(frozen=True, slots=True)
class Exported:
    """A calibration in another format.

    Attributes:
        content: of the file.
        notes: what to know about it, whole sentences.
    """

    content: bytes
    notes: tuple[str, ...] = ()


def export(
    params: Path, target: Target, urdf: Path | None = None, wheel_joints: Mapping[Side, str] | None = None
) -> Exported:
    """Write a calibration as something else.

    Args:
        params: params.yaml; camera_info and camchain also take extraction.npz and report.json beside it.
        target: the format.
        urdf: the file to patch, for the target urdf.
        wheel_joints: names of the wheels' joints, over those that the calibration read.

    Raises:
        ConfigError: a file is missing or does not fit.
    """
    robot = read_params(params)
    joints = {**robot.wheel_joints, **(wheel_joints or {})}
    if target == Target.urdf:
        return _urdf(robot, urdf, joints)
    if target in (Target.camchain, Target.camera_info_left, Target.camera_info_right):
        return _cameras(params, target)
    text: dict[Target, Callable[[], str]] = {
        Target.xacro: lambda: xacro_properties(robot),
        Target.ros2_control: lambda: diff_drive_yaml(robot, joints, robot.nominal_wheels),
        Target.static_transform_launch: lambda: static_transform_launch(robot),
        Target.static_transform_yaml: lambda: static_transform_yaml(robot),
        Target.json: lambda: plain_json(robot),
    }
    return Exported(text[target]().encode())


def _urdf(robot: CalibratedRobot, path: Path | None, joints: Mapping[Side, str]) -> Exported:
    if path is None:
        raise ConfigError("--to urdf patches a file that is there", "name the robot's URDF with --urdf")
    try:
        content = path.read_bytes() if path.stat().st_size <= LARGEST_URDF_BYTES else None
    except OSError as error:
        raise ConfigError(
            f"{path}: cannot be read: {error.strerror}", "check the path after --urdf"
        ) from error
    if content is None:
        raise ConfigError(f"{path}: is larger than {LARGEST_URDF_BYTES} bytes", "give a URDF")
    patched = patched_urdf(content, robot, joints)
    missing = [side for side in _SIDES if side not in joints]
    notes = patched.changes
    if missing:
        notes += (
            f"The {' and '.join(missing)} wheel's joint is not known: name it with --left-joint, --right-joint.",
        )
    return Exported(patched.content, notes)


def _cameras(params: Path, target: Target) -> Exported:
    """The stereo pair of the calibration's own robot, with what was refined of it."""
    extraction = _beside(params)
    extras = _extras(params)
    cameras = cameras_with(extraction.rig.cameras, extras)
    refined = cameras is not extraction.rig.cameras
    note = (
        "The stereo pair is as it was refined."
        if refined
        else "The stereo pair is as the recording states it."
    )
    if target == Target.camchain:
        return Exported(camchain_yaml(cameras, extraction.rig.sources.image).encode(), (note,))
    if not refined:
        raise ConfigError(
            f"{params}: the stereo pair was not refined, so its camera_info is still right",
            "calibrate with --estimate stereo (or focal_length, principal_point) where the recording supports it",
        )
    if cameras.rectified:
        raise ConfigError(
            "the pictures were rectified, so what was refined is no camera_info of the raw ones",
            "calibrate from the raw images",
        )
    return Exported(
        _camera_info(cameras, "left" if target == Target.camera_info_left else "right").encode(), (note,)
    )


def _camera_info(cameras: StereoRig, side: Side) -> str:
    pair = rectified_pair(cameras)
    camera = cameras.left if side == "left" else cameras.right
    return camera_info_yaml(camera, pair.R[side], pair.P[side])


def _beside(params: Path) -> Extraction:
    path = params.with_name("extraction.npz")
    if not path.is_file():
        raise ConfigError(
            f"{path}: is not there, and the cameras are written in it",
            "keep params.yaml in the directory that calibrate wrote",
        )
    return extraction_from_npz(path)


def _extras(params: Path) -> dict[str, float]:
    """What was estimated beside the nine, as the report beside the file says."""
    path = params.with_name("report.json")
    try:
        data = json.loads(read_text(path, _LARGEST_REPORT_BYTES))
        found = (
            data["additional_parameters"] if "additional_parameters" in data else data["extras"]
        )  # schema 1
        return {str(name): float(entry["value"]) for name, entry in found.items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise ConfigError(
            f"{path}: cannot be read: {error}", "keep params.yaml in the directory that calibrate wrote"
        ) from error
