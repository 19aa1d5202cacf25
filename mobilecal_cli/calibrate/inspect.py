"""`mobilecal inspect` and `check`: a summary of a recording of any length."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from mobilecal_cli.calibrate import Progress, silent
from mobilecal_cli.calibrate.detect import check_picture, several_sizes, undecodable
from mobilecal_cli.calibrate.extract import (
    OF_MARKERS,
    describe,
    other_size,
    refuse_equal_files,
    size_bytes,
    wrong_chain,
)
from mobilecal_cli.calibrate.gaps import FEWEST_STATIONS
from mobilecal_cli.errors import ConfigError, ObservationError, QualityError, RecordingError, SolveError
from mobilecal_cli.kinematics import cut_at, integrate, unseen_height
from mobilecal_cli.likelihood.constants import table
from mobilecal_cli.likelihood.processes import path_m
from mobilecal_cli.model.arrays import GrayImage, IntArray
from mobilecal_cli.model.calibration import NINE
from mobilecal_cli.model.observations import LogSource, WheelTrack
from mobilecal_cli.model.rig import SIDES, Board, CameraRig, Rig, Sources
from mobilecal_cli.model.signals import (
    CAMERA_INFO_CHANGES,
    BoardView,
    PictureIndex,
    Rejection,
    Signals,
    Station,
    TopicInfo,
    sampled,
)
from mobilecal_cli.readers import (
    Extent,
    Recording,
    clocks_that_differ,
    join_splits,
    open_recording,
    pictures_near,
    read_signals,
    sha256_of,
)
from mobilecal_cli.report.checks import MIN_STATIONS
from mobilecal_cli.report.inspection import Finding, Inspection, JointRange, MotionView, TopicView
from mobilecal_cli.report.motion import Gap, gaps_between
from mobilecal_cli.report.verdict import gates_of
from mobilecal_cli.rig.config import UNCONFIGURED, RigConfig, load_rig, read_urdf
from mobilecal_cli.rig.resolve import Survey, complete_rig
from mobilecal_cli.stations import PAIR_AT_REST_S, plan_stations, wheel_track
from mobilecal_cli.vision import (
    Detection,
    Measured,
    Miss,
    find_board,
    identify_size,
    measure,
    readable_words,
    square_cure,
    square_error,
)

#: Number of moments, evenly spaced, at which an image of either camera is searched for the board.
PICTURE_MOMENTS = 6
#: Difference of the stated squares from the measured ones.
_SQUARE_PERCENT = 1.0
#: The board is at most so many times farther at the stations than in these images.
_FARTHER = 2.0
#: At most so much of a recording is decompressed for the motion.
MOTION_BYTES = 2**28
#: A smaller share of images during which joints and wheels were recorded limits a calibration.
_LEAST_COVERED = 0.9
#: Unit of a joint's range → a larger range is one in degrees or millimeters that was taken for radians or meters.
_LARGEST_RANGE = {"deg": 360.0, "mm": 2e4}


def _gaps(about: str, rig: Rig, gaps: Iterable[Gap], solvable: bool = False) -> Iterator[Finding]:
    """Unobservable parameters: `calibrate` can fix some of them at nominal values, the others prevent it.

    Unless it is `solvable` with them: what is unread of the recording may show them, for example.
    """
    for gap in gaps:
        of_wheels = any("radi" in name or "separation" in name for name in gap.parameters)
        nominal = rig.nominal.wheels if of_wheels else rig.nominal.T_h_reference
        what = f"{', '.join(gap.parameters)}: unobservable: {gap.because}"
        yield Finding.of(about, SolveError(what, gap.cure), prevents=nominal is None and not solvable)


def inspect(
    logs: Sequence[Path], config: RigConfig = UNCONFIGURED, progress: Progress = silent
) -> Inspection:
    """Summary of one recording (in one file or several): contents, what `calibrate` would use, what is missing.

    Only a part of a long recording is read: the first messages of each topic, the index, joints and wheels of at most
    256 MB of the file, and a few images.

    Args:
        logs: parts of one recording.
        config: rig.yaml with the flags that override it.
        progress: receives the progress.

    Raises:
        RecordingError: the recording cannot be opened.
        ConfigError: the URDF that the configuration names cannot be read.
    """
    findings: list[Finding] = []
    notes: list[str] = []
    with open_recording(logs) as recording:
        progress("topics", 0, None)
        times = recording.log_times()
        try:
            gates_of((), config.gates)
        except ConfigError as error:
            findings.append(Finding.of("gates", error))
        rig, survey, board, motion, covered = None, None, None, None, None
        try:
            survey = describe(recording, config)
        except RecordingError as empty:
            findings.append(Finding.of("recording", empty))
        if survey is not None and survey.lacks:
            findings += [Finding.of(part, lack) for part, lack in survey.lacks]
        elif survey is not None:
            rig = complete_rig(survey)
            notes += survey.notes
            progress("motion", 0, None)
            findings += [Finding.of("head chain", each, prevents=False) for each in wrong_chain(survey, rig)]
            findings += _without_priors(rig, config)
            findings += _without_height(rig)
            for note in clocks_that_differ(recording, (*rig.sources.image.values(), *rig.sources.motion)):
                cure = "correct the clock that is wrong, and record again; late messages alone do no harm"
                findings.append(Finding.of("time", RecordingError(note, cure), prevents=False))
            covered = _covered(rig, times, findings)
            motion = _motion(recording, rig, times, findings, notes)
        if survey is not None and survey.sources.image:
            progress("images", 0, None)
            board, of_board = sample_board(recording, survey)
            findings += of_board
        return Inspection(
            name=recording.name,
            containers=recording.containers,
            size_bytes=sum(map(size_bytes, logs)),
            start_ns=recording.start_ns,
            end_ns=recording.end_ns,
            topics=tuple(_topic(recording, info, times.get(info.name)) for info in recording.topics),
            rig=rig,
            survey=survey,
            board=board,
            motion=motion,
            covered=covered,
            findings=tuple(findings),
            notes=(*notes, *recording.damage),
        )


def recordings(logs: Sequence[Path]) -> list[list[Path]]:
    """The recordings that the user's paths are, as `calibrate` groups them; see `join_splits`.

    Paths of which one cannot be opened stay together: reading them says what is wrong.

    Raises:
        ConfigError: two paths have the same content.
    """
    try:
        sizes = list(map(size_bytes, logs))
        equal = [log for log, size in zip(logs, sizes, strict=True) if size and sizes.count(size) > 1]
        refuse_equal_files([LogSource(str(log), sha256_of(log)) for log in equal])
        return join_splits(logs)
    except RecordingError:
        return [list(logs)]


def check(
    config_path: Path,
    logs: Sequence[Path],
    flags: Mapping[str, Any] | None = None,
    progress: Progress = silent,
) -> Inspection:
    """`inspect`, with an invalid configuration and an unreadable recording among the problems found."""
    about = "rig.yaml"
    try:
        config = load_rig(config_path, flags)
        read_urdf(config)
        about = "recording"
        return inspect(logs, config, progress)
    except (ConfigError, RecordingError) as error:
        return Inspection(str(logs[0]), findings=(Finding.of(about, error),))


def _without_height(rig: Rig) -> list[Finding]:
    """The height of a camera that no joint tilts, if it is not stated: no motion of the robot shows it."""
    if unseen_height(rig.chain) is None or rig.nominal.T_h_reference is not None:
        return []
    what = "no joint tilts the camera, so the recording does not show its height, and nominal.head_eye is not stated"
    cure = "set nominal.head_eye in rig.yaml, or calibrate with --fix and the measured height"
    return [Finding.of("head chain", SolveError(what, cure))]


def _without_priors(rig: Rig, config: RigConfig) -> Iterator[Finding]:
    """Parameters that are unobservable in any recording, because too many constants are free."""
    rows = table(rig.cameras, rig.chain)
    known = {row.kind for row in rows if not math.isinf(rig.prior_sigmas.get(row.name, 0.0))}
    free = {row.kind for row in rows} - known
    if config.board.square_m is None:
        free.add("square_size")
    if {"baseline_length", "square_size", "joint_position"} <= free:
        because = (
            "the stereo baseline, the squares of the board and the positions of the head joints are all free"
        )
        gap = Gap(NINE[6:], because, "state how well one of these lengths is known", ())
        yield from _gaps("priors", rig, [gap])
    if {"joint_axis", "joint_zero"} <= free:
        because = "the axes and zero positions of the head joints are all free"
        gap = Gap(NINE[:3], because, "state how well one of the two is known", ())
        yield from _gaps("priors", rig, [gap], solvable=True)  # free ones keep a wide prior, which suffices


def _covered(rig: Rig, times: Mapping[str, IntArray], findings: list[Finding]) -> tuple[int, int] | None:
    """Images of the first camera within the time of all other topics, and of all its images; few of them are a finding.

    Log times of one moment differ by what the messages take to arrive.
    """
    first, *others = rig.sources.image.values()
    images, (name, *other_names) = times.get(first), rig.sources.image
    motion = [times.get(t) for t in (*others, *rig.sources.motion)]
    spans = [(int(t.min()), int(t.max())) for t in motion if t is not None and len(t)]
    if images is None or not len(images) or len(spans) < len(motion):
        return None
    late_ns = round(PAIR_AT_REST_S * 1e9)
    begin, end = max(span[0] for span in spans) - late_ns, min(span[1] for span in spans) + late_ns
    count, total = int(np.sum((images >= begin) & (images <= end))), len(images)
    others_words = "".join(f"{other} images, " for other in other_names)
    cameras_words = {0: "the camera", 1: "both cameras"}.get(len(others), "all cameras")
    if count < _LEAST_COVERED * total:
        error = RecordingError(
            f"{count} of {total} {name} images were recorded while {others_words}joints and wheels were",
            f"record {cameras_words}, joint states and wheels at the same time",
        )
        findings.append(Finding.of("time", error, prevents=not count))
    return count, total


def _topic(recording: Recording, info: TopicInfo, times_ns: IntArray | None) -> TopicView:
    rate_hz = longest_s = since_s = back = None
    if times_ns is not None and len(times_ns):
        back = int(np.sum(np.diff(times_ns) < 0))
        ordered = np.sort(times_ns)
        intervals_s = np.diff(ordered) * 1e-9
        if len(intervals_s):
            usual_s, longest = float(np.median(intervals_s)), int(np.argmax(intervals_s))
            longest_s = float(intervals_s[longest])
            since_s = float(ordered[longest] - (recording.start_ns or 0)) * 1e-9
            rate_hz = 1 / usual_s if usual_s > 0 else None
    return TopicView(info.name, info.type, info.count, rate_hz, longest_s, since_s, back)


def _motion(
    recording: Recording, rig: Rig, times: Mapping[str, IntArray], findings: list[Finding], notes: list[str]
) -> MotionView | None:
    """Motion of the robot; adds what is unobservable from it, and notes."""
    extent = Extent(MOTION_BYTES)
    try:
        logs = read_signals(recording, replace(rig.sources, image={}), extent)
        wheels = [wheel_track(signals.wheels) for signals in logs]
    except RecordingError as error:
        findings.append(Finding.of("motion", error))
        return None
    joints = {}
    for name in rig.chain.joints:
        readings = np.concatenate([signals.joints[name].value for signals in logs])
        scale, unit = (1e3, "mm") if name in rig.chain.prismatic else (180 / np.pi, "deg")
        joints[name] = JointRange(float(readings.min()) * scale, float(readings.max()) * scale, unit)
        low, high = joints[name].low, joints[name].high
        if high - low > _LARGEST_RANGE[unit]:
            like, expected = ("degrees", "radians") if unit == "deg" else ("millimeters", "meters")
            what = (
                f"{name}: range {low:.0f} to {high:.0f} {unit} (limit {_LARGEST_RANGE[unit]:g}); "
                f"the readings look like {like}, and {expected} are expected"
            )
            cure = "set its unit in joints.fields, or correct the driver"
            findings.append(Finding.of("joints", SolveError(what, cure), prevents=False))
    alone = rig.sources.assumed_wheels is not None  # odometry has no wheels
    wheels_deg: dict[str, float] = {
        side: float(sum(np.degrees(np.abs(np.diff(signals.wheels[side].value)).sum()) for signals in logs))
        for side in SIDES
        if not alone
    }
    driven_m = turned_deg = None
    if rig.nominal.wheels is not None:
        steps = [cut_at(track, _seconds(track)) for track in wheels]
        driven_m = float(sum(path_m(each, rig.nominal.wheels).sum() for each in steps))
        turns_rad = [0.0, *(psi for each in steps for psi in integrate(each, rig.nominal.wheels).psi_rad)]
        turned_deg = float(np.degrees(np.ptp(np.cumsum(turns_rad))))
    share = recording.share(rig.sources.motion, extent)
    rests = _rests(rig, logs, wheels, times, share, findings)
    # Gaps between the parts that are read would be noted as irregularities.
    notes += [note for s in logs for note in s.notes if share == 1 or CAMERA_INFO_CHANGES in note]
    return MotionView(joints, wheels_deg, driven_m, turned_deg, rests, share)


def _seconds(wheels: WheelTrack) -> IntArray:
    """Times of the track about a second apart with both ends: shorter steps would count noise as motion."""
    first, last = int(wheels.time_ns[0]), int(wheels.time_ns[-1])
    count = min(max(2, (last - first) // 10**9 + 1), len(wheels.time_ns))
    return np.linspace(first, last, count).astype(np.int64)


def _rests(
    rig: Rig,
    logs: Sequence[Signals],
    wheels: Sequence[WheelTrack],
    times: Mapping[str, IntArray],
    share: float,
    findings: list[Finding],
) -> int | None:
    """Number of rests with images; adds what is unobservable from them, or from all of the motion."""
    images = {name: times.get(topic) for name, topic in rig.sources.image.items()}
    # Where a clock steps, log times do not tell which readings belong to an image.
    if share < 1 or len(logs) > 1 or any(logged is None for logged in images.values()):
        moments = [_seconds(track) for track in wheels]
        readings = [
            sampled([signals.joints[name] for name in rig.chain.joints], at)
            for signals, at in zip(logs, moments, strict=True)
        ]
        gaps = gaps_between(rig.chain, np.concatenate(readings), wheels, moments)
        findings += _gaps("motion", rig, gaps, solvable=share < 1)
        return None
    unique = {side: np.unique(logged) for side, logged in images.items() if logged is not None}
    index = {side: PictureIndex(ns, ns, ns) for side, ns in unique.items()}
    signals = replace(logs[0], images=index, recorded_ns=unique)
    try:
        (plan,), _ = plan_stations([signals], rig.chain)
    except RecordingError as unpaired:
        findings.append(Finding.of("motion", unpaired))
        return None
    if len(plan.stations) < MIN_STATIONS:
        error = ObservationError(
            f"The recording has {len(plan.stations)} possible stations; a calibration needs {FEWEST_STATIONS}, "
            f"and {MIN_STATIONS} to pass.",
            "record at least ten rests of two seconds, and move head and base in between",
        )
        findings.append(Finding.of("motion", error, prevents=len(plan.stations) < FEWEST_STATIONS))
    if plan.stations:
        at = np.array([station.time_ns for station in plan.stations])
        stops = np.stack([station.joints for station in plan.stations])
        findings += _gaps("motion", rig, gaps_between(rig.chain, stops, [plan.wheels], [at]))
    return sum(station.at_rest for station in plan.stations)


def sample_board(recording: Recording, survey: Survey) -> tuple[BoardView | None, list[Finding]]:
    """The board in a few images (None if no image can be read), and what is wrong with it.

    Args:
        survey: of a recording whose image topics are known; the board's size is found in the images if its
            configuration does not state it.
    """
    cameras, stated, square_m = survey.cameras, survey.config.board.stated, survey.config.board.square_m
    samples = _sampled(recording, survey)
    readable = [image for some in samples.values() for image in some if not isinstance(image, Rejection)]
    if not readable:
        broken = [image for some in samples.values() for image in some if isinstance(image, Rejection)]
        none = RecordingError("the recording contains no image", "record the cameras' images")
        return None, [Finding.of("cameras", undecodable(broken) if broken else none)] if samples else []
    findings = [] if cameras is None else list(_wrong_pictures(samples, cameras))
    board, others, wrong = _shown(readable, stated)
    findings += [Finding.of("board", error) for error in wrong]
    if board is None:
        if not wrong:
            findings.append(Finding.of("board", _no_board(survey, len(readable))))
        return BoardView(len(readable), 0, None, other_sizes=others), findings
    detections = {
        name: [None if isinstance(image, Rejection) else find_board(image, board) for image in some]
        for name, some in samples.items()
    }
    detected = sum(isinstance(each, Detection) for of_camera in detections.values() for each in of_camera)
    pairs = () if cameras is None or findings else _stereo_pairs(cameras, board, detections)
    squares_m = tuple(pair.square_m for pair in pairs)
    findings += _wrong_square(square_m, pairs) if square_m and pairs else []
    size = board.columns, board.rows
    return BoardView(len(readable), detected, size, squares_m, square_m, others), findings


def _sampled(recording: Recording, survey: Survey) -> dict[str, list[GrayImage | Rejection]]:
    """A few images of each camera, spread over the recording; nothing of one without messages."""
    start, end, images = recording.start_ns, recording.end_ns, survey.sources.image
    if start is None or end is None:
        return {}
    moments = np.linspace(start, end, PICTURE_MOMENTS + 2)[1:-1].astype(np.int64).tolist()
    samples: dict[str, list[GrayImage | Rejection]] = {name: [] for name in images}
    sources = Sources(images, {}, {}, {}, layout=survey.config.cameras.layout)
    for name, picture in pictures_near(recording, sources, moments):
        samples[name].append(picture)
    return samples


def _wrong_pictures(
    samples: Mapping[str, Sequence[GrayImage | Rejection]], cameras: CameraRig
) -> Iterator[Finding]:
    """Images of another size than their camera infos state."""
    for name, some in samples.items():
        first = next((image for image in some if not isinstance(image, Rejection)), None)
        try:
            if first is not None:
                check_picture(first, name, cameras)
        except RecordingError as wrong_size:
            yield Finding.of("camera infos", wrong_size)


def _shown(
    readable: Sequence[GrayImage], stated: Board | None
) -> tuple[Board | None, int, list[ObservationError]]:
    """The stated board if an image shows it, or the one that most images show; images of others; what is wrong."""
    if stated is not None and any(isinstance(find_board(image, stated), Detection) for image in readable):
        return stated, 0, []
    vote = identify_size(readable)
    columns, rows = vote.size or (0, 0)
    # A grid that is no larger may be this board, cut off by the image.
    others = vote.beside + sum(n for size, n in vote.votes.items() if size[0] > columns or size[1] > rows)
    if vote.size is None:
        return None, others, [several_sizes(vote)] if vote.votes else []
    wrong = []
    if stated is not None and stated.markers is not None:
        unread = ObservationError(
            f"none of {len(readable)} images shows the markers of the stated {stated.markers.kind} board, but a "
            f"checkerboard of {columns} x {rows} inner corners",
            "correct board.dictionary in rig.yaml, or leave out board.kind if the board has no markers",
        )
        wrong.append(unread)
    elif stated is not None and {columns, rows} != {stated.columns, stated.rows}:
        wrong.append(other_size(stated, vote.size))
    return Board(columns, rows), others, wrong


def _no_board(survey: Survey, images: int) -> ObservationError:
    """The error for images that show no board."""
    stated = survey.config.board.stated
    plain = stated is None or stated.markers is None
    where = "an image" if survey.cameras is None else survey.cameras.images_words
    where = "both images" if len(survey.sources.image) == 2 else where
    cure = f"keep the whole board in {where}, in good light, with {readable_words(stated)}"
    return ObservationError(
        f"{'a whole checkerboard' if plain else 'the configured board'} is in none of {images} images spread over the "
        "recording",
        f"{cure}; {OF_MARKERS}" if stated is None else cure,
    )


def _wrong_square(stated_m: float, pairs: Sequence[Measured]) -> list[Finding]:
    """A stated size of the squares that `calibrate` refuses, or that several stereo pairs do not confirm."""
    squares_m = [pair.square_m for pair in pairs]
    mean, refused = float(np.mean(squares_m)), square_error(stated_m, pairs, _FARTHER)
    if refused is not None:
        return [Finding.of("square size", refused)]
    noise = float(np.std(squares_m, ddof=1)) / math.sqrt(len(squares_m)) if len(squares_m) > 1 else math.inf
    if abs(mean - stated_m) <= max(_SQUARE_PERCENT / 100 * stated_m, 3 * noise):
        return []
    what = f"the squares measure {mean * 1e3:.2f} mm in {len(squares_m)} stereo pairs, {stated_m * 1e3:.2f} mm are "
    what += f"stated (limit {_SQUARE_PERCENT:g} %)"
    if square_error(stated_m, pairs, 1 / _FARTHER) is not None:
        what += "; whether a calibration stops at this depends on the board's distance at its stations, not known yet"
    return [Finding("square size", "limit", what, square_cure(stated_m, mean), QualityError.exit_code)]


def _stereo_pairs(
    cameras: CameraRig, board: Board, detections: Mapping[str, Sequence[Detection | Miss | None]]
) -> tuple[Measured, ...]:
    """The board in each stereo pair that shows it."""
    if not cameras.calibrated or len(detections["left"]) != len(detections["right"]):
        return ()  # the images cannot be paired without their stamps
    pairs = []
    station = Station(0, True, (), 0, np.zeros(0), np.zeros(0))
    for left, right in zip(detections["left"], detections["right"], strict=True):
        if isinstance(left, Detection) and isinstance(right, Detection):
            measured = measure(station, [[left, right]], cameras, board)
            if isinstance(measured, Measured) and measured.points is not None:
                pairs.append(measured)
    return tuple(pairs)
