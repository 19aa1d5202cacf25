"""The verdict as the commands print it: once, and with the exit code that it means."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import typer

from mobilecal_cli.errors import QualityError


def conclude(
    level: str,
    reason: str,
    next_step: str,
    *,
    written: Sequence[Path] = (),
    quiet: bool = False,
    exit_code: int = QualityError.exit_code,
) -> None:
    """Print the verdict on standard output.

    Args:
        level: "PASS", "FAIL" or "NOT ENOUGH".
        reason: one or two sentences.
        next_step: what to do now.
        written: the files written.
        quiet: print nothing on standard output (--quiet, --json), and a failure on standard error.
        exit_code: where the level is not PASS.

    Raises:
        Exit: with that code, as the level is not PASS.
    """
    from mobilecal_cli.terminal import verdict_text

    passed = level == "PASS"
    if not quiet or not passed:
        typer.echo(verdict_text(level, reason, next_step, to_stderr=quiet), err=quiet)
    if written and (not quiet or not passed):
        typer.echo(written_line(*written), err=quiet)
    if not passed:
        raise typer.Exit(exit_code)


def written_line(*paths: Path) -> str:
    """The line that says which files were written; their names must not control the terminal."""
    from mobilecal_cli.model.text import visible

    return f"Written: {visible(', '.join(map(str, paths)))}"
