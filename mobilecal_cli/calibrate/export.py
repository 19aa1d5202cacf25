"""`mobilecal export`: a calibration in the format of another program."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from mobilecal_cli.calibrate.arguments import AnyPath, by_name, path_of, paths_of, require
from mobilecal_cli.calibrate.load import differences, read_extraction, read_params
from mobilecal_cli.calibrate.steps import Report
from mobilecal_cli.errors import ConfigError, MobilecalError, QualityError
from mobilecal_cli.export import (
    Improved,
    ImprovedChain,
    OdometryCovariance,
    camchain_yaml,
    camera_constants,
    camera_info_yaml,
    diff_drive_yaml,
    frame_note,
    improved_cameras,
    improved_chain,
    odometry_covariance,
    odometry_yaml,
    patched_urdf,
    plain_json,
    rectified_pair,
    static_transform_launch,
    static_transform_yaml,
    verdict_note,
    with_verdict,
    xacro_properties,
)
from mobilecal_cli.files.reading import read_bytes, reason_of
from mobilecal_cli.files.scratch import scratch_directory
from mobilecal_cli.model import SIDES, CalibratedRobot, Extraction, Side, StereoRig
from mobilecal_cli.ranges import DISTANCE, ODOMETRY_RATE
from mobilecal_cli.rig.config import LARGEST_URDF_BYTES
from mobilecal_cli.targets import OPTIONS, Target

#: Largest acceptable difference between a distortion model and the estimated lens.
_LENS_PX = 0.1
#: Shorter legs are those between images in motion, or hardly a drive.
_LEAST_LEG_M = 0.25


@dataclass(frozen=True, slots=True)
class Exported:
    """A calibration in another format.

    Attributes:
        content: the bytes of the file.
        notes: changes and notes, whole sentences.
        layout: text of a second file, the layout for Foxglove; "" for none.
    """

    content: bytes = field(repr=False)
    notes: tuple[str, ...] = ()
    layout: str = field(default="", repr=False)


def export(
    params: AnyPath | Report,
    target: str,
    *,
    urdf: AnyPath | None = None,
    wheel_joints: Mapping[Side, str] | None = None,
    with_chain: bool = False,
    rate_hz: float | None = None,
    distance_m: float | None = None,
    logs: AnyPath | Iterable[AnyPath] = (),
    allow_failed: bool = False,
) -> Exported:
    """A calibration in the format of another program, as `mobilecal export --to`.

    A calibration whose verdict is FAIL or NOT ENOUGH is refused. A params.yaml of an earlier version states no verdict:
    it is exported with a note. Unobservable parameters stay as they are in a URDF, and a controller keeps its own.

    Args:
        params: params.yaml, or a report; camera_info, camchain, the head chain, odometry_covariance and foxglove also
            need extraction.npz next to params.yaml.
        target: the format, see `mobilecal export --help`.
        urdf: the file to patch, for the target urdf.
        wheel_joints: names of the wheel joints, overriding those that the calibration read.
        with_chain: for the target urdf, also write the estimated head chain.
        rate_hz: for the target odometry_covariance, messages per second; 50 by default.
        distance_m: for the target odometry_covariance, length of straight drives, m; the recording's legs by default.
        logs: for the target foxglove, recordings of the calibration, for the images.
        allow_failed: also export a calibration whose verdict is not PASS. The export then states the verdict.

    Raises:
        ConfigError: an unknown format, a file that is missing or invalid, an option that does not apply to it, or files
            of two robots.
        QualityError: the verdict is not PASS.
    """
    if not isinstance(target, str) or target not in tuple(Target):
        raise ConfigError(f"export to {target}: no such format", f"formats: {', '.join(Target)}")
    joint_names: Mapping[Any, str] = by_name("wheel_joints", {} if wheel_joints is None else wheel_joints)
    for side, joint in joint_names.items():
        if side not in SIDES or not (isinstance(joint, str) and joint):
            raise ConfigError(
                f"wheel_joints: {side!r}: {joint!r} is not a side and the name of its joint",
                "for example {'left': 'wheel_left_joint'}",
            )
    if isinstance(params, Report):
        with scratch_directory() as directory:
            path = directory / "params.yaml"
            for name, content in params.files().items():
                path.with_name(name).write_bytes(content)
            try:
                return export(
                    path,
                    target,
                    urdf=urdf,
                    wheel_joints=wheel_joints,
                    with_chain=with_chain,
                    rate_hz=rate_hz,
                    distance_m=distance_m,
                    logs=logs,
                    allow_failed=allow_failed,
                )
            except MobilecalError as error:
                raise type(error)(error.message.replace(str(path), "the report"), error.hint) from error
    path, to, recordings = path_of("params", params), Target(target), paths_of("logs", logs)
    robot_urdf = None if urdf is None else path_of("urdf", urdf)
    require("with_chain", with_chain, bool, "True or False")
    robot = read_params(path)
    if robot.verdict not in ("PASS", "") and not allow_failed:
        reason = robot.reasons[0] if robot.reasons else "report.html states the reasons."
        raise QualityError(
            f"{path}: the verdict is {robot.verdict}. {reason}",
            "calibrate again as report.html says, or add --allow-failed (in Python allow_failed=True): the export then "
            "states the verdict",
        )
    joints = {**robot.wheel_joints, **joint_names}
    _check_wheels(robot, joint_names, joints)
    _check_options(
        to,
        {
            "--urdf": urdf is not None,
            "--left-joint": "left" in joint_names,
            "--right-joint": "right" in joint_names,
            "--with-chain": with_chain,
            "--rate": rate_hz is not None,
            "--distance": distance_m is not None,
            "--log": bool(recordings),
        },
    )
    if to == Target.foxglove:
        made = _foxglove(robot, path, recordings)
    elif to == Target.urdf:
        chain = _chain(path, robot) if with_chain else None
        made = _urdf(robot, robot_urdf, joints, chain)
    elif to in (Target.camchain, Target.camera_info_left, Target.camera_info_right):
        made = _cameras(path, robot, to)
    elif to == Target.odometry_covariance:
        rate = ODOMETRY_RATE.check("--rate", 50.0 if rate_hz is None else rate_hz)
        if distance_m is not None:
            DISTANCE.check("--distance", distance_m)
        found = odometry_covariance(robot, _beside(path, robot), rate, distance_m)
        made = Exported(odometry_yaml(found).encode(), _short(found) if distance_m is None else ())
    else:
        text: dict[Target, Callable[[], str]] = {
            Target.xacro: lambda: xacro_properties(robot),
            Target.ros2_control: lambda: diff_drive_yaml(robot, joints, robot.nominal_wheels),
            Target.static_transform_launch: lambda: static_transform_launch(robot),
            Target.static_transform_yaml: lambda: static_transform_yaml(robot),
            Target.json: lambda: plain_json(robot),
        }
        notes = (frame_note(robot),) if robot.rectified and to != Target.ros2_control else ()
        made = Exported(text[to]().encode(), notes)
    content = made.content
    if to not in (Target.json, Target.foxglove):  # they have fields for it
        content = with_verdict(content, robot)
    return replace(made, content=content, notes=made.notes + verdict_note(robot))


def _check_wheels(robot: CalibratedRobot, given: Mapping[Side, str], joints: Mapping[Side, str]) -> None:
    """Refuse the joint of the head or of the other wheel as that of a wheel."""
    for side, name in given.items():
        other: Side = "right" if side == "left" else "left"
        if name in robot.head_joints:
            used = "moves the head in the calibration"
        elif name in (robot.wheel_joints.get(other), joints.get(other)):
            used = f"is that of the {other} wheel"
        else:
            continue
        own = robot.wheel_joints.get(side)
        hint = f"omit it: the calibration read {own!r}" if own else f"give the joint of the {side} wheel"
        raise ConfigError(f"--{side}-joint {name}: this joint {used}", hint)


def _check_options(target: Target, given: Mapping[str, bool]) -> None:
    """Refuse an option that is given (True) for a format that does not use it."""
    for name, formats in OPTIONS.items():
        if given[name] and target not in formats:
            raise ConfigError(f"{name} applies only to --to {' and '.join(formats)}", "leave it out")


def _short(found: OdometryCovariance) -> tuple[str, ...]:
    """A note where the legs are too short to represent the drives of a robot, as in a recording without stops."""
    if found.path_m >= _LEAST_LEG_M:
        return ()
    return (
        f"The legs of the recording are {found.path_m:.2f} m long on average, and the covariance applies to such "
        "drives. Give the length of your drives with --distance.",
    )


def _foxglove(robot: CalibratedRobot, params: Path, logs: Sequence[Path]) -> Exported:
    from mobilecal_cli.calibrate.scene import scene_of
    from mobilecal_cli.export.foxglove import foxglove_layout, foxglove_mcap

    scene = scene_of(robot, _beside(params, robot), params, logs)
    notes = () if logs else ("The file contains no images. Give the recording with --log to add them.",)
    return Exported(foxglove_mcap(scene), notes, foxglove_layout(scene))


def _chain(params: Path, robot: CalibratedRobot) -> ImprovedChain:
    if robot.constants is None:
        raise ConfigError(
            f"{params}: the head chain was not estimated",
            "calibrate extraction.npz again with this version and --method ml, or omit --with-chain",
        )
    return improved_chain(_beside(params, robot).rig, robot.constants)


def _urdf(
    robot: CalibratedRobot, path: Path | None, joints: Mapping[Side, str], chain: ImprovedChain | None
) -> Exported:
    if path is None:
        raise ConfigError("--to urdf changes an existing file", "give the URDF of the robot with --urdf")
    try:
        content = read_bytes(path, LARGEST_URDF_BYTES)
    except (OSError, ValueError) as error:
        raise ConfigError(
            f"{path}: cannot be read: {reason_of(error)}", "check the path after --urdf"
        ) from error
    patched = patched_urdf(content, robot, joints, chain)
    missing = [side for side in SIDES if side not in joints]
    notes = patched.changes
    if chain is None and robot.constants:
        notes += (
            "The head chain is unchanged. --with-chain also writes its estimated joint axes, positions and zeros.",
        )
    if robot.rectified:
        notes += (frame_note(robot),)
    if missing:
        notes += (
            f"The joint of the {' and '.join(missing)} wheel is unknown: give it with --left-joint or --right-joint.",
        )
    return Exported(patched.content, notes)


def _cameras(params: Path, robot: CalibratedRobot, target: Target) -> Exported:
    """The stereo pair of the calibrated robot, with the estimated constants."""
    rig = _beside(params, robot).rig
    changed = camera_constants(rig, robot.constants or {})
    kalibr = target == Target.camchain
    improved = improved_cameras(rig, changed, kalibr)
    notes: tuple[str, ...] = ("The stereo pair is as estimated by the calibration.",)
    if not changed:
        notes = ("The stereo pair is as stated in the recording.",)
    elif improved.residual_px:
        notes += (_lens_note(improved),)
    if kalibr:
        return Exported(camchain_yaml(improved.cameras, rig.sources.image).encode(), notes)
    if not changed:
        raise ConfigError(
            f"{params}: the stereo pair was not estimated, so its camera_info does not change",
            "calibrate extraction.npz again with this version, --method ml, and priors that are not fixed",
        )
    if rig.cameras.rectified:
        raise ConfigError(
            "the calibration was made from rectified images, so it gives no camera_info of the raw images",
            "calibrate from the raw images",
        )
    side: Side = "left" if target == Target.camera_info_left else "right"
    return Exported(_camera_info(improved.cameras, side).encode(), notes)


def _lens_note(improved: Improved) -> str:
    largest, usual = improved.residual_px, improved.residual_rms_px
    note = f"The distortion model differs from the estimated lens by {usual:.2g} px rms and at most {largest:.2g} px"
    if largest <= _LENS_PX:
        return f"{note}."
    return f"{note} (limit {_LENS_PX:g} px). To describe the lens better, calibrate the camera with a richer model."


def _camera_info(cameras: StereoRig, side: Side) -> str:
    pair = rectified_pair(cameras)
    camera = cameras.left if side == "left" else cameras.right
    return camera_info_yaml(camera, pair.R[side], pair.P[side])


def _beside(params: Path, robot: CalibratedRobot) -> Extraction:
    """The measurements in the directory of a params.yaml.

    Raises:
        ConfigError: there are none, or they are not its own.
    """
    path = params.with_name("extraction.npz")
    if not path.is_file():
        raise ConfigError(
            f"{path}: not found; it contains the measurements",
            "keep params.yaml in the directory that calibrate wrote",
        )
    extraction = read_extraction(path)
    different = differences(robot, extraction)
    if different:
        raise ConfigError(
            f"{path}: not the measurements of {params}: {'; '.join(different)}",
            "keep params.yaml in the directory that calibrate wrote",
        )
    return extraction
