"""`mobilecal init`."""

from __future__ import annotations

import os
import shlex
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from mobilecal_cli.calibrate import Progress, silent
from mobilecal_cli.commands.options import written_line
from mobilecal_cli.errors import ConfigError

if TYPE_CHECKING:
    from mobilecal_cli.rig.draft import Draft


def init(
    logs: list[Path],
    output: Path = Path("rig.yaml"),
    urdf: Path | None = None,
    force: bool = False,
    quiet: bool = False,
) -> None:
    """Write a commented draft of rig.yaml from a recording.

    Fills in what the topics, a few images and the URDF tell, each with its source. What is missing, or has two possible
    answers, is left to you as TODO, and listed.

    Example: mobilecal init log.mcap --urdf robot.urdf --output rig.yaml

    Args:
        output: File to write; - for standard output.
        urdf: URDF of the robot. [default: robot_description in the recording]
    """
    from mobilecal_cli.commands.terminal import progress_bar
    from mobilecal_cli.export.outputs import check_output, write_outputs
    from mobilecal_cli.report.inspection import draft_text

    stdout = str(output) == "-"
    if not stdout:
        check_output(output, force, [*logs, urdf])
    with progress_bar(quiet) as progress:
        made = draft(logs, urdf, None if stdout else output.parent, progress)
        if not stdout:
            write_outputs({output: made.text.encode()}, force)
    if stdout:
        typer.echo(made.text, nl=False)
    if not quiet:
        typer.echo(draft_text(made), nl=False, err=stdout)
        if not stdout:
            typer.echo(f"\n{written_line(output)}")
            typer.echo(f"Next: mobilecal check {shlex.join(map(str, (output, *logs)))}")


def draft(
    logs: Sequence[Path], urdf: Path | None = None, beside: Path | None = None, progress: Progress = silent
) -> Draft:
    """Commented draft of rig.yaml; from the most complete one of several recordings.

    Args:
        logs: recordings of one robot.
        urdf: URDF file to use in place of the one in the recording.
        beside: directory of the rig.yaml, which the path of the URDF is relative to; the working directory by default.

    Raises:
        RecordingError: a recording cannot be read.
        ConfigError: the URDF cannot be read, two paths have the same content, or the recordings are of two robots.
    """
    from mobilecal_cli.calibrate.inspect import recordings

    drafts = {parts[0]: _draft(parts, urdf, beside, progress) for parts in recordings(logs)}
    (first, its), *others = drafts.items()
    for log, other in others:
        for one, another in product(its.filled, other.filled):
            # Whether a counter starts again, and so has bits, is not in each recording.
            if one.key == another.key and one.value.split(", bits")[0] != another.value.split(", bits")[0]:
                raise ConfigError(
                    f"{first} and {log} need different configurations: {one.key} is {one.value} in one, and "
                    f"{another.value} in the other",
                    "draft a configuration for each robot, and for each board",
                )
    return min(drafts.values(), key=lambda each: len(each.todo))


def _draft(parts: Sequence[Path], urdf: Path | None, beside: Path | None, progress: Progress) -> Draft:
    """The draft from one recording, see `draft`."""
    from mobilecal_cli.calibrate.extract import describe
    from mobilecal_cli.calibrate.inspect import sample_board
    from mobilecal_cli.readers import open_recording
    from mobilecal_cli.rig.config import load_rig
    from mobilecal_cli.rig.draft import draft_rig

    config = load_rig(None, {"head.urdf": urdf})
    with open_recording(parts) as recording:
        progress("topics", 0, None)
        survey = describe(recording, config, joints_too=True)
        board = None
        if survey.sources.image:
            progress("images", 0, None)
            board, _ = sample_board(recording, survey)
        made = draft_rig(
            survey,
            parts[0].name,
            urdf_path=None if urdf is None else os.path.relpath(urdf, beside or Path()),
            board=board,
        )
        return replace(made, notes=(*made.notes, *recording.damage))
