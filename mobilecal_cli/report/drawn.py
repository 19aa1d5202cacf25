"""What the page shows beside values: plots, and images with marks.

A new plot is a function with the decorator `plot`.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeVar

from mobilecal_cli.model import Extraction, Snapshot, Solution
from mobilecal_cli.report.overlays import LegView, leg_views

_Draw = TypeVar("_Draw", bound=Callable[..., str])
_MOST_PATHS = 4  # recordings with their own plots


@dataclass(frozen=True, slots=True)
class Figure:
    """A plot, or the same plot of several recordings or of both cameras.

    Attributes:
        section: where the page shows it.
        parts: title ("" for none) and SVG element of each.
        caption: sentences below it; its braces are filled in by `report_html`.
        half: half as wide as the page, side by side.
    """

    section: str
    parts: tuple[tuple[str, str], ...]
    caption: str
    half: bool


@dataclass(frozen=True, slots=True)
class Drawings:
    """What the page shows beside values.

    Attributes:
        figures: plots in the order of their definition.
        views: images of legs with detected and predicted corners.
    """

    figures: tuple[Figure, ...]
    views: Sequence[LegView]


@dataclass(frozen=True, slots=True)
class _Plot:
    section: str
    draw: Callable[..., str]
    caption: str
    half: bool
    each: Literal["log", "side"] | None

    def figure(self, solution: Solution, extraction: Extraction) -> Figure:
        parts = tuple(self._parts(solution, extraction))
        return Figure(self.section, tuple(part for part in parts if part[1]), self.caption, self.half)

    def _parts(self, solution: Solution, extraction: Extraction) -> Iterator[tuple[str, str]]:
        logs = sorted({o.log for o in extraction.observations})
        items: dict[str | None, Sequence[Any]] = {"log": logs[:_MOST_PATHS], "side": ("left", "right")}
        for item in items.get(self.each, (None,)):
            title = extraction.log_names[item] if self.each == "log" and len(logs) > 1 else ""
            yield title, self.draw(solution, extraction, *(() if item is None else (item,)))


_PLOTS: list[_Plot] = []


def plot(
    section: str, caption: str = "", *, half: bool = False, each: Literal["log", "side"] | None = None
) -> Callable[[_Draw], _Draw]:
    """Add a function to the plots of the page: solution, data (and log or side) → SVG element, "" for none.

    Args:
        section: where the page shows it.
        caption: see `Figure`.
        half: see `Figure`.
        each: draw it for each recording, or for each camera.
    """

    def registered(draw: _Draw) -> _Draw:
        _PLOTS.append(_Plot(section, draw, caption, half, each))
        return draw

    return registered


def draw_all(solution: Solution, extraction: Extraction, snapshots: Sequence[Snapshot] = ()) -> Drawings:
    """Draw all plots, and the images of legs.

    Args:
        solution: the solution.
        extraction: the data it was computed from.
        snapshots: images of some or all stations; may be empty.
    """
    from mobilecal_cli.report import plots, residual_plots  # noqa: F401  (their plots are in _PLOTS)

    drawn = [each.figure(solution, extraction) for each in _PLOTS] if extraction.observations else []
    figures = tuple(figure for figure in drawn if figure.parts)
    return Drawings(figures, leg_views(solution, extraction, snapshots))
