"""`mobilecal calibrate` and `suggest`: from recordings to the nine parameters and a report."""

from __future__ import annotations

import itertools
import os
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from mobilecal_cli import __version__
from mobilecal_cli.config import load_rig
from mobilecal_cli.errors import SolveError
from mobilecal_cli.export import (
    check_output,
    extraction_to_npz,
    parameters_from_yaml,
    params_yaml,
    write_outputs,
)
from mobilecal_cli.model import CalibratedRobot, Evaluation, Extraction, Method, Provenance, Solution
from mobilecal_cli.pipeline.drawing import Draughtsman
from mobilecal_cli.pipeline.evaluating import held_out, read_params
from mobilecal_cli.pipeline.loading import load
from mobilecal_cli.pipeline.progress import Progress, silent
from mobilecal_cli.pipeline.settings import settings_of
from mobilecal_cli.report import (
    Change,
    Verdict,
    change_from_nominal,
    change_since,
    gates_of,
    judge,
    recommendation,
    report_html,
    report_json,
    suggestion_sentences,
)
from mobilecal_cli.solvers import Constraints, clock_offsets, evaluate, solve
from mobilecal_cli.uncertainty import motion_gaps, require_observable, require_stations


@dataclass(frozen=True, slots=True, eq=False)
class Calibration:
    """Result of a calibration.

    Attributes:
        solution, extraction, verdict: the solution, its data and the verdict on it.
        directory: output directory.
        trial: test of the calibration on the held-out stations, if there are any.
    """

    solution: Solution
    extraction: Extraction
    verdict: Verdict
    directory: Path
    trial: Evaluation | None = None


def default_output(log: Path) -> Path:
    """`<log name>_calibration` in the working directory."""
    name = log.resolve().name if log.is_dir() else log.stem
    return Path(f"{name}_calibration")


def _created() -> str:
    """Current time in UTC; SOURCE_DATE_EPOCH overrides it, for reproducible output."""
    epoch = os.environ.get("SOURCE_DATE_EPOCH", "")
    now = datetime.fromtimestamp(int(epoch), UTC) if epoch.isdigit() else datetime.now(UTC)
    return now.strftime("%Y-%m-%dT%H:%M:%SZ")


def _solved(
    extraction: Extraction, method: Method, constraints: Constraints | None, progress: Progress
) -> Solution:
    """Solve; an error is extended by the motion that the recording lacks."""
    steps = itertools.count(1)
    progress("solving", 0, None)
    try:
        return solve(
            extraction,
            method,
            constraints=constraints,
            on_step=lambda: progress("solving", next(steps), None),
        )
    except SolveError as error:
        gaps = motion_gaps(extraction, constraints.fixed if constraints is not None else ())
        if not gaps:
            raise
        because, cures = "; ".join(gap.because for gap in gaps), "; ".join(gap.cure for gap in gaps)
        raise SolveError(f"{error.message}; {because}", f"{cures}; or {error.hint}") from error


def suggest(
    logs: Sequence[Path], config_path: Path | None, flags: Mapping[str, Any], progress: Progress = silent
) -> tuple[str, ...]:
    """What limits the result, and suggested additional stops as numbered lines, the best first.

    Raises:
        MobilecalError: see `errors`.
    """
    extraction, _ = load(logs, load_rig(config_path, flags), config_path, flags, progress)
    require_stations(extraction)
    solution = _solved(extraction, "ml", None, progress)
    sentences, limiting = suggestion_sentences(solution, extraction), " ".join(recommendation(solution))
    if not sentences:
        return (
            *filter(None, [limiting]),
            "No stop near the last one shows the whole board. Move the robot and record again.",
        )
    head = "Additional stop at the end of this recording, most useful first:"
    return (
        *filter(None, [limiting]),
        head,
        *(f"{number}. {sentence}" for number, sentence in enumerate(sentences, 1)),
    )


def _change(
    robot: CalibratedRobot, earlier: CalibratedRobot | None, name: Path | None, extraction: Extraction
) -> Change | None:
    if earlier is not None:
        return change_since(robot, earlier, f"{name} ({earlier.created})" if earlier.created else str(name))
    return change_from_nominal(robot, extraction.rig.nominal)


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
) -> Calibration:
    """Read recordings, solve, and write params.yaml, report.html, report.json and extraction.npz.

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
        jobs: worker processes for images and figures; more than one needs a main module without side effects on
            import, as for `multiprocessing`.

    Raises:
        MobilecalError: see `errors`; nothing is written then.
    """
    with Draughtsman(jobs) as draughtsman:
        directory = output if output is not None else default_output(logs[0])
        check_output(directory, force)
        config = load_rig(config_path, flags)
        limits = gates_of(gates, config.gates, hold_out=hold_out is not None)
        earlier = None if last is None else read_params(last)
        whole, snapshots = load(logs, config, config_path, flags or {}, draughtsman.watching(progress), jobs)
        extraction, rest = (whole, None) if hold_out is None else held_out(whole, hold_out)
        require_stations(extraction)
        if method != "ml":
            require_observable(extraction)
        draughtsman.begin_with(extraction)
        solution = _solved(extraction, method, constraints, progress)
        nominal = extraction.rig.nominal.wheels
        offsets = clock_offsets(solution)
        trial = None if rest is None else evaluate(rest, solution.parameters, nominal, offsets_s=offsets)
        settings = settings_of(extraction) | ({} if hold_out is None else {"hold_out": hold_out})
        provenance = Provenance(__version__, _created(), method, extraction.logs, settings)
        drawing = draughtsman.begin(solution, extraction)
        params = params_yaml(solution, extraction, provenance)
        change = _change(parameters_from_yaml(params), earlier, last, extraction)
        verdict = judge(solution, extraction, limits, trial, change)
        progress("writing the report", 0, None)
        files = {
            "params.yaml": params.encode(),
            "report.json": report_json(solution, extraction, provenance, verdict, trial, change).encode(),
            "extraction.npz": extraction_to_npz(whole),
            "report.html": report_html(
                solution, extraction, snapshots, provenance, verdict, trial, change, drawing
            ).encode(),
        }
        write_outputs(directory, files, force)
    return Calibration(solution, extraction, verdict, directory, trial)
