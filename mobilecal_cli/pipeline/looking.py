"""Segments of a long log looked at by several processes, each of which reads its own part of the recording."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, suppress
from pathlib import Path

from mobilecal_cli.model import Rejection, Snapshot, Station
from mobilecal_cli.pipeline.processes import FAILED, Processes, Task
from mobilecal_cli.pipeline.progress import Progress
from mobilecal_cli.pipeline.seeing import SIDES, Looks, Scene, Segment, look_at, measure_at, segments_of
from mobilecal_cli.readers import Recording, open_recording
from mobilecal_cli.vision import Measured

#: So many segments of a process wait or are being looked at, so that results do not pile up.
_AHEAD = 2
_MEASURED_AT_ONCE = 200  # stations

Logged = dict[str, dict[int, int]]


class _Here:
    """What a process of the crew keeps from one segment to the next."""

    resources = ExitStack()
    recording: Recording


def _begin(files: Sequence[Path]) -> None:
    _Here.recording = _Here.resources.enter_context(open_recording(files))


def _look(scene: Scene, segment: Segment, logged: Logged) -> tuple[list[Looks], tuple[str, ...]]:
    _Here.recording.logged = logged
    *_, looks = look_at(_Here.recording, scene, segment)
    assert isinstance(looks, list)
    return looks, _Here.recording.damage


def _logged(recording: Recording, scene: Scene, segment: Segment) -> Logged:
    """When the segment's images were logged: all that it needs to know of the first pass."""
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
    """Processes that look at a long log's images.

    Where they cannot be started, or one dies, the segments that are left are looked at in this one.

    Args:
        recording: one log, open.
        jobs: so many processes may look.
    """

    def __init__(self, recording: Recording, jobs: int) -> None:
        super().__init__()
        self._recording, self._jobs = recording, jobs

    def call(self, most: int | None = None) -> None:
        """Start them, if there may be more than one; they get ready while this one goes on.

        Args:
            most: so many at most have something to do; not known by default.
        """
        processes = min(self._jobs, self._jobs if most is None else most)
        if not self.started and processes > 1:
            self.start(processes, _begin, [part.path for part in self._recording.parts])

    def look_at(self, scene: Scene, segments: Sequence[Segment]) -> Iterator[int | list[Looks]]:
        """`seeing.look_at` for all segments, in their order.

        Yields:
            How many images have been looked at since the last word, and one list a segment.
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
        """`seeing.measure_at` for all stations, by the processes that looked."""
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
    """Look at every shot of every station.

    Args:
        crew: who looks. A few segments are looked at in this process.
        scene: cameras and board.
        stations: what to look at.
        thorough: how boards are searched for, see `vision.detect`.
        progress: told about every image.

    Returns:
        One `Looks` a station, and JPEGs of some stations' first images.
    """
    segments = segments_of(stations, thorough)
    total = 2 * sum(len(station.shots) for station in stations)
    done = 0
    looks: list[Looks] = []
    for step in crew.look_at(scene, segments):
        if isinstance(step, int):
            done += step
            progress("looking for the board", done, total)
        else:
            looks += step
    snapshots = [
        Snapshot(0, station.index, seen.pictures["left"], seen.pictures["right"])
        for station, seen in zip(stations, looks, strict=True)
        if all(side in seen.pictures for side in SIDES)
    ]
    return looks, snapshots
