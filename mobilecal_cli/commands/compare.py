"""`mobilecal compare`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from mobilecal_cli.commands.options import conclude


def compare(
    files: list[Path],
    max_sigma: Annotated[float | None, Option(min=0.0)] = None,
    max_ray_mm: Annotated[float | None, Option(min=0.0)] = None,
    max_heading_deg: Annotated[float | None, Option(min=0.0)] = None,
    plot: Path | None = None,
    as_json: bool = False,
    force: bool = False,
) -> None:
    """Compare calibrations of one robot.

    Prints the change of each parameter in units and in sigmas, and its effect on the robot. A limit that is exceeded
    ends with exit code 6.

    Example: mobilecal compare monday/params.yaml friday/params.yaml --max-sigma 4

    A history: mobilecal compare */params.yaml --plot drift.svg

    Args:
        files: params.yaml files of one robot; the first is the reference.
        max_sigma: Limit on the change of each parameter, in sigmas.
        max_ray_mm: Limit on the shift of a point 2 m ahead, mm.
        max_heading_deg: Limit on the change of heading per full turn, deg.
        plot: SVG file to write: every parameter over all calibrations.
    """
    from mobilecal_cli.calibrate.compare import compare as compared
    from mobilecal_cli.report.comparison import comparison_json, comparison_text

    limits = {"max_sigma": max_sigma, "max_ray_mm": max_ray_mm, "max_heading_deg": max_heading_deg}
    comparison = compared(files, plot=plot, force=force, **limits)
    typer.echo(comparison_json(comparison) if as_json else comparison_text(comparison), nl=False)
    if comparison.broken:
        conclude(
            "FAIL",
            f"The calibrations differ by more than the limit: {'; '.join(comparison.broken)}.",
            "Calibrate again to tell a changed robot from a bad recording.",
            quiet=as_json,
        )
