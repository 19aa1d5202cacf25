"""`mobilecal batch`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from typer import Option

from mobilecal_cli.commands import options
from mobilecal_cli.errors import OutputError, ResourceError


def batch(
    source: Path,
    output: Annotated[Path, Option("--output", "-o")],
    config: Path | None = None,
    setting: options.Settings = None,
    gate: options.Gates = None,
    jobs: Annotated[int | None, Option(min=1)] = None,
    scheduler: str | None = None,
    force: bool = False,
    as_json: bool = False,
    junit: Path | None = None,
    quiet: bool = False,
) -> None:
    """Calibrate many robots and tabulate the results.

    Writes one directory per robot, and one table of all robots. Robots with a result from the same inputs are
    skipped; changed inputs replace the results of the same batch, and robots without a result are tried again.

    Example: mobilecal batch recordings/ --output fleet/

    On a cluster: mobilecal batch fleet.yaml --output /shared/fleet --scheduler tcp://host:8786

    Args:
        source: Directory with one recording per robot, or a manifest (YAML).
        output: Directory for the results of all robots.
        jobs: Worker processes. [default: one per core]
        scheduler: Dask scheduler such as tcp://host:8786, instead of local processes.
        force: Calibrate all robots again, and replace also results that this batch did not write.
    """
    import os
    from functools import partial

    from mobilecal_cli.calibrate.batch import AGAIN, SUMMARIES, in_processes, on_cluster
    from mobilecal_cli.calibrate.batch import batch as calibrate_each
    from mobilecal_cli.commands.terminal import progress_bar
    from mobilecal_cli.model.text import listed
    from mobilecal_cli.report.fleet import failed_text, fleet_json, fleet_text, robots_of
    from mobilecal_cli.report.junit import junit_fleet_xml
    from mobilecal_cli.report.verdict import Verdict
    from mobilecal_cli.rig.config import parse_settings

    local = partial(in_processes, count=jobs or os.cpu_count() or 1)
    run = partial(on_cluster, address=scheduler) if scheduler else local
    summaries = {name: output / name for name in SUMMARIES}
    with options.junit_file(junit, [source], force, [config], summaries) as write_junit:
        with progress_bar(quiet) as progress:
            rows = calibrate_each(
                source,
                output,
                config_path=config,
                flags=parse_settings(setting or []),
                gates=gate or [],
                force=force,
                run=run,
                progress=progress,
            )
        write_junit(junit_fleet_xml(str(source), rows))
    robots = robots_of(rows)
    failed = [row for row in robots if row.verdict != "PASS"]
    if as_json:
        typer.echo(fleet_json(rows), nl=False)
    elif not quiet:
        typer.echo(fleet_text(rows), nl=False)
    if as_json or quiet:
        typer.echo(failed_text(rows), nl=False, err=True)
    worst = max(robots, key=lambda row: row.exit_code)
    kinds = {kind.exit_code: kind for kind in (OutputError, ResourceError)}
    if worst.exit_code in kinds:
        stopped = sum(row.exit_code == worst.exit_code for row in robots)
        raise kinds[worst.exit_code](
            f"{stopped} of {len(robots)} robots were not calibrated: {worst.name}: {worst.reason}",
            worst.hint or AGAIN,
        )
    reason = f"{len(robots)} of {len(robots)} robots passed."
    if failed:
        reason = f"{len(failed)} of {len(robots)} robots did not pass: {listed(row.name for row in failed)}."
    options.conclude(
        Verdict("FAIL" if failed else "PASS", reason, f"See {output / 'summary.html'}."),
        written=(output / "summary.csv", output / "summary.html"),
        quiet=as_json or quiet,
        exit_code=worst.exit_code,  # a robot without a result has one of its own
    )
