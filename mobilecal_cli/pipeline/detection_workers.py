"""Board detection in worker processes; each reads its own part of the recording."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import islice
from pathlib import Path

import cv2

from mobilecal_cli.model import SIDES, Rejection, Snapshot, Station
from mobilecal_cli.pipeline.detecting import (
    Scene,
    Segment,
    StationDetections,
    detect_segment,
    measure_stations,
    segments_of,
)
from mobilecal_cli.pipeline.processes import FAILED, Processes, Task, resources
from mobilecal_cli.pipeline.progress import Progress
from mobilecal_cli.readers import Recording, open_recording
from mobilecal_cli.stations import Plan
from mobilecal_cli.vision import Measured

#: Largest number of pending segments per process, so that results do not fill the memory.
_AHEAD = 2
_MEASURED_AT_ONCE = 200  # stations


class _Here:
    """State of a worker process, kept from one segment to the next."""

    recording: Recording


def _begin(files: Sequence[Path]) -> None:
    cv2.setNumThreads(1)
    _Here.recording = resources.enter_context(open_recording(files))


def _detect(scene: Scene, segment: Segment) -> tuple[list[StationDetections], tuple[str, ...]]:
    *_, detections = detect_segment(_Here.recording, scene, segment)
    assert isinstance(detections, list)
    return detections, _Here.recording.damage


@contextmanager
def _one_thread() -> Iterator[None]:
    """OpenCV in one thread inside the block: an image is too small for several, long recordings use processes."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


class DetectionWorkers(Processes):
    """Worker processes that detect the board in the images of a long recording.

    If they cannot be started, or one dies, this process does the remaining segments.

    Args:
        recording: one recording, open.
        jobs: largest number of worker processes.
    """

    def __init__(self, recording: Recording, jobs: int) -> None:
        super().__init__()
        self._recording, self._jobs = recording, jobs

    def call(self, most: int | None = None) -> None:
        """Start the worker processes in the background, if more than one may be used.

        Args:
            most: upper limit of useful processes; none by default.
        """
        processes = min(self._jobs, self._jobs if most is None else most)
        if not self.started and processes > 1:
            self.start(processes, _begin, [part.opened for part in self._recording.parts])

    def detect_segment(
        self, scene: Scene, segments: Sequence[Segment]
    ) -> Iterator[int | list[StationDetections]]:
        """`detecting.detect_segment` for all segments, in order.

        Yields:
            The number of images processed since the last value; after each segment, its list of results.
        """
        done = 0
        self.call(len(segments) // 2)
        if self.started and len(segments) > 1:
            with suppress(*FAILED):
                for detections, damage in self._together(scene, segments):
                    for note in damage:
                        self._recording.note(note)
                    yield sum(len(found) for one in detections for found in one.found.values())
                    yield detections
                    done += 1
        for segment in segments[done:]:
            yield from detect_segment(self._recording, scene, segment)

    def measure_stations(
        self, log: int, scene: Scene, stations: Sequence[Station], detections: Sequence[StationDetections]
    ) -> list[Measured | Rejection]:
        """`detecting.measure_stations` for all stations, in the worker processes if there are many."""
        if self.started and len(stations) > _MEASURED_AT_ONCE:
            starts = range(0, len(stations), _MEASURED_AT_ONCE)
            some = [slice(start, start + _MEASURED_AT_ONCE) for start in starts]
            with suppress(*FAILED):
                tasks = [
                    self.submit(measure_stations, log, scene, stations[part], detections[part])
                    for part in some
                ]
                return [one for task in tasks for one in task.result()]
        return measure_stations(log, scene, stations, detections)

    def _together(
        self, scene: Scene, segments: Sequence[Segment]
    ) -> Iterator[tuple[list[StationDetections], tuple[str, ...]]]:
        waiting: deque[Task[tuple[list[StationDetections], tuple[str, ...]]]] = deque()
        for segment in segments:
            waiting.append(self.submit(_detect, scene, segment))
            if len(waiting) >= _AHEAD * self._jobs:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()


def detect_all(
    workers: DetectionWorkers, scene: Scene, plans: Sequence[Plan], thorough: bool, progress: Progress
) -> list[tuple[list[StationDetections], list[Snapshot]]]:
    """Detect the board in the images of all stations of a recording.

    Args:
        workers: the worker processes; a few segments are processed without them.
        scene: cameras and board.
        plans: stations of each of its logs.
        thorough: see `vision.detect`.
        progress: called after every image.

    Returns:
        For each log: one `StationDetections` per station, and JPEGs of the first images of some stations.
    """
    segments = [segments_of(plan, thorough) for plan in plans]
    total = 2 * sum(len(station.pairs) for plan in plans for station in plan.stations)
    done = 0
    detections: list[StationDetections] = []
    with _one_thread():
        for step in workers.detect_segment(scene, [segment for some in segments for segment in some]):
            if isinstance(step, int):
                done += step
                progress("detecting the board", done, total)
            else:
                detections += step
    found = iter(detections)
    return [_with_snapshots(plan, list(islice(found, len(plan.stations)))) for plan in plans]


def _with_snapshots(
    plan: Plan, detections: list[StationDetections]
) -> tuple[list[StationDetections], list[Snapshot]]:
    return detections, [
        Snapshot(0, station.index, seen.pictures["left"], seen.pictures["right"])
        for station, seen in zip(plan.stations, detections, strict=True)
        if all(side in seen.pictures for side in SIDES)
    ]
