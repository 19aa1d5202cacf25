"""All figures of a report as SVG text, so that worker processes can draw them before the page is assembled."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from mobilecal_cli.model import Extraction, Solution
from mobilecal_cli.report import plots, residual_plots

_MOST_PATHS = 4  # recordings with a top view

#: Figure name → SVG element.
Drawn = Mapping[str, str]

_OF_EXTRACTION: dict[str, Callable[[Extraction], str]] = {
    "stations": plots.station_residuals,
    "head": plots.head_angles,
    "left": lambda extraction: plots.picture_coverage(extraction, "left"),
    "right": lambda extraction: plots.picture_coverage(extraction, "right"),
    "residual_left": lambda extraction: residual_plots.picture_residuals(extraction, "left"),
    "residual_right": lambda extraction: residual_plots.picture_residuals(extraction, "right"),
}
_OF_SOLUTION: dict[str, Callable[[Solution, Extraction], str]] = {
    "nine": plots.all_convergence,
    "wheels": plots.wheel_convergence,
    "refinement": lambda solution, _: plots.refinement_convergence(solution),
    "legs": plots.leg_residuals,
    "budget": lambda solution, _: residual_plots.error_budget(solution),
    "correlation": lambda solution, _: residual_plots.correlation_matrix(solution),
}


@dataclass(frozen=True, slots=True)
class Figures:
    """SVG elements.

    Attributes:
        named: figure → element, "" where there is nothing to show.
        paths: per recording: its path, the top view, and the residuals over time.
    """

    named: Drawn
    paths: tuple[tuple[str, str, str], ...]


def draw_seen(extraction: Extraction) -> Drawn:
    """The figures that need no solution."""
    seen = bool(extraction.observations)
    return {name: draw(extraction) if seen else "" for name, draw in _OF_EXTRACTION.items()}


def _logs(extraction: Extraction) -> Sequence[int]:
    return sorted({o.log for o in extraction.observations})[:_MOST_PATHS]


def draw_solved(solution: Solution, extraction: Extraction) -> Drawn:
    """The figures that need the solution."""
    seen = bool(extraction.observations)
    drawn = {name: draw(solution, extraction) if seen else "" for name, draw in _OF_SOLUTION.items()}
    for log in _logs(extraction):
        drawn[f"above {log}"] = plots.seen_from_above(solution, extraction, log)
        drawn[f"time {log}"] = residual_plots.over_time(solution, extraction, log)
    return drawn


def put_together(drawn: Drawn, extraction: Extraction) -> Figures:
    """The drawn figures in the structure that the report needs."""
    named = {name: drawn[name] for name in (*_OF_SOLUTION, *_OF_EXTRACTION)}
    paths = [(extraction.log_names[i], drawn[f"above {i}"], drawn[f"time {i}"]) for i in _logs(extraction)]
    return Figures(named, tuple(paths))


def draw_figures(solution: Solution, extraction: Extraction) -> Figures:
    """Draw all figures of the report."""
    return put_together({**draw_seen(extraction), **draw_solved(solution, extraction)}, extraction)
