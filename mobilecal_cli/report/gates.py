"""Gates: limits on the figures of a calibration or an evaluation, `--gate NAME=LIMIT` or `gates:` in rig.yaml."""

from __future__ import annotations

import difflib
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mobilecal_cli.errors import ConfigError
from mobilecal_cli.model import Drift, Evaluation, Extraction, Solution
from mobilecal_cli.ranges import number_of
from mobilecal_cli.report.at_work import USE_GATES
from mobilecal_cli.report.check import LEAST_MOTION, Check
from mobilecal_cli.report.metrics import FIGURES, gate_names
from mobilecal_cli.report.numbers import reference_std
from mobilecal_cli.report.parameters import PARAMETERS

#: Name of a figure → its value, None if unknown.
Figures = Mapping[str, float | None]

_EVALUATED: Mapping[str, Callable[[Evaluation], float | None]] = {
    "stations": lambda found: float(found.stations),
    "legs": lambda found: float(len(found.legs)),
    "reprojection_rms_px": lambda found: rms(found.reprojection_px),
    "rotation_rms_deg": lambda found: math.degrees(rms(found.rotation_rad)),
    "translation_rms_mm": lambda found: rms(found.translation_m) * 1e3,
    "drift_mm_per_m": lambda found: drift_figures(found.after)["mm_per_m"],
    "drift_deg_per_turn": lambda found: drift_figures(found.after)["deg_per_turn"],
}
_SOLVED: Mapping[str, Callable[[Solution, Extraction], float]] = {
    "stations": lambda _, extraction: float(len(extraction.observations)),
    "legs": lambda _, extraction: float(
        len(extraction.observations) - len({o.log for o in extraction.observations})
    ),
    "reprojection_rms_px": lambda solution, _: solution.reprojection_rms_px,
    "point_rms_mm": lambda solution, _: solution.point_rms_m * 1e3,
    "left_out": lambda solution, _: float(sum(outlier.kind != "corners" for outlier in solution.outliers)),
}


@dataclass(frozen=True, slots=True)
class Gate:
    """A limit on one figure.

    Attributes:
        name: name of the figure.
        limit: upper limit, or a lower one, see `metrics`.
    """

    name: str
    limit: float


def gates_of(
    flags: Sequence[str], config: Mapping[str, float], *, evaluating: bool = False, hold_out: bool = True
) -> tuple[Gate, ...]:
    """Gates of the command line and the configuration; the command line takes precedence.

    Args:
        flags: `NAME=LIMIT`.
        config: name → limit.
        evaluating: for `evaluate`; gates of the configuration that apply to `calibrate` only are ignored.
        hold_out: whether stations are held out.

    Raises:
        ConfigError: the limit is missing or no number, or the figure is unknown or needs held-out stations.
    """
    known = gate_names(evaluating=evaluating)
    every = {*gate_names(), *gate_names(evaluating=True)}
    limits = dict(config)
    for name in config:
        if name not in every:
            raise _unknown(f"gates.{name}", name, sorted(every))
    if evaluating:
        limits = {name: limit for name, limit in limits.items() if name in known}
    for text in flags:
        name, equals, value = text.partition("=")
        if name not in known:
            raise _unknown(f"--gate {text}", name, known)
        try:
            limits[name] = float(value)
        except ValueError:
            limits[name] = math.nan
        if not equals or not math.isfinite(limits[name]):
            raise ConfigError(
                f"--gate {text}: not of the form NAME=LIMIT", "for example --gate reprojection_rms_px=0.5"
            )
    tested = next((name for name in limits if name.startswith("hold_out.")), None)
    if tested is not None and not hold_out:
        raise ConfigError(
            f"gate {tested}: no stations are held out", "add --hold-out, for example --hold-out 0.3"
        )
    return tuple(Gate(name, _finite(name, limit)) for name, limit in limits.items())


def _finite(name: str, limit: object) -> float:
    value = number_of(f"gate {name}", limit)
    if not math.isfinite(value):
        raise ConfigError(f"gate {name}: the limit is {value}", "give a finite number")
    return value


def _unknown(where: str, name: str, known: Sequence[str]) -> ConfigError:
    near = difflib.get_close_matches(name, known, n=1, cutoff=0.5)
    hint = f"did you mean {near[0]}?" if near else f"known: {', '.join(known)}"
    return ConfigError(f"{where}: unknown figure", hint)


def figures_of(
    solution: Solution,
    extraction: Extraction,
    hold_out: Evaluation | None = None,
    checks: Iterable[Check] = (),
) -> dict[str, float | None]:
    """Value of every figure of a calibration that a gate can limit, None if unknown, in the units of `METRICS`.

    Args:
        solution, extraction: the calibration.
        hold_out: evaluation on the held-out stations, if any.
        checks: criteria, whose values are figures too.
    """
    found = solution.uncertainty
    figures: dict[str, float | None] = dict.fromkeys(gate_names())
    figures |= {name: of(solution, extraction) for name, of in _SOLVED.items()}
    figures |= {f"motion.{key}": solution.motion.get(key) for key in LEAST_MOTION}
    if found is not None:
        figures |= {
            name: 0.0 for name in figures if name.startswith("noise.")
        }  # levels of zero have no criterion
        figures["observable"] = float(np.sum(found.observable | found.fixed))
        stds = zip(PARAMETERS, reference_std(solution), strict=True)
        figures |= {parameter.gate: std for parameter, std in stds}
        figures |= {figure.name: figure.of(found.at_work) for figure in FIGURES}
    if hold_out is not None:
        figures |= {f"hold_out.{name}": value for name, value in evaluated_figures(hold_out).items()}
    return figures | {check.id: check.value for check in checks if check.id in figures}


def evaluated_figures(found: Evaluation) -> Figures:
    """Every figure of an evaluation that a gate can limit."""
    return {name: of(found) for name, of in _EVALUATED.items()}


def drift_figures(drift: Drift) -> dict[str, float | None]:
    """Drift in mm per m and degrees per full turn."""
    return {
        "mm_per_m": None if drift.m_per_m is None else drift.m_per_m * 1e3,
        "deg_per_turn": None if drift.rad_per_rad is None else drift.rad_per_rad * 360,
    }


def rms(values: np.ndarray[tuple[int, ...], np.dtype[np.float64]]) -> float:
    """Root mean square."""
    return float(np.sqrt(np.mean(np.square(values))))


def use_limits(gates: Sequence[Gate]) -> Mapping[str, float]:
    """Gate → limit of the gates that replace a limit of the expected errors in use, for `judge`."""
    return {gate.name: gate.limit for gate in gates if gate.name in USE_GATES}


def gate_checks(gates: Sequence[Gate], figures: Figures) -> Iterator[Check]:
    """Each gate as a criterion of the verdict; an unknown figure fails.

    Known expected errors in use are left out: `judge` compares them with `use_limits`.
    """
    for gate in gates:
        value = figures.get(gate.name)
        if gate.name in USE_GATES and value is not None:
            continue
        check = Check(f"gate.{gate.name}", value, gate.limit, "pass")
        passes = value is not None and (value >= gate.limit if check.at_least else abs(value) <= gate.limit)
        yield check if passes else replace(check, outcome="fail")
