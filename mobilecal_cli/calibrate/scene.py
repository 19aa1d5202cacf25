"""The scene of a calibration for viewers: from params.yaml, extraction.npz, report.json, and the recordings' images."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path

import numpy as np
from pydantic import TypeAdapter

from mobilecal_cli.calibrate.detect import first_images, plan_recording
from mobilecal_cli.calibrate.load import parameters_of
from mobilecal_cli.errors import ConfigError, RecordingError
from mobilecal_cli.export.improved import improved_chain
from mobilecal_cli.export.scene import Motion, Scene, Unused
from mobilecal_cli.kinematics import cut_at, head_pose, integrate
from mobilecal_cli.likelihood.nuisance import clock_s
from mobilecal_cli.model import CalibratedRobot, Extraction, FloatArray, Outlier, Rejection, Residuals
from mobilecal_cli.readers import join_splits, open_recording, sha256_of
from mobilecal_cli.solvers.residuals import at_constants, residuals_of
from mobilecal_cli.solvers.transfer import base_motion
from mobilecal_cli.vision import snapshot_jpeg

_STEP_NS = 10**8  # between two poses of the base


def scene_of(
    robot: CalibratedRobot, extraction: Extraction, params: Path, logs: Sequence[Path] = ()
) -> Scene:
    """The scene of a calibration.

    Args:
        extraction: its measurements.
        params: its file; report.json next to it, if it exists, names the outliers and the legs that were used.
        logs: its recordings, for the images; none for a scene without images.

    Raises:
        ConfigError: a recording is not of this calibration, or report.json cannot be read.
        RecordingError: a recording cannot be read.
    """
    constants = dict(robot.constants or {})
    parameters = parameters_of(robot, extraction, params)
    report = params.with_name("report.json")
    outliers, used_legs = _judged(report) if report.is_file() else ([], None)
    shown = at_constants(extraction, parameters, constants)
    residuals, pairs = residuals_of(shown, parameters), shown.pairs
    images = _images(extraction, logs) if logs else {}
    return Scene(
        robot=robot,
        extraction=extraction,
        motions={
            log: _motion(extraction, log, robot, constants, residuals, pairs.T_v_h)
            for log in sorted({o.log for o in extraction.observations})
        },
        residuals=residuals,
        T_w_c=residuals.T_w_v @ pairs.T_v_h @ parameters.T_h_c,
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
    improved = improved_chain(extraction.rig, constants)
    joints = [
        track.at(joints_ns) + improved.zeros.get(name, 0.0)
        for name, track in zip(extraction.rig.chain.joints, extraction.joint_tracks[log], strict=True)
    ]
    values = np.stack(joints, axis=1) if joints else np.zeros((len(time_ns), 0))
    head = np.array(head_pose(improved.improved, values))
    head[at] = T_v_h[mine]
    return Motion(time_ns, T_w_v, head)


def _judged(path: Path) -> tuple[list[Outlier], set[tuple[int, int]]]:
    """The outliers of a report.json, and the pairs of observations of the legs that were used."""
    try:
        report = json.loads(path.read_text(encoding="utf-8"))
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
