"""Writes the recording of a scenario and its ground truth, both or neither."""

from __future__ import annotations

import secrets
import shutil
import sqlite3
from pathlib import Path

from mobilecal_cli.errors import OutputError
from mobilecal_cli.pipeline.progress import Progress, silent
from mobilecal_cli.simulate.containers import WRITERS, ros_of
from mobilecal_cli.simulate.messages import Publisher, published
from mobilecal_cli.simulate.scenario import Scenario, truth_yaml

_DIRECTORIES = ("rosbag2", "rosbag2-mcap")
_IN_ROSBAG2 = (".db3", ".mcap", ".db3-wal", ".db3-shm")


def truth_path(out: Path) -> Path:
    """Path of a recording's ground truth: `<name>.truth.yaml` in the same directory."""
    return out.with_name(f"{out.stem if out.suffix in ('.mcap', '.bag') else out.name}.truth.yaml")


def simulate(scenario: Scenario, out: Path, force: bool = False, progress: Progress = silent) -> Path:
    """Simulate a scenario and write its recording.

    Args:
        scenario: what to simulate.
        out: the recording: a file, or a directory for rosbag2.
        force: replace an existing recording.
        progress: called after every rendered stereo pair.

    Returns:
        Path of the ground truth.

    Raises:
        OutputError: the path already exists, or cannot be written.
        ConfigError: no route keeps the board in view.
    """
    truth = truth_path(out)
    _check(out, scenario.container in _DIRECTORIES, force)
    _check(truth, False, force)
    robot, route = scenario.plan()
    publisher = Publisher(ros_of(scenario.container))
    messages = published(
        scenario, robot, route, publisher, lambda done, total: progress("rendering images", done, total)
    )
    # Only the parent is temporary, because the writers name files inside a rosbag2 directory after the
    # directory.
    partial = out.with_name(f".{out.name}.{secrets.token_hex(4)}.partial")
    try:
        partial.mkdir()
        WRITERS[scenario.container](partial / out.name, messages, publisher)
        (partial / truth.name).write_text(truth_yaml(scenario, robot, route), encoding="utf-8")
        _put_in_place(partial, (truth, out))
    except (OSError, sqlite3.Error) as error:
        reason = getattr(error, "strerror", None) or error
        raise OutputError(f"{out}: cannot be written: {reason}", "choose another output path") from error
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return truth


def _check(path: Path, directory: bool, force: bool) -> None:
    """Check before the simulation whether a path can be written or replaced."""
    if not path.parent.is_dir():
        raise OutputError(
            f"{path}: {path.parent} is not a directory", "create it, or choose another output path"
        )
    if path.is_symlink() or (path.exists() and not force):
        raise OutputError(f"{path}: exists already", "add --force to replace it, or choose another name")
    if not path.exists():
        return
    if directory != path.is_dir() or not (directory or path.is_file()):
        kind = "a directory" if path.is_dir() else "not a directory"
        raise OutputError(f"{path}: exists and is {kind}", "choose another name")
    # Delete only files that a simulation wrote.
    for entry in sorted(path.iterdir()) if directory else ():
        if entry.name != "metadata.yaml" and not (entry.is_file() and entry.suffix in _IN_ROSBAG2):
            raise OutputError(f"{path}: not a recording: it contains {entry.name!r}", "choose another name")


def _put_in_place(partial: Path, targets: tuple[Path, ...]) -> None:
    """Move everything to its final path; if a move fails, restore the previous files."""
    aside = partial / "old"
    aside.mkdir()
    done: list[Path] = []
    try:
        for target in targets:
            if target.exists():
                target.rename(aside / target.name)
            done.append(target)
            (partial / target.name).rename(target)
    except BaseException:
        for target in done:
            if target.exists():
                target.rename(partial / target.name)
            if (aside / target.name).exists():
                (aside / target.name).rename(target)
        raise
