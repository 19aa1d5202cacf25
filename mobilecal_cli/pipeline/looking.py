"""Board detection in worker processes; each reads its own part of the recording."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from itertools import islice
from pathlib import Path

import cv2

from mobilecal_cli.model import Rejection, Snapshot, Station
from mobilecal_cli.pipeline.processes import FAILED, Processes, Task, resources
from mobilecal_cli.pipeline.progress import Progress
from mobilecal_cli.pipeline.seeing import SIDES, Looks, Scene, Segment, look_at, measure_at, segments_of
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


def _look(scene: Scene, segment: Segment) -> tuple[list[Looks], tuple[str, ...]]:
    *_, looks = look_at(_Here.recording, scene, segment)
    assert isinstance(looks, list)
    return looks, _Here.recording.damage


@contextmanager
def _one_thread() -> Iterator[None]:
    """OpenCV in one thread inside the block: an image is too small for several, long recordings use processes."""
    before = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(before)


class Crew(Processes):
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

    def look_at(self, scene: Scene, segments: Sequence[Segment]) -> Iterator[int | list[Looks]]:
        """`seeing.look_at` for all segments, in order.

        Yields:
            The number of images processed since the last value; after each segment, its list of results.
        """
        done = 0
        self.call(len(segments) // 2)
        if self.started and len(segments) > 1:
            with suppress(*FAILED):
                for looks, damage in self._together(scene, segments):
                    for note in damage:
                        self._recording.note(note)
                    yield sum(len(found) for one in looks for found in one.found.values())
                    yield looks
                    done += 1
        for segment in segments[done:]:
            yield from look_at(self._recording, scene, segment)

    def measure_at(
        self, log: int, scene: Scene, stations: Sequence[Station], looks: Sequence[Looks]
    ) -> list[Measured | Rejection]:
        """`seeing.measure_at` for all stations, in the worker processes if there are many."""
        if self.started and len(stations) > _MEASURED_AT_ONCE:
            starts = range(0, len(stations), _MEASURED_AT_ONCE)
            some = [slice(start, start + _MEASURED_AT_ONCE) for start in starts]
            with suppress(*FAILED):
                tasks = [self.submit(measure_at, log, scene, stations[part], looks[part]) for part in some]
                return [one for task in tasks for one in task.result()]
        return measure_at(log, scene, stations, looks)

    def _together(
        self, scene: Scene, segments: Sequence[Segment]
    ) -> Iterator[tuple[list[Looks], tuple[str, ...]]]:
        waiting: deque[Task[tuple[list[Looks], tuple[str, ...]]]] = deque()
        for segment in segments:
            waiting.append(self.submit(_look, scene, segment))
            if len(waiting) >= _AHEAD * self._jobs:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()


def look(
    crew: Crew, scene: Scene, plans: Sequence[Plan], thorough: bool, progress: Progress
) -> list[tuple[list[Looks], list[Snapshot]]]:
    """Detect the board in the images of all stations of a recording.

    Args:
        `crew`: the worker processes; a few segments are processed without them.
        scene: cameras and board.
        plans: stations of each of its logs.
        thorough: see `vision.detect`.
        progress: called after every image.

    Returns:
        For each log: one `Looks` per station, and JPEGs of the first images of some stations.
    """
    segments = [segments_of(plan, thorough) for plan in plans]
    total = 2 * sum(len(station.shots) for plan in plans for station in plan.stations)
    done = 0
    looks: list[Looks] = []
    with _one_thread():
        for step in crew.look_at(scene, [segment for some in segments for segment in some]):
            if isinstance(step, int):
                done += step
                progress("detecting the board", done, total)
            else:
                looks += step
    found = iter(looks)
    return [_with_snapshots(plan, list(islice(found, len(plan.stations)))) for plan in plans]


def _with_snapshots(plan: Plan, looks: list[Looks]) -> tuple[list[Looks], list[Snapshot]]:
    return looks, [
        Snapshot(0, station.index, seen.pictures["left"], seen.pictures["right"])
        for station, seen in zip(plan.stations, looks, strict=True)
        if all(side in seen.pictures for side in SIDES)
    ]
