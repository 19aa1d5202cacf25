"""An evaluation of a calibration as numbers, as text and as JSON."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from mobilecal_cli.model import Drift, Evaluation, Extraction, FloatArray
from mobilecal_cli.model.text import visible
from mobilecal_cli.report.check import Check
from mobilecal_cli.report.gates import drift_figures, rms
from mobilecal_cli.report.values import DriftData, EvaluationData, LegErrorData, SpreadData, json_text
from mobilecal_cli.report.verdict import Verdict, check_data, verdict_data
from mobilecal_cli.report.wording import words
from mobilecal_cli.report.wording.evaluation import dependence

EVALUATION_SCHEMA = 2


def evaluation_data(found: Evaluation) -> EvaluationData:
    """Every number of an evaluation."""
    errors = {
        "reprojection_px": found.reprojection_px,
        "rotation_deg": np.degrees(found.rotation_rad),
        "translation_mm": found.translation_m * 1e3,
    }
    return EvaluationData(
        stations=found.stations,
        legs=len(found.legs),
        driven_m=found.driven_m,
        turned_deg=math.degrees(found.turned_rad),
        **{key: _spread(values) for key, values in errors.items()},
        drift_before=None if found.before is None else _drift(found.before),
        drift_after=_drift(found.after),
        per_leg=tuple(
            LegErrorData(
                log=log,
                from_station=first,
                to_station=second,
                **{key: float(values[leg]) for key, values in errors.items()},
            )
            for leg, (log, first, second) in enumerate(found.legs.tolist())
        ),
        clock_offsets_s=dict(found.clock_offsets_s),
    )


def _drift(drift: Drift) -> DriftData:
    return DriftData(**drift_figures(drift))


def _spread(values: FloatArray) -> SpreadData:
    return SpreadData(rms=rms(values), median=float(np.median(values)), worst=float(values.max()))


def evaluation_json(
    found: Evaluation,
    extraction: Extraction,
    verdict: Verdict,
    gates: Sequence[Check],
    used: Sequence[str] = (),
) -> str:
    """An evaluation with its verdict and gates for programs."""
    numbers = evaluation_data(found)
    return json_text(
        {
            "schema_version": EVALUATION_SCHEMA,
            "logs": [{"path": log.path, "sha256": log.sha256} for log in extraction.logs],
            "used_for_calibration": list(used),
            "notes": [*dependence(used, len(extraction.logs)), *extraction.notes],
            **{name: getattr(numbers, name) for name in EvaluationData.__dataclass_fields__},
            "verdict": verdict_data(verdict),
            "gates": [check_data(check) for check in gates],
        }
    )


def evaluation_rows(found: EvaluationData) -> tuple[tuple[str, ...], ...]:
    """Table rows: name of the error, its rms, median, worst value and unit."""
    return tuple(
        (meaning, *(f"{value:.{digits}f}" for value in (spread.rms, spread.median, spread.worst)), unit)
        for meaning, spread, digits, unit in (
            ("station-to-station corner error", found.reprojection_px, 2, "px"),
            ("camera rotation error", found.rotation_deg, 3, "deg"),
            ("camera position error", found.translation_mm, 2, "mm"),
        )
    )


def drift_rows(found: EvaluationData) -> tuple[tuple[str, ...], ...]:
    """Table rows: name of the drift, before, after and unit."""
    return tuple(
        (meaning, *("-" if drift is None or getattr(drift, key) is None else f"{getattr(drift, key):.2f}"
                    for drift in (found.drift_before, found.drift_after)), unit)
        for meaning, key, unit in (
            ("dead reckoning: position", "mm_per_m", "mm per m"),
            ("dead reckoning: heading", "deg_per_turn", "deg per turn"),
        )
    )  # fmt: skip


def evaluation_text(found: EvaluationData, notes: Sequence[str] = (), verdict: Verdict | None = None) -> str:
    """An evaluation and the checks of its verdict for the terminal."""
    lines = [f"Note: {visible(note)}" for note in notes]
    lines += [
        f"{found.stations} stations, {found.legs} legs; driven {found.driven_m:.2f} m, turned "
        f"{found.turned_deg:.0f} deg",
    ]
    if found.clock_offsets_s:
        offsets = ", ".join(f"{name} {s * 1e3:+.1f} ms" for name, s in found.clock_offsets_s.items())
        lines += [f"Clock offsets: {offsets}"]
    lines += [
        "",
        f"  {'Prediction from station to station':<36}{'rms':>9}{'median':>9}{'worst':>9}",
        *(f"  {meaning:<36}{a:>9}{b:>9}{c:>9}  {unit}" for meaning, a, b, c, unit in evaluation_rows(found)),
        "",
        f"  {'Drift':<36}{'before':>9}{'after':>9}",
        *(f"  {meaning:<36}{a:>9}{b:>9}  {unit}" for meaning, a, b, unit in drift_rows(found)),
    ]
    if verdict is not None:
        lines += [
            "",
            f"  {'Calibration against this recording':<56}{'':<21}limit",
            *(
                f"  {check.label:<12}{said.name:<44}{said.measured:<21}{said.limit}"
                for check in verdict.checks
                for said in [words(check)]
            ),
        ]
    return "\n".join(lines) + "\n"
