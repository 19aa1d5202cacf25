"""Commands that look at a recording without solving it."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mobilecal_cli.cli.app import app
from mobilecal_cli.cli.options import AsJson, Config, Force, Logs, NoBar, Settings, flags_of


@app.command()
def inspect(
    logs: Logs,
    config: Config = None,
    setting: Settings = None,
    as_json: AsJson = False,
    quiet: NoBar = False,
) -> None:
    """Say what a recording holds, what would be used of it, and what is missing for a calibration.

    Looks at a part of a long recording only, so it answers in seconds, and writes nothing.

    Example: mobilecal inspect log.mcap
    """
    from mobilecal_cli import pipeline
    from mobilecal_cli.report import inspection_json, inspection_text
    from mobilecal_cli.terminal import progress_bar

    with progress_bar(quiet) as progress:
        found = pipeline.inspect(logs, config, flags_of(setting), progress)
    typer.echo(inspection_json(found) if as_json else inspection_text(found), nl=False)


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
