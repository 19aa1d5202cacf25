"""All figures of a report, as texts: they can be drawn before the page is put together, and elsewhere."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from mobilecal_cli.model import Extraction, Solution
from mobilecal_cli.report import plots, residual_plots

_MOST_PATHS = 4  # logs that are drawn from above


@dataclass(frozen=True, slots=True)
class Figures:
    """SVG elements.

    Attributes:
        named: figure → element, the empty text where there is nothing to show.
        paths: of each log, its recording, the way seen from above, and the residuals over time.
    """

    named: Mapping[str, str]
    paths: tuple[tuple[str, str, str], ...]


def draw_figures(solution: Solution, extraction: Extraction) -> Figures:
    """Draw what the report shows."""
    drawn: dict[str, Callable[[], str]] = {
        "wheels": lambda: plots.wheel_convergence(solution, extraction),
        "nine": lambda: plots.all_convergence(solution, extraction),
        "refinement": lambda: plots.refinement_convergence(solution),
        "legs": lambda: plots.leg_residuals(solution, extraction),
        "stations": lambda: plots.station_residuals(extraction),
        "head": lambda: plots.head_angles(extraction),
        "left": lambda: plots.picture_coverage(extraction, "left"),
        "right": lambda: plots.picture_coverage(extraction, "right"),
        "residual_left": lambda: residual_plots.picture_residuals(extraction, "left"),
        "residual_right": lambda: residual_plots.picture_residuals(extraction, "right"),
        "correlation": lambda: residual_plots.correlation_matrix(solution),
    }
    logs = sorted({o.log for o in extraction.observations})[:_MOST_PATHS]
    return Figures(
        {name: draw() if extraction.observations else "" for name, draw in drawn.items()},
        tuple(
            (
                extraction.logs[log].path,
                plots.seen_from_above(solution, extraction, log),
                residual_plots.over_time(solution, extraction, log),
            )
            for log in logs
        ),
    )
