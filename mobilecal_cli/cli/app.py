"""The application that the commands join, and what they have in common."""

from __future__ import annotations

from typing import Annotated

import typer

from mobilecal_cli import __version__

app = typer.Typer(
    name="mobilecal",
    help="Calibrate a differential-drive robot's stereo head and wheels from a recording of a checkerboard.",
    no_args_is_help=True,
    add_completion=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def _version(wanted: bool) -> None:
    if wanted:
        typer.echo(f"mobilecal {__version__}")
        raise typer.Exit


@app.callback()
def common(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version.")
    ] = False,
) -> None:
    """Calibrate a differential-drive robot's stereo head and wheels from a recording of a checkerboard.

    Example: mobilecal calibrate log.mcap
    """
