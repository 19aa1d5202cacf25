"""The stations of a recording; board detection and measurement at them, in segments that limit the images in memory."""

from __future__ import annotations

import itertools
import math
from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from functools import cache
from itertools import islice
from pathlib import Path

import cv2
import numpy as np

from mobilecal_cli.calibrate import Progress, silent
from mobilecal_cli.calibrate.gaps import clocks_noted
from mobilecal_cli.calibrate.workers import FAILED, answer, processes, resources
from mobilecal_cli.errors import ObservationError, RecordingError
from mobilecal_cli.model.arrays import GrayImage
from mobilecal_cli.model.rig import Board, CameraRig, Rig
from mobilecal_cli.model.signals import DEPTH_IMAGE, PictureIndex, Rejection, Signals, Station
from mobilecal_cli.model.text import listed
from mobilecal_cli.readers import Recording, open_recording, read_images, read_signals
from mobilecal_cli.stations import Plan, images_of, plan_stations, spread
from mobilecal_cli.vision import BoardFollower, Detection, Measured, Miss, SizeVote, identify_size, measure

SNAPSHOTS = 60  # images kept for the report, limited to save memory
_QUALITY = 85  # of their JPEGs
_ACROSS_PX, _SMALL_QUALITY = 96, 60  # of a thumbnail
#: Stations, spread over the recording, whose images tell the board's size: a few if they agree, otherwise more. Another
#: board may be in view at some of them.
SIZE_STATIONS = (3, 24)
SIZE_VOTES = 3  # number of agreeing images that determine the board's size
#: Shots per segment. Tracking runs inside a segment, so segments and results do not depend on the
#: number of processes.
SEGMENT_SHOTS = 250


def snapshot_jpeg(image: GrayImage) -> bytes:
    """JPEG data of a (height, width) gray image."""
    return bytes(cv2.imencode(".jpg", np.ascontiguousarray(image), [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1])


def thumbnail_jpeg(image: GrayImage) -> bytes:
    """JPEG data of a (height, width) gray image, scaled down to 96 pixels across."""
    height = max(1, round(image.shape[0] * _ACROSS_PX / image.shape[1]))
    small = cv2.resize(np.ascontiguousarray(image), (_ACROSS_PX, height), interpolation=cv2.INTER_AREA)
    return bytes(cv2.imencode(".jpg", small, [cv2.IMWRITE_JPEG_QUALITY, _SMALL_QUALITY])[1])


@dataclass(slots=True)
class StationDetections:
    """The board at one station, filled in while its images are read.

    Attributes:
        station: its shots.
        thumbnails: camera → small JPEG of the first image; empty without one.
        found: camera and time of an image (never None) → detection or miss.
        pictures: camera → JPEG of the first image, for the report.
        rejections: images that cannot be decoded.
        measured: the board, or why it cannot be measured; of the detections of all images.
    """

    station: Station
    thumbnails: dict[str, bytes]
    found: dict[tuple[str, int | None], Detection | Miss] = field(default_factory=dict)
    pictures: dict[str, bytes] = field(default_factory=dict)
    rejections: list[Rejection] = field(default_factory=list)
    measured: Measured | Rejection = field(init=False)

    def of_shots(self, rig: CameraRig) -> list[list[Detection | Miss | None]]:
        """Results of each camera for the shots with decoded images; None for an image that is missing."""
        times_ns = (shot.times_ns for shot in self.station.shots)
        each = [[self.found.get(image) for image in zip(rig.names, ns, strict=True)] for ns in times_ns]
        return [shot for shot in each if any(item is not None for item in shot)]

    @property
    def thumbnail(self) -> bytes:
        """The small image of the first camera that missed the board, otherwise of the first one; empty for none."""
        missed = {name for (name, _), found in self.found.items() if isinstance(found, Miss)}
        best = min(self.thumbnails, key=lambda name: (not self.thumbnails[name], name not in missed))
        return self.thumbnails[best]


@dataclass(frozen=True, slots=True)
class Segment:
    """Consecutive stations that are processed together.

    Attributes:
        stations: in order of time.
        images: camera → their images.
        shown: indices of stations with images in the report.
        thorough: see `vision.detect`.
    """

    stations: tuple[Station, ...]
    images: Mapping[str, PictureIndex]
    shown: frozenset[int]
    thorough: bool


def plan_recording(
    recording: Recording, rig: Rig, everything: bool = False
) -> tuple[tuple[Plan, ...], Signals, tuple[str, ...]]:
    """Choose the stations of a recording by one pass over joints, wheels and times of images.

    `everything` as for `plan_stations`.

    Returns:
        The stations of each log (one, or one for each piece between steps of the recording's clocks), the signals of
        the first, and notes on irregularities.

    Raises:
        RecordingError: see `read_signals` and `plan_stations`.
    """
    logs = read_signals(recording, rig.sources)
    with clocks_noted(logs[0].notes):
        plans, notes = plan_stations(logs, rig.chain, everything)
    every_note = itertools.chain(*(signals.notes for signals in logs), notes)
    return plans, logs[0], tuple(dict.fromkeys(every_note))


def check_picture(picture: GrayImage, name: str, cameras: CameraRig) -> None:
    """Check that an image has the size stated in its camera_info.

    Raises:
        RecordingError: the sizes differ.
    """
    camera = cameras.each[cameras.names.index(name)]
    height, width = picture.shape
    if (width, height) != (camera.width, camera.height):
        cure = "calibrate the cameras at the recorded size, or set binning and roi in camera_info"
        if camera.width > width and camera.width * height == camera.height * width:
            times = f"{camera.width / width:.3g}"
            cure = (
                f"the camera_info is that of images {times} times as large: record the one of this size, or set "
                f"binning_x and binning_y to {times} in it, if the images were scaled down"
            )
        raise RecordingError(
            f"the {name} images are {width} x {height} pixels, but their camera_info states "
            f"{camera.width} x {camera.height}",
            cure,
        )


def first_images(
    recording: Recording, rig: Rig, plan: Plan, stations: Sequence[Station]
) -> Iterator[tuple[str, int, GrayImage | Rejection]]:
    """Camera, time and image of the first shot of some stations of a plan."""
    firsts = [replace(station, shots=station.shots[:1]) for station in stations]
    return read_images(recording, rig.sources, images_of(firsts, plan.images))


def board_size(recording: Recording, rig: Rig, plans: Sequence[Plan]) -> tuple[int, int] | None:
    """Inner corners (columns, rows) of the board in some images, None if none shows it.

    Raises:
        RecordingError: none of them can be decoded, or one has another size than stated.
        ObservationError: they show boards of several sizes, none of them in most.
    """
    rejections: list[Rejection] = []
    count = sum(len(plan.stations) for plan in plans)

    def pictures(most: int) -> Iterator[GrayImage]:
        chosen = set(spread(range(count), most))
        numbers = itertools.count()
        for plan in plans:
            wanted = [station for station in plan.stations if next(numbers) in chosen]
            for name, _, picture in first_images(recording, rig, plan, wanted):
                if isinstance(picture, Rejection):
                    rejections.append(picture)
                else:
                    check_picture(picture, name, rig.cameras)
                    yield picture

    for most in SIZE_STATIONS:
        vote = identify_size(pictures(most))
        if len(vote.votes) == 1 and vote.votes.total() >= SIZE_VOTES:
            break
    if not vote.pictures and rejections:
        raise undecodable(rejections)
    if vote.size is None and vote.votes:
        raise several_sizes(vote)
    return vote.size


def several_sizes(vote: SizeVote) -> ObservationError:
    """The error for images that show boards of several sizes, none of them in most."""
    ranked = sorted(vote.votes.items(), key=lambda counted: (-counted[1], counted[0]))
    sizes = [(f"{columns}x{rows}", votes) for (columns, rows), votes in ranked]
    return ObservationError(
        f"the images show boards of several sizes: {listed(f'{size} in {n} images' for size, n in sizes)}",
        f"state the inner corners of the calibration board: --board {' or --board '.join(s for s, _ in sizes[:2])}",
    )


def undecodable(rejections: Sequence[Rejection]) -> RecordingError:
    """The error for images of which none can be decoded."""
    cure = "record JPEG or PNG images, or raw ones (sensor_msgs/Image)"
    if DEPTH_IMAGE in rejections[0].detail:
        cure = "set cameras in rig.yaml to the topics of the gray or color images"
    return RecordingError(f"none of {len(rejections)} images can be decoded: {rejections[0].detail}", cure)


def segments_of(plan: Plan, thorough: bool) -> list[Segment]:
    """Split the stations of a log into segments, and choose the images kept for the report."""
    stations = plan.stations
    shown = frozenset(station.index for station in stations[:: math.ceil(len(stations) / SNAPSHOTS) or 1])
    parts: list[list[Station]] = [[]]
    for station in stations:
        if parts[-1] and sum(len(each.shots) for each in (*parts[-1], station)) > SEGMENT_SHOTS:
            parts.append([])
        parts[-1].append(station)
    return [Segment(tuple(part), images_of(part, plan.images), shown, thorough) for part in parts]


def detect_segment(
    recording: Recording, rig: Rig, board: Board, segment: Segment, count: Callable[[int], object] = int
) -> list[StationDetections]:
    """The board at each station of a segment, in one pass over its part of the recording.

    `count` receives 1 after each image.
    """
    names = rig.cameras.names
    detections = [StationDetections(station, dict.fromkeys(names, b"")) for station in segment.stations]
    where = {
        image: place
        for place in detections
        for shot in place.station.shots
        for image in zip(names, shot.times_ns, strict=True)
    }
    followers = {name: BoardFollower(board, segment.thorough) for name in names}
    for name, stamp, picture in read_images(recording, rig.sources, segment.images):
        place = where[name, stamp]
        if isinstance(picture, Rejection):
            place.rejections.append(picture)
            continue
        check_picture(picture, name, rig.cameras)
        if place.station.index in segment.shown and name not in place.pictures:
            place.pictures[name] = snapshot_jpeg(picture)
        if not place.thumbnails[name]:
            place.thumbnails[name] = thumbnail_jpeg(picture)
        place.found[name, stamp] = followers[name].find(picture, stamp)
        for earlier_ns, detection in followers[name].earlier.items():
            where[name, earlier_ns].found[name, earlier_ns] = detection
        count(1)
    for place in detections:
        station = place.station
        if shots := place.of_shots(rig.cameras):
            place.measured = measure(station, shots, rig.cameras, board)
            continue
        details = [each.detail for each in place.rejections] or ["the recording does not contain the images"]
        place.measured = Rejection(
            "readers", "without images that can be decoded", details[0], station.time_ns, station.index
        )
    return detections


def first_pairs(detections: Sequence[StationDetections], rig: CameraRig) -> list[tuple[Detection, Detection]]:
    """The board in the first shot of each station that shows it to both cameras of a pair."""
    firsts = []
    for detected in detections:
        for left, right, *_ in detected.of_shots(rig) if len(rig.each) == 2 else ():
            if isinstance(left, Detection) and isinstance(right, Detection):
                firsts.append((left, right))
                break
    return firsts


#: Largest number of pending segments per process, so that results do not fill the memory.
_AHEAD = 2


@cache
def _opened(files: tuple[Path, ...]) -> Recording:
    """The recording of a worker process, open until its end."""
    return resources.enter_context(open_recording(files))


def _detect(
    files: tuple[Path, ...], rig: Rig, board: Board, segment: Segment
) -> tuple[list[StationDetections], tuple[str, ...]]:
    cv2.setNumThreads(1)
    recording = _opened(files)
    return detect_segment(recording, rig, board, segment), recording.damage


def detect_all(
    recording: Recording,
    rig: Rig,
    board: Board,
    plans: Sequence[Plan],
    thorough: bool = True,
    jobs: int = 1,
    progress: Progress = silent,
) -> list[list[StationDetections]]:
    """The board at all stations of a recording: for each of its logs, one `StationDetections` per station.

    Worker processes do the segments of a long recording. If they cannot be started, or one dies, this process does the
    remaining ones.

    Args:
        plans: stations of each log.
        thorough: see `vision.detect`.
        jobs: most worker processes.
        progress: receives the number of images.
    """
    segments = [segment for plan in plans for segment in segments_of(plan, thorough)]
    shots = [shot for plan in plans for station in plan.stations for shot in station.shots]
    total = sum(len(shot.taken_ns) for shot in shots)
    searched = 0

    def count(images: int) -> None:
        nonlocal searched
        searched += images
        progress("detecting the board", searched, total)

    count(0)
    detections: list[StationDetections] = []
    waiting: deque[Future[Path]] = deque()
    done, ahead, workers = 0, iter(segments), min(jobs, len(segments) // 2)
    files = tuple(part.opened for part in recording.parts)
    with ExitStack() as stack:
        # An image is too small for several threads of OpenCV; long recordings use processes.
        stack.callback(cv2.setNumThreads, cv2.getNumThreads())
        cv2.setNumThreads(1)
        submit = stack.enter_context(processes(workers)) if workers > 1 else None
        while submit is not None and len(segments) > done:
            try:
                for segment in islice(ahead, _AHEAD * workers - len(waiting)):
                    waiting.append(submit(_detect, files, rig, board, segment))
                detected, damage = answer(waiting.popleft())
            except FAILED:
                break
            for note in damage:
                recording.note(note)
            count(sum(len(station.found) for station in detected))
            detections += detected
            done += 1
        for segment in segments[done:]:
            detections += detect_segment(recording, rig, board, segment, count)
    in_order = iter(detections)
    return [list(islice(in_order, len(plan.stations))) for plan in plans]
