"""`mobilecal calibrate` and `suggest`: from recordings to the nine parameters and a report."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from mobilecal_cli.config import load_rig
from mobilecal_cli.export import check_output
from mobilecal_cli.model import Method
from mobilecal_cli.pipeline.evaluating import read_params
from mobilecal_cli.pipeline.loading import load
from mobilecal_cli.pipeline.progress import Progress, silent
from mobilecal_cli.pipeline.steps import Data, Report, check_options, fitted
from mobilecal_cli.report.findings import suggestion_sentences
from mobilecal_cli.report.use import recommendation
from mobilecal_cli.report.verdict import gates_of
from mobilecal_cli.solvers import Constraints


def default_output(log: Path) -> Path:
    """`<log name>_calibration` in the working directory."""
    name = log.resolve().name if log.is_dir() else log.stem
    return Path(f"{name}_calibration")


def suggest(
    logs: Sequence[Path], config_path: Path | None, flags: Mapping[str, Any], progress: Progress = silent
) -> tuple[str, ...]:
    """What limits the result, and suggested additional stops as numbered lines, the best first.

    Raises:
        MobilecalError: see `errors`.
    """
    extraction, _ = load(logs, load_rig(config_path, flags), config_path, flags, progress)
    solution = fitted(extraction, progress=progress).solution
    sentences, limiting = suggestion_sentences(solution, extraction), " ".join(recommendation(solution))
    if not sentences:
        sentences = ("No stop near the last one shows the whole board. Move the robot and record again.",)
    else:
        head = "Additional stop at the end of this recording, most useful first:"
        sentences = (head, *(f"{number}. {sentence}" for number, sentence in enumerate(sentences, 1)))
    return (*filter(None, [limiting]), *sentences)


def calibrate(
    logs: Sequence[Path],
    output: Path | None = None,
    *,
    config_path: Path | None = None,
    flags: Mapping[str, Any] | None = None,
    method: Method = "ml",
    constraints: Constraints | None = None,
    gates: Sequence[str] = (),
    hold_out: float | None = None,
    last: Path | None = None,
    force: bool = False,
    progress: Progress = silent,
    jobs: int = 1,
) -> tuple[Report, Path]:
    """Read recordings, solve, and write params.yaml, report.html, report.json and extraction.npz.

    Returns:
        The report, and the output directory.

    Args:
        logs: recordings of one robot, or one extraction.npz.
        output: directory to write; `<log name>_calibration` by default.
        config_path: rig.yaml.
        flags: dotted key → value, overriding the file.
        method: see `solvers.solve`.
        constraints: fixed parameters, priors and additional parameters; for the method "ml".
        gates: `NAME=LIMIT`, overriding those of the file.
        hold_out: share at the end of each recording to hold out and to test the calibration on.
        last: params.yaml to compare the result with; the nominal values by default.
        force: replace an existing output directory.
        progress: called with the progress.
        jobs: worker processes for images; more than one needs a main module without side effects on
            import, as for `multiprocessing`.

    Raises:
        MobilecalError: see `errors`; nothing is written then.
    """
    settings = [key for key, value in (flags or {}).items() if value is not None]
    check_options(method, constraints, hold_out, settings)
    directory = output if output is not None else default_output(logs[0])
    check_output(directory, force)
    config = load_rig(config_path, flags)
    limits = gates_of(gates, config.gates, hold_out=hold_out is not None)
    if last is not None:
        read_params(last)
    data = Data(*load(logs, config, config_path, flags or {}, progress, jobs), config.gates)
    fit = fitted(data.extraction, method, constraints, hold_out, progress)
    report = Report(data, fit, limits, last)
    progress("writing the report", 0, None)
    report.save(directory, force)
    return report, directory
