"""`mobilecal suggest`."""

from __future__ import annotations

import typer

from mobilecal_cli.commands.options import AsJson, Config, Logs, NoBar, Settings, flags_of


def suggest(
    logs: Logs,
    config: Config = None,
    setting: Settings = None,
    as_json: AsJson = False,
    quiet: NoBar = False,
) -> None:
    """Suggest what improves a calibration most, the cheapest first.

    Limits of the expected errors (gates in rig.yaml) say what matters. A stop says where to drive, where to point the
    head, and the standard deviation to expect. Reads recordings or an extraction.npz. Writes nothing.

    Example: mobilecal suggest log.mcap
    """
    from mobilecal_cli.calibrate import steps
    from mobilecal_cli.commands.terminal import progress_bar
    from mobilecal_cli.report.formats import json_text
    from mobilecal_cli.rig.config import load_rig

    with progress_bar(quiet) as progress:
        advice = steps.suggest(logs, load_rig(config, flags_of(setting)), progress)
    typer.echo(json_text(advice) if as_json else "\n".join(advice.lines), nl=not as_json)
