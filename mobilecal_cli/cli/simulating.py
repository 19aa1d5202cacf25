"""The command that records robots of known truth."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, cast

import typer

from mobilecal_cli.cli.app import app
from mobilecal_cli.cli.options import Force, Quiet


class RobotName(StrEnum):
    """Robots of known truth."""

    paper = "paper"
    tick = "tick"


class MotionName(StrEnum):
    """How a simulated robot moves."""

    standard = "standard"
    head_fixed = "head_fixed"
    pan_only = "pan_only"
    straight = "straight"
    spin = "spin"
    base_fixed = "base_fixed"
    large_turns = "large_turns"
    moving = "moving"


class ContainerName(StrEnum):
    """Kinds of recordings."""

    mcap = "mcap"
    mcap_lz4 = "mcap-lz4"
    mcap_zstd = "mcap-zstd"
    mcap_ros1 = "mcap-ros1"
    rosbag2 = "rosbag2"
    rosbag2_mcap = "rosbag2-mcap"
    bag = "bag"
    bag_lz4 = "bag-lz4"
    bag_bz2 = "bag-bz2"


class BoardName(StrEnum):
    """Boards that are simulated."""

    checkerboard = "checkerboard"
    charuco = "charuco"
    aprilgrid = "aprilgrid"


class PictureName(StrEnum):
    """How a simulated recording stores pictures."""

    jpeg = "jpeg"
    png = "png"
    mono8 = "mono8"


@app.command()
def simulate(
    out: Annotated[Path, typer.Argument(help="Recording to write: a file, or a directory for rosbag2.")],
    robot: Annotated[
        RobotName, typer.Option(help="paper: the paper's; tick: pan-tilt with tick counters.")
    ] = (RobotName.paper),
    motion: Annotated[MotionName, typer.Option(help="How base and head move.")] = MotionName.standard,
    seed: Annotated[int, typer.Option(min=0, help="Of every random choice.")] = 0,
    stations: Annotated[int, typer.Option(min=2, help="Stops; without stops, three seconds each.")] = 12,
    container: Annotated[
        ContainerName | None, typer.Option(help="Kind of recording. [default: by the name's ending]")
    ] = None,
    pictures: Annotated[PictureName, typer.Option(help="How images are stored.")] = PictureName.jpeg,
    board: Annotated[
        BoardName, typer.Option(help="What hangs on the wall; boards with markers are seen in part.")
    ] = BoardName.checkerboard,
    exact: Annotated[
        bool, typer.Option("--exact", help="No noise, encoders without steps (use with png).")
    ] = False,
    camera_late: Annotated[
        float, typer.Option(min=-0.2, max=0.2, help="Seconds by which the cameras' clock is late.")
    ] = 0.0,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Record a simulated robot with known truth, which is written beside it.

    Example: mobilecal simulate drive.mcap --robot paper --seed 7
    """
    from mobilecal_cli.simulate.record import simulate as record
    from mobilecal_cli.simulate.scenario import Scenario
    from mobilecal_cli.terminal import progress_bar

    kind = container.value if container else {".mcap": "mcap", ".bag": "bag"}.get(out.suffix, "rosbag2")
    scenario = Scenario(
        robot=robot.value,
        motion=cast(Any, motion.value),
        seed=seed,
        stations=stations,
        container=cast(Any, kind),
        pictures=cast(Any, pictures.value),
        kind=cast(Any, board.value),
        exact=exact,
        camera_late_s=camera_late,
    )
    with progress_bar(quiet) as progress:
        truth = record(scenario, out, force, progress)
    if not quiet:
        typer.echo(f"written: {out}, {truth}")
