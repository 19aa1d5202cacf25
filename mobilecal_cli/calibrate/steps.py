"""A calibration in three steps, for notebooks and for `calibrate`: extract, solve, report."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import cached_property
from pathlib import Path
from typing import Any, get_args

import numpy as np

from mobilecal_cli import __version__
from mobilecal_cli.arguments import AnyPath, by_name, names_of, pair_of, path_of, paths_of, require
from mobilecal_cli.calibrate import Progress, silent, source_date
from mobilecal_cli.calibrate.gaps import clocks_noted, require_observable, require_stations
from mobilecal_cli.calibrate.load import Data, differences, load, read_params
from mobilecal_cli.errors import ConfigError, ObservationError, SolveError
from mobilecal_cli.export.extraction import extraction_to_npz
from mobilecal_cli.export.outputs import check_output, recognized_output, write_outputs
from mobilecal_cli.export.params import parameters_from_yaml, params_yaml, with_verdict
from mobilecal_cli.kinematics import FEWEST_LEGS
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.calibration import CalibratedRobot, Parameters
from mobilecal_cli.model.observations import Extraction
from mobilecal_cli.model.rig import CameraRig
from mobilecal_cli.model.signals import CHAIN_ENDS, CHAIN_LACKS, CLOCK_SET, CLOCK_STEPS, FEW_READINGS
from mobilecal_cli.model.solution import Evaluation, Method, Provenance, Solution
from mobilecal_cli.ranges import HOLD_OUT
from mobilecal_cli.report.comparison import change_from_nominal, change_since
from mobilecal_cli.report.criteria import Case
from mobilecal_cli.report.formats import json_text
from mobilecal_cli.report.motion import motion_gaps
from mobilecal_cli.report.page import report_html
from mobilecal_cli.report.plots import path_picture
from mobilecal_cli.report.text import job_summary, notebook_html, summary_text
from mobilecal_cli.report.values import Advice, advice_on, build_report
from mobilecal_cli.report.verdict import gates_of
from mobilecal_cli.rig.config import UNCONFIGURED, RigConfig, load_rig
from mobilecal_cli.rig.settings import settings_of
from mobilecal_cli.solvers import Constraints, checked_constraints, clock_offsets
from mobilecal_cli.solvers import evaluate as evaluate_parameters
from mobilecal_cli.solvers import solve as solve_extraction

#: Sections of rig.yaml that only the method "ml" uses.
_ONLY_ML = frozenset({"noise", "priors"})


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """A solution and its data.

    Attributes:
        solution: with uncertainty, outliers, constants and residuals.
        extraction: the measurements it was solved from.
        method: as requested.
        hold_out: share of the stations that was held out, if any.
        trial: test of the parameters on the held-out stations, if there are any.
    """

    solution: Solution
    extraction: Extraction
    method: Method
    hold_out: float | None = None
    trial: Evaluation | None = None

    def __repr__(self) -> str:
        return (
            f"Fit({self.method!r}, {self.extraction!r}, point error {1e3 * self.solution.point_rms_m:.3g} mm)"
        )

    @property
    def parameters(self) -> Parameters:
        """The nine parameters, of the first camera."""
        return self.solution.parameters

    @property
    def cameras(self) -> CameraRig:
        """The cameras as estimated."""
        return self.solution.cameras

    @property
    def covariance(self) -> FloatArray | None:
        """(9, 9) covariance of the nine parameters with the pose of the reference camera, rad and m.

        None for methods that give none.
        """
        uncertainty = self.solution.uncertainty
        return None if uncertainty is None else uncertainty.reference_covariance


def extract(
    logs: AnyPath | Iterable[AnyPath],
    config: AnyPath | None = None,
    *,
    settings: Mapping[str, Any] | None = None,
    progress: Progress = silent,
    jobs: int = 1,
) -> Data:
    """Read recordings of one robot, or an extraction.npz.

    Args:
        logs: recordings, or one extraction.npz.
        config: rig.yaml.
        settings: dotted key → value, overriding the file, as `--set`.
        progress: called with the progress.
        jobs: worker processes for images; more than one needs a main module without side effects on import, as for
            `multiprocessing`.

    Raises:
        MobilecalError: see `errors`.
    """
    path = None if config is None else path_of("config", config)
    flags = by_name("settings", settings)
    files = paths_of("logs", logs)
    if not files:
        raise ConfigError("logs: no recording is given", "give a recording, or a list of them")
    require("progress", progress, Callable, "a function of stage, done and total")  # type: ignore[arg-type]
    if jobs is True or not isinstance(jobs, int | np.integer) or jobs < 1:
        raise ConfigError(f"jobs: {jobs!r} worker processes are not possible", "give 1 or more")
    return load(files, load_rig(path, flags), progress, int(jobs))


def solve(
    data: Data | Extraction,
    *,
    method: Method = "ml",
    fix: str | Mapping[str, float | None] | Iterable[str] = (),
    prior: Mapping[str, tuple[float, float]] | None = None,
    estimate: str | Iterable[str] = (),
    hold_out: float | None = None,
    progress: Progress = silent,
) -> Fit:
    """Estimate the nine parameters.

    Args:
        data: the measurements.
        method: "ml" (maximum likelihood), "linear", "paper" or "lm", see `--method`.
        fix: parameters, groups of them or constants to fix, one or several; a mapping gives each a value (m, rad,
            share), or None for the nominal one. Rotations are relative to the nominal rotation.
        prior: parameter or constant → (value, standard deviation).
        estimate: constants, kinds of them, or groups of kinds ("stereo", "lenses", "board", "head"), one or several,
            whose stated values are ignored.
        hold_out: share at the end of each recording to hold out and to test the parameters on.
        progress: called with the progress.

    Raises:
        MobilecalError: see `errors`.
    """
    require("data", data, (Data, Extraction), "what extract() returns")
    require("progress", progress, Callable, "a function of stage, done and total")  # type: ignore[arg-type]
    fixed = by_name("fix", fix) if isinstance(fix, Mapping) else dict.fromkeys(names_of("fix", fix))
    priors = by_name("prior", prior)
    constraints = checked_constraints(
        fixed.items(),
        [(name, pair_of(f"--prior {name}", pair)) for name, pair in priors.items()],
        names_of("estimate", estimate),
    )
    check_options(method, constraints, hold_out)
    extraction = data.extraction if isinstance(data, Data) else data
    return fitted(extraction, method, constraints, hold_out, progress)


def check_options(
    method: Method, constraints: Constraints, hold_out: float | None, settings: Iterable[str] = ()
) -> None:
    """Check how to solve, before any work; `settings` are dotted keys that the user gives for this run.

    Raises:
        ConfigError: an unknown method, a share that is out of range, or options that the method does not use.
    """
    methods = get_args(Method)
    if not isinstance(method, str) or method not in methods:
        raise ConfigError(f"method {method!r}: no such method", f"methods: {', '.join(methods)}")
    if hold_out is not None:
        HOLD_OUT.check("--hold-out", hold_out, "give a share, such as 0.25 for 25 %")
    if method != "ml":
        unused = [*constraints.given]
        unused += [f"--set {key}" for key in settings if key.partition(".")[0] in _ONLY_ML]
        if unused:
            raise ConfigError(
                f"{', '.join(unused)}: not used by --method {method}", "use --method ml, or leave them out"
            )


def fitted(
    whole: Extraction,
    method: Method = "ml",
    constraints: Constraints | None = None,
    hold_out: float | None = None,
    progress: Progress = silent,
) -> Fit:
    """`solve` with constraints as a value; the options are those that `check_options` allows.

    Raises:
        MobilecalError: see `errors`; a `SolveError` also names the motion or readings that the recording lacks.
    """
    constraints = constraints or Constraints()
    extraction, rest = (whole, None) if hold_out is None else held_out(whole, hold_out)
    with clocks_noted(extraction.notes):
        require_stations(extraction)
        steps = itertools.count(1)
        progress("solving", 0, None)
        try:
            if method != "ml":
                require_observable(extraction)
            solution = solve_extraction(
                extraction,
                method,
                constraints=constraints,
                on_step=lambda: progress("solving", next(steps), None),
            )
        except SolveError as error:
            gaps = motion_gaps(extraction, constraints.fixed) if method == "ml" else ()
            told = () if error.explained else (CHAIN_ENDS, CHAIN_LACKS, FEW_READINGS, CLOCK_STEPS, CLOCK_SET)
            notes = [
                note.removesuffix(".") for note in extraction.notes if any(part in note for part in told)
            ]
            cures = [*notes, *(gap.cure for gap in gaps)]
            if not cures:
                raise
            message = "; ".join([error.message, *(gap.because for gap in gaps)])
            others = [note for note in error.noted if note not in notes]
            raise SolveError(message, f"{'; '.join(cures)}; or {error.cure}", noted=others) from error
    trial = None
    if rest is not None:
        nominal, offsets = extraction.rig.nominal.wheels, clock_offsets(solution)
        constants = {name: constant.value for name, constant in solution.constants.items()}
        trial = evaluate_parameters(
            rest, solution.parameters, nominal, offsets_s=offsets, constants=constants
        )
    return Fit(solution, extraction, method, hold_out, trial)


class Report:
    """The report on a fit.

    Args:
        data: the data that were solved.
        fit: their solution.
        gates: name → limit, over those of the configuration, as `--gate`.
        last: params.yaml to compare the result with; the nominal values by default.

    Attributes:
        data, fit: as given.
        provenance: version, time, recordings and settings.
        params: text of params.yaml.
        robot: what it says.
        change: difference from the last calibration or from the nominal values, if there is either.
        verdict: PASS, FAIL or NOT ENOUGH, with all criteria.
        values: content of report.json, also every figure that a gate can limit (`metrics`).

    Raises:
        ConfigError: an unknown gate, a params.yaml that cannot be read, a fit of other data, or an argument of another
            type.
    """

    def __init__(
        self, data: Data, fit: Fit, gates: Mapping[str, float] | None = None, last: AnyPath | None = None
    ) -> None:
        require("data", data, Data, "what extract() returns")
        require("fit", fit, Fit, "what solve() returns")
        self.data, self.fit = data, fit
        solution, extraction = fit.solution, fit.extraction
        limits = gates_of((), {**data.gates, **by_name("gates", gates)}, hold_out=fit.trial is not None)
        settings = settings_of(extraction) | ({} if fit.hold_out is None else {"hold_out": fit.hold_out})
        created = (source_date() or datetime.now(UTC)).strftime("%Y-%m-%dT%H:%M:%SZ")
        self.provenance = Provenance(__version__, created, fit.method, extraction.logs, settings)
        params = params_yaml(solution, extraction, self.provenance)
        robot = parameters_from_yaml(params)
        _require_own(data.extraction, fit.extraction, robot)
        if last is None:
            self.change = change_from_nominal(robot, extraction.rig.nominal)
        else:
            earlier = read_params(path_of("last", last))
            name = f"{last} ({earlier.created})" if earlier.created else str(last)
            self.change = change_since(robot, earlier, name)
        self._case = Case(solution, extraction, self.provenance, limits, fit.trial, self.change)
        self.values = build_report(self._case)
        self.verdict = self.values.verdict
        level, reasons = self.verdict.level, self.verdict.reasons
        self.params = with_verdict(params, level, reasons)
        self.robot = replace(robot, verdict=level, reasons=reasons)

    def __repr__(self) -> str:
        return f"Report({self.verdict.level}, {self.fit!r})"

    def __str__(self) -> str:
        """The summary and the verdict, as `calibrate` prints them."""
        return "\n".join((summary_text(self.values), *self.verdict.lines))

    @property
    def json(self) -> str:
        """Text of report.json."""
        return json_text(self.values)

    @cached_property
    def html(self) -> str:
        """Text of report.html."""
        return report_html(self.values, self._case, self.data.snapshots)

    def _repr_html_(self) -> str:
        """Verdict, numbers and path, for notebooks; `html` is the whole page."""
        return notebook_html(self.values, path_picture(self.fit.solution, self.fit.extraction).svg)

    @property
    def markdown(self) -> str:
        """Verdict, numbers and change as Markdown, for the summary of a CI job."""
        return job_summary(self.values)

    def save(self, directory: AnyPath, force: bool = False) -> None:
        """Write params.yaml, report.html, report.json and extraction.npz, completely or not at all.

        Args:
            directory: to create.
            force: replace an existing output directory.

        Raises:
            OutputError: the directory cannot be written.
        """
        path = path_of("directory", directory)
        files = {
            "params.yaml": self.params.encode(),
            "report.html": self.html.encode(),
            "report.json": self.json.encode(),
            "extraction.npz": extraction_to_npz(self.data.extraction, self.data.snapshots),
        }
        write_outputs({path: files}, force)


def _require_own(data: Extraction, solved: Extraction, robot: CalibratedRobot) -> None:
    """Refuse the data of another recording or robot than the fit's; a fit may hold out some of its stations."""
    if solved is data:
        return
    different = differences(robot, data)
    stations, used = ({(o.log, o.time_ns) for o in each.observations} for each in (data, solved))
    if not used <= stations:
        different += (f"{len(used - stations)} of {len(used)} stations of the fit are not in the data",)
    if different:
        raise ConfigError(
            f"Report: the fit was not made from these data: {'; '.join(different)}",
            "give the data that solve() got",
        )


_LEAST_LEGS = 2  # between held-out stations: the least that gives an error


def held_out(extraction: Extraction, share: float) -> tuple[Extraction, Extraction]:
    """A recording without the last share of each log's stations, and these held-out stations.

    Raises:
        ObservationError: too few stations of one recording would be held out, or be left.
    """
    kept, tried = [], []
    for log in range(len(extraction.wheels)):
        members = [o for o in extraction.observations if o.log == log]
        first = len(members) - math.ceil(share * len(members))
        kept += members[:first]
        tried += members[first:]
    rest = replace(extraction, observations=tuple(tried))
    if rest.legs < _LEAST_LEGS:
        raise ObservationError(
            f"--hold-out {share:g} holds out {len(tried)} of {len(extraction.observations)} stations, with {rest.legs} "
            f"legs between them; at least {_LEAST_LEGS} legs are needed",
            "hold out a larger share, or record more stops",
        )
    searched = extraction.counts.get("stations", 0)
    counts = {**extraction.counts, "stations": searched - len(tried)} if searched else extraction.counts
    used = replace(extraction, observations=tuple(kept), counts=counts)
    if used.legs < FEWEST_LEGS <= extraction.legs:
        raise ObservationError(
            f"--hold-out {share:g} leaves {len(kept)} of {len(extraction.observations)} stations, with {used.legs} "
            f"legs between them; at least {FEWEST_LEGS} legs are needed",
            "hold out a smaller share, or record more stops",
        )
    return used, rest


def suggest(logs: Sequence[Path], config: RigConfig, progress: Progress = silent) -> Advice:
    """What limits the result, its cures from the cheapest on, and additional stops that improve it by 5 % or more.

    Raises:
        MobilecalError: see `errors`.
    """
    limits = gates_of((), config.gates)
    data = load(logs, config, progress)
    solution = fitted(data.extraction, progress=progress).solution
    return advice_on(solution, data.extraction, limits)


def calibrate(
    logs: Sequence[Path],
    output: Path,
    *,
    config: RigConfig = UNCONFIGURED,
    method: Method = "ml",
    constraints: Constraints | None = None,
    gates: Sequence[str] = (),
    hold_out: float | None = None,
    last: Path | None = None,
    force: bool = False,
    progress: Progress = silent,
    jobs: int = 1,
    before_writing: Callable[[Report], None] = lambda report: None,
) -> Report:
    """Read recordings, solve, and write params.yaml, report.html, report.json and extraction.npz.

    Args:
        logs: recordings of one robot, or one extraction.npz.
        output: directory to write.
        config: rig.yaml with the flags that override it.
        method: see `solvers.solve`.
        constraints: fixed parameters, priors and additional parameters; for the method "ml".
        gates: `NAME=LIMIT`, overriding those of the file.
        hold_out: share at the end of each recording to hold out and to test the calibration on.
        last: params.yaml to compare the result with; the nominal values by default.
        force: replace an existing output directory.
        progress: called with the progress.
        jobs: worker processes for images; more than one needs a main module without side effects on
            import, as for `multiprocessing`.
        before_writing: called with what is about to be written.

    Raises:
        MobilecalError: see `errors`; nothing is written then.
    """
    check_options(method, constraints or Constraints(), hold_out, config.flags)
    check_output(output, force, [*logs, config.path, last], recognized_output)
    limits = gates_of(gates, config.gates, hold_out=hold_out is not None)
    if last is not None:
        read_params(last)
    data = load(logs, config, progress, jobs)
    fit = fitted(data.extraction, method, constraints, hold_out, progress)
    report = Report(data, fit, limits, last)
    progress("writing the report", 0, None)
    before_writing(report)
    report.save(output, force)
    return report
