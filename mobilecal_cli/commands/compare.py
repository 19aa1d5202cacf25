"""`mobilecal compare`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from mobilecal_cli.commands.options import conclude
from mobilecal_cli.errors import ConfigError


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
    from mobilecal_cli.calibrate.load import read_params
    from mobilecal_cli.comparison import broken_limits
    from mobilecal_cli.export.outputs import check_output, write_outputs
    from mobilecal_cli.report.comparison import Comparison, comparison_json, comparison_text, history_plot
    from mobilecal_cli.report.verdict import Verdict

    if len(files) < 2:
        raise ConfigError("only one calibration to compare", "give two or more params.yaml files")
    if plot is not None:
        check_output(plot, force, files)
    comparison = Comparison(tuple(map(str, files)), tuple(map(read_params, files)))
    broken = [
        f"{name}: {what}"
        for name, change in zip(comparison.names[1:], comparison.differences, strict=True)
        for what in broken_limits(change, max_sigma, max_ray_mm, max_heading_deg)
    ]
    if plot is not None:
        write_outputs({plot: history_plot(comparison).encode()}, force)
    typer.echo(comparison_json(comparison) if as_json else comparison_text(comparison), nl=False)
    if broken:
        reason = f"The calibrations differ by more than the limit: {'; '.join(broken)}."
        again = "Calibrate again to tell a changed robot from a bad recording."
        conclude(Verdict("FAIL", reason, again), quiet=as_json)
