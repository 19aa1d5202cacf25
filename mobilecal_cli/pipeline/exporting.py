"""`mobilecal export`: a calibration in the format of another program."""

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
    frame_note,
    patched_urdf,
    plain_json,
    rectified_pair,
    static_transform_launch,
    static_transform_yaml,
    xacro_properties,
)
from mobilecal_cli.likelihood.nuisance import CONSTANTS, camera_change
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
        content: the bytes of the file.
        notes: changes and notes, whole sentences.
    """

    content: bytes
    notes: tuple[str, ...] = ()


def export(
    params: Path, target: Target, urdf: Path | None = None, wheel_joints: Mapping[Side, str] | None = None
) -> Exported:
    """A calibration in another format.

    Args:
        params: params.yaml; camera_info and camchain also read extraction.npz and report.json next to it.
        target: the format.
        urdf: the file to patch, for the target urdf.
        wheel_joints: names of the wheel joints, overriding those that the calibration read.

    Raises:
        ConfigError: a file is missing or invalid.
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
    notes = (frame_note(robot),) if robot.rectified and target != Target.ros2_control else ()
    return Exported(text[target]().encode(), notes)


def _urdf(robot: CalibratedRobot, path: Path | None, joints: Mapping[Side, str]) -> Exported:
    if path is None:
        raise ConfigError("--to urdf changes an existing file", "give the URDF of the robot with --urdf")
    try:
        content = path.read_bytes() if path.stat().st_size <= LARGEST_URDF_BYTES else None
    except OSError as error:
        raise ConfigError(
            f"{path}: cannot be read: {error.strerror}", "check the path after --urdf"
        ) from error
    if content is None:
        raise ConfigError(f"{path}: larger than {LARGEST_URDF_BYTES} bytes", "give a URDF")
    patched = patched_urdf(content, robot, joints)
    missing = [side for side in _SIDES if side not in joints]
    notes = patched.changes
    if robot.rectified:
        notes += (frame_note(robot),)
    if missing:
        notes += (
            f"The joint of the {' and '.join(missing)} wheel is unknown: give it with --left-joint or --right-joint.",
        )
    return Exported(patched.content, notes)


def _cameras(params: Path, target: Target) -> Exported:
    """The stereo pair of the calibrated robot, as refined."""
    extraction = _beside(params)
    extras = _extras(params)
    cameras = camera_change(CONSTANTS, extras).apply(extraction.rig.cameras)
    refined = bool(extras)
    note = (
        "The stereo pair is as refined by the calibration."
        if refined
        else "The stereo pair is as stated in the recording."
    )
    if target == Target.camchain:
        return Exported(camchain_yaml(cameras, extraction.rig.sources.image).encode(), (note,))
    if not refined:
        raise ConfigError(
            f"{params}: the stereo pair was not refined, so its camera_info does not change",
            "calibrate with --estimate stereo (or focal_length, principal_point) if the recording supports it",
        )
    if cameras.rectified:
        raise ConfigError(
            "the calibration was made from rectified images, so it gives no camera_info of the raw images",
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
            f"{path}: not found; it contains the cameras",
            "keep params.yaml in the directory that calibrate wrote",
        )
    return extraction_from_npz(path)


def _extras(params: Path) -> dict[str, float]:
    """Parameters estimated besides the nine, from the report.json next to params.yaml."""
    path = params.with_name("report.json")
    try:
        data = json.loads(read_text(path, _LARGEST_REPORT_BYTES))
        found = next(data[key] for key in ("constants", "additional_parameters", "extras") if key in data)
        return {str(name): float(entry["value"]) for name, entry in found.items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError, StopIteration) as error:
        raise ConfigError(
            f"{path}: cannot be read: {error}", "keep params.yaml in the directory that calibrate wrote"
        ) from error
