"""Pictures into detections: decoded in order, looked at in parallel, never many in memory."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, field

import cv2

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model import (
    Board,
    GrayImage,
    Rejection,
    Shot,
    Side,
    Snapshot,
    Sources,
    Station,
    StereoRig,
)
from mobilecal_cli.pipeline.progress import Progress
from mobilecal_cli.readers import Recording, read_images
from mobilecal_cli.vision import Detection, Miss, find_board, identify_size, snapshot_jpeg

SNAPSHOTS = 60  # pictures kept for the report, so that memory does not grow with the log
SIZE_PICTURES = 8
_SIDES: tuple[Side, Side] = ("left", "right")


@dataclass(slots=True)
class Looks:
    """What was seen at one station, filled as its pictures come by.

    Attributes:
        found: side → stamp → detection or miss.
        pictures: side → JPEG of the first picture, for the report.
        rejections: pictures that could not be decoded.
    """

    found: dict[Side, dict[int, Detection | Miss]] = field(default_factory=lambda: {"left": {}, "right": {}})
    pictures: dict[Side, bytes] = field(default_factory=dict)
    rejections: list[Rejection] = field(default_factory=list)

    def pairs(self, shots: Sequence[Shot]) -> tuple[list[Detection | Miss], list[Detection | Miss]]:
        """Left and right findings of those shots of which both pictures could be decoded."""
        left, right = self.found["left"], self.found["right"]
        whole = [shot for shot in shots if shot.left_ns in left and shot.right_ns in right]
        return [left[shot.left_ns] for shot in whole], [right[shot.right_ns] for shot in whole]


def stamps(shots: Iterable[Shot]) -> dict[Side, list[int]]:
    """The stamps of both sides' pictures."""
    listed = list(shots)
    return {"left": [shot.left_ns for shot in listed], "right": [shot.right_ns for shot in listed]}


def check_picture(picture: GrayImage, side: Side, cameras: StereoRig) -> None:
    """Refuse pictures of another size than the camera info speaks of.

    Raises:
        RecordingError: with both sizes.
    """
    camera = cameras.left if side == "left" else cameras.right
    height, width = picture.shape
    if (width, height) != (camera.width, camera.height):
        raise RecordingError(
            f"the {side} pictures are {width} x {height} pixels, their camera info speaks of "
            f"{camera.width} x {camera.height}",
            "calibrate the cameras at the recorded size, or set binning and roi in the camera info",
        )


def first_pictures(
    recording: Recording, sources: Sources, stations: Sequence[Station]
) -> Iterator[GrayImage]:
    """A few pictures spread over the log, left and right, to find the board's size in."""
    stride = max(1, -(-len(stations) // SIZE_PICTURES))
    wanted = stamps(station.shots[0] for station in stations[::stride])
    for _, _, picture in read_images(recording, sources.image, wanted, sources.layout):
        if not isinstance(picture, Rejection):
            yield picture


def board_size(recording: Recording, sources: Sources, stations: Sequence[Station]) -> tuple[int, int] | None:
    """The board's inner corners as a few pictures show them, None where they show none."""
    return identify_size(first_pictures(recording, sources, stations)).size


def look(
    recording: Recording,
    sources: Sources,
    cameras: StereoRig,
    board: Board,
    stations: Sequence[Station],
    progress: Progress,
) -> tuple[list[Looks], list[Snapshot]]:
    """Look at every shot of every station, in one pass over the recording.

    Args:
        recording: one log.
        sources: its image topics.
        cameras: for the pictures' sizes.
        board: its size.
        stations: what to look at.
        progress: told about every picture.

    Returns:
        One `Looks` a station, and JPEGs of some stations' first pictures.
    """
    wanted = stamps(shot for station in stations for shot in station.shots)
    where: Mapping[Side, dict[int, int]] = {
        "left": {shot.left_ns: i for i, station in enumerate(stations) for shot in station.shots},
        "right": {shot.right_ns: i for i, station in enumerate(stations) for shot in station.shots},
    }
    looks = [Looks() for _ in stations]
    stride = max(1, -(-len(stations) // SNAPSHOTS))
    total = sum(len(times) for times in wanted.values())
    cv2.setNumThreads(1)  # one picture a thread is faster than many threads a picture
    workers = os.cpu_count() or 1
    pending: deque[tuple[Side, int, Future[Detection | Miss]]] = deque()
    done = 0

    def collect() -> None:
        nonlocal done
        side, stamp, future = pending.popleft()
        looks[where[side][stamp]].found[side][stamp] = future.result()
        done += 1
        progress("looking for the board", done, total)

    with ThreadPoolExecutor(workers) as pool:
        for side, stamp, picture in read_images(recording, sources.image, wanted, sources.layout):
            place = looks[where[side][stamp]]
            if isinstance(picture, Rejection):
                place.rejections.append(picture)
                continue
            check_picture(picture, side, cameras)
            if where[side][stamp] % stride == 0 and side not in place.pictures:
                place.pictures[side] = snapshot_jpeg(picture)
            pending.append((side, stamp, pool.submit(find_board, picture, board)))
            if len(pending) > 2 * workers:
                collect()
        while pending:
            collect()
    snapshots = [
        Snapshot(0, station.index, seen.pictures["left"], seen.pictures["right"])
        for station, seen in zip(stations, looks, strict=True)
        if all(side in seen.pictures for side in _SIDES)
    ]
    return looks, snapshots
