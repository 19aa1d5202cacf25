"""`mobilecal inspect`."""

from __future__ import annotations

from pathlib import Path

from mobilecal_cli.commands.options import Settings, rig_of, show_each


def inspect(
    logs: list[Path],
    config: Path | None = None,
    setting: Settings = None,
    as_json: bool = False,
    quiet: bool = False,
) -> None:
    """Show what a recording contains and what is missing.

    Describes the recording: topics, the settings that a calibration would use, the motion and the board; `check` tests
    a rig.yaml against it. Samples a long recording, so that it takes seconds. Writes nothing.

    Example: mobilecal inspect log.mcap

    Args:
        quiet: Print no progress.
    """
    from mobilecal_cli.calibrate.inspect import inspect as inspected
    from mobilecal_cli.calibrate.inspect import recordings
    from mobilecal_cli.commands.terminal import progress_bar
    from mobilecal_cli.report.inspection import inspection_json, inspection_text

    with progress_bar(quiet) as progress:
        rig = rig_of(config, setting)
        inspections = [inspected(parts, rig, progress) for parts in recordings(logs)]
    show_each(inspections, inspection_json if as_json else inspection_text, as_json)
