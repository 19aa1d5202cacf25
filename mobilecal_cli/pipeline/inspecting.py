"""`mobilecal inspect`: what a recording holds, at a glance, however long it is."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from mobilecal_cli.config import RigConfig, load_rig, read_urdf
from mobilecal_cli.discovery import lacking, settle_rig
from mobilecal_cli.errors import MobilecalError, RecordingError
from mobilecal_cli.kinematics import cut_at, integrate
from mobilecal_cli.model import (
    Board,
    BoardView,
    GrayImage,
    Inspection,
    IntArray,
    JointRange,
    Lack,
    MotionView,
    Prelude,
    Rejection,
    Rig,
    Side,
    Signals,
    TopicInfo,
    TopicView,
    WheelTrack,
)
from mobilecal_cli.pipeline.extracting import board_of, sliding_joints
from mobilecal_cli.pipeline.progress import Progress, silent
from mobilecal_cli.readers import Extent, Recording, open_recording, pictures_near, read_prelude, read_signals
from mobilecal_cli.report import MIN_STATIONS
from mobilecal_cli.stations import plan_stations, wheel_track
from mobilecal_cli.uncertainty import FEWEST_STATIONS, gaps_between
from mobilecal_cli.vision import Detection, find_board, identify_size

#: So much of a long recording is decompressed for the motion; of a shorter one all of it.
MOTION_BYTES = 2**28
#: Moments, spread over the log, at which a picture of either camera is looked at.
PICTURE_MOMENTS = 6
_SIDES: tuple[Side, Side] = ("left", "right")


def inspect(
    logs: Sequence[Path],
    config_path: Path | None = None,
    flags: Mapping[str, Any] | None = None,
    progress: Progress = silent,
) -> Inspection:
    """Look at one recording (in one file or several): what is there, what would be used, what is missing.

    Of a long recording only a part is read: the first messages of each topic, the index, joints and wheels of at most
    256 MB of the file, and a few pictures.

    Args:
        logs: parts of one recording.
        config_path: rig.yaml.
        flags: dotted key → value, over the file.
        progress: told what is being looked at.

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
            progress("pictures", 0, None)
            board = _board(recording, rig, board_of(config), missing)
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
    return Lack(error.message, error.hint)


def _settled(
    recording: Recording, config: RigConfig, flags: frozenset[str]
) -> tuple[Rig | None, list[Lack], list[str]]:
    """The rig that a calibration would use, or everything that keeps it from one."""
    try:
        prelude: Prelude = read_prelude(recording)
    except RecordingError as error:
        return None, [_lack(error)], []
    urdf = read_urdf(config)
    missing = lacking(config, prelude, urdf)
    if missing:
        return None, [_lack(error) for error in missing], []
    settled = settle_rig(config, prelude, urdf, flags)
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
    """How the robot moved, what that cannot show, and what was odd."""
    try:
        signals = read_signals(recording, rig.sources, rig.chain.joints, (), Extent(MOTION_BYTES))
        wheels = wheel_track(signals.wheels["right"], signals.wheels["left"])
    except RecordingError as error:
        missing.append(_lack(error))
        return None, (), ()
    sliding = sliding_joints(rig.chain)
    joints = {}
    for name, track in signals.joints.items():
        low, high = float(track.value.min()), float(track.value.max())
        scale, unit = (1e3, "mm") if name in sliding else (180 / np.pi, "deg")
        joints[name] = JointRange(low * scale, high * scale, unit)
    turned = {"right": wheels.right_rad, "left": wheels.left_rad}
    wheels_deg = {side: float(np.degrees(np.abs(np.diff(values)).sum())) for side, values in turned.items()}
    driven_m = turned_deg = None
    if rig.nominal.wheels is not None:
        legs = integrate(cut_at(wheels, _seconds(wheels)), rig.nominal.wheels)
        driven_m = float(np.linalg.norm(legs.t_m, axis=1).sum())
        turned_deg = float(np.degrees(np.ptp(np.cumsum([0.0, *legs.psi_rad]))))
    share = recording.share(rig.sources.motion, Extent(MOTION_BYTES))
    rests, weak = _rests(rig, signals, times, share)
    notes = signals.notes if share == 1 else ()
    return MotionView(joints, wheels_deg, driven_m, turned_deg, rests, share), weak, notes


def _seconds(wheels: WheelTrack) -> IntArray:
    """The track's times about a second apart, its ends included: over less, noise would count as motion."""
    first, last = int(wheels.time_ns[0]), int(wheels.time_ns[-1])
    count = min(max(2, (last - first) // 10**9 + 1), len(wheels.time_ns))
    return np.linspace(first, last, count).astype(np.int64)


def _rests(
    rig: Rig, signals: Signals, times: Mapping[str, IntArray], share: float
) -> tuple[int | None, tuple[Lack, ...]]:
    """How often the robot rests with pictures, and what its stations' motion cannot show."""
    images = {side: times.get(rig.sources.image[side]) for side in _SIDES}
    if share < 1 or any(stamps is None for stamps in images.values()):
        return None, ()
    stamps = {side: np.unique(found) for side, found in images.items() if found is not None}
    try:
        plan = plan_stations(
            Signals(signals.joints, signals.wheels, stamps, ()), rig.chain.joints, sliding_joints(rig.chain)
        )
    except RecordingError as error:
        return None, (_lack(error),)
    weak = []
    if len(plan.stations) < MIN_STATIONS:
        weak.append(
            Lack(
                f"only {len(plan.stations)} moments are worth a look: {FEWEST_STATIONS} with the board make a "
                f"calibration, {MIN_STATIONS} are the least that passes",
                "record at least ten rests of two seconds, with the head and the base moved in between",
            )
        )
    if plan.stations:
        at = np.array([station.time_ns for station in plan.stations])
        readings = np.stack([station.joints for station in plan.stations])
        weak += [
            Lack(f"{', '.join(gap.parameters)} cannot be seen: {gap.because}", gap.cure)
            for gap in gaps_between(rig.chain, readings, [plan.wheels], [at])
        ]
    return sum(station.at_rest for station in plan.stations), tuple(weak)


def _board(recording: Recording, rig: Rig, board: Board | None, missing: list[Lack]) -> BoardView | None:
    """In how many of a few pictures the board is."""
    start, end = recording.start_ns, recording.end_ns
    if start is None or end is None:
        return None
    moments = np.linspace(start, end, PICTURE_MOMENTS + 2)[1:-1].astype(np.int64)
    pictures: list[GrayImage] = []
    broken: list[Rejection] = []
    for picture in pictures_near(recording, rig.sources, moments.tolist()):
        if isinstance(picture, Rejection):
            broken.append(picture)
        else:
            pictures.append(picture)
    if not pictures:
        why = f": {broken[0].detail}" if broken else ""
        missing.append(Lack(f"no picture can be looked at{why}", "record both cameras' images"))
        return None
    size, seen = _found(pictures, board)
    if not seen:
        missing.append(
            Lack(
                f"a whole checkerboard is in none of {len(pictures)} pictures spread over the log",
                "keep the whole board in both pictures, in good light, with squares of 7 pixels or more",
            )
        )
    return BoardView(len(pictures), seen, size)


def _found(pictures: Sequence[GrayImage], board: Board | None) -> tuple[tuple[int, int] | None, int]:
    """The board's columns and rows, and in how many pictures it is."""
    if board is not None and board.markers is not None:
        seen = sum(isinstance(find_board(picture, board), Detection) for picture in pictures)
        return (board.columns, board.rows) if seen else None, seen
    vote = identify_size(pictures)
    return vote.size, vote.votes[vote.size] if vote.size else 0
