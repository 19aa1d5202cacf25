"""Draws the report's figures in a second process, which starts during board detection."""

from __future__ import annotations

import atexit
import os
from collections.abc import Callable
from contextlib import suppress

from mobilecal_cli.model import Extraction, Solution
from mobilecal_cli.pipeline.processes import FAILED, Processes, Task
from mobilecal_cli.pipeline.progress import Progress
from mobilecal_cli.report import Drawn, Figures, draw_figures, draw_seen, draw_solved, put_together

#: Stages that show that the input is valid and that some seconds are left to load the plotting library.
_BEGINS_WITH = ("finding the board's size", "detecting the board")


def _get_ready() -> None:
    """Load the plotting library, which takes half of the time of the figures."""
    # Exit without destroying the library's objects, which would delay the command by a third of a second.
    atexit.register(os._exit, 0)
    import matplotlib.backends.backend_svg
    import matplotlib.figure  # noqa: F401


class Draughtsman(Processes):
    """Draws figures in a second process; in this process if there is no second core or if that process fails.

    More processes would take longer to start than to draw.

    Args:
        jobs: number of processes that may be used.
    """

    def __init__(self, jobs: int) -> None:
        super().__init__()
        self._wanted = jobs > 1
        self._seen: Task[Drawn] | None = None

    def watching(self, progress: Progress) -> Progress:
        """Wrap a progress callback so that the drawing process starts at the first image."""

        def told(stage: str, done: int, total: int | None) -> None:
            progress(stage, done, total)
            if stage in _BEGINS_WITH and self._wanted:
                self._wanted = False
                self.start(1, _get_ready)

        return told

    def begin_with(self, extraction: Extraction) -> None:
        """Start drawing the figures that need no solution."""
        if self.started:
            with suppress(*FAILED):
                self._seen = self.submit(draw_seen, extraction)

    def begin(self, solution: Solution, extraction: Extraction) -> Callable[[], Figures]:
        """Start drawing the remaining figures; the returned function waits for all of them.

        Args:
            solution: the result of the solver.
            extraction: the same as for `begin_with`.
        """
        seen, solved = self._seen, None
        if seen is not None:
            with suppress(*FAILED):
                solved = self.submit(draw_solved, solution, extraction)

        def figures() -> Figures:
            with suppress(*FAILED):
                if seen is not None and solved is not None:
                    return put_together({**seen.result(), **solved.result()}, extraction)
            return draw_figures(solution, extraction)

        return figures
