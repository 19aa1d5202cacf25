"""Board detection and measurement per station, in segments that limit the number of images in memory."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model import (
    SIDES,
    Board,
    GrayImage,
    PictureIndex,
    Rejection,
    Rig,
    Side,
    Sources,
    Station,
    StereoPair,
    StereoRig,
)
from mobilecal_cli.readers import Recording, read_images
from mobilecal_cli.stations import Plan, images_of
from mobilecal_cli.vision import (
    BoardFollower,
    Detection,
    Measured,
    Miss,
    identify_size,
    measure,
    snapshot_jpeg,
)

SNAPSHOTS = 60  # images kept for the report, limited to save memory
SIZE_PICTURES = 8
SIZE_VOTES = 3  # number of agreeing images that determine the board's size
#: Stereo pairs per segment. Tracking runs inside a segment, so segments and results do not depend on the
#: number of processes.
SEGMENT_PAIRS = 250


@dataclass(slots=True)
class StationDetections:
    """Detections at one station, filled in while its images are read.

    Attributes:
        found: side → time → detection or miss.
        pictures: side → JPEG of the first image, for the report.
        rejections: images that cannot be decoded.
    """

    found: dict[Side, dict[int, Detection | Miss]] = field(default_factory=lambda: {"left": {}, "right": {}})
    pictures: dict[Side, bytes] = field(default_factory=dict)
    rejections: list[Rejection] = field(default_factory=list)

    def pairs(self, pairs: Sequence[StereoPair]) -> tuple[list[Detection | Miss], list[Detection | Miss]]:
        """Left and right results of the stereo pairs with both images decoded."""
        left, right = self.found["left"], self.found["right"]
        whole = [pair for pair in pairs if pair.left_ns in left and pair.right_ns in right]
        return [left[pair.left_ns] for pair in whole], [right[pair.right_ns] for pair in whole]


@dataclass(frozen=True, slots=True)
class Segment:
    """Consecutive stations that are processed together.

    Attributes:
        stations: in order of time.
        images: side → their images.
        shown: indices, in this segment, of stations with images in the report.
        thorough: see `vision.detect`.
    """

    stations: tuple[Station, ...]
    images: Mapping[Side, PictureIndex]
    shown: frozenset[int]
    thorough: bool


@dataclass(frozen=True, slots=True, eq=False)
class Scene:
    """Data common to all segments of a recording.

    Attributes:
        sources: the image topics.
        cameras: the stereo pair, for the image sizes.
        board: board to detect.
    """

    sources: Sources
    cameras: StereoRig
    board: Board


def check_picture(picture: GrayImage, side: Side, cameras: StereoRig) -> None:
    """Check that an image has the size stated in its camera_info.

    Raises:
        RecordingError: the sizes differ.
    """
    camera = cameras.left if side == "left" else cameras.right
    height, width = picture.shape
    if (width, height) != (camera.width, camera.height):
        raise RecordingError(
            f"the {side} images are {width} x {height} pixels, but their camera_info states "
            f"{camera.width} x {camera.height}",
            "calibrate the cameras at the recorded size, or set binning and roi in camera_info",
        )


def first_pictures(
    recording: Recording, rig: Rig, plans: Sequence[Plan], rejections: list[Rejection]
) -> Iterator[GrayImage]:
    """Some images of both cameras, spread over the recording, to estimate the board's size.

    Args:
        recording: the open recording.
        rig: its topics and cameras.
        plans: its stations.
        rejections: receives those that cannot be decoded.

    Raises:
        RecordingError: an image has another size than stated.
    """
    stride = max(1, -(-sum(len(plan.stations) for plan in plans) // SIZE_PICTURES))
    for plan in plans:
        firsts = [replace(station, pairs=station.pairs[:1]) for station in plan.stations[::stride]]
        wanted = images_of(firsts, plan.images)
        for side, _, picture in read_images(recording, rig.sources.image, wanted, rig.sources.layout):
            if isinstance(picture, Rejection):
                rejections.append(picture)
                continue
            check_picture(picture, side, rig.cameras)
            yield picture


def board_size(recording: Recording, rig: Rig, plans: Sequence[Plan]) -> tuple[int, int] | None:
    """Inner corners (columns, rows) of the board in some images, None if none shows it.

    Raises:
        RecordingError: none of them can be decoded, or one has another size than stated.
    """
    rejections: list[Rejection] = []
    vote = identify_size(first_pictures(recording, rig, plans, rejections), SIZE_VOTES)
    if not vote.pictures and rejections:
        raise undecodable(rejections)
    return vote.size


def undecodable(rejections: Sequence[Rejection]) -> RecordingError:
    """The error for images of which none can be decoded."""
    return RecordingError(
        f"none of {len(rejections)} images can be decoded: {rejections[0].detail}",
        "record JPEG or PNG images, or raw ones (sensor_msgs/Image)",
    )


def segments_of(plan: Plan, thorough: bool) -> list[Segment]:
    """Split the stations of a log into segments, and choose the images kept for the report."""
    stations = plan.stations
    stride = max(1, -(-len(stations) // SNAPSHOTS))
    cuts, count = [0], 0
    for i, station in enumerate(stations):
        if count and count + len(station.pairs) > SEGMENT_PAIRS:
            cuts.append(i)
            count = 0
        count += len(station.pairs)
    cuts.append(len(stations))
    return [
        Segment(
            stations[begin:end],
            images_of(stations[begin:end], plan.images),
            frozenset(i - begin for i in range(begin, end) if i % stride == 0),
            thorough,
        )
        for begin, end in pairwise(cuts)
    ]


def detect_segment(
    recording: Recording, scene: Scene, segment: Segment
) -> Iterator[int | list[StationDetections]]:
    """Detect the board in all images of a segment, in one pass over its part of the recording.

    Yields:
        1 for every image processed; at the end, a list with one `StationDetections` per station.
    """
    stations = segment.stations
    where: Mapping[Side, dict[int, int]] = {
        "left": {pair.left_ns: i for i, station in enumerate(stations) for pair in station.pairs},
        "right": {pair.right_ns: i for i, station in enumerate(stations) for pair in station.pairs},
    }
    detections = [StationDetections() for _ in stations]
    followers = {side: BoardFollower(scene.board, segment.thorough) for side in SIDES}
    sources = scene.sources
    for side, stamp, picture in read_images(recording, sources.image, segment.images, sources.layout):
        station = where[side][stamp]
        place = detections[station]
        if isinstance(picture, Rejection):
            place.rejections.append(picture)
            continue
        check_picture(picture, side, scene.cameras)
        if station in segment.shown and side not in place.pictures:
            place.pictures[side] = snapshot_jpeg(picture)
        place.found[side][stamp] = followers[side].find(picture, stamp)
        yield 1
    yield detections


def measure_stations(
    log: int, scene: Scene, stations: Sequence[Station], detections: Sequence[StationDetections]
) -> list[Measured | Rejection]:
    """Measure the board at some stations of a recording.

    Args:
        log: index of the recording.
        scene: cameras and board.
        stations: stations to measure.
        detections: detections at each of them.

    Returns:
        The board at each station, or a rejection.
    """
    return [_measured(log, scene, station, seen) for station, seen in zip(stations, detections, strict=True)]


def first_pairs(
    stations: Sequence[Station], detections: Sequence[StationDetections]
) -> list[tuple[Detection, Detection]]:
    """The board in the first stereo pair of each station that shows it in both images."""
    found = []
    for station, seen in zip(stations, detections, strict=True):
        for left, right in zip(*seen.pairs(station.pairs), strict=True):
            if isinstance(left, Detection) and isinstance(right, Detection):
                found.append((left, right))
                break
    return found


def _measured(
    log: int, scene: Scene, station: Station, detections: StationDetections
) -> Measured | Rejection:
    left, right = detections.pairs(station.pairs)
    if not left:
        detail = (
            detections.rejections[0].detail
            if detections.rejections
            else "the recording does not contain the images"
        )
        return Rejection("readers", "images cannot be decoded", detail, station.time_ns, station.index, log)
    return measure(log, station, left, right, scene.cameras, scene.board)
