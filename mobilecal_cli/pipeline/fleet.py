"""`mobilecal batch`: many robots, in local processes or on a Dask cluster."""

from __future__ import annotations

import hashlib
import json
import multiprocessing
import os
import re
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from mobilecal_cli import __version__, se3
from mobilecal_cli.errors import ConfigError, MobilecalError, OutputError, QualityError
from mobilecal_cli.export import from_plain, to_plain, write_file
from mobilecal_cli.model import FleetJob, FleetRow
from mobilecal_cli.pipeline.calibrating import Calibration, calibrate
from mobilecal_cli.pipeline.processes import stand_by
from mobilecal_cli.pipeline.progress import Progress, silent
from mobilecal_cli.readers import recognised, sha256_of
from mobilecal_cli.report import fleet_csv, fleet_html, reference_pose, reference_std
from mobilecal_cli.yaml_input import LARGEST_BYTES, load_yaml, read_text

RECORDS = ".mobilecal_batch"
_NAME = re.compile(r"[A-Za-z0-9_][A-Za-z0-9_.+-]{0,99}")
#: Number of attempts at a job whose process dies.
_ATTEMPTS = 3
_CRASHED = "the worker process died (out of memory, or killed)"
#: Reasons for skipping, in the order of the summary.
DONE, NO_RECORDING, UNREADABLE = "already done", "no recording", "unreadable"
_CONTAINERS = frozenset({".mcap", ".bag", ".db3", ".npz"})

Run = Callable[[Sequence[FleetJob], Callable[[FleetRow], None]], None]


class _Robot(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")
    name: str
    logs: tuple[Path, ...] = Field(min_length=1)
    config: Path | None = None


class _Manifest(BaseModel):
    model_config = ConfigDict(frozen=True, extra="forbid")
    schema_version: int = 1
    robots: tuple[_Robot, ...] = Field(min_length=1)


def fleet_jobs(
    source: Path, output: Path, config: Path | None, flags: Mapping[str, Any], gates: Sequence[str]
) -> tuple[FleetJob, ...]:
    """The robots in a directory or a manifest, in order of name.

    Each recording in a directory is one robot; `NAME.rig.yaml` next to it is its configuration.

    Raises:
        ConfigError: no recording, an invalid manifest, or a name that is invalid or not unique.
    """
    robots = _of_directory(source) if source.is_dir() else _of_manifest(source)
    names = [robot.name for robot in robots]
    for name in names:
        if not _NAME.fullmatch(name) or name.startswith("."):
            raise ConfigError(
                f"{source}: {name!r} is not a valid robot name", "use letters, digits, . _ + and -"
            )
        if names.count(name) > 1:
            raise ConfigError(f"{source}: two robots are named {name!r}", "give each robot a unique name")
    return tuple(
        FleetJob(
            robot.name,
            tuple(log.absolute() for log in robot.logs),
            (robot.config or config).absolute() if robot.config or config else None,  # type: ignore[union-attr]
            output.absolute(),
            flags,
            tuple(gates),
        )
        for robot in sorted(robots, key=lambda robot: robot.name)
    )


def _of_directory(folder: Path) -> list[_Robot]:
    robots = []
    for path in sorted(folder.iterdir()):
        holds = (path / "metadata.yaml").is_file() if path.is_dir() else recognised(path)
        if holds and not path.name.startswith("."):
            name = path.name if path.is_dir() else path.stem
            own = folder / f"{name}.rig.yaml"
            robots.append(_Robot(name=name, logs=(path,), config=own if own.is_file() else None))
    if not robots:
        raise ConfigError(f"{folder}: no recording found", "give a directory of recordings, or a manifest")
    return robots


def skipped_entries(source: Path, output: Path) -> tuple[FleetRow, ...]:
    """The entries of a directory that are not calibrated, with the reason; none for a manifest."""
    if not source.is_dir():
        return ()
    rows = []
    for path in sorted(source.iterdir()):
        known = (
            path.name.startswith(".")
            or path.name.endswith(".rig.yaml")
            or path.absolute() == output.absolute()
        )
        holds = (path / "metadata.yaml").is_file() if path.is_dir() else recognised(path)
        if not known and not holds:
            readable = path.is_dir() or path.suffix not in _CONTAINERS
            text = "is not a recording" if readable else "is damaged, or has the wrong file name extension"
            reason = NO_RECORDING if readable else UNREADABLE
            rows.append(FleetRow(path.name, "SKIPPED", 0, f"{path.name} {text}", skipped=reason))
    return tuple(rows)


def _of_manifest(path: Path) -> list[_Robot]:
    hint = "robots: [{name: NAME, logs: [FILE], config: rig.yaml}, ...]"
    try:
        manifest = _Manifest.model_validate(load_yaml(read_text(path, LARGEST_BYTES)))
    except OSError as error:
        raise ConfigError(f"{path}: cannot be read: {error.strerror}", "check the path") from error
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"])
        raise ConfigError(f"{path}: {where}: {first['msg']}", hint) from error
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


def run_job(job: FleetJob) -> FleetRow:
    """Calibrate one robot, or return the earlier result for the same recordings and settings.

    The record of a job is written last, so that any process or machine repeats an interrupted job and skips a
    finished one.

    Raises:
        OutputError: the record cannot be written.
    """
    record = job.output / RECORDS / f"{job.name}.json"
    key = ""  # without a fingerprint the job is repeated
    try:
        key = fingerprint(job)
        done = _recorded(record, key, job)
        if done is not None:
            return done
        calibration = calibrate(
            job.logs,
            job.output / job.name,
            config_path=job.config,
            flags=job.flags,
            gates=job.gates,
            force=True,
        )
        row = _row(job, calibration)
    except MobilecalError as error:
        row = FleetRow(job.name, "ERROR", error.exit_code, error.message)
    except Exception as error:  # a bug must not stop the other robots
        row = FleetRow(job.name, "ERROR", 1, f"a bug in mobilecal: {type(error).__name__}: {error}")
    record.parent.mkdir(parents=True, exist_ok=True)
    write_file(record, json.dumps({"key": key, "row": to_plain(row)}, indent=1).encode() + b"\n", force=True)
    return row


def fingerprint(job: FleetJob) -> str:
    """SHA-256 of everything that the result of a job depends on.

    Raises:
        RecordingError: a recording cannot be read.
        ConfigError: the configuration cannot be read.
    """
    settings = "" if job.config is None else _text(job.config)
    parts = [__version__, settings, json.dumps(dict(job.flags), sort_keys=True, default=str), *job.gates]
    parts += [sha256_of(log) for log in job.logs]
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()


def _text(path: Path) -> str:
    try:
        return read_text(path, LARGEST_BYTES)
    except (OSError, ValueError) as error:
        raise ConfigError(f"{path}: cannot be read: {error}", "check the path") from error


def _recorded(record: Path, key: str, job: FleetJob) -> FleetRow | None:
    """The row of an earlier run of the same job, if its outputs still exist."""
    try:
        data = json.loads(read_text(record, LARGEST_BYTES))
        row, same = from_plain(FleetRow, data["row"]), data["key"] == key
    except (OSError, ValueError, KeyError, TypeError):
        return None
    there = row.verdict == "ERROR" or (job.output / job.name / "report.json").is_file()
    return replace(row, skipped=DONE) if same and there else None


def _row(job: FleetJob, done: Calibration) -> FleetRow:
    solution = done.solution
    T, wheels = reference_pose(solution.parameters, solution.cameras), solution.parameters.wheels
    lengths = (*T[:3, 3].tolist(), wheels.radius_right_m, wheels.radius_left_m, wheels.separation_m)
    return FleetRow(
        job.name,
        done.verdict.level,
        0 if done.verdict.level == "PASS" else QualityError.exit_code,
        done.verdict.reason,
        len(done.extraction.observations),
        tuple(se3.log_so3(T[:3, :3]).tolist()),
        lengths,
        reference_std(solution),
    )


def run_locally(workers: int) -> Run:
    """Runs jobs in local processes; if one dies, the other robots are still calibrated."""

    def run(jobs: Sequence[FleetJob], done: Callable[[FleetRow], None]) -> None:
        waiting = {job.name: job for job in jobs}
        for row in _in_a_pool(list(waiting.values()), workers):
            del waiting[row.name]
            done(row)
        for name, job in waiting.items():  # a process died: each remaining job gets its own process
            row = FleetRow(name, "ERROR", 1, _CRASHED)
            for _ in range(_ATTEMPTS - 1):
                rows = list(_in_a_pool([job], 1))
                if rows:
                    row = rows[0]
                    break
            done(row)

    return run


def _in_a_pool(jobs: Sequence[FleetJob], workers: int) -> Iterator[FleetRow]:
    """Rows in the order of completion; a pool that breaks yields only part of them."""
    with ProcessPoolExecutor(workers, multiprocessing.get_context("spawn"), stand_by) as pool:
        futures = [pool.submit(run_job, job) for job in jobs]
        for future in as_completed(futures):
            with suppress(BrokenProcessPool):
                yield future.result()


def batch(
    source: Path,
    output: Path,
    *,
    config_path: Path | None = None,
    flags: Mapping[str, Any] | None = None,
    gates: Sequence[str] = (),
    run: Run | None = None,
    progress: Progress = silent,
) -> tuple[FleetRow, ...]:
    """Calibrate many robots, each into its own directory, and write summary.csv and summary.html.

    Robots that an earlier run finished are skipped; `FleetRow.skipped` has the reason.

    Args:
        source: a directory of recordings, or a manifest.
        output: directory; created if it does not exist.
        config_path: rig.yaml of the robots without their own.
        flags: dotted key → value, over the files.
        gates: `NAME=LIMIT` for each robot.
        run: runs the jobs; by default one process per core.
        progress: receives the number of finished robots.

    Raises:
        ConfigError: see `fleet_jobs`.
        OutputError: the outputs cannot be written.
    """
    jobs = fleet_jobs(source, output, config_path, flags or {}, gates)
    try:
        (output / RECORDS).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(
            f"{output}: cannot be created: {error.strerror}", "choose another --output"
        ) from error
    rows: dict[str, FleetRow] = {}

    def done(row: FleetRow) -> None:
        rows[row.name] = row
        progress("robots", len(rows), len(jobs))

    progress("robots", 0, len(jobs))
    (run or run_locally(os.cpu_count() or 1))(jobs, done)
    ordered = (*(rows[job.name] for job in jobs), *skipped_entries(source, output))
    _write_summaries(output, ordered)
    return ordered


def _write_summaries(output: Path, rows: Iterable[FleetRow]) -> None:
    listed = tuple(rows)
    write_file(output / "summary.csv", fleet_csv(listed).encode(), force=True)
    write_file(output / "summary.html", fleet_html(listed).encode(), force=True)
