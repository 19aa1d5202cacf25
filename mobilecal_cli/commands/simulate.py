"""`mobilecal simulate`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from mobilecal_cli.commands.options import Force, Quiet, path_argument, written_line
from mobilecal_cli.targets import ROBOTS, BoardKind, Container, Motion, Pictures, Robot

_PAPER = Robot("paper")
_BY_SUFFIX: dict[str, Container] = {".mcap": "mcap", ".bag": "bag"}


def simulate(
    out: Annotated[Path, path_argument(help="Recording to write: a file, or a directory for rosbag2.")],
    robot: Annotated[
        Robot, Option(help=f"{'; '.join(f'{name}: {meaning}' for name, meaning in ROBOTS.items())}.")
    ] = _PAPER,
    motion: Annotated[Motion, Option(help="Motion of the base and the head.")] = "standard",
    seed: Annotated[int, Option(min=0, help="Seed of the random numbers.")] = 0,
    stations: Annotated[
        int, Option(min=2, help="Number of stops; a moving recording lasts 3 s per stop.")
    ] = 12,
    container: Annotated[
        Container | None, Option(help="Container format. [default: from the file extension]")
    ] = None,
    pictures: Annotated[Pictures, Option(help="Image encoding.")] = "jpeg",
    board: Annotated[
        BoardKind, Option(help="Board on the wall; boards with markers may be partly visible.")
    ] = "checkerboard",
    exact: Annotated[
        bool, Option("--exact", help="No noise and no encoder quantization (use with png).")
    ] = False,
    camera_late: Annotated[float, Option(min=-0.2, max=0.2, help="Delay of the camera clock, s.")] = 0.0,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Simulate a recording with known truth.

    The truth is written to a YAML file next to the recording.

    Example: mobilecal simulate drive.mcap --robot paper --seed 7
    """
    from mobilecal_cli.commands.terminal import progress_bar
    from mobilecal_cli.simulate.record import simulate as record
    from mobilecal_cli.simulate.scenario import Scenario

    scenario = Scenario(
        robot=robot.value,
        motion=motion,
        seed=seed,
        stations=stations,
        container=container or _BY_SUFFIX.get(out.suffix, "rosbag2"),
        pictures=pictures,
        kind=board,
        exact=exact,
        camera_late_s=camera_late,
    )
    with progress_bar(quiet) as progress:
        truth = record(scenario, out, force, progress)
    if not quiet:
        typer.echo(written_line(out, truth))
