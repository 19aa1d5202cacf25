"""Commands that solve, and try what was solved."""

from __future__ import annotations

import os
from collections.abc import Iterator
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
    Quiet,
    Settings,
    StationsName,
    Verbose,
    flags_of,
)
from mobilecal_cli.errors import MobilecalError, QualityError


class MethodName(StrEnum):
    """How the nine numbers are solved for."""

    linear = "linear"
    paper = "paper"
    lm = "lm"
    ml = "ml"


@contextmanager
def _told_to(junit: Path | None, name: str, force: bool) -> Iterator[None]:
    """What goes wrong also goes to a JUnit file, but for a file that must not be replaced."""
    from mobilecal_cli import pipeline

    if junit is not None:
        pipeline.check_file(junit, force)
    try:
        yield
    except QualityError:
        raise
    except MobilecalError as error:
        if junit is not None:
            pipeline.write_junit_error(junit, name, error, force)
        raise


@app.command()
def calibrate(
    logs: Logs,
    config: Config = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Directory to write. [default: <log name>_calibration]"),
    ] = None,
    method: Annotated[
        MethodName,
        typer.Option(
            help="ml: maximum likelihood; linear: iterative linear; paper: eq. 19; lm: eq. 19, faster."
        ),
    ] = MethodName.ml,
    board: Annotated[
        str | None, typer.Option(help="Inner corners, such as 9x6. [default: found by itself]")
    ] = None,
    square_m: Annotated[
        float | None, typer.Option(help="Side of a square, m. [default: from the stereo pair]")
    ] = None,
    stations: Annotated[
        StationsName | None,
        typer.Option(
            help="auto: rests, or the best moments of a moving log; all: every picture. [default: auto]",
            show_default=False,
        ),
    ] = None,
    jobs: Annotated[
        int | None,
        typer.Option(
            min=1, help="Processes that look at a long log's pictures and draw. [default: one a core]"
        ),
    ] = None,
    setting: Settings = None,
    fix: Annotated[
        list[str] | None,
        typer.Option(help="NAME or NAME=VALUE (m, rad): hold it there; also head_eye, wheels."),
    ] = None,
    prior: Annotated[list[str] | None, typer.Option(help="NAME=VALUE±SIGMA: what is known of it.")] = None,
    estimate: Annotated[
        list[str] | None, typer.Option(help="NAME,...: numbers beside the nine, such as pan_zero or mount.")
    ] = None,
    gate: Gates = None,
    hold_out: Annotated[
        float | None,
        typer.Option(
            min=0.0, max=0.8, help="Leave so large a share of each log's end out, and try the result on it."
        ),
    ] = None,
    last: Annotated[
        Path | None, typer.Option(help="params.yaml of the last calibration. [default: the nominal values]")
    ] = None,
    as_json: AsJson = False,
    junit: JUnit = None,
    force: Force = False,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Read recordings, solve for all nine numbers, and write parameters and a report.

    Several recordings of one robot are solved together; files that follow one another are one recording.

    Example: mobilecal calibrate log.mcap --config rig.yaml --output result

    In CI: mobilecal calibrate log.mcap --gate reprojection_rms_px=0.5 --gate std.wheels.separation_m=0.001 --json
    """
    from mobilecal_cli import pipeline
    from mobilecal_cli.report import summary_table
    from mobilecal_cli.solvers import asked_of
    from mobilecal_cli.terminal import progress_bar

    with _told_to(junit, str(logs[0]), force):
        flags = flags_of(setting, board, square_m, stations)
        asked = asked_of(fix or [], prior or [], estimate or [])
        with progress_bar(quiet, verbose) as progress:
            result = pipeline.calibrate(
                logs,
                output,
                config_path=config,
                flags=flags,
                method=cast(Any, method.value),
                asked=asked,
                gates=gate or [],
                hold_out=hold_out or None,
                last=last,
                force=force,
                progress=progress,
                jobs=jobs or os.cpu_count() or 1,
            )
        if junit is not None:
            pipeline.write_junit(junit, str(logs[0]), result.verdict.checks, force)
    if as_json:
        typer.echo((result.directory / "report.json").read_text(encoding="utf-8"), nl=False)
    elif not quiet:
        typer.echo(summary_table(result.solution, result.extraction, result.verdict, result.trial))
        typer.echo(f"written: {result.directory / 'params.yaml'}, {result.directory / 'report.html'}")
    if result.verdict.level != "PASS":
        raise QualityError(
            f"{result.verdict.level}: {result.verdict.reason}",
            f"{result.verdict.next_step} (see {result.directory / 'report.html'})",
        )


@app.command()
def evaluate(
    logs: Logs,
    params: Annotated[Path, typer.Argument(help="params.yaml of an earlier calibration.")],
    before: Annotated[
        Path | None,
        typer.Option(help="params.yaml whose wheels drift is compared with. [default: the nominal wheels]"),
    ] = None,
    config: Config = None,
    setting: Settings = None,
    gate: Gates = None,
    as_json: AsJson = False,
    junit: JUnit = None,
    force: Annotated[bool, typer.Option("--force", help="Replace the JUnit file.")] = False,
    verbose: Verbose = False,
    quiet: NoBar = False,
) -> None:
    """Try a calibration on a recording that it was not made from: what it predicts from stop to stop, and its drift.

    Example: mobilecal evaluate another.mcap log_calibration/params.yaml

    In CI: mobilecal evaluate another.mcap params.yaml --gate translation_rms_mm=15 --gate drift_deg_per_turn=3
    """
    from mobilecal_cli import pipeline
    from mobilecal_cli.report import evaluation_json, evaluation_text
    from mobilecal_cli.terminal import progress_bar

    with _told_to(junit, str(logs[0]), force):
        with progress_bar(quiet, verbose) as progress:
            found = pipeline.evaluate(
                logs,
                params,
                before=before,
                config_path=config,
                flags=flags_of(setting),
                gates=gate or [],
                progress=progress,
            )
        if junit is not None:
            pipeline.write_junit(junit, str(logs[0]), found.checks, force)
    if as_json:
        typer.echo(evaluation_json(found.evaluation, found.extraction, found.checks), nl=False)
    else:
        typer.echo(evaluation_text(found.evaluation, found.checks), nl=False)
    failed = [check for check in found.checks if check.outcome != "good"]
    if failed:
        raise QualityError("; ".join(check.why for check in failed), failed[0].next_step)


@app.command()
def suggest(logs: Logs, config: Config = None, setting: Settings = None, quiet: NoBar = False) -> None:
    """Say which stops would improve a recording most: where to drive, where to look, and what it would bring.

    Reads recordings, or the extraction.npz of an earlier calibration, and writes nothing.

    Example: mobilecal suggest log.mcap
    """
    from mobilecal_cli import pipeline
    from mobilecal_cli.terminal import progress_bar

    with progress_bar(quiet) as progress:
        lines = pipeline.suggest(logs, config, flags_of(setting), progress)
    typer.echo("\n".join(lines))
