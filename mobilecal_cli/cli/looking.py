"""Commands that read a recording without calibrating."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mobilecal_cli.cli.app import app
from mobilecal_cli.cli.options import AsJson, Config, Force, Logs, NoBar, Settings, flags_of
from mobilecal_cli.cli.verdict import written_line


@app.command()
def inspect(
    logs: Logs,
    config: Config = None,
    setting: Settings = None,
    as_json: AsJson = False,
    quiet: NoBar = False,
) -> None:
    """Show what a recording contains and what is missing.

    Describes the recording: topics, the settings that a calibration would use, the motion and the board; `check` tests
    a rig.yaml against it. Samples a long recording, so that it takes seconds. Writes nothing.

    Example: mobilecal inspect log.mcap
    """
    from mobilecal_cli import pipeline
    from mobilecal_cli.report import inspection_json, inspection_text
    from mobilecal_cli.terminal import progress_bar

    with progress_bar(quiet) as progress:
        found = pipeline.inspect(logs, config, flags_of(setting), progress)
    typer.echo(inspection_json(found) if as_json else inspection_text(found), nl=False)
    if found.exit_code:
        raise typer.Exit(found.exit_code)


@app.command()
def check(
    rig: Annotated[Path, typer.Argument(help="Configuration to check (rig.yaml).")],
    logs: Logs,
    setting: Settings = None,
    as_json: AsJson = False,
    quiet: NoBar = False,
) -> None:
    """Check a configuration against a recording, without calibrating.

    One line for each criterion: topics and their types, camera infos, wheels, head chain and joints, times, motion,
    board and size of its squares. The exit code is that of a calibration. Writes nothing.

    Example: mobilecal check rig.yaml log.mcap
    """
    from mobilecal_cli import pipeline
    from mobilecal_cli.report import checklist_json, checklist_text
    from mobilecal_cli.terminal import progress_bar

    with progress_bar(quiet) as progress:
        found = pipeline.check(rig, logs, flags_of(setting), progress)
    typer.echo(checklist_json(found) if as_json else checklist_text(found), nl=False)
    if found.exit_code:
        raise typer.Exit(found.exit_code)


@app.command()
def init(
    log: Annotated[Path, typer.Argument(help="Recording to read.")],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="File to write; - for standard output.")
    ] = Path("rig.yaml"),
    force: Force = False,
) -> None:
    """Write a commented draft of rig.yaml from a recording.

    Example: mobilecal init log.mcap --output rig.yaml
    """
    from mobilecal_cli import pipeline

    if str(output) == "-":
        typer.echo(pipeline.draft(log), nl=False)
        return
    pipeline.write_draft(log, output, force)
    typer.echo(written_line(output))
