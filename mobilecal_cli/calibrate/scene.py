"""The scene of a calibration for viewers: from params.yaml, extraction.npz, report.json, and the recordings' images."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mobilecal_cli.calibrate.load import parameters_of
from mobilecal_cli.calibrate.plan import plan_recording
from mobilecal_cli.errors import ConfigError, RecordingError
from mobilecal_cli.export import from_plain, improved_cameras, improved_chain
from mobilecal_cli.export.scene import CornerView, Motion, Scene, StationView, Unused
from mobilecal_cli.kinematics import cut_at, head_pose, integrate
from mobilecal_cli.model import (
    SIDES,
    CalibratedRobot,
    Extraction,
    FloatArray,
    IntArray,
    Outlier,
    Parameters,
    Rejection,
    Residuals,
    Side,
    Station,
)
from mobilecal_cli.readers import join_splits, open_recording, read_images, sha256_of
from mobilecal_cli.report.numbers import station_names
from mobilecal_cli.solvers.residuals import at_constants, residuals_of
from mobilecal_cli.solvers.transfer import base_motion
from mobilecal_cli.stations import images_of
from mobilecal_cli.vision import snapshot_jpeg

_STEP_NS = 10**8  # between two poses of the base
#: Observation → its images.
Images = Mapping[int, Mapping[Side, bytes]]


def scene_of(
    robot: CalibratedRobot, extraction: Extraction, params: Path, logs: Sequence[Path] = ()
) -> Scene:
    """The scene of a calibration.

    Args:
        robot: the calibration.
        extraction: its measurements.
        params: its file; report.json next to it names the outliers.
        logs: its recordings, for the images; none for a scene without images.

    Raises:
        ConfigError: a recording is not of this calibration, or report.json cannot be read.
        RecordingError: a recording cannot be read.
    """
    constants, rig = dict(robot.constants or {}), extraction.rig
    parameters = parameters_of(robot, extraction, params)
    judged = _judged(params.with_name("report.json"))
    seen, pairs = at_constants(extraction, parameters, constants)
    residuals = residuals_of(seen, pairs, parameters)
    images = _images(extraction, logs) if logs else {}
    square_m = extraction.board.square_m
    if square_m is None:
        square_m = float(np.median([o.square_m for o in extraction.observations]))
    views = _stations(extraction, residuals, pairs.T_v_h, parameters, images, judged)
    return Scene(
        robot=robot,
        chain=rig.chain,
        cameras=improved_cameras(rig, constants).cameras,
        board=replace(extraction.board, square_m=square_m),
        motions=tuple(
            _motion(extraction, log, robot, constants, residuals, pairs.T_v_h)
            for log in sorted({o.log for o in extraction.observations})
        ),
        stations=tuple(
            tuple(view for view, o in zip(views, extraction.observations, strict=True) if o.log == log)
            for log in sorted({o.log for o in extraction.observations})
        ),
        unused=tuple(sorted(_unused(extraction, judged.outliers), key=lambda item: item.start_ns)),
    )


def _stations(
    extraction: Extraction,
    residuals: Residuals,
    T_v_h: FloatArray,
    parameters: Parameters,
    images: Images,
    judged: _Judged,
) -> list[StationView]:
    names = station_names(extraction)
    legs = {
        i: k
        for k, (i, j) in enumerate(residuals.legs.tolist())
        if judged.legs is None or (i, j) in judged.legs
    }
    T_w_c = residuals.T_w_v @ T_v_h @ parameters.T_h_c
    predicted = {"left": residuals.predicted_left_px, "right": residuals.predicted_right_px}
    views = []
    for number, o in enumerate(extraction.observations):
        leg = legs.get(number)
        corners: dict[Side, CornerView] = {}
        for side in SIDES:
            found = o.left if side == "left" else o.right
            jpeg = images.get(number, {}).get(side, b"")
            corners[side] = CornerView(
                found.pixels, found.seen, None if leg is None else predicted[side][leg], jpeg
            )
        view = StationView(names[number], o.time_ns, residuals.T_w_k[number], T_w_c[number], corners)
        if leg is not None:
            view = replace(
                view,
                to_station=names[int(residuals.legs[leg, 1])],
                point_m=float(residuals.leg_point_rms_m[leg]),
                reprojection_px=float(residuals.leg_reprojection_px[leg]),
            )
        views.append(view)
    return views


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
    between = np.arange(stops_ns[0], stops_ns[-1], _STEP_NS)
    time_ns = np.union1d(between, stops_ns)
    track = extraction.wheels[log]
    clocks = (
        {} if extraction.observations[mine[0]].at_rest else constants
    )  # stations at rest keep their stamps
    read_ns = np.clip(_by_clock(time_ns, "time_wheels", clocks), track.time_ns[0], track.time_ns[-1])
    T = [residuals.T_w_v[mine[0]]]
    if len(time_ns) > 1:
        for step in base_motion(integrate(cut_at(track, read_ns), robot.wheels)):
            T.append(T[-1] @ step)
    head = _heads(extraction, log, constants, _by_clock(time_ns, "time_joints", clocks))
    at = np.searchsorted(time_ns, stops_ns)
    T_w_v = np.array(T)
    T_w_v[at] = residuals.T_w_v[mine]
    if head is None:  # no joints between the stations
        return Motion(stops_ns, T_w_v[at], T_v_h[mine])
    head[at] = T_v_h[mine]
    return Motion(time_ns, T_w_v, head)


def _by_clock(time_ns: IntArray, name: str, constants: Mapping[str, float]) -> IntArray:
    """Times of the images by another clock, whose offset is a constant."""
    return np.asarray(time_ns + round(constants.get(name, 0.0) * 1e9), dtype=np.int64)


def _heads(
    extraction: Extraction, log: int, constants: Mapping[str, float], time_ns: IntArray
) -> FloatArray | None:
    """(n, 4, 4) T_v_h between the stations, without scale and backlash of the joints; None without joint tracks."""
    if not extraction.joint_tracks:
        return None
    improved = improved_chain(extraction.rig, constants)
    joints = [
        track.at(time_ns) + improved.zeros.get(name, 0.0)
        for name, track in zip(extraction.rig.chain.joints, extraction.joint_tracks[log], strict=True)
    ]
    values = np.stack(joints, axis=1) if joints else np.zeros((len(time_ns), 0))
    return np.array(head_pose(improved.improved, values))


# -- what was not used ----------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Judged:
    """What report.json says about the measurements.

    Attributes:
        outliers: the outliers.
        legs: observations of the legs that were used; None if all were.
    """

    outliers: tuple[Outlier, ...] = ()
    legs: frozenset[tuple[int, int]] | None = None


def _judged(path: Path) -> _Judged:
    """The outliers of a report.json; nothing if the file does not exist.

    Raises:
        ConfigError: it is another file.
    """
    if not path.is_file():
        return _Judged()
    try:
        found = json.loads(path.read_text(encoding="utf-8"))
        outliers = tuple(from_plain(Outlier, one) for one in found["outliers"])
        legs = frozenset((int(leg["from_observation"]), int(leg["to_observation"])) for leg in found["legs"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise ConfigError(
            f"{path}: not a report.json of mobilecal", "remove the file, or calibrate again"
        ) from error
    return _Judged(outliers, legs)


def _unused(extraction: Extraction, outliers: Sequence[Outlier]) -> Iterator[Unused]:
    """A slip concerns the time between its two stations; everything else a moment."""
    count, seen = len(extraction.observations), extraction.observations
    for one in outliers:
        times = [seen[k].time_ns for k in one.observations if 0 <= k < count] or [one.time_ns]
        yield Unused(min(times), max(times), f"outlier ({one.kind})", one.text)
    for rejection in extraction.rejections:
        yield Unused(rejection.time_ns, rejection.time_ns, rejection.reason, rejection.detail)


# -- images ---------------------------------------------------------------------------------------


def _images(extraction: Extraction, logs: Sequence[Path]) -> Images:
    """The first stereo pair of each station, from the recordings of the extraction.

    Raises:
        ConfigError: a recording is not one of the extraction's.
        RecordingError: a recording cannot be read, or its stations are not those of the extraction.
    """
    known = {log.sha256 for log in extraction.logs}
    wanted = {(o.log, o.time_ns): number for number, o in enumerate(extraction.observations)}
    found: dict[int, dict[Side, bytes]] = {}
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
                plans = plan_recording(recording, rig, rig.chain.prismatic, everything).plans
                if any((log + k, s.time_ns) in wanted for k, plan in enumerate(plans) for s in plan.stations):
                    break
            for plan in plans:
                mine = [s for s in plan.stations if (log, s.time_ns) in wanted]
                firsts = [replace(station, pairs=station.pairs[:1]) for station in mine]
                places = _places(firsts, log, wanted)
                index = images_of(firsts, plan.images)
                for side, time_ns, picture in read_images(
                    recording, rig.sources.image, index, rig.sources.layout
                ):
                    if not isinstance(picture, Rejection):
                        found.setdefault(places[side, time_ns], {})[side] = snapshot_jpeg(picture)
                log += 1
    if not found:
        raise RecordingError(
            "the stations of the recordings are not those of extraction.npz",
            "give the recordings in the same order as to calibrate, or calibrate again",
        )
    return found


def _places(
    stations: Sequence[Station], log: int, wanted: Mapping[tuple[int, int], int]
) -> dict[tuple[Side, int], int]:
    """(side, time of its first image) → observation."""
    places: dict[tuple[Side, int], int] = {}
    for station in stations:
        number = wanted[log, station.time_ns]
        places["left", station.pairs[0].left_ns] = number
        places["right", station.pairs[0].right_ns] = number
    return places
