"""All plots of a report by name. A new plot is a function and a line in a table here."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from mobilecal_cli.model import Extraction, Solution
from mobilecal_cli.report import plots, residual_plots

_MOST_PATHS = 4  # recordings with a top view
_PLOTS: Mapping[str, Callable[[Solution, Extraction], str]] = {
    "nine": lambda solution, _: plots.all_convergence(solution),
    "wheels": lambda solution, _: plots.wheel_convergence(solution),
    "refinement": lambda solution, _: plots.refinement_convergence(solution),
    "legs": residual_plots.leg_residuals,
    "budget": lambda solution, _: residual_plots.error_budget(solution),
    "correlation": lambda solution, _: residual_plots.correlation_matrix(solution),
    "stations": lambda _, extraction: residual_plots.station_residuals(extraction),
    "head": lambda _, extraction: plots.head_angles(extraction),
    "left": lambda _, extraction: plots.picture_coverage(extraction, "left"),
    "right": lambda _, extraction: plots.picture_coverage(extraction, "right"),
    "residual_left": lambda _, extraction: residual_plots.picture_residuals(extraction, "left"),
    "residual_right": lambda _, extraction: residual_plots.picture_residuals(extraction, "right"),
    "histogram": lambda _, extraction: residual_plots.residual_histogram(extraction),
}


@dataclass(frozen=True, slots=True)
class Figures:
    """SVG elements.

    Attributes:
        named: plot → element, "" where there is nothing to show.
        paths: per recording: its name, the top view, and the residuals over time.
    """

    named: Mapping[str, str]
    paths: tuple[tuple[str, str, str], ...]


def draw_figures(solution: Solution, extraction: Extraction) -> Figures:
    """Draw all plots of the report."""
    seen = bool(extraction.observations)
    logs = sorted({o.log for o in extraction.observations})[:_MOST_PATHS]
    return Figures(
        {name: draw(solution, extraction) if seen else "" for name, draw in _PLOTS.items()},
        tuple(
            (
                extraction.log_names[log],
                plots.seen_from_above(solution, extraction, log),
                residual_plots.over_time(solution, extraction, log),
            )
            for log in logs
        ),
    )
