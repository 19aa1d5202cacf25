"""`mobilecal suggest`."""

from __future__ import annotations

import typer

from mobilecal_cli.commands.options import Config, Logs, NoBar, Settings, flags_of


def suggest(logs: Logs, config: Config = None, setting: Settings = None, quiet: NoBar = False) -> None:
    """Suggest additional stops that improve a calibration most.

    For each stop: where to drive, where to point the head, and the standard deviation to expect. Reads recordings or
    an extraction.npz. Writes nothing.

    Example: mobilecal suggest log.mcap
    """
    from mobilecal_cli.calibrate import steps
    from mobilecal_cli.commands.terminal import progress_bar

    with progress_bar(quiet) as progress:
        lines = steps.suggest(logs, config, flags_of(setting), progress)
    typer.echo("\n".join(lines))
