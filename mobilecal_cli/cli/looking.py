"""Commands that read a recording without calibrating."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from mobilecal_cli.cli.app import app
from mobilecal_cli.cli.options import AsJson, Config, Force, Logs, NoBar, Quiet, Settings, flags_of
from mobilecal_cli.cli.verdict import written_line

if TYPE_CHECKING:
    from mobilecal_cli.model import Inspection


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
    from mobilecal_cli.pipeline import inspecting
    from mobilecal_cli.report.inspection import inspection_json, inspection_text
    from mobilecal_cli.terminal import progress_bar

    with progress_bar(quiet) as progress:
        flags = flags_of(setting)
        found = [inspecting.inspect(parts, config, flags, progress) for parts in inspecting.recordings(logs)]
    _show(found, [inspection_json(each) if as_json else inspection_text(each) for each in found], as_json)


@app.command()
def check(
    rig: Annotated[Path, typer.Argument(readable=False, help="Configuration to check (rig.yaml).")],
    logs: Logs,
    setting: Settings = None,
    as_json: AsJson = False,
    quiet: NoBar = False,
) -> None:
    """Check a configuration against a recording, without calibrating.

    One line for each criterion: topics and their types, camera infos, wheels, head chain and joints, priors, times,
    motion, board and size of its squares. Exit code 0: no problem; with a limit, the result may not pass. Exit code 2
    to 5: a problem, at which a calibration would stop with this code. Writes nothing.

    Only `calibrate` finds wrong signs, ticks_per_revolution and delays of wheels, wrong signs and axes of head joints,
    and outliers: exit code 0 does not mean that the result passes.

    Example: mobilecal check rig.yaml log.mcap
    """
    from mobilecal_cli.model.text import visible
    from mobilecal_cli.pipeline import inspecting
    from mobilecal_cli.report.inspection import checklist_json, checklist_text
    from mobilecal_cli.terminal import progress_bar

    with progress_bar(quiet) as progress:
        flags = flags_of(setting)
        found = [inspecting.check(rig, parts, flags, progress) for parts in inspecting.recordings(logs)]
    if as_json:
        texts = [checklist_json(each) for each in found]
    else:
        titles = [f"{visible(each.name)}\n" if len(found) > 1 else "" for each in found]
        texts = [title + checklist_text(each) for title, each in zip(titles, found, strict=True)]
    _show(found, texts, as_json)


def _show(found: Sequence[Inspection], texts: Sequence[str], as_json: bool) -> None:
    """Print one recording after another, in JSON as a list if there are several; end with the largest exit code."""
    if as_json and len(texts) > 1:
        typer.echo(f"[\n{','.join(texts)}]")
    else:
        typer.echo("\n".join(texts), nl=False)
    code = max(each.exit_code for each in found)
    if code:
        raise typer.Exit(code)


@app.command()
def init(
    logs: Logs,
    output: Annotated[
        Path, typer.Option("--output", "-o", readable=False, help="File to write; - for standard output.")
    ] = Path("rig.yaml"),
    urdf: Annotated[
        Path | None,
        typer.Option(readable=False, help="URDF of the robot. [default: robot_description in the recording]"),
    ] = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Write a commented draft of rig.yaml from a recording.

    Fills in what the topics, a few images and the URDF tell, each with its source. What is missing, or has two possible
    answers, is left to you as TODO, and listed.

    Example: mobilecal init log.mcap --urdf robot.urdf --output rig.yaml
    """
    from mobilecal_cli.pipeline import drafting
    from mobilecal_cli.report.inspection import draft_text
    from mobilecal_cli.terminal import progress_bar

    stdout = str(output) == "-"
    with progress_bar(quiet) as progress:
        if stdout:
            made = drafting.draft(logs, urdf, progress=progress)
        else:
            made = drafting.write_draft(logs, output, force, urdf, progress)
    if stdout:
        typer.echo(made.text, nl=False)
    if not quiet:
        typer.echo(draft_text(made), nl=False, err=stdout)
        if not stdout:
            typer.echo(f"\n{written_line(output)}")
            typer.echo(f"Next: mobilecal check {shlex.join(map(str, (output, *logs)))}")
