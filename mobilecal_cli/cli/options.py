"""What several commands take."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from mobilecal_cli.errors import ConfigError

Logs = Annotated[list[Path], typer.Argument(help="Recordings of one robot: MCAP, rosbag2, .db3, ROS 1 .bag.")]
Config = Annotated[Path | None, typer.Option("--config", "-c", help="rig.yaml; see `mobilecal init`.")]
Settings = Annotated[
    list[str] | None, typer.Option("--set", help="KEY=VALUE over rig.yaml, such as wheels.left.sign=-1.")
]
Gates = Annotated[
    list[str] | None,
    typer.Option("--gate", help="NAME=LIMIT: fail (exit code 6) where a figure leaves it; may be repeated."),
]
Force = Annotated[bool, typer.Option("--force", help="Replace an output that is there already.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress bar and no summary.")]
NoBar = Annotated[bool, typer.Option("--quiet", "-q", help="No progress bar.")]
Verbose = Annotated[
    bool, typer.Option("--verbose", "-v", help="Say what is done and how long it takes, on standard error.")
]
AsJson = Annotated[bool, typer.Option("--json", help="JSON for programs on standard output instead of text.")]
JUnit = Annotated[
    Path | None, typer.Option("--junit", help="Also write every criterion as JUnit XML to this file.")
]


class StationsName(StrEnum):
    """Which moments are looked at."""

    auto = "auto"
    all = "all"


def flags_of(
    settings: list[str] | None,
    board: str | None = None,
    square_m: float | None = None,
    stations: StationsName | None = None,
) -> dict[str, Any]:
    """The flags as dotted keys over rig.yaml.

    Raises:
        ConfigError: one that is no setting, or no board.
    """
    from mobilecal_cli.config import parse_setting

    flags = dict(parse_setting(text) for text in settings or [])
    if board is not None:
        columns, x, rows = board.lower().partition("x")
        if not (x and columns.isdigit() and rows.isdigit()):
            raise ConfigError(f"--board {board}: not COLUMNSxROWS", "count the inner corners: --board 9x6")
        flags |= {"board.columns": int(columns), "board.rows": int(rows)}
    if square_m is not None:
        flags["board.square_m"] = square_m
    if stations is not None:
        flags["stations"] = stations.value
    return flags
