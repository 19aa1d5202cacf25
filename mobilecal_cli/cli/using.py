"""Commands that work on calibrations alone."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mobilecal_cli.cli.app import app
from mobilecal_cli.cli.options import AsJson, Force
from mobilecal_cli.errors import QualityError


@app.command()
def compare(
    files: Annotated[
        list[Path], typer.Argument(help="params.yaml files of one robot, the first to compare with.")
    ],
    max_sigma: Annotated[
        float | None, typer.Option(min=0.0, help="Fail where a number moved by more standard deviations.")
    ] = None,
    max_ray_mm: Annotated[
        float | None, typer.Option(min=0.0, help="Fail where a point 2 m ahead moved by more, mm.")
    ] = None,
    max_heading_deg: Annotated[
        float | None, typer.Option(min=0.0, help="Fail where a turn on the spot moved by more, deg.")
    ] = None,
    plot: Annotated[Path | None, typer.Option(help="SVG file: every number over all calibrations.")] = None,
    as_json: AsJson = False,
    force: Force = False,
) -> None:
    """Say how far calibrations of one robot are apart: in units, in standard deviations, and in what a user feels.

    Example: mobilecal compare monday/params.yaml friday/params.yaml --max-sigma 4

    A history: mobilecal compare */params.yaml --plot drift.svg
    """
    from mobilecal_cli import pipeline
    from mobilecal_cli.report import comparison_json, comparison_text

    found = pipeline.compare(files, pipeline.Limits(max_sigma, max_ray_mm, max_heading_deg), plot, force)
    if as_json:
        typer.echo(comparison_json(found.names, found.robots, found.differences, found.past), nl=False)
    else:
        typer.echo(comparison_text(found.names, found.differences, found.past), nl=False)
    if found.broken:
        raise QualityError(
            "the calibrations are apart: " + "; ".join(found.broken),
            "calibrate once more to tell a changed robot from a bad recording",
        )
