"""A calibration in the formats of other programs. Each states its frames and units in a comment."""

from __future__ import annotations

import json
import re
import shlex
from collections.abc import Mapping
from typing import Any

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.export.xml_text import attribute, comment
from mobilecal_cli.export.yaml_text import decimal, decimals, quoted
from mobilecal_cli.model import NINE, CalibratedRobot, Camera, Side, StereoRig, WheelGeometry
from mobilecal_cli.model.text import visible

_CONVENTION = (
    "x_parent = R x_child + translation; optical frames: x right, y down, z forward. "
    "Lengths in m, angles in rad."
)
#: Without distortion, radtan with zeros: Kalibr's reader accepts "none", but builds no camera from it.
_KALIBR_MODELS = {"none": "radtan", "plumb_bob": "radtan", "equidistant": "equidistant"}


def frame_note(robot: CalibratedRobot) -> str:
    """Which optical frame the camera frame of a calibration is."""
    if not robot.rectified:
        return f"{robot.child_frame} is the optical frame of the raw images."
    return (
        f"{robot.child_frame} is the rectified optical frame: the calibration was made from rectified images. "
        "For raw images, use head_eye_raw of params.yaml."
    )


def verdict_note(robot: CalibratedRobot) -> tuple[str, ...]:
    """What a reader of an export has to know: a verdict other than PASS, its reasons, unobservable parameters."""
    lines: tuple[str, ...] = ()
    if not robot.verdict:
        lines = (
            "Verdict of the calibration: unknown. Its params.yaml states none, like those of earlier versions.",
        )
    elif robot.verdict != "PASS":
        lines = (f"Verdict of the calibration: {robot.verdict}.", *robot.reasons)
    hidden = ", ".join(name for name, hides in zip(NINE, robot.unobservable, strict=True) if hides)
    if hidden:
        lines += (f"Unobservable, so the calibration keeps the nominal value: {hidden}.",)
    return lines


def with_verdict(content: bytes, robot: CalibratedRobot) -> bytes:
    """A file in XML or YAML with `verdict_note` as comments at its beginning."""
    note = verdict_note(robot)
    if not note:
        return content
    start = re.match(rb"(?:\xef\xbb\xbf)?(?:<\?xml\s[^>]*\?>)?\s*(<?)", content)
    assert start is not None  # it matches the empty text too
    xml = start.group(1)
    lines = (f"<!-- {comment(line)} -->\n" if xml else f"# {visible(line)}\n" for line in note)
    at = start.start(1)
    return content[:at] + "".join(lines).encode() + content[at:]


def plain_json(robot: CalibratedRobot) -> str:
    """The nine parameters with their covariance as JSON."""
    T, known = robot.T_parent_child, robot.knowledge
    data: dict[str, Any] = {
        "convention": _CONVENTION,
        "parent_frame": robot.parent_frame,
        "child_frame": robot.child_frame,
        "child_frame_images": "rectified" if robot.rectified else "raw",
        "T_parent_child": T.tolist(),
        "translation_m": T[:3, 3].tolist(),
        "quaternion_xyzw": se3.quaternion_xyzw(T[:3, :3]).tolist(),
        "radius_left_m": robot.wheels.radius_left_m,
        "radius_right_m": robot.wheels.radius_right_m,
        "separation_m": robot.wheels.separation_m,
        "order": list(NINE),
        "covariance": None if known is None else known.covariance.tolist(),
        "observable": None if known is None else known.observable.tolist(),
        "verdict": robot.verdict or None,
        "verdict_reasons": list(robot.reasons),
        "created": robot.created,
    }
    return json.dumps(data, indent=1, allow_nan=False) + "\n"


def _fields(robot: CalibratedRobot) -> dict[str, str]:
    T = robot.T_parent_child
    names = ("x", "y", "z", "qx", "qy", "qz", "qw")
    values = (*T[:3, 3], *se3.quaternion_xyzw(T[:3, :3]))
    return {name: decimal(float(value)) for name, value in zip(names, values, strict=True)}


def static_transform_launch(robot: CalibratedRobot) -> str:
    """A ROS 2 launch file (XML) that publishes the head-eye transform with tf2_ros.

    Raises:
        ConfigError: a frame has a name that a launch file would change or that XML does not allow.
    """
    for frame in (robot.parent_frame, robot.child_frame):
        if "$(" in frame:
            raise ConfigError(f"a launch file substitutes $( in the frame name {frame!r}", "rename the frame")
    words = " ".join(f"--{name} {value}" for name, value in _fields(robot).items())
    frames = f"--frame-id {shlex.quote(robot.parent_frame)} --child-frame-id {shlex.quote(robot.child_frame)}"
    return "\n".join(
        [
            "<launch>",
            f"  <!-- {comment(f'{_CONVENTION} {frame_note(robot)}')} -->",
            '  <node pkg="tf2_ros" exec="static_transform_publisher" name="mobilecal_head_eye"',
            f"        args={attribute(f'{words} {frames}')}/>",
            "</launch>",
            "",
        ]
    )


def static_transform_yaml(robot: CalibratedRobot) -> str:
    """The head-eye transform with the keys of geometry_msgs/TransformStamped."""
    v = _fields(robot)
    return "\n".join(
        [
            f"# {_CONVENTION}",
            "# The parent is frame_id, the head; the child is child_frame_id, the camera.",
            f"# {visible(frame_note(robot))}",
            "header:",
            f"  frame_id: {quoted(robot.parent_frame)}",
            f"child_frame_id: {quoted(robot.child_frame)}",
            "transform:",
            f'  translation: {{x: {v["x"]}, "y": {v["y"]}, z: {v["z"]}}}',
            f'  rotation: {{x: {v["qx"]}, "y": {v["qy"]}, z: {v["qz"]}, w: {v["qw"]}}}',
            "",
        ]
    )


def xacro_properties(robot: CalibratedRobot) -> str:
    """Properties to include in a xacro file."""
    T, wheels = robot.T_parent_child, robot.wheels
    values = {
        "head_eye_xyz": " ".join(decimal(float(value)) for value in T[:3, 3]),
        "head_eye_rpy": " ".join(decimal(float(value)) for value in se3.to_rpy(T[:3, :3])),
        "wheel_radius_left": decimal(wheels.radius_left_m),
        "wheel_radius_right": decimal(wheels.radius_right_m),
        "wheel_separation": decimal(wheels.separation_m),
    }
    note = comment(
        f"Origin of {robot.child_frame} in {robot.parent_frame}: R = Rz(yaw) Ry(pitch) Rx(roll). {_CONVENTION} "
        f"{frame_note(robot)}"
    )
    return "\n".join(
        [
            '<?xml version="1.0"?>',
            '<robot xmlns:xacro="http://www.ros.org/wiki/xacro">',
            f"  <!-- {note} -->",
            *(
                f'  <xacro:property name="mobilecal_{name}" value={attribute(value)}/>'
                for name, value in values.items()
            ),
            "</robot>",
            "",
        ]
    )


def diff_drive_yaml(robot: CalibratedRobot, joints: Mapping[Side, str], nominal: WheelGeometry | None) -> str:
    """Parameters of ros2_control's diff_drive_controller.

    The controller takes one wheel radius and one separation, each with multipliers. The multipliers refer to the
    nominal sizes; without these, the radius is the mean of both and the multiplier of the separation is 1.
    Unobservable sizes are left out, so that the controller keeps its own.

    Args:
        robot: the calibration.
        joints: names of the wheel joints, as far as they are known.
        nominal: sizes that the multipliers refer to; the mean of their radii is used.

    Raises:
        ConfigError: all sizes are unobservable.
    """
    wheels = robot.wheels
    radius_m, separation_m = (wheels.radius_left_m + wheels.radius_right_m) / 2, wheels.separation_m
    base = "the mean of both radii and the calibrated separation"
    if nominal is not None:
        radius_m = (nominal.radius_left_m + nominal.radius_right_m) / 2
        separation_m, base = nominal.separation_m, "the nominal sizes"
    names = [
        f"    {side}_wheel_names: [{quoted(joints[side])}]" for side in ("left", "right") if side in joints
    ]
    left, right = decimal(wheels.radius_left_m), decimal(wheels.radius_right_m)
    calibrated, sizes = (
        [f"left radius {left}", f"right radius {right}"],
        [
            f"    wheel_radius: {decimal(radius_m)}",
            f"    left_wheel_radius_multiplier: {decimal(wheels.radius_left_m / radius_m)}",
            f"    right_wheel_radius_multiplier: {decimal(wheels.radius_right_m / radius_m)}",
        ],
    )
    if robot.unobservable[6:8].any():
        calibrated, sizes = [], ["    # Unobservable: keep the wheel_radius of your controller."]
    if robot.unobservable[8]:
        sizes.append("    # Unobservable: keep the wheel_separation of your controller.")
    else:
        calibrated.append(f"separation {decimal(wheels.separation_m)}")
        sizes += [
            f"    wheel_separation: {decimal(separation_m)}",
            f"    wheel_separation_multiplier: {decimal(wheels.separation_m / separation_m)}",
        ]
    if not calibrated:
        raise ConfigError(
            "the calibration determines neither the wheel radii nor the separation",
            "record again with straight drives and turns",
        )
    return "\n".join(
        [
            f"# Lengths in m. The multipliers refer to {base}. Calibrated:",
            f"# {', '.join(calibrated)}.",
            "diff_drive_controller:",
            "  ros__parameters:",
            *names,
            *sizes,
            "",
        ]
    )


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


def camera_info_yaml(camera: Camera, R: np.ndarray[Any, Any], P: np.ndarray[Any, Any]) -> str:
    """One camera in the format of camera_calibration_parsers.

    Args:
        camera: K and D.
        R: (3, 3) raw to rectified coordinates.
        P: (3, 4) projection of rectified coordinates, px.
    """
    model = "plumb_bob" if camera.distortion == "none" else camera.distortion
    D = camera.D.tolist() or [0.0] * 5

    def matrix(name: str, values: np.ndarray[Any, Any]) -> list[str]:
        rows, columns = values.shape
        data = decimals(values.ravel().tolist())
        return [f"{name}:", f"  rows: {rows}", f"  cols: {columns}", f"  data: {data}"]

    return "\n".join(
        [
            "# Frame: the optical frame of the raw images. x_rectified = R x_raw; pixels = P x_rectified, px.",
            f"image_width: {camera.width}",
            f"image_height: {camera.height}",
            f"camera_name: {quoted(camera.frame_id)}",
            *matrix("camera_matrix", camera.K),
            f"distortion_model: {model}",
            *matrix("distortion_coefficients", np.array([D])),
            *matrix("rectification_matrix", R),
            *matrix("projection_matrix", P),
            "",
        ]
    )
