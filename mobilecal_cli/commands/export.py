"""`mobilecal export`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from mobilecal_cli.commands.options import written_line
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.targets import Target


def export(
    params: Path,
    to: Annotated[list[Target], Option()],
    urdf: Path | None = None,
    camera: Annotated[str | None, Option(metavar="NAME")] = None,
    left_joint: str | None = None,
    right_joint: str | None = None,
    with_chain: bool = False,
    rate: Annotated[float | None, Option(metavar="HZ")] = None,
    distance: Annotated[float | None, Option(metavar="METERS")] = None,
    log: list[Path] | None = None,
    allow_failed: bool = False,
    output: Path | None = None,
    force: bool = False,
) -> None:
    """Export a calibration as URDF, xacro, ros2_control and more.

    Refuses a calibration whose verdict is not PASS with exit code 6.

    Example: mobilecal export out/params.yaml --to urdf --urdf robot.urdf --output robot_calibrated.urdf

    For a controller: mobilecal export out/params.yaml --to ros2_control

    Args:
        params: params.yaml of a calibration.
        to: Output format.
        urdf: URDF to patch, for --to urdf; the file itself is not changed.
        camera: For --to camera_info: the camera. [default: the reference]
        left_joint: Joint of the left wheel. [default: as calibrated]
        right_joint: Joint of the right wheel. [default: as calibrated]
        with_chain: For --to urdf: also write the estimated head chain (joint origins and axes).
        rate: For --to odometry_covariance: messages per second. [default: 50]
        distance: For --to odometry_covariance: length of straight drives. [default: legs of the recording]
        log: For --to foxglove: recording of the calibration, for its images. Repeatable.
        allow_failed: Also export a calibration whose verdict is not PASS; the export states the verdict.
        output: File to write; - for standard output. [default: -]
    """
    from mobilecal_cli.calibrate.export import export as exported
    from mobilecal_cli.export.outputs import check_output, recognized_file, regular_file, write_outputs
    from mobilecal_cli.model.text import visible

    if len(to) > 1:
        raise ConfigError(f"--to {' --to '.join(to)}: more than one format", "export one format at a time")
    target, output = to[0], None if str(output) == "-" else output
    inputs, paths = [params, urdf, *(log or [])], []
    scene = target == Target("foxglove")
    if output is not None:
        check_output(output, force, inputs, regular_file if scene else recognized_file)
        paths.append(output)
    if scene:
        if output is None:
            raise ConfigError(f"--to {target} writes two files", "name the first with --output scene.mcap")
        paths.append(output.with_suffix(".layout.json"))
        check_output(paths[1], force, inputs)
    given = {"left": left_joint, "right": right_joint}
    joints = {side: name for side, name in given.items() if name is not None}
    made = exported(
        params,
        target,
        urdf=urdf,
        camera=camera,
        wheel_joints=joints,  # type: ignore[arg-type]
        with_chain=with_chain,
        rate_hz=rate,
        distance_m=distance,
        logs=log or [],
        allow_failed=allow_failed,
    )
    if not paths:
        typer.echo(made.content, nl=False)
    write_outputs(dict(zip(paths, (made.content, made.layout.encode()), strict=False)), force)
    for note in made.notes:
        typer.echo(visible(note), err=True)
    if paths:
        typer.echo(written_line(*paths))
