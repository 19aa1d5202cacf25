"""`mobilecal inspect`: a summary of a recording of any length."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mobilecal_cli.config import RigConfig, load_rig, read_urdf
from mobilecal_cli.discovery import lacking, resolve_rig
from mobilecal_cli.errors import MobilecalError, ObservationError, RecordingError, SolveError
from mobilecal_cli.kinematics import cut_at, integrate
from mobilecal_cli.model import (
    CAMERA_INFO_CHANGES,
    Board,
    BoardView,
    GrayImage,
    Inspection,
    IntArray,
    JointRange,
    Lack,
    MotionView,
    PictureIndex,
    Prelude,
    Rejection,
    Rig,
    Side,
    Signals,
    Station,
    TopicInfo,
    TopicView,
    WheelTrack,
)
from mobilecal_cli.pipeline.extracting import board_of
from mobilecal_cli.pipeline.progress import Progress, silent
from mobilecal_cli.readers import Extent, Recording, open_recording, pictures_near, read_prelude, read_signals
from mobilecal_cli.report import MIN_STATIONS
from mobilecal_cli.stations import plan_stations, wheel_track
from mobilecal_cli.uncertainty import FEWEST_STATIONS, Gap, gaps_between
from mobilecal_cli.vision import Detection, Measured, find_board, identify_size, measure

#: At most so much of a recording is decompressed for the motion.
MOTION_BYTES = 2**28
#: Number of moments, evenly spaced, at which an image of either camera is searched for the board.
PICTURE_MOMENTS = 6
#: `calibrate` rejects stations whose squares differ by this share from the stated size.
_SQUARE_TOLERANCE = 0.1
_SIDES: tuple[Side, Side] = ("left", "right")


def inspect(
    logs: Sequence[Path],
    config_path: Path | None = None,
    flags: Mapping[str, Any] | None = None,
    progress: Progress = silent,
) -> Inspection:
    """Summary of one recording (in one file or several): contents, what `calibrate` would use, what is missing.

    Only a part of a long recording is read: the first messages of each topic, the index, joints and wheels of at most
    256 MB of the file, and a few images.

    Args:
        logs: parts of one recording.
        config_path: rig.yaml.
        flags: dotted key → value, over the file.
        progress: receives the progress.

    Raises:
        RecordingError: the recording cannot be opened.
        ConfigError: the configuration cannot be read.
    """
    config = load_rig(config_path, dict(flags or {}))
    given = frozenset(key for key, value in (flags or {}).items() if value is not None)
    with open_recording(logs) as recording:
        progress("topics", 0, None)
        times = recording.log_times()
        rig, missing, notes = _settled(recording, config, given)
        board: BoardView | None = None
        motion: MotionView | None = None
        weak: tuple[Lack, ...] = ()
        if rig is not None:
            progress("motion", 0, None)
            motion, weak, seen = _motion(recording, rig, times, missing)
            notes = [*notes, *seen]
            progress("images", 0, None)
            board = _board(recording, rig, board_of(config), config.board.square_m, missing)
        return Inspection(
            name=recording.name,
            containers=recording.containers,
            size_bytes=_size_bytes(logs),
            start_ns=recording.start_ns,
            end_ns=recording.end_ns,
            topics=tuple(_topic(recording, info, times.get(info.name)) for info in recording.topics),
            rig=rig,
            board=board,
            motion=motion,
            missing=tuple(missing),
            weak=weak,
            notes=(*notes, *recording.damage),
        )


def _size_bytes(logs: Sequence[Path]) -> int:
    files = [p for log in logs for p in (log.rglob("*") if log.is_dir() else [log])]
    return sum(p.stat().st_size for p in files if p.is_file())


def _lack(error: MobilecalError) -> Lack:
    return Lack(error.message, error.hint, error.exit_code)


def _settled(
    recording: Recording, config: RigConfig, flags: frozenset[str]
) -> tuple[Rig | None, list[Lack], list[str]]:
    """The rig that `calibrate` would use, or everything that is missing for it, and notes."""
    try:
        prelude: Prelude = read_prelude(recording)
    except RecordingError as error:
        return None, [_lack(error)], []
    urdf = read_urdf(config)
    missing = lacking(config, prelude, urdf)
    if missing:
        return None, [_lack(error) for error in missing], []
    settled = resolve_rig(config, prelude, urdf, flags)
    return settled.rig, [], list(settled.notes)


def _topic(recording: Recording, info: TopicInfo, times_ns: IntArray | None) -> TopicView:
    if times_ns is None or not len(times_ns):
        return TopicView(info.name, info.type, info.count, None, None, None, None)
    ordered = np.sort(times_ns)
    intervals_s = np.diff(ordered) * 1e-9
    back = int(np.sum(np.diff(times_ns) < 0))
    if not len(intervals_s):
        return TopicView(info.name, info.type, info.count, None, None, None, back)
    usual, longest = float(np.median(intervals_s)), int(np.argmax(intervals_s))
    since = float(ordered[longest] - (recording.start_ns or 0)) * 1e-9
    rate_hz = 1 / usual if usual > 0 else None
    return TopicView(info.name, info.type, info.count, rate_hz, float(intervals_s[longest]), since, back)


def _motion(
    recording: Recording, rig: Rig, times: Mapping[str, IntArray], missing: list[Lack]
) -> tuple[MotionView | None, tuple[Lack, ...], tuple[str, ...]]:
    """Motion of the robot, what is unobservable from it, and notes."""
    extent = Extent(MOTION_BYTES)
    try:
        logs = read_signals(recording, replace(rig.sources, image={}), rig.chain.joints, extent)
        wheels = [wheel_track(signals.wheels["right"], signals.wheels["left"]) for signals in logs]
    except RecordingError as error:
        missing.append(_lack(error))
        return None, (), ()
    joints = {}
    for name in rig.chain.joints:
        readings = np.concatenate([signals.joints[name].value for signals in logs])
        scale, unit = (1e3, "mm") if name in rig.chain.prismatic else (180 / np.pi, "deg")
        joints[name] = JointRange(float(readings.min()) * scale, float(readings.max()) * scale, unit)
    wheels_deg: dict[str, float] = {
        side: float(sum(np.degrees(np.abs(np.diff(signals.wheels[side].value)).sum()) for signals in logs))
        for side in _SIDES
    }
    driven_m = turned_deg = None
    if rig.nominal.wheels is not None:
        legs = [integrate(cut_at(track, _seconds(track)), rig.nominal.wheels) for track in wheels]
        driven_m = float(sum(np.linalg.norm(one.t_m, axis=1).sum() for one in legs))
        turned_deg = float(
            np.degrees(np.ptp(np.cumsum([0.0, *(psi for one in legs for psi in one.psi_rad)])))
        )
    share = recording.share(rig.sources.motion, extent)
    rests, weak = _rests(rig, logs, times, share, missing)
    # Gaps between the parts that are read would be noted as irregularities.
    notes = tuple(note for s in logs for note in s.notes if share == 1 or CAMERA_INFO_CHANGES in note)
    return MotionView(joints, wheels_deg, driven_m, turned_deg, rests, share), weak, notes


def _seconds(wheels: WheelTrack) -> IntArray:
    """Times of the track about a second apart with both ends: shorter steps would count noise as motion."""
    first, last = int(wheels.time_ns[0]), int(wheels.time_ns[-1])
    count = min(max(2, (last - first) // 10**9 + 1), len(wheels.time_ns))
    return np.linspace(first, last, count).astype(np.int64)


def _rests(
    rig: Rig, logs: Sequence[Signals], times: Mapping[str, IntArray], share: float, missing: list[Lack]
) -> tuple[int | None, tuple[Lack, ...]]:
    """Number of rests with images, and what is unobservable; what prevents a calibration goes to `missing`."""
    images = {side: times.get(rig.sources.image[side]) for side in _SIDES}
    # Where a clock steps, log times do not tell which readings belong to an image.
    if share < 1 or len(logs) > 1 or any(logged is None for logged in images.values()):
        return None, ()
    unique = {side: np.unique(logged) for side, logged in images.items() if logged is not None}
    signals = replace(logs[0], images={side: PictureIndex(ns, ns, ns) for side, ns in unique.items()})
    try:
        (plan,) = plan_stations([signals], rig.chain.joints, rig.chain.prismatic)
    except RecordingError as error:
        missing.append(_lack(error))
        return None, ()
    weak: list[Lack] = []
    if len(plan.stations) < MIN_STATIONS:
        lack = Lack(
            f"The recording has {len(plan.stations)} possible stations; a calibration needs {FEWEST_STATIONS}, "
            f"and {MIN_STATIONS} to pass.",
            "record at least ten rests of two seconds, and move head and base in between",
            ObservationError.exit_code,
        )
        (missing if len(plan.stations) < FEWEST_STATIONS else weak).append(lack)
    if plan.stations:
        at = np.array([station.time_ns for station in plan.stations])
        readings = np.stack([station.joints for station in plan.stations])
        for gap in gaps_between(rig.chain, readings, [plan.wheels], [at]):
            lack = Lack(
                f"{', '.join(gap.parameters)}: unobservable: {gap.because}", gap.cure, SolveError.exit_code
            )
            (weak if _has_nominal(rig, gap) else missing).append(lack)
    return sum(station.at_rest for station in plan.stations), tuple(weak)


def _has_nominal(rig: Rig, gap: Gap) -> bool:
    """Whether `calibrate` can fix the unobservable parameters at nominal values."""
    of_wheels = any("radi" in name or "separation" in name for name in gap.parameters)
    return (rig.nominal.wheels if of_wheels else rig.nominal.T_h_reference) is not None


def _board(
    recording: Recording, rig: Rig, board: Board | None, stated_m: float | None, missing: list[Lack]
) -> BoardView | None:
    """The board in a few images: its size, how often it is found, and the measured side of its squares."""
    start, end = recording.start_ns, recording.end_ns
    if start is None or end is None:
        return None
    moments = np.linspace(start, end, PICTURE_MOMENTS + 2)[1:-1].astype(np.int64).tolist()
    found = {
        side: list(
            pictures_near(recording, replace(rig.sources, image={side: rig.sources.image[side]}), moments)
        )
        for side in _SIDES
    }
    images = [image for side in _SIDES for image in found[side] if not isinstance(image, Rejection)]
    if not images:
        broken = [image for side in _SIDES for image in found[side] if isinstance(image, Rejection)]
        why = f": {broken[0].detail}" if broken else ""
        missing.append(
            Lack(f"no image can be read{why}", "record both cameras' images", ObservationError.exit_code)
        )
        return None
    size, seen = _found(images, board)
    if not seen:
        missing.append(
            Lack(
                f"a whole checkerboard is in none of {len(images)} images spread over the recording",
                "keep the whole board in both images, in good light, with squares of 7 pixels or more",
                ObservationError.exit_code,
            )
        )
        return BoardView(len(images), seen, size)
    square_m = None
    if size is not None:
        square_m = _square_m(rig, board or Board(*size), found["left"], found["right"])
    if square_m and stated_m and abs(square_m - stated_m) > _SQUARE_TOLERANCE * stated_m:
        missing.append(
            Lack(
                f"the squares measure {square_m * 1e3:.1f} mm, {stated_m * 1e3:.1f} mm are stated "
                f"(limit {100 * _SQUARE_TOLERANCE:g} %)",
                "correct board.square_m, or calibrate the stereo pair again (camera_info)",
                ObservationError.exit_code,
            )
        )
    return BoardView(len(images), seen, size, square_m, stated_m)


def _square_m(
    rig: Rig,
    board: Board,
    left: Sequence[GrayImage | Rejection],
    right: Sequence[GrayImage | Rejection],
) -> float | None:
    """Median side of a square over the stereo pairs, m; None if no pair shows the board."""
    if len(left) != len(right):  # the images cannot be paired without their stamps
        return None
    sides = []
    for pair in zip(left, right, strict=True):
        if not any(isinstance(image, Rejection) for image in pair):
            detections = [find_board(image, board) for image in pair if not isinstance(image, Rejection)]
            station = Station(0, True, (), 0, np.zeros(0), np.zeros(0))
            measured = measure(0, station, detections[:1], detections[1:], rig.cameras, board)
            if isinstance(measured, Measured):
                sides.append(measured.square_m)
    return float(np.median(sides)) if sides else None


def _found(images: Sequence[GrayImage], board: Board | None) -> tuple[tuple[int, int] | None, int]:
    """Columns and rows of the board, and the number of images that show it whole."""
    if board is not None and board.markers is not None:
        seen = sum(isinstance(find_board(image, board), Detection) for image in images)
        return (board.columns, board.rows) if seen else None, seen
    vote = identify_size(images)
    return vote.size, vote.votes[vote.size] if vote.size else 0
