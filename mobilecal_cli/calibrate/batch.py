"""`mobilecal batch`: many robots, in local processes or on a Dask cluster."""

from __future__ import annotations

import asyncio
import hashlib
import os
import re
import time
from collections import Counter
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import Future, as_completed
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from pydantic import BaseModel, Field, ValidationError

from mobilecal_cli import __version__
from mobilecal_cli.calibrate import Progress, silent
from mobilecal_cli.calibrate.extract import size_bytes
from mobilecal_cli.calibrate.steps import Report, calibrate
from mobilecal_cli.calibrate.workers import answer, processes
from mobilecal_cli.errors import ConfigError, MobilecalError, OutputError, QualityError, RecordingError
from mobilecal_cli.export.outputs import OUTPUT_NAMES, write_outputs
from mobilecal_cli.files.interruption import naming_interruptions, placed
from mobilecal_cli.files.placing import already_exists
from mobilecal_cli.files.reading import LARGEST_BYTES, mapping_of, problems_of, read_text
from mobilecal_cli.readers import looks_recorded, sha256_of
from mobilecal_cli.report.fleet import FleetRow, fleet_csv, fleet_html
from mobilecal_cli.rig.config import Beside, load_rig, read_urdf

#: Directory with the records of finished jobs, in the output directory of a batch.
RECORDS = ".mobilecal_batch"
#: Files of all robots, in the output directory of a batch.
SUMMARIES = ("summary.csv", "summary.html")
#: Names of directories on all systems, in any script; none begins like a formula in a table or an option.
_NAME = re.compile(r"\w(?:[\w .,()+-]{0,98}[\w.,()+-])?")
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
    logs: tuple[Beside, ...] = Field(min_length=1)
    config: Beside | None = None


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
                if not robot.config.exists():
                    raise ConfigError(
                        f"{source}: the configuration of {robot.name}: no such file: {robot.config}",
                        "correct the path: it is relative to the manifest",
                    ) from None
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
            own.absolute() if (own := robot.config or config) else None,
            output.absolute(),
            flags,
            tuple(gates),
            force,
        )
        for robot in sorted(robots, key=lambda robot: robot.name)
    )


def _check_names(source: Path, names: Sequence[str]) -> None:
    for name in names:
        if not _NAME.fullmatch(name):
            raise ConfigError(
                f"{source}: {name!r} is not a valid robot name",
                "use at most 100 letters, digits, spaces and . , _ + - ( ), a letter or a digit first",
            )
        if name in SUMMARIES:
            raise ConfigError(
                f"{source}: a robot is named {name!r}, like a file that batch writes", "rename the robot"
            )
        if names.count(name) > 1:
            raise ConfigError(f"{source}: two robots are named {name!r}", "give each robot a unique name")


def _refuse_shared(source: Path, robots: Iterable[_Robot]) -> None:
    """Refuse a recording that two robots use, also as copies."""
    recorded = [(robot.name, log, size_bytes(log)) for robot in robots for log in robot.logs]
    sizes = Counter(size for *_, size in recorded)
    user: dict[str, str] = {}
    for name, log, size in recorded:
        try:
            other = user.setdefault(sha256_of(log), name) if size and sizes[size] > 1 else name
        except RecordingError:  # the other robots can still be calibrated
            continue
        if other != name:
            raise ConfigError(
                f"{source}: {other} and {name} have the same recording: {log.name}",
                "give each robot its own recordings",
            )


def _of_directory(folder: Path) -> Sequence[_Robot]:
    robots = []
    for path in sorted(folder.iterdir()):
        if looks_recorded(path) and not path.name.startswith("."):
            name = path.name if path.is_dir() else path.stem
            own = folder / f"{name}.rig.yaml"
            robots.append(_Robot(name=name, logs=(path,), config=own if own.is_file() else None))
    if not robots:
        raise ConfigError(f"{folder}: no recording found", "give a directory of recordings, or a manifest")
    return robots


def skipped_entries(source: Path, output: Path, robots: Collection[str]) -> tuple[FleetRow, ...]:
    """The entries of a directory that are no recordings, nor results of the robots; none for a manifest."""
    if not source.is_dir():
        return ()
    results = {path.absolute() for path in (output, *(output / name for name in (*SUMMARIES, *robots)))}
    return tuple(
        FleetRow(path.name, "SKIPPED", 0, f"{path.name} is not a recording", skipped=NO_RECORDING)
        for path in sorted(source.iterdir())
        if not (path.name.startswith(".") or path.name.endswith(".rig.yaml") or looks_recorded(path))
        and path.absolute() not in results
    )


def _of_manifest(path: Path) -> Sequence[_Robot]:
    hint = "give a directory of recordings, or a file with robots: [{name: NAME, logs: [FILE], config: rig.yaml}, ...]"
    try:
        stated = mapping_of(read_text(path, LARGEST_BYTES, hint, "manifest"), str(path), hint)
        if "robots" not in stated:
            raise ConfigError(
                f"{path}: not a manifest: it has no key robots", f"{hint}; a rig.yaml is given with --config"
            )
        return _Manifest.model_validate(stated, context=path.parent).robots
    except ValidationError as error:
        raise ConfigError(f"{path}: {problems_of(error)}", hint) from error


#: Hint for a robot whose process died.
AGAIN = "run the same command again: it calibrates only what is missing; with fewer --jobs if memory is short"


def run_job(job: FleetJob) -> FleetRow:
    """Calibrate one robot, or return the earlier result for the same recordings and settings.

    Any process or machine repeats an interrupted job and skips a finished one. A robot without a result is tried again.
    """
    began_s = time.perf_counter()
    try:
        key, record, earlier = fingerprint(job), _record(job), _params_digest(job)
        own = job.force or earlier in record.params
        there = all((job.output / job.name / name).is_file() for name in OUTPUT_NAMES)
        if there and not job.force and record.row and (key, earlier) == (record.key, record.params[-1]):
            return replace(record.row, skipped=DONE)
        rows: list[FleetRow] = []

        def write_record(report: Report) -> None:
            rows.append(replace(_row(job, report), seconds=round(time.perf_counter() - began_s, 3)))
            made = hashlib.sha256(report.params.encode()).hexdigest()
            written = _Record(params=(earlier, made) if own else (made,), key=key, row=rows[0])
            path = _record_path(job)
            path.parent.mkdir(parents=True, exist_ok=True)
            write_outputs({path: written.model_dump_json(indent=1).encode() + b"\n"}, force=True)

        with naming_interruptions():
            calibrate(
                job.logs,
                job.output / job.name,
                config=load_rig(job.config, job.flags),
                gates=job.gates,
                force=own,
                before_writing=write_record,
            )
        return rows[0]
    except MobilecalError as error:
        row = FleetRow(job.name, "ERROR", error.exit_code, error.message, hint=error.hint)
    except Exception as error:  # a bug must not stop the other robots
        row = FleetRow(job.name, "ERROR", 1, f"a bug in mobilecal: {type(error).__name__}: {error}")
    if (job.output / job.name).is_dir():
        row = replace(row, reason=f"{row.reason} (the files in {job.name}/ are of an earlier run)")
    return replace(row, seconds=round(time.perf_counter() - began_s, 3))


class _Record(BaseModel, frozen=True):
    """What a batch keeps of the result of a job. It is written before the result, and counts once that is in place.

    Attributes:
        params: SHA-256 of the params.yaml that are results of the batch: the one that was replaced, and the last one.
        key: `fingerprint` of the job.
        row: its row of the table.
    """

    params: tuple[str, ...] = ()
    key: str = ""
    row: FleetRow | None = None


def _record_path(job: FleetJob) -> Path:
    return job.output / RECORDS / f"{job.name}.json"


def _record(job: FleetJob) -> _Record:
    """The record of a job; an empty one if there is none, or one that cannot be read."""
    try:
        return _Record.model_validate_json(read_text(_record_path(job), LARGEST_BYTES))
    except (ConfigError, ValidationError):
        return _Record()


def _params_digest(job: FleetJob) -> str:
    """SHA-256 of the robot's params.yaml, "" without one."""
    path = job.output / job.name / "params.yaml"
    return sha256_of(path) if path.is_file() else ""


def fingerprint(job: FleetJob) -> str:
    """SHA-256 of everything that the result of a job depends on, also of the files that its configuration names.

    Raises:
        RecordingError: a recording cannot be read.
        ConfigError: the configuration or a file that it names cannot be read.
    """
    config = load_rig(job.config, job.flags)
    parts = [__version__, config.model_dump_json(), read_urdf(config) or "", *sorted(job.flags), *job.gates]
    journals = [log.with_name(f"{log.name}-wal") for log in job.logs]  # SQLite reads them with the database
    parts += [sha256_of(path) for path in (*job.logs, *(path for path in journals if path.is_file()))]
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()


def _row(job: FleetJob, report: Report) -> FleetRow:
    verdict, numbers = report.verdict, report.values.numbers
    passed = verdict.level == "PASS"
    return FleetRow(
        job.name,
        verdict.level,
        0 if passed else QualityError.exit_code,
        verdict.reason,
        report.values.quality.stations,
        {number.name: number.value for number in numbers},
        {number.name: number.std for number in numbers},
        hint="" if passed else verdict.next_step,
    )


def in_processes(jobs: Sequence[FleetJob], count: int = os.cpu_count() or 1) -> Iterator[FleetRow]:
    """Rows in the order of completion, by local processes; if one dies, the other robots are still calibrated."""
    waiting = {job.name: job for job in jobs}
    for row in _in_a_pool(jobs, count):
        del waiting[row.name]
        yield row
    for name, job in waiting.items():  # a process died: each remaining job gets its own process, alone
        crashed = "the worker process died (out of memory, or killed)"
        yield next(_in_a_pool([job], 1), FleetRow(name, "ERROR", 1, crashed, hint=AGAIN))


def _in_a_pool(jobs: Sequence[FleetJob], count: int) -> Iterator[FleetRow]:
    """Rows in the order of completion; a pool that breaks yields only part of them."""
    with processes(count) as submit:
        if submit is None:  # no process can be started
            yield from map(run_job, jobs)
            return
        futures: list[Future[Path]] = []
        with suppress(BrokenProcessPool):  # a process may die while the jobs are submitted
            futures.extend(submit(run_job, job) for job in jobs)
        for future in as_completed(futures):
            with suppress(BrokenProcessPool):
                yield answer(future)


def batch(
    source: Path,
    output: Path,
    *,
    config_path: Path | None = None,
    flags: Mapping[str, Any] | None = None,
    gates: Sequence[str] = (),
    force: bool = False,
    run: Callable[[Sequence[FleetJob]], Iterable[FleetRow]] = in_processes,
    progress: Progress = silent,
) -> tuple[FleetRow, ...]:
    """Calibrate many robots, each into its own directory, and write summary.csv and summary.html.

    Robots with a result of an earlier run from the same inputs are skipped; `FleetRow.skipped` has the reason.

    Args:
        source: a directory of recordings, or a manifest.
        output: directory; created if it does not exist.
        config_path: rig.yaml of the robots without their own.
        flags: dotted key → value, over the files.
        gates: `NAME=LIMIT` for each robot.
        force: calibrate all robots again, and replace also results that this batch did not write.
        run: gives the row of each job, in any order.
        progress: receives the number of finished robots.

    Raises:
        ConfigError: see `fleet_jobs`.
        OutputError: the outputs cannot be written.
    """
    jobs = fleet_jobs(source, output, config_path, flags or {}, gates, force)
    for path in (output / name for name in SUMMARIES):
        if path.exists() and not (output / RECORDS).is_dir() and not force:
            raise already_exists(path)
    rows: dict[str, FleetRow] = {}
    new = [path for path in (output / RECORDS, output) if not path.exists()]
    try:
        (output / RECORDS).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise OutputError(
            f"{output}: cannot be created: {error.strerror}", "choose another --output"
        ) from error
    progress("robots", 0, len(jobs))
    try:
        for row in run(jobs):
            rows[row.name] = row
            if not row.skipped and row.exit_code in (0, QualityError.exit_code):
                placed.append(output / row.name)
            progress("robots", len(rows), len(jobs))
    except BaseException:
        for path in new:
            with suppress(OSError):  # it contains results
                path.rmdir()
        raise
    ordered = (*(rows[job.name] for job in jobs), *skipped_entries(source, output, rows))
    tables = (fleet_csv(ordered).encode(), fleet_html(ordered).encode())
    write_outputs(dict(zip((output / name for name in SUMMARIES), tables, strict=True)), force=True)
    return ordered


def on_cluster(jobs: Sequence[FleetJob], address: str, timeout_s: float = 30.0) -> Iterator[FleetRow]:
    """Rows in the order of completion, by the workers of a Dask scheduler, which must see the same files and paths.

    If a worker dies, the scheduler gives its jobs to other workers, which skip finished jobs.

    Args:
        address: of the scheduler, `tcp://host:8786`.
        timeout_s: longest time to wait for an answer of the scheduler, and for a worker, s.

    Raises:
        ConfigError: the extra is not installed, no scheduler answers, or it has no workers.
    """
    try:
        from distributed import Client, as_completed, rpc
    except ImportError as error:
        raise ConfigError(
            "the Dask package `distributed` is not installed",
            "run pip install '.[cluster]' in mobilecal's source directory, here and on the workers",
        ) from error

    async def identity() -> None:
        async with rpc(address) as scheduler:  # type: ignore[no-untyped-call]
            await scheduler.identity()

    try:
        # The client would wait without end for a program that accepts the connection and does not answer.
        asyncio.run(asyncio.wait_for(identity(), timeout_s))
        client = Client(address, timeout=timeout_s)  # type: ignore[no-untyped-call]
    except (OSError, ValueError, TimeoutError) as error:
        why = str(error) or f"no answer within {timeout_s:g} s"
        raise ConfigError(
            f"--scheduler {address}: cannot connect to the scheduler: {why}",
            "start a scheduler and workers with dask scheduler and dask worker, and check the address",
        ) from error
    with client:
        try:
            client.wait_for_workers(1, timeout=timeout_s)
        except TimeoutError as error:
            raise ConfigError(
                f"--scheduler {address}: the scheduler has no workers after {timeout_s:g} s",
                f"start workers: dask worker {address}",
            ) from error
        futures = {client.submit(run_job, job, key=f"mobilecal-{job.name}", pure=False): job for job in jobs}
        for future in as_completed(list(futures)):  # type: ignore[no-untyped-call]
            if (failed := future.exception()) is None:
                yield future.result()
            else:
                reason = f"the worker process died or failed: {type(failed).__name__}: {failed}"
                yield FleetRow(futures[future].name, "ERROR", 1, reason, hint=AGAIN)
