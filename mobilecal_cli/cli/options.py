"""Arguments and options that several commands share."""

from __future__ import annotations

import re
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from mobilecal_cli.cli.completion import gate_names, setting_keys
from mobilecal_cli.errors import ConfigError

_COUNTS = re.compile("([0-9]{1,9})x([0-9]{1,9})", re.IGNORECASE)
_LONGEST_SHOWN = 40  # characters of a text that is refused

Logs = Annotated[
    list[Path],
    typer.Argument(readable=False, help="Recordings of one robot: MCAP, rosbag2, .db3 or ROS 1 .bag."),
]
Config = Annotated[
    Path | None,
    typer.Option(
        "--config", "-c", readable=False, help="Configuration (rig.yaml); `mobilecal init` drafts one."
    ),
]
Settings = Annotated[
    list[str] | None,
    typer.Option(
        "--set",
        metavar="KEY=VALUE",
        help="Override rig.yaml, for example wheels.left.sign=-1. Repeatable.",
        autocompletion=setting_keys,
    ),
]
Gates = Annotated[
    list[str] | None,
    typer.Option(
        "--gate",
        metavar="NAME=LIMIT",
        help="Exit with code 6 if the figure exceeds the limit. Repeatable.",
        autocompletion=gate_names,
    ),
]
Force = Annotated[bool, typer.Option("--force", help="Replace existing output.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="Print no progress and no summary.")]
NoBar = Annotated[bool, typer.Option("--quiet", "-q", help="Print no progress.")]
Verbose = Annotated[
    bool, typer.Option("--verbose", "-v", help="Print each stage and its duration on standard error.")
]
OpenReport = Annotated[
    bool,
    typer.Option("--open", help="Open the report in the browser; without a display, print where it is."),
]
AsJson = Annotated[bool, typer.Option("--json", help="Print JSON instead of text.")]
JUnit = Annotated[
    Path | None,
    typer.Option("--junit", readable=False, help="Also write every criterion to this file as JUnit XML."),
]


class StationsName(StrEnum):
    """Which moments of a recording are used."""

    auto = "auto"
    all = "all"


def flags_of(
    settings: list[str] | None,
    board: str | None = None,
    square_m: float | None = None,
    stations: StationsName | None = None,
) -> dict[str, Any]:
    """The flags as dotted keys that override rig.yaml.

    Raises:
        ConfigError: a flag is not a valid setting or board size.
    """
    from mobilecal_cli.config import parse_setting

    flags = dict(parse_setting(text) for text in settings or [])
    if board is not None:
        columns, rows = counts_of("--board", board)
        flags |= {"board.columns": columns, "board.rows": rows}
    if square_m is not None:
        flags["board.square_m"] = square_m
    if stations is not None:
        flags["stations"] = stations.value
    return flags


def counts_of(option: str, text: str) -> tuple[int, int]:
    """Columns and rows of inner corners, from "9x6".

    Raises:
        ConfigError: another text.
    """
    found = _COUNTS.fullmatch(text)
    if found is None:
        given = text if len(text) <= _LONGEST_SHOWN else f"{text[:_LONGEST_SHOWN]}..."
        raise ConfigError(
            f"{option} {given}: not of the form COLUMNSxROWS",
            f"count the inner corners, for example {option} 9x6",
        )
    return int(found[1]), int(found[2])
