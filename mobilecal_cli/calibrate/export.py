"""`mobilecal export`: a calibration in the format of another program."""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from mobilecal_cli.arguments import AnyPath, by_name, path_of, paths_of, require
from mobilecal_cli.calibrate.detect import first_images, plan_recording, snapshot_jpeg
from mobilecal_cli.calibrate.load import differences, parameters_of, read_extraction, read_params
from mobilecal_cli.calibrate.steps import Report
from mobilecal_cli.errors import ConfigError, QualityError, RecordingError
from mobilecal_cli.export.formats import Exported, Source, format_of, options_of, verdict_note, with_verdict
from mobilecal_cli.export.improved import improved_chain
from mobilecal_cli.export.scene import Motion, Scene, Unused
from mobilecal_cli.kinematics import cut_at, head_pose, integrate
from mobilecal_cli.likelihood.constants import clock_s
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.calibration import CalibratedRobot
from mobilecal_cli.model.observations import Extraction
from mobilecal_cli.model.rig import SIDES, Side
from mobilecal_cli.model.signals import Rejection
from mobilecal_cli.model.solution import Outlier, Residuals
from mobilecal_cli.readers import join_splits, open_recording, sha256_of
from mobilecal_cli.solvers.residuals import at_constants, residuals_of
from mobilecal_cli.solvers.transfer import base_motion
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
_STEP_NS = 10**8  # between two poses of the base in a scene


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

    A calibration whose verdict is FAIL or NOT ENOUGH is refused; one without a verdict is exported with a note.
    Unobservable parameters stay as they are in a URDF, and a controller keeps its own.

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
    path = Path("the report") if isinstance(params, Report) else path_of("params", params)
    robot = params.robot if isinstance(params, Report) else read_params(path)

    def measurements() -> Extraction:
        return params.data.extraction if isinstance(params, Report) else _beside(path, robot)

    def scene(with_images_of: tuple[Path, ...]) -> Scene:
        report = params.json if isinstance(params, Report) else None
        return _scene(robot, measurements(), path, report, with_images_of)

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
    if "wheel_joints" in used:
        given["wheel_joints"] = joints
    made = format_of(target)(Source(robot, path, measurements, scene), **given)
    content = made.content if made.states_verdict else with_verdict(made.content, robot)
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


def _scene(
    robot: CalibratedRobot, extraction: Extraction, params: Path, report: str | None, logs: Sequence[Path]
) -> Scene:
    """The scene of a calibration.

    Args:
        report: text of its report.json, which names the outliers and the legs that were used; None for the file next to
            params.yaml, if it exists.
        logs: its recordings, for the images; none for a scene without images.

    Raises:
        ConfigError: a recording is not of this calibration, or report.json cannot be read.
        RecordingError: a recording cannot be read.
    """
    constants = dict(robot.constants)
    parameters = parameters_of(robot, extraction, params)
    outliers, used_legs = _judged(params.with_name("report.json"), report)
    shown = at_constants(extraction, parameters, constants)
    residuals = residuals_of(shown, parameters)
    images = _images(extraction, logs) if logs else {}
    return Scene(
        robot=robot,
        extraction=extraction,
        motions={
            log: _motion(extraction, log, robot, constants, residuals, shown.pairs.T_v_h)
            for log in sorted({o.log for o in extraction.observations})
        },
        residuals=residuals,
        legs={
            i: k
            for k, (i, j) in enumerate(residuals.legs.tolist())
            if used_legs is None or (i, j) in used_legs
        },
        images=images,
        unused=tuple(sorted(_unused(extraction, outliers), key=lambda item: item.start_ns)),
    )


def _motion(
    extraction: Extraction,
    log: int,
    robot: CalibratedRobot,
    constants: Mapping[str, float],
    residuals: Residuals,
    T_v_h: FloatArray,
) -> Motion:
    """Base and head ten times per second and at the stations, where both are exactly those of the residuals."""
    mine = [k for k, o in enumerate(extraction.observations) if o.log == log]
    stops_ns = np.array([extraction.observations[k].time_ns for k in mine], dtype=np.int64)
    time_ns = np.union1d(np.arange(stops_ns[0], stops_ns[-1], _STEP_NS), stops_ns)
    track = extraction.wheels[log]
    # Stations at rest keep their stamps.
    clocks = {} if extraction.observations[mine[0]].at_rest else constants
    joints_ns, wheels_ns = (time_ns + round(clock_s(of, log, clocks) * 1e9) for of in ("joints", "wheels"))
    read_ns = np.clip(wheels_ns, track.time_ns[0], track.time_ns[-1])
    T = [residuals.T_w_v[mine[0]]]
    if len(time_ns) > 1:
        for step in base_motion(integrate(cut_at(track, read_ns), robot.wheels)):
            T.append(T[-1] @ step)
    at = np.searchsorted(time_ns, stops_ns)
    T_w_v = np.array(T)
    T_w_v[at] = residuals.T_w_v[mine]
    if not extraction.joint_tracks:  # no joints between the stations
        return Motion(stops_ns, T_w_v[at], T_v_h[mine])
    # Between the stations without scale and backlash of the joints.
    improved = improved_chain(extraction.rig.chain, constants)
    joints = [
        track.at(joints_ns) + improved.zeros.get(name, 0.0)
        for name, track in zip(extraction.rig.chain.joints, extraction.joint_tracks[log], strict=True)
    ]
    values = np.stack(joints, axis=1) if joints else np.zeros((len(time_ns), 0))
    head = np.array(head_pose(improved.improved, values))
    head[at] = T_v_h[mine]
    return Motion(time_ns, T_w_v, head)


def _judged(path: Path, text: str | None) -> tuple[list[Outlier], set[tuple[int, int]] | None]:
    """The outliers of a report.json, and the pairs of observations of the legs that were used (None: unknown)."""
    if text is None and not path.is_file():
        return [], None
    try:
        report = json.loads(path.read_text(encoding="utf-8") if text is None else text)
        outliers = TypeAdapter(list[Outlier]).validate_python(report["outliers"])
        legs = {(int(leg["from_observation"]), int(leg["to_observation"])) for leg in report["legs"]}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigError(
            f"{path}: not a report.json of mobilecal", "remove the file, or calibrate again"
        ) from error
    return outliers, legs


def _unused(extraction: Extraction, outliers: Sequence[Outlier]) -> Iterator[Unused]:
    """A slip concerns the time between its two stations; everything else a moment."""
    stamps_ns = [o.time_ns for o in extraction.observations]
    for outlier in outliers:
        times = [stamps_ns[k] for k in outlier.observations if 0 <= k < len(stamps_ns)] or [outlier.time_ns]
        yield Unused(min(times), max(times), f"outlier ({outlier.kind})", outlier.text)
    for rejection in extraction.rejections:
        yield Unused(rejection.time_ns, rejection.time_ns, rejection.reason, rejection.detail)


def _images(extraction: Extraction, logs: Sequence[Path]) -> dict[int, dict[str, bytes]]:
    """The first images of each station, from the recordings of the extraction."""
    known = {log.sha256 for log in extraction.logs}
    wanted = {(o.log, o.time_ns): number for number, o in enumerate(extraction.observations)}
    jpegs: dict[int, dict[str, bytes]] = {}
    log = 0
    for parts in join_splits(list(logs)):
        for part in parts:
            if sha256_of(part) not in known:
                names = ", ".join(source.path for source in extraction.logs)
                raise ConfigError(
                    f"{part}: not a recording of this calibration", f"give its recordings: {names}"
                )
        with open_recording(parts) as recording:
            rig = extraction.rig
            for everything in (False, True):
                plans, *_ = plan_recording(recording, rig, everything)
                if any((log + k, s.time_ns) in wanted for k, plan in enumerate(plans) for s in plan.stations):
                    break
            for plan in plans:
                mine = [s for s in plan.stations if (log, s.time_ns) in wanted]
                numbers: dict[tuple[str, int], int] = {}  # (camera, time of its first image) → observation
                for station in mine:
                    taken = zip(rig.cameras.names, station.shots[0].times_ns, strict=True)
                    number = wanted[log, station.time_ns]
                    numbers |= {(name, at): number for name, at in taken if at is not None}
                for name, time_ns, picture in first_images(recording, rig, plan, mine):
                    if not isinstance(picture, Rejection):
                        jpegs.setdefault(numbers[name, time_ns], {})[name] = snapshot_jpeg(picture)
                log += 1
    if not jpegs:
        raise RecordingError(
            "the stations of the recordings are not those of extraction.npz",
            "give the recordings in the same order as to calibrate, or calibrate again",
        )
    return jpegs
