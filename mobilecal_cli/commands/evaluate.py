"""`mobilecal evaluate`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer
from typer import Argument

from mobilecal_cli.commands import options
from mobilecal_cli.errors import ConfigError


def evaluate(
    files: Annotated[list[Path], Argument(metavar="logs... params")],
    before: Path | None = None,
    config: Path | None = None,
    setting: options.Settings = None,
    gate: options.Gates = None,
    as_json: bool = False,
    junit: Path | None = None,
    force: bool = False,
    verbose: bool = False,
    quiet: bool = False,
) -> None:
    """Test a calibration on another recording.

    Prints the prediction errors from station to station, the drift of dead reckoning, and a verdict.

    Example: mobilecal evaluate another.mcap log_calibration/params.yaml

    In CI: mobilecal evaluate another.mcap params.yaml --gate translation_rms_mm=15 --gate drift_deg_per_turn=3

    Args:
        files: Recordings of one robot, and last the params.yaml of the calibration to test.
        before: params.yaml with the wheels to compare drift with. [default: the nominal wheels]
        force: Replace also a file at --junit that mobilecal did not write.
        quiet: Print no progress.
    """
    from mobilecal_cli.calibrate.evaluate import evaluate as evaluated
    from mobilecal_cli.commands.terminal import progress_bar
    from mobilecal_cli.report.evaluation import evaluation_json, evaluation_text
    from mobilecal_cli.report.junit import junit_xml

    *logs, params = files
    with options.junit_file(junit, files, force, [before, config]) as write_junit:
        if not logs:
            raise ConfigError(
                f"{params}: the only path given; evaluate needs a recording and a params.yaml",
                "mobilecal evaluate another.mcap log_calibration/params.yaml",
            )
        with progress_bar(quiet, verbose) as progress:
            result = evaluated(
                logs,
                params,
                before=before,
                config=options.rig_of(config, setting),
                gates=gate or [],
                progress=progress,
            )
        write_junit(junit_xml(str(logs[0]), result.verdict))
    text = evaluation_json(result) if as_json else evaluation_text(result)
    typer.echo(text, nl=False)
    options.conclude(result.verdict, quiet=as_json)
