"""`mobilecal suggest`."""

from __future__ import annotations

from pathlib import Path

import typer

from mobilecal_cli.commands.options import Settings, rig_of


def suggest(
    logs: list[Path],
    config: Path | None = None,
    setting: Settings = None,
    as_json: bool = False,
    quiet: bool = False,
) -> None:
    """Suggest what improves a calibration most, the cheapest first.

    Limits of the expected errors (gates in rig.yaml) say what matters. A stop says where to drive, where to point the
    head, and the standard deviation to expect. Reads recordings or an extraction.npz. Writes nothing.

    Example: mobilecal suggest log.mcap

    Args:
        quiet: Print no progress.
    """
    from mobilecal_cli.calibrate import steps
    from mobilecal_cli.commands.terminal import progress_bar
    from mobilecal_cli.report.formats import json_text

    with progress_bar(quiet) as progress:
        advice = steps.suggest(logs, rig_of(config, setting), progress)
    typer.echo(json_text(advice) if as_json else "\n".join(advice.lines), nl=not as_json)
