"""`mobilecal check`."""

from __future__ import annotations

from pathlib import Path

from mobilecal_cli.commands.options import Settings, show_each


def check(
    rig: Path, logs: list[Path], setting: Settings = None, as_json: bool = False, quiet: bool = False
) -> None:
    """Check a configuration against a recording, without calibrating.

    One line for each criterion: topics and their types, camera infos, wheels, head chain and joints, priors, times,
    motion, board and size of its squares. Exit code 0: no problem; with a limit, the result may not pass. Exit code 2
    to 5: a problem, at which a calibration would stop with this code. Writes nothing.

    Only `calibrate` finds wrong signs, ticks_per_revolution and delays of wheels, wrong signs and axes of head joints,
    and outliers: exit code 0 does not mean that the result passes.

    Example: mobilecal check rig.yaml log.mcap

    Args:
        rig: Configuration to check (rig.yaml).
        quiet: Print no progress.
    """
    from mobilecal_cli.calibrate.inspect import check as checked
    from mobilecal_cli.calibrate.inspect import recordings
    from mobilecal_cli.commands.terminal import progress_bar
    from mobilecal_cli.model.text import visible
    from mobilecal_cli.report.inspection import Inspection, checklist_json, checklist_text
    from mobilecal_cli.rig.config import parse_settings

    with progress_bar(quiet) as progress:
        flags = parse_settings(setting or [])
        inspections = [checked(rig, parts, flags, progress) for parts in recordings(logs)]

    def titled(each: Inspection) -> str:
        return f"{visible(each.name)}\n" * (len(inspections) > 1) + checklist_text(each)

    show_each(inspections, checklist_json if as_json else titled, as_json)
