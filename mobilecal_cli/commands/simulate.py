"""`mobilecal simulate`."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from mobilecal_cli.commands.options import written_line
from mobilecal_cli.targets import ROBOTS, BoardKind, Container, Motion, Pictures, Robot

_PAPER = Robot("paper")
_BY_SUFFIX: dict[str, Container] = {".mcap": "mcap", ".bag": "bag", "": "rosbag2"}


def simulate(
    out: Path,
    robot: Annotated[
        Robot, Option(help=f"{'; '.join(f'{name}: {meaning}' for name, meaning in ROBOTS.items())}.")
    ] = _PAPER,
    motion: Motion = "standard",
    seed: Annotated[int, Option(min=0)] = 0,
    stations: Annotated[int, Option(min=2)] = 12,
    container: Container | None = None,
    pictures: Pictures = "jpeg",
    board: BoardKind = "checkerboard",
    exact: bool = False,
    camera_late: Annotated[float, Option(min=-0.2, max=0.2)] = 0.0,
    force: bool = False,
    quiet: bool = False,
) -> None:
    """Simulate a recording with known truth.

    The truth is written to a YAML file next to the recording.

    Example: mobilecal simulate drive.mcap --robot paper --seed 7

    Args:
        out: Recording to write: a file, or a directory for rosbag2.
        motion: Motion of the base and the head.
        seed: Seed of the random numbers.
        stations: Number of stops; a moving recording lasts 3 s per stop.
        container: Container format. [default: from the file extension]
        pictures: Image encoding.
        board: Board on the wall; boards with markers may be partly visible.
        exact: No noise and no encoder quantization (use with png).
        camera_late: Delay of the camera clock, s.
    """
    from mobilecal_cli.commands.terminal import progress_bar
    from mobilecal_cli.errors import ConfigError
    from mobilecal_cli.model.text import visible
    from mobilecal_cli.simulate.record import simulate as record
    from mobilecal_cli.simulate.scenario import Scenario

    if container is None and out.suffix not in _BY_SUFFIX:
        raise ConfigError(
            f"{out}: {out.suffix} is not the suffix of a recording",
            "use .mcap, .bag, or a directory name without a suffix (rosbag2), or add --container",
        )
    scenario = Scenario(
        robot=robot.value,
        motion=motion,
        seed=seed,
        stations=stations,
        container=container or _BY_SUFFIX[out.suffix],
        pictures=pictures,
        kind=board,
        exact=exact,
        camera_late_s=camera_late,
    )
    with progress_bar(quiet) as progress:
        truth = record(scenario, out, force, progress)
    if not quiet:
        typer.echo(written_line(out, truth))
        settings = (f" --set {key}={value}" for key, value in scenario.unrecorded().items())
        typer.echo(visible(f"Next: mobilecal calibrate {shlex.quote(str(out))}{''.join(settings)}"))
