"""`mobilecal simulate`."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, cast

import typer

from mobilecal_cli.commands.options import Force, Quiet, written_line


class RobotName(StrEnum):
    """Simulated robots."""

    paper = "paper"
    tick = "tick"


class MotionName(StrEnum):
    """Motions of a simulated robot."""

    standard = "standard"
    head_fixed = "head_fixed"
    pan_only = "pan_only"
    straight = "straight"
    spin = "spin"
    base_fixed = "base_fixed"
    large_turns = "large_turns"
    moving = "moving"


class ContainerName(StrEnum):
    """Container formats of recordings."""

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
    """Simulated boards."""

    checkerboard = "checkerboard"
    charuco = "charuco"
    aprilgrid = "aprilgrid"


class PictureName(StrEnum):
    """Image encodings of a simulated recording."""

    jpeg = "jpeg"
    png = "png"
    mono8 = "mono8"


def simulate(
    out: Annotated[
        Path, typer.Argument(readable=False, help="Recording to write: a file, or a directory for rosbag2.")
    ],
    robot: Annotated[
        RobotName, typer.Option(help="paper: the robot of the paper; tick: pan-tilt head, tick counters.")
    ] = (RobotName.paper),
    motion: Annotated[
        MotionName, typer.Option(help="Motion of the base and the head.")
    ] = MotionName.standard,
    seed: Annotated[int, typer.Option(min=0, help="Seed of the random numbers.")] = 0,
    stations: Annotated[
        int, typer.Option(min=2, help="Number of stops; a moving recording lasts 3 s per stop.")
    ] = 12,
    container: Annotated[
        ContainerName | None, typer.Option(help="Container format. [default: from the file extension]")
    ] = None,
    pictures: Annotated[PictureName, typer.Option(help="Image encoding.")] = PictureName.jpeg,
    board: Annotated[
        BoardName, typer.Option(help="Board on the wall; boards with markers may be partly visible.")
    ] = BoardName.checkerboard,
    exact: Annotated[
        bool, typer.Option("--exact", help="No noise and no encoder quantization (use with png).")
    ] = False,
    camera_late: Annotated[
        float, typer.Option(min=-0.2, max=0.2, help="Delay of the camera clock, s.")
    ] = 0.0,
    imperfect: Annotated[
        bool,
        typer.Option(
            "--imperfect", help="Robot, cameras and board differ from their description; uneven floor."
        ),
    ] = False,
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
        imperfect=imperfect,
    )
    with progress_bar(quiet) as progress:
        truth = record(scenario, out, force, progress)
    if not quiet:
        typer.echo(written_line(out, truth))
