"""Board detection in worker processes; each reads its own part of the recording."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import suppress
from pathlib import Path

from mobilecal_cli.model import Rejection, Snapshot, Station
from mobilecal_cli.pipeline.processes import FAILED, Processes, Task, resources
from mobilecal_cli.pipeline.progress import Progress
from mobilecal_cli.pipeline.seeing import SIDES, Looks, Scene, Segment, look_at, measure_at, segments_of
from mobilecal_cli.readers import Recording, open_recording
from mobilecal_cli.vision import Measured

#: Largest number of pending segments per process, so that results do not fill the memory.
_AHEAD = 2
_MEASURED_AT_ONCE = 200  # stations

Logged = dict[str, dict[int, int]]


class _Here:
    """State of a worker process, kept from one segment to the next."""

    recording: Recording


def _begin(files: Sequence[Path]) -> None:
    _Here.recording = resources.enter_context(open_recording(files))


def _look(scene: Scene, segment: Segment, logged: Logged) -> tuple[list[Looks], tuple[str, ...]]:
    _Here.recording.logged = logged
    *_, looks = look_at(_Here.recording, scene, segment)
    assert isinstance(looks, list)
    return looks, _Here.recording.damage


def _logged(recording: Recording, scene: Scene, segment: Segment) -> Logged:
    """Log times of the segment's images, which a worker cannot know without indexing the recording."""
    wanted = {"left": scene.sources.image["left"], "right": scene.sources.image["right"]}
    logged: Logged = {}
    for station in segment.stations:
        for shot in station.shots:
            for side, stamp in (("left", shot.left_ns), ("right", shot.right_ns)):
                at_ns = recording.logged.get(wanted[side], {}).get(stamp)
                if at_ns is not None:
                    logged.setdefault(wanted[side], {})[stamp] = at_ns
    return logged


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
            self.start(processes, _begin, [part.path for part in self._recording.parts])

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
            logged = _logged(self._recording, scene, segment)
            waiting.append(self.submit(_look, scene, segment, logged))
            if len(waiting) >= _AHEAD * self._jobs:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()


def look(
    crew: Crew,
    scene: Scene,
    stations: Sequence[Station],
    thorough: bool,
    progress: Progress,
) -> tuple[list[Looks], list[Snapshot]]:
    """Detect the board in the images of all stations.

    Args:
        `crew`: the worker processes; a few segments are processed without them.
        scene: cameras and board.
        stations: stations to process.
        thorough: see `vision.detect`.
        progress: called after every image.

    Returns:
        One `Looks` per station, and JPEGs of the first images of some stations.
    """
    segments = segments_of(stations, thorough)
    total = 2 * sum(len(station.shots) for station in stations)
    done = 0
    looks: list[Looks] = []
    for step in crew.look_at(scene, segments):
        if isinstance(step, int):
            done += step
            progress("detecting the board", done, total)
        else:
            looks += step
    snapshots = [
        Snapshot(0, station.index, seen.pictures["left"], seen.pictures["right"])
        for station, seen in zip(stations, looks, strict=True)
        if all(side in seen.pictures for side in SIDES)
    ]
    return looks, snapshots
