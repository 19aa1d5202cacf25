"""The commands. Each is a few lines; `main` turns errors into messages and exit codes."""

from __future__ import annotations

import sys
from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any, cast

import typer

from mobilecal_cli import __version__
from mobilecal_cli.errors import ConfigError, MobilecalError, QualityError

app = typer.Typer(
    name="mobilecal",
    help="Calibrate a differential-drive robot's stereo head and wheels from a recording of a checkerboard.",
    no_args_is_help=True,
    add_completion=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
)


class MethodName(StrEnum):
    """How the nine numbers are solved for."""

    linear = "linear"
    paper = "paper"
    lm = "lm"
    ml = "ml"


Logs = Annotated[list[Path], typer.Argument(help="Recordings of one robot: MCAP, rosbag2, .db3, ROS 1 .bag.")]
Config = Annotated[Path | None, typer.Option("--config", "-c", help="rig.yaml; see `mobilecal init`.")]
Settings = Annotated[
    list[str] | None, typer.Option("--set", help="KEY=VALUE over rig.yaml, such as wheels.left.sign=-1.")
]
Force = Annotated[bool, typer.Option("--force", help="Replace an output that is there already.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress bar and no summary.")]


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


def _flags(board: str | None, square_m: float | None, settings: list[str]) -> dict[str, Any]:
    """The flags as dotted keys over rig.yaml."""
    from mobilecal_cli.config import parse_setting

    flags = dict(parse_setting(text) for text in settings)
    if board is not None:
        columns, x, rows = board.lower().partition("x")
        if not (x and columns.isdigit() and rows.isdigit()):
            raise ConfigError(f"--board {board}: not COLUMNSxROWS", "count the inner corners: --board 9x6")
        flags |= {"board.columns": int(columns), "board.rows": int(rows)}
    if square_m is not None:
        flags["board.square_m"] = square_m
    return flags


@app.command()
def calibrate(
    logs: Logs,
    config: Config = None,
    output: Annotated[
        Path | None,
        typer.Option("--output", "-o", help="Directory to write. [default: <log name>_calibration]"),
    ] = None,
    method: Annotated[
        MethodName,
        typer.Option(
            help="ml: maximum likelihood; linear: iterative linear; paper: eq. 19; lm: eq. 19, faster."
        ),
    ] = MethodName.ml,
    board: Annotated[
        str | None, typer.Option(help="Inner corners, such as 9x6. [default: found by itself]")
    ] = None,
    square_m: Annotated[
        float | None, typer.Option(help="Side of a square, m. [default: from the stereo pair]")
    ] = None,
    setting: Settings = None,
    fix: Annotated[
        list[str] | None,
        typer.Option(help="NAME or NAME=VALUE (m, rad): hold it there; also head_eye, wheels."),
    ] = None,
    prior: Annotated[list[str] | None, typer.Option(help="NAME=VALUE±SIGMA: what is known of it.")] = None,
    estimate: Annotated[
        list[str] | None, typer.Option(help="NAME,...: numbers beside the nine, such as pan_zero or mount.")
    ] = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Read recordings, solve for all nine numbers, and write parameters and a report.

    Several recordings of one robot are solved together; files that follow one another are one recording.

    Example: mobilecal calibrate log.mcap --config rig.yaml --output result
    """
    from mobilecal_cli import pipeline
    from mobilecal_cli.report import summary_table
    from mobilecal_cli.solvers import asked_of
    from mobilecal_cli.terminal import progress_bar

    flags = _flags(board, square_m, setting or [])
    asked = asked_of(fix or [], prior or [], estimate or [])
    with progress_bar(quiet) as progress:
        result = pipeline.calibrate(
            logs,
            output,
            config_path=config,
            flags=flags,
            method=cast(Any, method.value),
            asked=asked,
            force=force,
            progress=progress,
        )
    if not quiet:
        typer.echo(summary_table(result.solution, result.extraction, result.verdict))
        typer.echo(f"written: {result.directory / 'params.yaml'}, {result.directory / 'report.html'}")
    if result.verdict.level != "PASS":
        raise QualityError(
            f"{result.verdict.level}: {result.verdict.reason}",
            f"{result.verdict.next_step} (see {result.directory / 'report.html'})",
        )


@app.command()
def suggest(
    logs: Logs,
    config: Config = None,
    setting: Settings = None,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress bar.")] = False,
) -> None:
    """Say which stops would improve a recording most: where to drive, where to look, and what it would bring.

    Reads recordings, or the extraction.npz of an earlier calibration, and writes nothing.

    Example: mobilecal suggest log.mcap
    """
    from mobilecal_cli import pipeline
    from mobilecal_cli.terminal import progress_bar

    with progress_bar(quiet) as progress:
        lines = pipeline.suggest(logs, config, _flags(None, None, setting or []), progress)
    typer.echo("\n".join(lines))


@app.command()
def inspect(
    logs: Logs,
    config: Config = None,
    setting: Settings = None,
    as_json: Annotated[bool, typer.Option("--json", help="JSON for programs instead of text.")] = False,
    quiet: Annotated[bool, typer.Option("--quiet", "-q", help="No progress bar.")] = False,
) -> None:
    """Say what a recording holds, what would be used of it, and what is missing for a calibration.

    Looks at a part of a long recording only, so it answers in seconds, and writes nothing.

    Example: mobilecal inspect log.mcap
    """
    from mobilecal_cli import pipeline
    from mobilecal_cli.report import inspection_json, inspection_text
    from mobilecal_cli.terminal import progress_bar

    with progress_bar(quiet) as progress:
        found = pipeline.inspect(logs, config, _flags(None, None, setting or []), progress)
    typer.echo(inspection_json(found) if as_json else inspection_text(found), nl=False)


@app.command()
def init(
    log: Annotated[Path, typer.Argument(help="A recording.")],
    output: Annotated[
        Path, typer.Option("--output", "-o", help="File to write, - for standard output.")
    ] = Path("rig.yaml"),
    force: Force = False,
) -> None:
    """Write a commented draft of rig.yaml from what a recording tells.

    Example: mobilecal init log.mcap --output rig.yaml
    """
    from mobilecal_cli import pipeline

    if str(output) == "-":
        typer.echo(pipeline.draft(log), nl=False)
        return
    pipeline.write_draft(log, output, force)
    typer.echo(f"written: {output}")


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


def main() -> None:
    """Run the command line and leave with the exit code that fits."""
    try:
        app()
    except MobilecalError as error:
        from mobilecal_cli.model.text import visible  # names out of a log must not steer the terminal

        print(f"error: {visible(error.message)}", file=sys.stderr)
        if error.hint:
            print(f"hint: {visible(error.hint)}", file=sys.stderr)
        sys.exit(error.exit_code)
