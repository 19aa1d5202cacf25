"""The commands. Each is a few lines; `main` turns errors into messages and exit codes."""

from __future__ import annotations

import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, cast

import typer

from mobilecal_cli import __version__
from mobilecal_cli.errors import ConfigError, MobilecalError

app = typer.Typer(
    name="mobilecal",
    help="Calibrate a differential-drive robot's stereo head and wheels from a recording of a checkerboard.",
    no_args_is_help=True,
    add_completion=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


class MethodName(StrEnum):
    """How the nine numbers are solved for."""

    linear = "linear"
    paper = "paper"
    lm = "lm"


Logs = Annotated[list[Path], typer.Argument(help="Recordings of one robot: MCAP, rosbag2, .db3, ROS 1 .bag.")]
Config = Annotated[Path | None, typer.Option("--config", "-c", help="rig.yaml; see `mobilecal init`.")]
Force = Annotated[bool, typer.Option("--force", help="Replace an output that is there already.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress bar and no summary.")]


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"mobilecal {__version__}")
        raise typer.Exit


@app.callback()
def common(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Calibrate a differential-drive robot's stereo head and wheels from a recording of a checkerboard.

    Example: mobilecal calibrate log.mcap
    """


def _flags(board: str | None, square_m: float | None, settings: list[str]) -> dict[str, Any]:
    """The flags as dotted keys over rig.yaml."""
    from mobilecal_cli.config import parse_setting

    flags = dict(parse_setting(text) for text in settings)
    if board is not None:
        columns, x, rows = board.lower().partition("x")
        if not (x and columns.isdigit() and rows.isdigit()):
            raise ConfigError(f"--board {board}: not COLUMNSxROWS", "count the inner corners: --board 9x6")
        flags |= {"board.columns": int(columns), "board.rows": int(rows)}
    if square_m is not None:
        flags["board.square_m"] = square_m
    return flags


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
        typer.Option(help="linear: iterative linear; paper: eq. 19 by Powell; lm: by Levenberg-Marquardt."),
    ] = MethodName.lm,
    board: Annotated[
        str | None, typer.Option(help="Inner corners, such as 9x6. [default: found by itself]")
    ] = None,
    square_m: Annotated[
        float | None, typer.Option(help="Side of a square, m. [default: from the stereo pair]")
    ] = None,
    setting: Annotated[
        list[str] | None, typer.Option("--set", help="KEY=VALUE over rig.yaml, such as wheels.left.sign=-1.")
    ] = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Read recordings, solve for all nine numbers, and write parameters and a report.

    Several recordings of one robot are solved together; files that follow one another are one recording.

    Example: mobilecal calibrate log.mcap --config rig.yaml --output result
    """
    from mobilecal_cli import pipeline
    from mobilecal_cli.report import summary_table
    from mobilecal_cli.terminal import progress_bar

    flags = _flags(board, square_m, setting or [])
    with progress_bar(quiet) as progress:
        result = pipeline.calibrate(
            logs,
            output,
            config_path=config,
            flags=flags,
            method=cast(Any, method.value),
            force=force,
            progress=progress,
        )
    if not quiet:
        typer.echo(summary_table(result.solution, result.extraction, result.verdict))
        typer.echo(f"written: {result.directory / 'params.yaml'}, {result.directory / 'report.html'}")


@app.command()
def init(
    log: Annotated[Path, typer.Argument(help="A recording.")],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="File to write, - for standard output.")
    ] = Path("rig.yaml"),
    force: Force = False,
) -> None:
    """Write a commented draft of rig.yaml from what a recording tells.

    Example: mobilecal init log.mcap --output rig.yaml
    """
    from mobilecal_cli import pipeline

    if str(output) == "-":
        typer.echo(pipeline.draft(log), nl=False)
        return
    pipeline.write_draft(log, output, force)
    typer.echo(f"written: {output}")


def main() -> None:
    """Run the command line and leave with the exit code that fits."""
    try:
        app()
    except MobilecalError as error:
        print(f"error: {error.message}", file=sys.stderr)
        if error.hint:
            print(f"hint: {error.hint}", file=sys.stderr)
        sys.exit(error.exit_code)
    except KeyboardInterrupt:
        print("interrupted: nothing was written", file=sys.stderr)
        sys.exit(130)
