"""An evaluation of a calibration as text and as JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from mobilecal_cli.model import Evaluation, Extraction, FloatArray
from mobilecal_cli.model.text import visible
from mobilecal_cli.report.check import OUTCOME_LABELS, Check
from mobilecal_cli.report.gates import drift_figures, rms
from mobilecal_cli.report.verdict import Verdict
from mobilecal_cli.report.wording import words

EVALUATION_SCHEMA = 2


def evaluation_data(found: Evaluation) -> dict[str, Any]:
    """Every number of an evaluation, units in the keys; the keys are in docs/reference/cli.md."""
    errors = {
        "reprojection_px": found.reprojection_px,
        "rotation_deg": np.degrees(found.rotation_rad),
        "translation_mm": found.translation_m * 1e3,
    }
    return {
        "stations": found.stations,
        "legs": len(found.legs),
        "driven_m": found.driven_m,
        "turned_deg": math.degrees(found.turned_rad),
        **{key: _spread(values) for key, values in errors.items()},
        "drift_before": None if found.before is None else drift_figures(found.before),
        "drift_after": drift_figures(found.after),
        "per_leg": [
            {"log": log, "from_station": first, "to_station": second}
            | {key: float(values[leg]) for key, values in errors.items()}
            for leg, (log, first, second) in enumerate(found.legs.tolist())
        ],
    }


def _spread(values: FloatArray) -> dict[str, float]:
    return {"rms": rms(values), "median": float(np.median(values)), "worst": float(values.max())}


def evaluation_json(
    found: Evaluation,
    extraction: Extraction,
    verdict: Verdict,
    gates: Sequence[Check],
    used: Sequence[str] = (),
) -> str:
    """An evaluation with its verdict and gates for programs."""
    data = {
        "schema_version": EVALUATION_SCHEMA,
        "logs": [{"path": log.path, "sha256": log.sha256} for log in extraction.logs],
        "used_for_calibration": list(used),
        "notes": [*dependence(used, len(extraction.logs)), *extraction.notes],
        **evaluation_data(found),
        "clock_offsets_s": dict(found.clock_offsets_s),
        "verdict": {
            "level": verdict.level,
            "reason": verdict.reason,
            "next_step": verdict.next_step,
            "checks": [check_data(check) for check in verdict.checks],
        },
        "gates": [check_data(check) for check in gates],
    }
    return json.dumps(data, indent=1, sort_keys=True, allow_nan=False) + "\n"


def check_data(check: Check) -> dict[str, Any]:
    """A criterion as numbers and sentences."""
    said = words(check)
    return {
        "id": check.id,
        "value": check.value,
        "limit": check.limit,
        "unit": check.unit,
        "at_least": check.at_least,
        "outcome": OUTCOME_LABELS[check.outcome].replace(" ", "_"),
        "name": said.name,
        "measured_text": said.measured,
        "limit_text": said.limit,
        "why": "" if check.outcome == "good" else said.why,
        "next_step": "" if check.outcome == "good" else said.next_step,
    }


def dependence(used: Sequence[str], logs: int) -> tuple[str, ...]:
    """A note if the calibration was made from some of the evaluated recordings."""
    if not used:
        return ()
    which = "This recording was" if logs == 1 else f"{', '.join(used)} {'was' if len(used) == 1 else 'were'}"
    return (f"{which} used for this calibration: the errors below are not independent.",)


def evaluation_rows(found: Evaluation) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """Table rows: name of the error, then its rms, median, worst value and unit."""
    rows = []
    for meaning, values, digits, unit in (
        ("station-to-station corner error", found.reprojection_px, 2, "px"),
        ("camera rotation error", np.degrees(found.rotation_rad), 3, "deg"),
        ("camera position error", found.translation_m * 1e3, 2, "mm"),
    ):
        spread = _spread(values)
        rows.append((meaning, (*(f"{spread[key]:.{digits}f}" for key in ("rms", "median", "worst")), unit)))
    return tuple(rows)


def drift_rows(found: Evaluation) -> tuple[tuple[str, tuple[str, str, str]], ...]:
    """Table rows: name of the drift, then before, after and unit."""
    before = {} if found.before is None else drift_figures(found.before)
    after = drift_figures(found.after)
    return tuple(
        (meaning, (_number(before.get(key)), _number(after[key]), unit))
        for meaning, key, unit in (
            ("dead reckoning: position", "mm_per_m", "mm per m"),
            ("dead reckoning: heading", "deg_per_turn", "deg per turn"),
        )
    )


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def evaluation_text(found: Evaluation, notes: Sequence[str] = (), verdict: Verdict | None = None) -> str:
    """An evaluation and the checks of its verdict for the terminal."""
    lines = [f"Note: {visible(note)}" for note in notes]
    lines += [
        f"{found.stations} stations, {len(found.legs)} legs; driven {found.driven_m:.2f} m, turned "
        f"{math.degrees(found.turned_rad):.0f} deg",
    ]
    if found.clock_offsets_s:
        offsets = ", ".join(f"{name} {s * 1e3:+.1f} ms" for name, s in found.clock_offsets_s.items())
        lines += [f"Clock offsets: {offsets}"]
    lines += [
        "",
        f"  {'Prediction from station to station':<36}{'rms':>9}{'median':>9}{'worst':>9}",
        *(
            f"  {meaning:<36}{a:>9}{b:>9}{c:>9}  {unit}"
            for meaning, (a, b, c, unit) in evaluation_rows(found)
        ),
        "",
        f"  {'Drift':<36}{'before':>9}{'after':>9}",
        *(f"  {meaning:<36}{a:>9}{b:>9}  {unit}" for meaning, (a, b, unit) in drift_rows(found)),
    ]
    if verdict is not None:
        lines += [
            "",
            f"  {'Calibration against this recording':<56}{'':<21}limit",
            *(
                f"  {OUTCOME_LABELS[check.outcome]:<12}{said.name:<44}{said.measured:<21}{said.limit}"
                for check in verdict.checks
                for said in [words(check)]
            ),
        ]
    return "\n".join(lines) + "\n"
