"""Extraction of observations from recordings: the slow part, and the only one that decodes images."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from mobilecal_cli.calibrate import Progress, silent
from mobilecal_cli.calibrate.detect import (
    StationDetections,
    board_size,
    detect_all,
    first_pairs,
    plan_recording,
    undecodable,
)
from mobilecal_cli.calibrate.gaps import FEWEST_STATIONS, causes_noted, clocks_noted
from mobilecal_cli.errors import ConfigError, MobilecalError, ObservationError, RecordingError, SolveError
from mobilecal_cli.export.extraction import THUMBNAILS
from mobilecal_cli.kinematics import head_pose
from mobilecal_cli.model.observations import Corners, Extraction, LogSource, Observation, Snapshot
from mobilecal_cli.model.rig import Board, Rig
from mobilecal_cli.model.signals import (
    CAMERA_INFO,
    CAMERA_INFO_CHANGES,
    CHAIN_ENDS,
    IMAGES,
    JOINT_STATE,
    ODOMETRY,
    STRING,
    TRANSFORMS,
    UNUSED,
    Rejection,
    RobotDescription,
    Track,
)
from mobilecal_cli.model.text import capitalized, listed
from mobilecal_cli.readers import (
    Recording,
    choose_topics,
    join_splits,
    joint_numbers,
    never_changing,
    number_fields,
    open_recording,
    pose_numbers,
    read_description,
    sha256_of,
)
from mobilecal_cli.rig.config import RigConfig
from mobilecal_cli.rig.head import outside_chain
from mobilecal_cli.rig.names import joint_state_names, may_be_a_reading, without_joints
from mobilecal_cli.rig.resolve import Part, Survey, complete_rig, survey_rig
from mobilecal_cli.rig.wheels import may_have_wheels, needs_numbers, wheel_joints
from mobilecal_cli.stations import Plan, spread
from mobilecal_cli.vision import (
    Detection,
    Measured,
    agreeing,
    check_arrangement,
    check_square,
    readable_words,
    resolve_numbering,
    resolve_square,
)

#: Types that are read by their meaning, not by field paths.
_KNOWN = {*IMAGES, CAMERA_INFO, JOINT_STATE, ODOMETRY, STRING, TRANSFORMS}
#: What to do for a board that is no checkerboard, where none is configured.
OF_MARKERS = "for a board with markers, set board.kind in rig.yaml to charuco or aprilgrid"


def describe(
    recording: Recording, config: RigConfig, joints_too: bool = False, earlier: RobotDescription | None = None
) -> Survey:
    """What the description of a recording and a configuration determine.

    Numbers in other messages are read only if no wheel is known without them. Wheels that never move in the joint
    states, as those of a `joint_state_publisher`, are passed over if anything else may be the wheels.

    Args:
        joints_too: read these numbers also where anything else is unknown, as candidates for head joints.
        earlier: of another recording of the robot, whose URDF is used if this one contains none, and whose wheels are
            those of this one.

    Raises:
        RecordingError: the recording is empty.
        ConfigError: the URDF that the configuration names cannot be read.
    """
    description = read_description(recording)
    if earlier is not None and not description.urdfs and earlier.urdfs:
        description = replace(description, urdfs=earlier.urdfs)
        recording.note("the recording contains no URDF; that of an earlier one is used")
    unread, others = _without_unmoved(recording, config, description, earlier)
    survey = _survey(recording, config, others, joints_too)
    if unread and not may_have_wheels(survey.description):
        survey = _survey(recording, config, description, joints_too)
    elif unread:
        because = "because they never move" if earlier is None else "as in the first recording"
        recording.note(f"Joints {listed(sorted(unread))}: not read as wheels, {because}.")
    return _with_topics(recording, survey) if survey.shared else survey


def _without_unmoved(
    recording: Recording, config: RigConfig, description: RobotDescription, earlier: RobotDescription | None
) -> tuple[set[str], RobotDescription]:
    """Wheel joints that are not read, and the description without these.

    They never move; then odometry that never moves, either, is left out, too. Further recordings have the wheels of the
    first one.
    """
    sets = wheel_joints(config, description)
    if earlier is not None:
        unread = set[str]().union(*sets).difference(joint_state_names(earlier))
        return unread, without_joints(description, unread)
    topics = [topic for topic, names in description.joint_names.items() if names]
    still = never_changing(recording, topics, set().union(*sets), joint_numbers)
    unread = set[str]().union(*(joints for joints in sets if joints <= still))
    if not unread:
        return unread, description
    odometry = [topic.name for topic in description.topics if topic.type == ODOMETRY]
    still = never_changing(recording, odometry, odometry, pose_numbers)
    moving = tuple(topic for topic in description.topics if topic.name not in still)
    return unread, replace(without_joints(description, unread), topics=moving)


def _survey(
    recording: Recording, config: RigConfig, description: RobotDescription, joints_too: bool
) -> Survey:
    """See `describe`."""
    survey = None if needs_numbers(config, description) else survey_rig(config, description)
    if survey is None or (joints_too and survey.lacks):
        others = [topic.name for topic in description.topics if topic.type not in _KNOWN]
        description = replace(description, numbers=number_fields(recording, others, may_be_a_reading))
        survey = survey_rig(config, description)
    return survey


def _with_topics(recording: Recording, survey: Survey) -> Survey:
    """A survey with each joint of the rig on the one topic that says most of it; its lacks tell where two differ."""
    config, description, wheels = survey.config, survey.description, survey.wheel_joints
    chosen, problems = choose_topics(recording, survey.shared, wheels & {*survey.shared})
    joint_names = {
        topic: tuple(name for name in names if chosen.get(name, topic) == topic)
        for topic, names in description.joint_names.items()
    }
    survey = survey_rig(config, replace(description, joint_names=joint_names))
    errors: dict[Part, RecordingError] = {}
    for name, error in problems.items():
        errors.setdefault("wheels" if name in wheels else "joints", error)
    survey.lacks += errors.items()
    if "wheels" in errors:
        survey.sources = replace(survey.sources, wheels={})
    return survey


def wrong_chain(survey: Survey, rig: Rig) -> Iterator[SolveError]:
    """Joints that the head chain probably has twice, or not at all; those that the URDF shows have a note."""
    links = Counter(link.joint for link in survey.config.head.chain or () if link.joint)
    for name in (name for name, count in links.items() if count > 1):
        yield SolveError(
            f"joint {name!r} is in head.chain {links[name]} times",
            "delete the repeated link, unless the mechanism moves both by the same reading",
        )
    outside = [
        repr(name)
        for name in outside_chain(rig.chain, survey.description)
        if not any(f"Joint {name} " in note and CHAIN_ENDS in note for note in survey.notes)
    ]
    if outside:
        ends = f"from {rig.chain.base_frame} to {rig.chain.head_frame}"
        yield SolveError(
            f"{listed(outside)}: recorded, but not in the head chain {ends}",  # CHAIN_LACKS
            "set head.head_frame to the link that carries the cameras, or add to head.chain what moves them",
        )


#: Relative difference of camera infos that is rounding.
_SAME_INFO = 1e-6


@dataclass(frozen=True, slots=True, eq=False)
class ExtractedLog:
    """Data extracted from one log: a recording, or a piece of it between steps of its clocks."""

    name: str
    description: RobotDescription
    rig: Rig
    board: Board
    plan: Plan
    detections: Sequence[StationDetections]
    measured: Sequence[Measured | Rejection]
    notes: tuple[str, ...]


def _extracted(
    earlier: Sequence[ExtractedLog], recording: Recording, config: RigConfig, progress: Progress, jobs: int
) -> list[ExtractedLog]:
    """The data of one recording: one log, or one for each piece between steps of its clocks."""
    progress("reading", 0, None)
    survey = describe(recording, config, earlier=earlier[0].description if earlier else None)
    with causes_noted(note for part in recording.parts for note in list(part.damage)[:1]):
        rig = complete_rig(survey)
    plans, signals, plan_notes = plan_recording(recording, rig, config.stations == "all")
    if signals.infos or signals.ahead_m:
        infos = {**survey.description.infos, **signals.infos}
        description = replace(survey.description, infos=infos, odometry_ahead_m=signals.ahead_m)
        survey = survey_rig(config, description)
        rig = complete_rig(survey)
    name = str(recording.paths[0])
    board = earlier[-1].board if earlier else config.board.stated
    with clocks_noted(plan_notes):
        for log in earlier:
            _refuse_other_robot(log, name, rig)
            for plan in plans:
                refuse_same_signals(log.name, log.plan.tracks, name, plan.tracks)
        if board is None:
            progress("finding the board's size", 0, None)
            size = board_size(recording, rig, plans)
            if size is None:
                raise ObservationError(
                    f"no checkerboard found in the images of {sum(len(plan.stations) for plan in plans)} stations",
                    f"keep the whole board in {rig.cameras.images_words}, in good light, with {readable_words(None)}, "
                    f"or set the number of its inner corners with --board, such as --board 9x6; {OF_MARKERS}",
                )
            board = Board(*size, config.board.square_m)
        detected = detect_all(recording, rig, board, plans, config.stations != "all", jobs, progress)
        stations = [station for detections in detected for station in detections]
        for camera, topic in rig.sources.image.items():
            lost = [r for each in stations for r in each.rejections if r.detail.startswith(f"{topic}: ")]
            if lost and not any(name == camera for each in stations for name, _ in each.found):
                raise undecodable(lost)
            if lost:
                count = len({rejection.time_ns for rejection in lost})
                recording.note(f"{count} images cannot be decoded, such as one on {lost[0].detail}")
        any_board = any(isinstance(d, Detection) for each in stations for d in each.found.values())
        if not any_board and board.markers is None:
            size = board_size(recording, rig, plans)
            if size is not None and set(size) != {board.columns, board.rows}:
                raise other_board(earlier[0].name, name, board, size) if earlier else other_size(board, size)
        wrong = (f"{capitalized(e.message)}. {capitalized(e.hint)}." for e in wrong_chain(survey, rig))
        notes = (*survey.notes, *wrong, *plan_notes, *recording.damage)
        notes_of_cameras = _other_cameras(earlier[0], name, rig) if earlier else ()
        logs = []
        for plan, detections in zip(plans, detected, strict=True):
            measured = [each.measured for each in detections]
            check_arrangement(measured, first_pairs(detections, rig.cameras), rig.cameras, board)
            measured, misfit = agreeing(measured)
            if board.square_m is not None:
                check_square(measured, board.square_m)
            unused = not any(isinstance(each, Measured) for each in measured)
            # Beside other recordings, nothing else says so.
            nothing = (f"{name}: {UNUSED}, as no station shows the board",) if unused else ()
            every_note = (*notes, *misfit, *notes_of_cameras, *nothing)
            logs.append(
                ExtractedLog(name, survey.description, rig, board, plan, detections, measured, every_note)
            )
    return logs


def other_size(board: Board, size: tuple[int, int]) -> ObservationError:
    """The error for a configured board that is not the one in the images, or is only in part."""
    part = all(np.less_equal(sorted(size), sorted((board.columns, board.rows))))
    uncover = "uncover the whole board, without bright reflections; or " if part else ""
    return ObservationError(
        f"the configured board has {board.columns} x {board.rows} inner corners, but the images show "
        f"{size[0]} x {size[1]}",
        f"{uncover}set the board size with --board {size[0]}x{size[1]}, or board.columns and board.rows in rig.yaml",
    )


def other_board(first: str, name: str, board: Board, size: tuple[int, int]) -> ObservationError:
    """The error for a recording that shows another board than the first one."""
    return ObservationError(
        f"the recordings show different boards: {first} one of {board.columns} x {board.rows} inner corners, "
        f"{name} one of {size[0]} x {size[1]}",
        "calibrate recordings of different boards separately",
    )


def extract(
    logs: Sequence[Path], config: RigConfig, progress: Progress = silent, jobs: int = 1
) -> tuple[Extraction, tuple[Snapshot, ...]]:
    """Read recordings of one robot and detect the board in their images.

    Files that follow one another in time form one recording; other files are separate recordings. No leg
    connects stations of two recordings.

    Raises:
        MobilecalError: see `errors`.
    """
    extracted: list[ExtractedLog] = []
    recordings = join_splits(logs)
    paths = [path for parts in recordings for path in parts]
    sources = [LogSource(str(path), sha256_of(path)) for path in paths]
    refuse_equal_files(sources)
    for parts in recordings:
        with _named(parts[0], several=len(recordings) > 1), open_recording(parts) as recording:
            extracted += _extracted(extracted, recording, config, progress, jobs)
    extraction = _assembled(extracted, sources)
    refuse_equal_recordings(extraction, [log.name for log in extracted])
    snapshots = [
        Snapshot(number, detected.station.index, detected.pictures, detected.thumbnail)
        for number, log in enumerate(extracted)
        for detected in log.detections
    ]
    return extraction, _bounded(snapshots, extraction)


def _bounded(snapshots: Sequence[Snapshot], extraction: Extraction) -> tuple[Snapshot, ...]:
    """The snapshots with some of their thumbnails: up to half are of rejected stations, evenly spread over time."""
    used = {(o.log, o.station) for o in extraction.observations}
    places = [s for s, each in enumerate(snapshots) if each.thumbnail]
    rejected = [s for s in places if (snapshots[s].log, snapshots[s].station) not in used]
    others = [s for s in places if s not in set(rejected)]
    few = spread(rejected, THUMBNAILS // 2)
    kept = {*few, *spread(others, THUMBNAILS - len(few))}
    bounded = (each if s in kept else replace(each, thumbnail=b"") for s, each in enumerate(snapshots))
    return tuple(each for each in bounded if each.jpegs or each.thumbnail)


@contextmanager
def _named(path: Path, *, several: bool) -> Iterator[None]:
    """Name the recording in an error, where there are several."""
    try:
        yield
    except MobilecalError as error:
        if not several or str(path) in error.message:
            raise
        raise type(error)(f"{path}: {error.message}", error.hint) from error


def _refuse_other_robot(first: ExtractedLog, name: str, rig: Rig) -> None:
    """Refuse a recording, of this name, with other head joints or cameras than the first one."""
    same = "give recordings with the same cameras, or name the cameras that all have in rig.yaml"
    for what, own, others, cure in (
        ("head joints", rig.chain.joints, first.rig.chain.joints, "give recordings of one robot only"),
        ("cameras", rig.cameras.names, first.rig.cameras.names, same),
    ):
        if own != others:
            have, had = (", ".join(names) or "none" for names in (own, others))
            raise ConfigError(f"{what} of {name}: {have}; of {first.name}: {had}", cure)


def _other_cameras(first: ExtractedLog, name: str, rig: Rig) -> tuple[str, ...]:
    """A note if the camera infos of a recording, of this name, differ from those of the first one beyond rounding."""
    a, b = first.rig.cameras, rig.cameras
    pairs = [
        (getattr(x, name), getattr(y, name)) for x, y in zip(a.each, b.each, strict=True) for name in "KD"
    ]
    pairs += zip(a.T_c_each[1:], b.T_c_each[1:], strict=True)
    if all(x.shape == y.shape and np.allclose(x, y, rtol=_SAME_INFO, atol=_SAME_INFO) for x, y in pairs):
        return ()
    return (
        f"{name}: {CAMERA_INFO_CHANGES} from that of {first.name}, which the estimate takes for all recordings",
    )


def _assembled(logs: Sequence[ExtractedLog], sources: Sequence[LogSource]) -> Extraction:
    board, rig = logs[0].board, logs[0].rig
    square_m = board.square_m
    if square_m is None:
        # All stations share one board: use the median of their square sizes, which the stereo baseline determines.
        measured = (m for log in logs for m in log.measured if isinstance(m, Measured))
        sides = [m.square_m for m in measured if m.points is not None]
        square_m = float(np.median(sides)) if len(sides) >= FEWEST_STATIONS else None
    observations: list[Observation] = []
    rejections: list[Rejection] = []
    for number, log in enumerate(logs):
        squared = [
            resolve_square(m, square_m, number) if isinstance(m, Measured) else m for m in log.measured
        ]
        observations += [item for item in squared if isinstance(item, Observation)]
        lost = (rejection for detections in log.detections for rejection in detections.rejections)
        missed = (item for item in squared if isinstance(item, Rejection))
        rejections += [replace(r, log=number) for r in (*log.plan.rejections, *lost, *missed)]
    if observations:
        R_v_h = head_pose(rig.chain, np.stack([o.joints for o in observations]))[:, :3, :3]
        numbered, unresolved = resolve_numbering(observations, R_v_h, board)
        observations, rejections = list(numbered), [*rejections, *unresolved]
    counts = {
        "stations": sum(len(log.plan.stations) for log in logs),
        "stations_at_rest": sum(s.at_rest for log in logs for s in log.plan.stations),
        "pictures": sum(len(station.found) for log in logs for station in log.detections),
        "observations": len(observations),
    }
    return Extraction(
        rig=rig,
        board=board,
        observations=tuple(observations),
        wheels=tuple(log.plan.wheels for log in logs),
        rejections=tuple(rejections),
        notes=_notes(logs),
        logs=tuple(sources),
        counts=counts,
        joint_tracks=tuple(log.plan.joints for log in logs),
    )


def _notes(logs: Sequence[ExtractedLog]) -> tuple[str, ...]:
    """Notes on all recordings; one that does not hold for all of them names its own."""

    def named(log: ExtractedLog, note: str) -> str:
        everywhere = all(note in other.notes for other in logs if other.name != log.name)
        return note if everywhere or log.name in note else f"{log.name}: {note}"

    return tuple(dict.fromkeys(named(log, note) for log in logs for note in log.notes))


_SAME_SHARE = 0.9  # of the readings while both were recorded
_LEAST_OVERLAP = 0.05  # of the shorter recording
_SAME_VALUE = 1e-9  # rad, m or px
_HINT = "give each recording once, in one container: repeated data make the standard deviations too small"


def size_bytes(log: Path) -> int:
    """Size of a recording, a file or a directory; 0 if it does not exist."""
    files = log.rglob("*") if log.is_dir() else [log]
    return sum(path.stat().st_size for path in files if path.is_file())


def refuse_equal_files(logs: Sequence[LogSource]) -> None:
    """Refuse files of equal content, whatever their names.

    Raises:
        ConfigError: naming both files.
    """
    first: dict[str, str] = {}
    for log in logs:
        if first.get(log.sha256) == log.path:
            raise ConfigError(f"{log.path} is given twice", _HINT)
        if log.sha256 in first:
            raise ConfigError(f"{first[log.sha256]} and {log.path} have the same content", _HINT)
        first[log.sha256] = log.path


def refuse_equal_recordings(extraction: Extraction, names: Sequence[str]) -> None:
    """Refuse recordings with the same readings or images, such as one recording in two containers.

    Raises:
        ConfigError: naming both recordings.
    """
    joints = extraction.joint_tracks or ((),) * len(extraction.wheels)
    tracks = [
        (wheels.right, wheels.left, *own) for wheels, own in zip(extraction.wheels, joints, strict=True)
    ]
    by_log = [[o for o in extraction.observations if o.log == log] for log in range(len(tracks))]
    for i, j in itertools.combinations(range(len(tracks)), 2):
        refuse_same_signals(names[i], tracks[i], names[j], tracks[j])
        at = {o.time_ns: o.views for o in by_log[i]}
        pairs = [(at[o.time_ns], o.views) for o in by_log[j] if o.time_ns in at]
        same = sum(len(a) == len(b) and all(map(_same_corners, a, b)) for a, b in pairs)
        if same > 1:  # simulations of one seed begin with the same image
            raise _same_recording(names[i], names[j], "images")


def refuse_same_signals(first: str, tracks: Sequence[Track], other: str, others: Sequence[Track]) -> None:
    """Refuse recordings of which all readings of both wheels and all joints are the same while both were recorded.

    Raises:
        ConfigError: naming both recordings.
    """
    if all(_same_readings(a, b) for a, b in zip(tracks, others, strict=False)):
        raise _same_recording(first, other, "wheel and joint readings")


def _same_recording(first: str, other: str, what: str) -> ConfigError:
    return ConfigError(f"{first} and {other} are the same recording: they contain the same {what}", _HINT)


def _same_readings(first: Track, other: Track) -> bool:
    """Whether two tracks overlap and are the same there; unwrapped rotations may start elsewhere."""
    stamps, i, j = np.intersect1d(first.time_ns, other.time_ns, return_indices=True)
    shorter = min(len(first.time_ns), len(other.time_ns))
    if not len(stamps) or len(stamps) < _LEAST_OVERLAP * shorter:
        return False
    begin, end = max(first.time_ns[0], other.time_ns[0]), min(first.time_ns[-1], other.time_ns[-1])
    overlap = min(int(np.sum((track.time_ns >= begin) & (track.time_ns <= end))) for track in (first, other))
    differences = first.value[i] - other.value[j]
    same = np.abs(differences - np.median(differences)) < _SAME_VALUE
    return int(same.sum()) >= _SAME_SHARE * overlap


def _same_corners(first: Corners, other: Corners) -> bool:
    a, b = first.pixels, other.pixels
    return a.shape == b.shape and bool(np.abs(a - b).max(initial=0.0) < _SAME_VALUE)
