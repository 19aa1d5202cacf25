"""The command for many robots."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from mobilecal_cli.cli.app import app
from mobilecal_cli.cli.options import Config, Gates, Quiet, Settings, flags_of
from mobilecal_cli.errors import QualityError


@app.command()
def batch(
    source: Annotated[
        Path, typer.Argument(help="Directory of recordings, one a robot; or a manifest (YAML).")
    ],
    output: Annotated[Path, typer.Option("--output", "-o", help="Directory for all robots' results.")],
    config: Config = None,
    setting: Settings = None,
    gate: Gates = None,
    jobs: Annotated[int | None, typer.Option(min=1, help="Processes. [default: one a core]")] = None,
    scheduler: Annotated[
        str | None, typer.Option(help="Dask scheduler, tcp://host:8786, instead of processes here.")
    ] = None,
    quiet: Quiet = False,
) -> None:
    """Calibrate many robots: one directory each, one table of all; what is done already is not done again.

    Example: mobilecal batch recordings/ --output fleet/

    On a cluster: mobilecal batch fleet.yaml --output /shared/fleet --scheduler tcp://host:8786
    """
    import os

    from mobilecal_cli import pipeline
    from mobilecal_cli.report import fleet_text
    from mobilecal_cli.terminal import progress_bar

    run = pipeline.run_on(scheduler) if scheduler else pipeline.run_locally(jobs or os.cpu_count() or 1)
    with progress_bar(quiet) as progress:
        rows = pipeline.batch(
            source,
            output,
            config_path=config,
            flags=flags_of(setting),
            gates=gate or [],
            run=run,
            progress=progress,
        )
    if not quiet:
        typer.echo(fleet_text(rows), nl=False)
        typer.echo(f"written: {output / 'summary.csv'}, {output / 'summary.html'}")
    failed = [row for row in rows if row.verdict != "PASS"]
    if failed:
        raise QualityError(
            f"{len(failed)} of {len(rows)} robots do not pass: {', '.join(row.name for row in failed[:10])}"
            + (" ..." if len(failed) > 10 else ""),
            f"see {output / 'summary.html'}",
        )
