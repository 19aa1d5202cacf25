"""Commands that calibrate, and that test a calibration."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, cast

import typer

from mobilecal_cli.cli.app import app
from mobilecal_cli.cli.options import (
    AsJson,
    Config,
    Force,
    Gates,
    JUnit,
    Logs,
    NoBar,
    OpenReport,
    Quiet,
    Settings,
    StationsName,
    Verbose,
    flags_of,
)
from mobilecal_cli.cli.verdict import conclude
from mobilecal_cli.errors import MobilecalError, OutputError


class MethodName(StrEnum):
    """Methods that estimate the nine parameters."""

    linear = "linear"
    paper = "paper"
    lm = "lm"
    ml = "ml"


@contextmanager
def errors_to(
    junit: Path | None,
    logs: Sequence[Path],
    force: bool,
    others: Sequence[Path | None],
    output: Path | None = None,
) -> Iterator[None]:
    """Write an error to the JUnit file as well, unless that file must not be replaced."""
    from mobilecal_cli.export import check_file, write_file
    from mobilecal_cli.report.junit import junit_error_xml

    if junit is not None:
        if output is not None and junit.resolve().is_relative_to(output.resolve()):
            raise OutputError(
                f"--junit {junit}: inside the output directory, which is replaced as a whole",
                "choose a path outside of it",
            )
        check_file(junit, force, [*logs, *others])
    try:
        yield
    except MobilecalError as error:
        if junit is not None:
            write_file(junit, junit_error_xml(str(logs[0]), error), force)
        raise


@app.command()
def calibrate(
    logs: Logs,
    config: Config = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "--output", "-o", readable=False, help="Directory to write. [default: <log name>_calibration]"
        ),
    ] = None,
    method: Annotated[
        MethodName,
        typer.Option(
            help="ml: maximum likelihood; linear: iterative linear; paper: eq. 19; lm: eq. 19, faster."
        ),
    ] = MethodName.ml,
    board: Annotated[
        str | None, typer.Option(help="Inner corners, for example 9x6. [default: detected]")
    ] = None,
    square_m: Annotated[
        float | None, typer.Option(help="Side of a square, m. [default: measured by the stereo pair]")
    ] = None,
    stations: Annotated[
        StationsName | None,
        typer.Option(
            help="auto: stops, or the best moments of a moving recording; all: every image. [default: auto]",
            show_default=False,
        ),
    ] = None,
    jobs: Annotated[
        int | None,
        typer.Option(min=1, help="Worker processes for images. [default: one per core]"),
    ] = None,
    setting: Settings = None,
    fix: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME[=VALUE]",
            help="Fix a parameter or constant (m, rad, share), or head_eye or wheels. Repeatable.",
        ),
    ] = None,
    prior: Annotated[
        list[str] | None,
        typer.Option(metavar="NAME=VALUE±SIGMA", help="Prior of a parameter or constant. Repeatable."),
    ] = None,
    estimate: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME,...",
            help="Constants, or kinds of them, whose stated values are ignored: pan_zero, stereo_rotation, stereo.",
        ),
    ] = None,
    gate: Gates = None,
    hold_out: Annotated[
        float | None,
        typer.Option(
            min=0.0, max=0.8, help="Share at the end of each recording to hold out and to test the result on."
        ),
    ] = None,
    last: Annotated[
        Path | None,
        typer.Option(
            readable=False, help="params.yaml to compare the result with. [default: the nominal values]"
        ),
    ] = None,
    open_report: OpenReport = False,
    as_json: AsJson = False,
    junit: JUnit = None,
    force: Force = False,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Calibrate head and wheels, and write parameters and a report.

    Recordings of one robot are calibrated together. Files that continue each other count as one recording.

    Example: mobilecal calibrate log.mcap --config rig.yaml --output result

    In CI: mobilecal calibrate log.mcap --gate reprojection_rms_px=0.5 --gate std.wheels.separation_m=0.001 --json
    """
    from mobilecal_cli.export import write_file
    from mobilecal_cli.pipeline import calibrating
    from mobilecal_cli.report.junit import junit_xml
    from mobilecal_cli.report.text import summary_text
    from mobilecal_cli.solvers import constraints_of
    from mobilecal_cli.terminal import open_page, progress_bar

    with errors_to(junit, logs, force, [config, last], output or calibrating.default_output(logs[0])):
        flags = flags_of(setting, board, square_m, stations)
        constraints = constraints_of(fix or [], prior or [], estimate or [])
        with progress_bar(quiet, verbose) as progress:
            report, directory = calibrating.calibrate(
                logs,
                output,
                config_path=config,
                flags=flags,
                method=cast(Any, method.value),
                constraints=constraints,
                gates=gate or [],
                hold_out=hold_out or None,
                last=last,
                force=force,
                progress=progress,
                jobs=jobs or os.cpu_count() or 1,
            )
        if junit is not None:
            write_file(junit, junit_xml(str(logs[0]), report.values.verdict), force)
    if as_json:
        typer.echo(report.json, nl=False)
    elif not quiet:
        typer.echo(summary_text(report.values))
    if open_report:
        typer.echo(open_page(directory / "report.html"), err=True)
    verdict = report.verdict
    conclude(
        verdict.level,
        verdict.reason,
        verdict.next_step,
        written=(directory / "params.yaml", directory / "report.html"),
        quiet=as_json or quiet,
    )


@app.command()
def evaluate(
    logs: Logs,
    params: Annotated[Path, typer.Argument(readable=False, help="params.yaml of the calibration to test.")],
    before: Annotated[
        Path | None,
        typer.Option(
            readable=False,
            help="params.yaml with the wheels to compare drift with. [default: the nominal wheels]",
        ),
    ] = None,
    config: Config = None,
    setting: Settings = None,
    gate: Gates = None,
    as_json: AsJson = False,
    junit: JUnit = None,
    force: Annotated[bool, typer.Option("--force", help="Replace an existing JUnit file.")] = False,
    verbose: Verbose = False,
    quiet: NoBar = False,
) -> None:
    """Test a calibration on another recording.

    Prints the prediction errors from station to station, the drift of dead reckoning, and a verdict.

    Example: mobilecal evaluate another.mcap log_calibration/params.yaml

    In CI: mobilecal evaluate another.mcap params.yaml --gate translation_rms_mm=15 --gate drift_deg_per_turn=3
    """
    from mobilecal_cli.export import write_file
    from mobilecal_cli.pipeline import evaluating
    from mobilecal_cli.report.evaluation import evaluation_data, evaluation_json, evaluation_text
    from mobilecal_cli.report.junit import junit_xml
    from mobilecal_cli.report.verdict import verdict_data
    from mobilecal_cli.terminal import progress_bar

    with errors_to(junit, logs, force, [params, before, config]):
        with progress_bar(quiet, verbose) as progress:
            found = evaluating.evaluate(
                logs,
                params,
                before=before,
                config_path=config,
                flags=flags_of(setting),
                gates=gate or [],
                progress=progress,
            )
        if junit is not None:
            write_file(junit, junit_xml(str(logs[0]), verdict_data(found.verdict)), force)
    if as_json:
        text = evaluation_json(found.evaluation, found.extraction, found.verdict, found.checks, found.used)
    else:
        text = evaluation_text(evaluation_data(found.evaluation), found.notes, found.verdict)
    typer.echo(text, nl=False)
    conclude(found.verdict.level, found.verdict.reason, found.verdict.next_step, quiet=as_json)


@app.command()
def suggest(logs: Logs, config: Config = None, setting: Settings = None, quiet: NoBar = False) -> None:
    """Suggest additional stops that improve a calibration most.

    For each stop: where to drive, where to point the head, and the standard deviation to expect. Reads recordings or
    an extraction.npz. Writes nothing.

    Example: mobilecal suggest log.mcap
    """
    from mobilecal_cli.pipeline import calibrating
    from mobilecal_cli.terminal import progress_bar

    with progress_bar(quiet) as progress:
        lines = calibrating.suggest(logs, config, flags_of(setting), progress)
    typer.echo("\n".join(lines))
