"""Segments of a long log looked at by several processes, each of which reads its own part of the recording."""

from __future__ import annotations

import os
import signal
from collections import deque
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager
from multiprocessing import get_context
from pathlib import Path

from mobilecal_cli.pipeline.seeing import Looks, Scene, Segment, look_at
from mobilecal_cli.readers import Recording, open_recording

#: So many segments of a process wait or are being looked at, so that results do not pile up.
_AHEAD = 2
#: Libraries that would start threads of their own in each of the processes.
_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")

Logged = dict[str, dict[int, int]]


class _Here:
    """What a process of the pool keeps from one segment to the next."""

    resources = ExitStack()
    recording: Recording
    scene: Scene


def _begin(files: Sequence[Path], scene: Scene) -> None:
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # the command tells that it was interrupted
    _Here.recording = _Here.resources.enter_context(open_recording(files))
    _Here.scene = scene


def _look(segment: Segment, logged: Logged) -> tuple[list[Looks], tuple[str, ...]]:
    _Here.recording.logged = logged
    *_, looks = look_at(_Here.recording, _Here.scene, segment)
    assert isinstance(looks, list)
    return looks, _Here.recording.damage


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Processes that are started meanwhile do their sums on one thread."""
    before = {name: os.environ.get(name) for name in _THREADS}
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _logged(recording: Recording, scene: Scene, segment: Segment) -> Logged:
    """When the segment's pictures were logged: all that it needs to know of the first pass."""
    wanted = {"left": scene.sources.image["left"], "right": scene.sources.image["right"]}
    logged: Logged = {}
    for station in segment.stations:
        for shot in station.shots:
            for side, stamp in (("left", shot.left_ns), ("right", shot.right_ns)):
                at_ns = recording.logged.get(wanted[side], {}).get(stamp)
                if at_ns is not None:
                    logged.setdefault(wanted[side], {})[stamp] = at_ns
    return logged


def in_processes(
    recording: Recording, scene: Scene, segments: Sequence[Segment], workers: int
) -> Iterator[int | list[Looks]]:
    """`look_at` for all segments, in their order, by several processes.

    Where processes cannot be started, or one dies, the segments that are left are looked at here.

    Yields:
        How many pictures have been looked at since the last word, and one list a segment.
    """
    done = 0
    try:
        for looks, damage in _from_pool(recording, scene, segments, workers):
            for note in damage:
                recording.note(note)
            yield sum(len(found) for one in looks for found in one.found.values())
            yield looks
            done += 1
    except (BrokenProcessPool, OSError, NotImplementedError):
        for segment in segments[done:]:
            yield from look_at(recording, scene, segment)


def _from_pool(
    recording: Recording, scene: Scene, segments: Sequence[Segment], workers: int
) -> Iterator[tuple[list[Looks], tuple[str, ...]]]:
    files = [part.path for part in recording.parts]
    waiting: deque[Future[tuple[list[Looks], tuple[str, ...]]]] = deque()
    # Spawned, not forked: a fork would copy locks that other threads hold.
    with ProcessPoolExecutor(workers, get_context("spawn"), _begin, (files, scene)) as pool:
        try:
            for segment in segments:
                with _one_thread_each():
                    waiting.append(pool.submit(_look, segment, _logged(recording, scene, segment)))
                if len(waiting) >= _AHEAD * workers:
                    yield waiting.popleft().result()
            while waiting:
                yield waiting.popleft().result()
        finally:
            pool.shutdown(cancel_futures=True)
