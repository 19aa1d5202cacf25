"""The application that the commands belong to, and its common options."""

from __future__ import annotations

from typing import Annotated

import typer

from mobilecal_cli import __version__

app = typer.Typer(
    name="mobilecal",
    help="Calibrate the stereo head and the wheels of a differential-drive robot.",
    no_args_is_help=True,
    add_completion=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


def _version(requested: bool) -> None:
    if requested:
        typer.echo(f"mobilecal {__version__}")
        raise typer.Exit


@app.callback()
def common(
    version: Annotated[
        bool, typer.Option("--version", callback=_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Calibrate the stereo head and the wheels of a differential-drive robot from a recording of a checkerboard.

    Example: mobilecal calibrate log.mcap
    """
