"""The robots of `mobilecal batch`: from a directory of recordings, or from a manifest."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic import BaseModel, Field, ValidationError

from mobilecal_cli.errors import ConfigError, RecordingError
from mobilecal_cli.files.reading import LARGEST_BYTES, load_yaml, problems_of, read_text
from mobilecal_cli.model import FleetRow
from mobilecal_cli.readers import looks_recorded, sha256_of
from mobilecal_cli.rig.config import load_rig

#: Directory with the records of finished jobs, in the output directory of a batch.
RECORDS = ".mobilecal_batch"
#: Files of all robots, in the output directory of a batch.
SUMMARIES = ("summary.csv", "summary.html")
_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.+-]{0,99}")
#: Reasons for skipping, in the order of the summary.
DONE, NO_RECORDING = "already done", "no recording"


@dataclass(frozen=True, slots=True)
class FleetJob:
    """One robot to calibrate.

    Attributes:
        name: name of the robot and of its output directory.
        logs: its recordings.
        config: its rig.yaml, or None.
        output: parent directory of the output directories.
        flags: dotted key → value; these override the file.
        gates: `NAME=LIMIT`.
        force: calibrate the robot again, and replace also a result that the batch did not write.
    """

    name: str
    logs: tuple[Path, ...]
    config: Path | None
    output: Path
    flags: Mapping[str, Any] = field(default_factory=dict)
    gates: tuple[str, ...] = ()
    force: bool = False


class _Robot(BaseModel, frozen=True, extra="forbid"):
    name: str
    logs: tuple[Path, ...] = Field(min_length=1)
    config: Path | None = None


class _Manifest(BaseModel, frozen=True, extra="forbid"):
    schema_version: int = 1
    robots: tuple[_Robot, ...] = Field(min_length=1)


def fleet_jobs(
    source: Path,
    output: Path,
    config: Path | None,
    flags: Mapping[str, Any],
    gates: Sequence[str],
    force: bool = False,
) -> tuple[FleetJob, ...]:
    """The robots in a directory or a manifest, in order of name.

    Each recording in a directory is one robot, also one that cannot be read; `NAME.rig.yaml` next to it is its
    configuration.

    Raises:
        ConfigError: no recording, an invalid manifest or configuration, a name that is invalid or not unique, or a
            recording of two robots.
    """
    try:
        robots = _of_directory(source) if source.is_dir() else _of_manifest(source)
    except OSError as error:
        raise ConfigError(f"{source}: cannot be read: {error.strerror}", "check its permissions") from error
    _check_names(source, [robot.name for robot in robots])
    _refuse_shared(source, robots)
    for robot in robots:
        if robot.config is not None:
            try:
                load_rig(robot.config, flags)
            except ConfigError:  # a manifest may name any file: do not quote it
                raise ConfigError(
                    f"{source}: the configuration of {robot.name} is not a valid rig.yaml: {robot.config}",
                    f"calibrate this robot alone with --config {robot.config}, which shows what is wrong",
                ) from None
    if config is not None:
        load_rig(config, flags)
    return tuple(
        FleetJob(
            robot.name,
            tuple(log.absolute() for log in robot.logs),
            (robot.config or config).absolute() if robot.config or config else None,  # type: ignore[union-attr]
            output.absolute(),
            flags,
            tuple(gates),
            force,
        )
        for robot in sorted(robots, key=lambda robot: robot.name)
    )


def _check_names(source: Path, names: Sequence[str]) -> None:
    for name in names:
        if not _NAME.fullmatch(name) or name.startswith("."):
            raise ConfigError(
                f"{source}: {name!r} is not a valid robot name", "use letters, digits, . _ + and -"
            )
        if name in SUMMARIES:
            raise ConfigError(
                f"{source}: a robot is named {name!r}, like a file that batch writes", "rename the robot"
            )
        if names.count(name) > 1:
            raise ConfigError(f"{source}: two robots are named {name!r}", "give each robot a unique name")


def _refuse_shared(source: Path, robots: Iterable[_Robot]) -> None:
    """Refuse a recording that two robots use, also as copies."""
    of_size: dict[int, list[tuple[str, Path]]] = {}
    for robot in robots:
        for log in robot.logs:
            files = log.rglob("*") if log.is_dir() else (log,)
            size = sum(path.stat().st_size for path in files if path.is_file())
            of_size.setdefault(size, []).append((robot.name, log))
    for size, alike in of_size.items():
        user: dict[str, str] = {}
        for name, log in alike if size and len(alike) > 1 else ():
            try:
                other = user.setdefault(sha256_of(log), name)
            except RecordingError:  # the other robots can still be calibrated
                continue
            if other != name:
                raise ConfigError(
                    f"{source}: {other} and {name} have the same recording: {log.name}",
                    "give each robot its own recordings",
                )


def _of_directory(folder: Path) -> list[_Robot]:
    robots = []
    for path in sorted(folder.iterdir()):
        if looks_recorded(path) and not path.name.startswith("."):
            name = path.name if path.is_dir() else path.stem
            own = folder / f"{name}.rig.yaml"
            robots.append(_Robot(name=name, logs=(path,), config=own if own.is_file() else None))
    if not robots:
        raise ConfigError(f"{folder}: no recording found", "give a directory of recordings, or a manifest")
    return robots


def skipped_entries(source: Path, output: Path) -> tuple[FleetRow, ...]:
    """The entries of a directory that are no recordings; none for a manifest."""
    if not source.is_dir():
        return ()
    rows = []
    for path in sorted(source.iterdir()):
        known = (
            path.name.startswith(".")
            or path.name.endswith(".rig.yaml")
            or path.absolute() == output.absolute()
        )
        if not known and not looks_recorded(path):
            why = f"{path.name} is not a recording"
            rows.append(FleetRow(path.name, "SKIPPED", 0, why, skipped=NO_RECORDING))
    return tuple(rows)


def _of_manifest(path: Path) -> list[_Robot]:
    hint = "robots: [{name: NAME, logs: [FILE], config: rig.yaml}, ...]"
    try:
        manifest = _Manifest.model_validate(load_yaml(read_text(path, LARGEST_BYTES)))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}", "check the path") from error
    except ValidationError as error:
        raise ConfigError(f"{path}: {problems_of(error)}", hint) from error
    except ValueError as error:
        raise ConfigError(f"{path}: not a valid manifest: {' '.join(str(error).split())}", hint) from error
    folder = path.parent
    return [
        robot.model_copy(
            update={
                "logs": tuple(folder / log for log in robot.logs),
                "config": folder / robot.config if robot.config else None,
            }
        )
        for robot in manifest.robots
    ]
