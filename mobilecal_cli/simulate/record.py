"""Writes the recording of a scenario and its ground truth, once both are complete."""

from __future__ import annotations

import os
import sqlite3
from pathlib import Path

from mobilecal_cli.calibrate import Progress, silent
from mobilecal_cli.errors import OutputError
from mobilecal_cli.export.outputs import (
    check_output,
    files_in,
    recognized_file,
    write_all,
    write_synced,
)
from mobilecal_cli.simulate.messages import ROSBAG2, published, write
from mobilecal_cli.simulate.scenario import Scenario, World

_IN_ROSBAG2 = (".db3", ".mcap", ".db3-wal", ".db3-shm")


def truth_path(out: Path) -> Path:
    """Path of a recording's ground truth: `<name>.truth.yaml` in the same directory.

    Raises:
        OutputError: the recording has no name, as "." and "/".
    """
    if not out.name:
        raise OutputError(f"{out}: not the name of a recording", "choose another output path")
    return out.with_name(f"{out.stem if out.suffix in ('.mcap', '.bag') else out.name}.truth.yaml")


def simulate(
    scenario: Scenario,
    out: Path,
    force: bool = False,
    progress: Progress = silent,
    world_of: type[World] = World,
) -> Path:
    """Simulate a scenario and write its recording.

    Args:
        scenario: what to simulate.
        out: the recording: a file, or a directory for rosbag2.
        force: replace an existing recording.
        progress: called after every rendered stereo pair.
        world_of: the robot and the board as they are.

    Returns:
        Path of the ground truth.

    Raises:
        OutputError: the path already exists, or cannot be written.
        ConfigError: no route keeps the board in view.
    """
    truth = truth_path(out)
    recognized = recognized_folder if scenario.container in ROSBAG2 else recognized_file
    check_output(out, force, recognize=recognized)
    if os.path.lexists(out) and not truth.is_file():
        raise OutputError(
            f"{out}: not written by mobilecal simulate: there is no {truth.name}", "choose another name"
        )
    check_output(truth, force)
    world = world_of(scenario, *scenario.plan())
    messages = published(world, lambda done, total: progress("rendering images", done, total))

    def write_recording(path: Path) -> None:
        try:
            write(scenario.container, path, messages)
        except sqlite3.Error as error:
            raise OSError(str(error)) from error

    def write_truth(path: Path) -> None:
        write_synced(path, world.truth().encode())

    write_all([(out, recognized, write_recording), (truth, recognized_file, write_truth)], force)
    return truth


def recognized_folder(folder: Path) -> tuple[str, ...]:
    """Names of the files in a rosbag2 directory.

    Raises:
        OutputError: it is not a directory, or contains something else.
    """
    return files_in(
        folder, "a recording", lambda path: path.name == "metadata.yaml" or path.suffix in _IN_ROSBAG2
    )
