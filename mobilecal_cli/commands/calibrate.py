"""`mobilecal calibrate`."""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Annotated, Literal

import typer
from typer import Option

from mobilecal_cli.commands import options
from mobilecal_cli.errors import OutputError


def calibrate(
    logs: list[Path],
    config: Path | None = None,
    output: Path | None = None,
    method: Literal["linear", "paper", "lm", "ml"] = "ml",
    board: str | None = None,
    square_m: float | None = None,
    stations: Literal["auto", "all"] | None = None,
    jobs: Annotated[int | None, Option(min=1)] = None,
    setting: options.Settings = None,
    fix: Annotated[list[str] | None, Option(metavar="NAME[=VALUE],...")] = None,
    prior: Annotated[list[str] | None, Option(metavar="NAME=VALUE±SIGMA")] = None,
    estimate: Annotated[list[str] | None, Option(metavar="NAME,...")] = None,
    gate: options.Gates = None,
    hold_out: float | None = None,
    last: Path | None = None,
    open_report: bool = False,
    as_json: bool = False,
    junit: Path | None = None,
    summary: Path | None = None,
    force: bool = False,
    verbose: bool = False,
    quiet: bool = False,
) -> None:
    """Calibrate head and wheels, and write parameters and a report.

    Recordings of one robot are calibrated together. Files that continue each other count as one recording.

    Example: mobilecal calibrate log.mcap --config rig.yaml --output result

    In CI: mobilecal calibrate log.mcap --gate predicted.camera_mm=5 --gate std.wheels.separation_m=0.002 --json

    Args:
        output: Directory to write. [default: <log name>_calibration]
        method: ml: maximum likelihood, with standard deviations; linear: no initial values; paper: least point error by
            Powell's method; lm: the same, faster.
        board: Inner corners, for example 9x6. [default: detected]
        square_m: Side of a square, m. [default: measured by the stereo pair]
        stations: auto: stops, or the best moments of a moving recording; all: every image. [default: auto]
        jobs: Worker processes for images. [default: one per core]
        fix: Fix parameters or constants (m, rad, share), or head_eye or wheels. Repeatable.
        prior: Prior of a parameter or constant. Repeatable.
        estimate: Constants, or kinds of them, whose stated values are ignored: pan_zero, stereo_rotation, stereo.
        hold_out: Share at the end of each recording to hold out and to test the result on.
        last: params.yaml to compare the result with. [default: the nominal values]
        open_report: Open the report in the browser; without a display, print where it is.
        summary: Append verdict, numbers and change to this file as Markdown, for example $GITHUB_STEP_SUMMARY.
    """
    from mobilecal_cli.calibrate import steps
    from mobilecal_cli.commands.terminal import open_page, progress_bar
    from mobilecal_cli.export.outputs import append_text, check_output
    from mobilecal_cli.report.junit import junit_xml
    from mobilecal_cli.report.text import summary_text
    from mobilecal_cli.rig.config import load_rig, parse_settings
    from mobilecal_cli.solvers import constraints_of

    began_s = time.perf_counter()
    if output is None:
        name = logs[0].resolve().name if logs[0].is_dir() else logs[0].stem
        output = Path(f"{name}_calibration")
    outputs = {"--summary": summary, "--output": output}
    with options.junit_file(junit, logs, force, [config, last], outputs) as write_junit:
        if summary is not None:
            check_output(summary, True, [*logs, config, last])
        flags = parse_settings(setting or [])
        if board is not None:
            flags["board.columns"], flags["board.rows"] = options.counts_of("--board", board)
        given = {"board.square_m": square_m, "stations": stations}
        flags |= {key: value for key, value in given.items() if value is not None}
        constraints = constraints_of(fix or [], prior or [], estimate or [])
        rig = load_rig(config, flags)
        with progress_bar(quiet, verbose) as progress:
            report = steps.calibrate(
                logs,
                output,
                config=rig,
                method=method,
                constraints=constraints,
                gates=gate or [],
                hold_out=hold_out,
                last=last,
                force=force,
                progress=progress,
                jobs=jobs or os.cpu_count() or 1,
            )
        try:
            if summary is not None:
                append_text(summary, report.markdown)
            write_junit(junit_xml(str(logs[0]), report.verdict, time.perf_counter() - began_s))
        except OutputError as error:
            raise OutputError(f"{error.message}; the results are written to {output}", error.hint) from error
    if as_json:
        typer.echo(report.json, nl=False)
    elif not quiet:
        typer.echo(summary_text(report.values, verbose))
    if open_report:
        typer.echo(open_page(output / "report.html"), err=True)
    written = output / "params.yaml", output / "report.html"
    options.conclude(report.verdict, written=written, quiet=as_json or quiet)
