"""The verdict on a calibration: PASS, FAIL or NOT ENOUGH, with the reason and the next step; and gates.

PASS means that the expected errors in use are within their limits, and that nothing contradicts. Gates are limits on
figures of a calibration or an evaluation, `--gate NAME=LIMIT` or `gates:` in rig.yaml.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from mobilecal_cli.errors import ConfigError
from mobilecal_cli.likelihood.predict import off_as_stated
from mobilecal_cli.model.calibration import NINE
from mobilecal_cli.model.findings import AtWork
from mobilecal_cli.model.rig import HeadChain
from mobilecal_cli.model.solution import Evaluation, Solution
from mobilecal_cli.model.text import capitalized, wrapped
from mobilecal_cli.ranges import number_of
from mobilecal_cli.report.checks import EVALUATED
from mobilecal_cli.report.criteria import CRITERIA, Case, Check, Metric
from mobilecal_cli.report.numbers import PARAMETERS, numbers_of, plain_names, reference_std
from mobilecal_cli.report.use import FIGURES, Error, Figure, next_step_of, shares_of, use_sentence

Level = Literal["PASS", "FAIL", "NOT ENOUGH", "GATE FAILED"]
GATE = "gate."  # how the ids of the user's limits begin


@dataclass(frozen=True, slots=True)
class Verdict:
    """Whether the calibration can be used, with every criterion."""

    level: Level
    reason: str
    next_step: str
    checks: tuple[Check, ...] = ()

    @property
    def lines(self) -> list[str]:
        """Verdict and next step for the terminal, escaped."""
        texts = f"{self.level}: {self.reason}", f"Next: {self.next_step}"
        return [line for text in texts for line in wrapped(text, "")]

    @property
    def reasons(self) -> tuple[str, ...]:
        """One sentence or two for each criterion that is not met; none for PASS."""
        return tuple(check.why for check in self.checks if not check.met)

    def check(self, of: str) -> Check:
        """A criterion by its id, such as "point_error".

        Raises:
            KeyError: there is none.
        """
        return {check.id: check for check in self.checks}[of]


def verdict_of(case: Case) -> Verdict:
    """The verdict: the first criterion that is not met decides."""
    solution = case.solution
    gated = gate_checks(case.gates, figures_of(case), lambda *gate: _gate_cure(case, *gate))
    checks = (*(check for check in case.checks if check.name), *gated)
    decisive = next((check for check in checks if not check.met), None)
    if decisive is not None:
        return decided_by(decisive, checks, case.gates)
    if solution.uncertainty is None:
        unknown = "gives no standard deviations, so the expected errors in use are unknown"
        error = f"The point error is {solution.point_rms_m * 1e3:.1f} mm."
        reason = f"{error} The method {solution.method} {unknown}."
        next_step = "Calibrate with --method ml (the default) for standard deviations and expected errors."
    else:
        reason = use_sentence(solution, case.gates)
        numbers = zip(
            NINE, numbers_of(solution, case.extraction.rig), solution.uncertainty.described, strict=False
        )
        for name, number, described in numbers:
            if described:
                shown = capitalized(plain_names([name], case.extraction))
                reason += f" {shown} {number.state}: no motion shows it, and these errors do not include it."
        next_step = _use(solution, solution.uncertainty.at_work, case.extraction.rig.chain)
    return Verdict("PASS", reason, next_step + _first(checks), checks)


def _use(solution: Solution, at_work: AtWork, chain: HeadChain) -> str:
    """How to use a result that passes: with the corrections of the head chain where they are more than the errors."""
    values = {constant.name: constant.value for constant in solution.constants.values()}
    turn_rad, shift_m = off_as_stated(chain, values, solution.parameters.T_h_c)
    if turn_rad <= at_work.camera_rad and shift_m <= at_work.camera_m:
        return "Use params.yaml on the robot."
    return (
        "Use params.yaml on the robot, also its corrections of the head chain (export --to urdf --with-chain): "
        f"without them, the camera is {math.degrees(turn_rad):.2g} degrees and {1e3 * shift_m:.2g} mm from its place."
    )


def _first(checks: Iterable[Check]) -> str:
    """What to look at before the next step: the first warning."""
    look = next((check for check in checks if check.outcome == "warning"), None)
    return "" if look is None else f" Check first: {look.why} {look.next_step}"


def decided_by(check: Check, checks: tuple[Check, ...], gates: Collection[str] = ()) -> Verdict:
    """The verdict where one check decides; the reason also has every other gate that is not met.

    Args:
        check: the one that decides.
        checks: all.
        gates: names of the gates, which are the ids of checks of expected errors in use.
    """
    level: Level = "NOT ENOUGH" if check.outcome == "not_enough" else "FAIL"
    if check.id.startswith(GATE):
        level = "GATE FAILED"
    first = ""
    if level == "NOT ENOUGH":  # a new recording would show the same
        first = _first(each for each in checks if each.next_step != check.next_step)
    label = "" if level == "GATE FAILED" else "Gate failed: "
    others = (
        f"{label * each.id.startswith(GATE)}{each.why}"
        for each in checks
        if not each.met and each is not check and (each.id.startswith(GATE) or each.id in gates)
    )
    return Verdict(level, " ".join((check.why, *others)), check.next_step + first, checks)


_USE_GATES = frozenset(figure.name for figure in FIGURES)


def gate_metrics(*, evaluating: bool = False) -> dict[str, Metric]:
    """Name → figure, of those that a gate of `calibrate` (or of `evaluate`) can limit."""
    judged = (metric for criterion in CRITERIA if criterion.gated for metric in criterion.metrics)
    return {metric.name: metric for metric in (EVALUATED if evaluating else judged)}


def gates_of(
    flags: Sequence[str], config: Mapping[str, float], *, evaluating: bool = False, hold_out: bool = True
) -> dict[str, float]:
    """Gates of the command line and the configuration, name → limit; the command line takes precedence.

    Args:
        flags: `NAME=LIMIT`.
        config: name → limit.
        evaluating: for `evaluate`; gates of the configuration that are those of the other command are ignored.
        hold_out: whether stations are held out.

    Raises:
        ConfigError: the limit is missing or no number, or the figure is unknown, has two limits on the command line, or
            needs held-out stations.
    """
    known = tuple(gate_metrics(evaluating=evaluating))
    every = gate_metrics() | gate_metrics(evaluating=True)
    for name in config:
        if name not in every:
            raise _unknown(f"gates.{name}", name, sorted(every))
    limits = {name: limit for name, limit in config.items() if name in known}
    given: set[str] = set()
    for text in flags:
        name, _, stated = text.partition("=")
        if name not in known:
            raise _unknown(f"--gate {text}", name, known)
        if name in given:
            raise ConfigError(f"--gate {text}: a second limit of {name}", "give one limit for each figure")
        given.add(name)
        try:
            limits[name] = float(stated)
        except ValueError:
            limits[name] = math.nan
        if not math.isfinite(limits[name]):
            wrong = f"{stated!r} is not a finite number" if stated else "not of the form NAME=LIMIT"
            raise ConfigError(f"--gate {text}: {wrong}", "for example --gate reprojection_rms_px=0.5")
    tested = next((name for name in limits if name.startswith("hold_out.")), None)
    if tested is not None and not hold_out:
        raise ConfigError(
            f"gate {tested}: no stations are held out", "add --hold-out, for example --hold-out 0.3"
        )
    for name, limit in limits.items():
        if not math.isfinite(number_of(f"gate {name}", limit)):
            raise ConfigError(f"gate {name}: the limit is {limit}", "give a finite number")
    return {name: float(limit) for name, limit in limits.items()}


def _unknown(where: str, name: str, known: Sequence[str]) -> ConfigError:
    near = difflib.get_close_matches(name, known, cutoff=0.4)
    question = f"did you mean {' or '.join(near)}? " if near else ""
    return ConfigError(f"{where}: unknown figure", f"{question}docs/how-to/use-in-ci.md lists all figures")


def figures_of(case: Case) -> dict[str, float | None]:
    """Value of every figure of a calibration that a gate can limit, None if unknown.

    The factors of odometry are left out for a robot with wheels.
    """
    alone = case.extraction.rig.sources.assumed_odometry is not None
    values = {check.id: check.value for check in case.checks}
    names = (name for name in gate_metrics() if alone or not name.startswith("std.odometry."))
    return {name: values.get(name) for name in names}


def evaluated_figures(evaluation: Evaluation) -> dict[str, float | None]:
    """Every figure of an evaluation that a gate can limit, None if unknown."""
    return {metric.name: of(evaluation) for metric, of in EVALUATED.items()}


def _gate_cure(case: Case, name: str, limit: float) -> str:
    """What improves a figure beyond its gate: for a standard deviation by its error budget."""
    uncertainty, names = case.solution.uncertainty, [parameter.gate for parameter in PARAMETERS]
    if uncertainty is None:
        return "Calibrate with --method ml (the default), which estimates standard deviations."
    if name not in names:
        return ""
    k = names.index(name)
    shares = shares_of(uncertainty.budget, PARAMETERS[k].name)
    label, unit = f"sigma of the {PARAMETERS[k].label}", PARAMETERS[k].unit
    value = float(reference_std(case.solution)[k] or 0.0)
    error = Error(Figure("", name, label, label, unit, 1.0), value, limit, shares)
    return next_step_of(error, case.solution, case.extraction)


def gate_checks(
    gates: Mapping[str, float],
    figures: Mapping[str, float | None],
    cure: Callable[[str, float], str] = lambda *_: "",
) -> Iterator[Check]:
    """Each gate as a criterion of the verdict, with its cure; an unknown figure fails.

    Known expected errors in use are left out: `verdict_of` compares them with the limits of their gates.
    """
    metrics = gate_metrics() | gate_metrics(evaluating=True)
    for name, limit in gates.items():
        value = figures.get(name)
        if name in _USE_GATES and value is not None:
            continue
        metric, measured = metrics[name], "unknown" if value is None else _rounded(value, limit)
        otherwise = "Record again, or change the limit."
        if value is None:
            otherwise = "Leave out this gate: the calibration does not have this figure."
        check = replace(metric, name=f"{GATE}{name}", section="checks").check(
            value,
            limit,
            f"gate {name}",
            cure(name, limit) or otherwise,
            measured=f"{measured}{metric.after}",
            beyond="fail",
        )
        yield check if check.met else replace(check, why=f"{name} = {measured} ({check.limit_text}).")


def _rounded(value: float, limit: float) -> str:
    """A value with three digits, or more where three equal the limit."""
    for digits in (3, 6, 9):
        shown = f"{value:.{max(digits, len(str(int(abs(value)))))}g}"
        if float(shown) != limit or value == limit:
            break
    return shown
