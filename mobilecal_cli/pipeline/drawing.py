"""The report's figures, drawn by a second process that gets ready while the pictures are looked at."""

from __future__ import annotations

import atexit
import os
import signal
from collections.abc import Callable
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from multiprocessing import get_context
from types import TracebackType
from typing import Self

from mobilecal_cli.model import Extraction, Solution
from mobilecal_cli.pipeline.progress import Progress
from mobilecal_cli.report import Drawn, Figures, draw_figures, draw_seen, draw_solved, put_together

#: By then the input is sound, and a few seconds are left.
_BEGINS_WITH = ("finding the board's size", "looking for the board")


def _get_ready() -> None:
    """Load the plotting library: half of the time that the figures take."""
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    # To take the library's many objects down one by one would keep the command waiting for a third of a second.
    atexit.register(os._exit, 0)
    import matplotlib.backends.backend_svg
    import matplotlib.figure  # noqa: F401


class Draughtsman:
    """Draws on another core, if there is one; here, if not, or if that process fails.

    A third process would take longer to get ready than it draws.

    Args:
        jobs: processes that may be used.
    """

    def __init__(self, jobs: int) -> None:
        self._pool: ProcessPoolExecutor | None = None
        self._alone = jobs < 2
        self._seen: Future[Drawn] | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)

    def watching(self, progress: Progress) -> Progress:
        """The same progress, at whose first picture the process is started."""

        def told(stage: str, done: int, total: int | None) -> None:
            progress(stage, done, total)
            if stage in _BEGINS_WITH and self._pool is None and not self._alone:
                self._start()

        return told

    def _start(self) -> None:
        try:
            self._pool = ProcessPoolExecutor(1, get_context("spawn"), _get_ready)
            self._pool.submit(int)  # a pool starts its process with the first task
        except (OSError, NotImplementedError):
            self._alone = True

    def begin_with(self, extraction: Extraction) -> None:
        """Begin with the figures of a report that need no solution."""
        if self._pool is not None:
            with suppress(BrokenProcessPool, OSError):
                self._seen = self._pool.submit(draw_seen, extraction)

    def begin(self, solution: Solution, extraction: Extraction) -> Callable[[], Figures]:
        """Begin with all that is left; what comes back waits until everything is there.

        Args:
            solution: the answer.
            extraction: the one that `begin_with` was given.
        """
        seen, solved = self._seen, None
        if self._pool is not None and seen is not None:
            with suppress(BrokenProcessPool, OSError):
                solved = self._pool.submit(draw_solved, solution, extraction)

        def figures() -> Figures:
            with suppress(BrokenProcessPool, OSError):
                if seen is not None and solved is not None:
                    return put_together({**seen.result(), **solved.result()}, extraction)
            return draw_figures(solution, extraction)

        return figures
