"""The report's figures, drawn by a second process that gets ready while the images are looked at."""

from __future__ import annotations

import atexit
import os
from collections.abc import Callable
from contextlib import suppress

from mobilecal_cli.model import Extraction, Solution
from mobilecal_cli.pipeline.processes import FAILED, Processes, Task
from mobilecal_cli.pipeline.progress import Progress
from mobilecal_cli.report import Drawn, Figures, draw_figures, draw_seen, draw_solved, put_together

#: By then the input is sound, and a few seconds are left.
_BEGINS_WITH = ("finding the board's size", "looking for the board")


def _get_ready() -> None:
    """Load the plotting library: half of the time that the figures take."""
    # To take the library's many objects down one by one would keep the command waiting for a third of a second.
    atexit.register(os._exit, 0)
    import matplotlib.backends.backend_svg
    import matplotlib.figure  # noqa: F401


class Draughtsman(Processes):
    """Draws on another core, if there is one; here, if not, or if that process fails.

    A third process would take longer to get ready than it draws.

    Args:
        jobs: processes that may be used.
    """

    def __init__(self, jobs: int) -> None:
        super().__init__()
        self._wanted = jobs > 1
        self._seen: Task[Drawn] | None = None

    def watching(self, progress: Progress) -> Progress:
        """The same progress, at whose first image the process is started."""

        def told(stage: str, done: int, total: int | None) -> None:
            progress(stage, done, total)
            if stage in _BEGINS_WITH and self._wanted:
                self._wanted = False
                self.start(1, _get_ready)

        return told

    def begin_with(self, extraction: Extraction) -> None:
        """Begin with the figures of a report that need no solution."""
        if self.started:
            with suppress(*FAILED):
                self._seen = self.submit(draw_seen, extraction)

    def begin(self, solution: Solution, extraction: Extraction) -> Callable[[], Figures]:
        """Begin with all that is left; what comes back waits until everything is there.

        Args:
            solution: the answer.
            extraction: the one that `begin_with` was given.
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
