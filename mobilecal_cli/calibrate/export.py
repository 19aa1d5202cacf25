"""`mobilecal export`: a calibration in the format of another program."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from mobilecal_cli.calibrate.arguments import AnyPath, by_name, path_of, paths_of, require
from mobilecal_cli.calibrate.load import differences, read_extraction, read_params
from mobilecal_cli.calibrate.steps import Report
from mobilecal_cli.errors import ConfigError, MobilecalError, QualityError
from mobilecal_cli.export.formats import Exported, Source, format_of, options_of, verdict_note, with_verdict
from mobilecal_cli.export.scene import Scene
from mobilecal_cli.files.scratch import scratch_directory
from mobilecal_cli.model import SIDES, CalibratedRobot, Extraction, Side
from mobilecal_cli.targets import Target

__all__ = ["Exported", "export"]
#: Options that only some formats use, as the command spells them.
_FLAGS = {
    "urdf": "--urdf",
    "camera": "--camera",
    "with_chain": "--with-chain",
    "rate_hz": "--rate",
    "distance_m": "--distance",
    "logs": "--log",
}


def export(
    params: AnyPath | Report,
    target: str,
    *,
    urdf: AnyPath | None = None,
    camera: str | None = None,
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
        camera: for the target camera_info, the name of the camera; the reference camera by default.
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
    joint_names: Mapping[Any, str] = by_name("wheel_joints", wheel_joints)
    for side, joint in joint_names.items():
        if side not in SIDES or not (isinstance(joint, str) and joint):
            raise ConfigError(
                f"wheel_joints: {side!r}: {joint!r} is not a side and the name of its joint",
                "for example {'left': 'wheel_left_joint'}",
            )
    recordings = paths_of("logs", logs)
    robot_urdf = None if urdf is None else path_of("urdf", urdf)
    require("with_chain", with_chain, bool, "True or False")
    with _file_of(params) as path:
        robot = read_params(path)
        if robot.verdict not in ("PASS", "") and not allow_failed:
            reason = robot.reasons[0] if robot.reasons else "report.html states the reasons."
            raise QualityError(
                f"{path}: the verdict is {robot.verdict}. {reason}",
                "calibrate again as report.html says, or add --allow-failed (in Python allow_failed=True): the export "
                "then states the verdict",
            )
        joints = {**robot.wheel_joints, **joint_names}
        _check_wheels(robot, joint_names, joints)
        options: dict[str, Any] = {
            "urdf": robot_urdf,
            "camera": camera,
            "wheel_joints": joint_names or None,
            "with_chain": with_chain or None,
            "rate_hz": rate_hz,
            "distance_m": distance_m,
            "logs": recordings or None,
        }
        given = {name: value for name, value in options.items() if value is not None}
        used = options_of(target)
        for name in (name for name in given if name not in used):
            flag = _FLAGS.get(name) or f"--{next(iter(joint_names))}-joint"
            formats = " and ".join(other for other in Target if name in options_of(other))
            raise ConfigError(f"{flag} applies only to --to {formats}", "leave it out")

        def scene(with_images_of: tuple[Path, ...]) -> Scene:
            from mobilecal_cli.calibrate.scene import scene_of

            return scene_of(robot, _beside(path, robot), path, with_images_of)

        if "wheel_joints" in used:
            given["wheel_joints"] = joints
        made = format_of(target)(Source(robot, path, lambda: _beside(path, robot), scene), **given)
        content = made.content if made.states_verdict else with_verdict(made.content, robot)
        return replace(made, content=content, notes=made.notes + verdict_note(robot))


@contextmanager
def _file_of(params: AnyPath | Report) -> Iterator[Path]:
    """params.yaml, beside its extraction.npz: that of a report is in a temporary directory."""
    if not isinstance(params, Report):
        yield path_of("params", params)
        return
    with scratch_directory() as directory:
        path = directory / "params.yaml"
        for name, content in params.files().items():
            path.with_name(name).write_bytes(content)
        try:
            yield path
        except MobilecalError as error:
            raise type(error)(error.message.replace(str(path), "the report"), error.hint) from error


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


def _beside(params: Path, robot: CalibratedRobot) -> Extraction:
    """The measurements in the directory of a params.yaml."""
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
