"""The command that calibrates many robots."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mobilecal_cli.cli.app import app
from mobilecal_cli.cli.options import Config, Gates, Quiet, Settings, flags_of
from mobilecal_cli.cli.verdict import conclude
from mobilecal_cli.errors import OutputError, ResourceError


@app.command()
def batch(
    source: Annotated[
        Path,
        typer.Argument(readable=False, help="Directory with one recording per robot, or a manifest (YAML)."),
    ],
    output: Annotated[
        Path, typer.Option("--output", "-o", readable=False, help="Directory for the results of all robots.")
    ],
    config: Config = None,
    setting: Settings = None,
    gate: Gates = None,
    jobs: Annotated[int | None, typer.Option(min=1, help="Worker processes. [default: one per core]")] = None,
    scheduler: Annotated[
        str | None, typer.Option(help="Dask scheduler such as tcp://host:8786, instead of local processes.")
    ] = None,
    force: Annotated[
        bool, typer.Option("--force", help="Replace results that this batch did not write.")
    ] = False,
    quiet: Quiet = False,
) -> None:
    """Calibrate many robots and tabulate the results.

    Writes one directory per robot, and one table of all robots. Robots that are already done are skipped; changed
    settings replace the results of the same batch.

    Example: mobilecal batch recordings/ --output fleet/

    On a cluster: mobilecal batch fleet.yaml --output /shared/fleet --scheduler tcp://host:8786
    """
    import os

    from mobilecal_cli.pipeline import cluster, fleet
    from mobilecal_cli.report.fleet import fleet_text
    from mobilecal_cli.terminal import progress_bar

    run = cluster.run_on(scheduler) if scheduler else fleet.run_locally(jobs or os.cpu_count() or 1)
    with progress_bar(quiet) as progress:
        rows = fleet.batch(
            source,
            output,
            config_path=config,
            flags=flags_of(setting),
            gates=gate or [],
            force=force,
            run=run,
            progress=progress,
        )
    if not quiet:
        typer.echo(fleet_text(rows), nl=False)
    robots = [row for row in rows if row.verdict != "SKIPPED"]
    stopped = [row for row in robots if row.verdict == "ERROR" and row.exit_code in fleet.OF_THE_MACHINE]
    if stopped:
        kind = OutputError if stopped[0].exit_code == OutputError.exit_code else ResourceError
        raise kind(
            f"{len(stopped)} of {len(robots)} robots were not calibrated: {stopped[0].name}: {stopped[0].reason}",
            "see the reason, then run the same command again: it calibrates only what is missing",
        )
    failed = [row.name for row in robots if row.verdict != "PASS"]
    names = ", ".join(failed[:10]) + (", ..." if len(failed) > 10 else "")
    conclude(
        "FAIL" if failed else "PASS",
        f"{len(failed)} of {len(robots)} robots did not pass: {names}."
        if failed
        else f"{len(robots)} of {len(robots)} robots passed.",
        f"See {output / 'summary.html'}.",
        written=(output / "summary.csv", output / "summary.html"),
        quiet=quiet,
    )
