"""A scenario onto the disk, with its truth beside it, whole or not at all."""

from __future__ import annotations

import secrets
import shutil
from pathlib import Path

from mobilecal_cli.errors import OutputError
from mobilecal_cli.pipeline.progress import Progress, silent
from mobilecal_cli.simulate.containers import WRITERS, ros_of
from mobilecal_cli.simulate.messages import Publisher, published
from mobilecal_cli.simulate.scenario import Scenario, truth_yaml


def truth_path(out: Path) -> Path:
    """Where the truth of a recording is: `<name>.truth.yaml` beside it."""
    return out.with_name(f"{out.stem if out.suffix in ('.mcap', '.bag') else out.name}.truth.yaml")


def _remove(path: Path) -> None:
    if path.is_dir():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def simulate(scenario: Scenario, out: Path, force: bool = False, progress: Progress = silent) -> Path:
    """Record a scenario.

    Args:
        scenario: what.
        out: the recording: a file, or a directory for rosbag2.
        force: replace a recording that is there.
        progress: told about every stereo pair that is drawn.

    Returns:
        The truth's path.

    Raises:
        OutputError: something is there already, or cannot be written.
        ConfigError: no route keeps the board in view.
    """
    truth = truth_path(out)
    for path in (out, truth):
        if path.is_symlink() or (path.exists() and not force):
            raise OutputError(f"{path}: exists already", "add --force to replace it, or choose another name")
    if out.is_dir() and not (out / "metadata.yaml").is_file() and any(out.iterdir()):
        raise OutputError(f"{out}: is a directory, but no recording", "choose another name")
    robot, route = scenario.plan()
    publisher = Publisher(ros_of(scenario.container))
    messages = published(
        scenario, robot, route, publisher, lambda done, total: progress("drawing the board", done, total)
    )
    # The writers name what is inside a rosbag2 directory after it, so only its parent is temporary.
    partial = out.with_name(f".{out.name}.{secrets.token_hex(4)}.partial")
    try:
        partial.mkdir()
        WRITERS[scenario.container](partial / out.name, messages, publisher)
        (partial / truth.name).write_text(truth_yaml(scenario, robot, route), encoding="utf-8")
        for path in (out, truth):
            _remove(path)
            (partial / path.name).rename(path)
    except OSError as error:
        raise OutputError(f"{out}: cannot be written: {error.strerror}", "choose another place") from error
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return truth
