"""What a calibration predicted on stations that it was not made from, as text and as JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from mobilecal_cli.model import Evaluation, Extraction, FloatArray
from mobilecal_cli.report.check import Check
from mobilecal_cli.report.gates import drift_figures, rms

EVALUATION_SCHEMA = 1


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


def evaluation_json(found: Evaluation, extraction: Extraction, checks: Sequence[Check]) -> str:
    """An evaluation and its gates for programs."""
    gates = [
        {"name": c.name, "measured": c.measured, "limit": c.limit, "kept": c.outcome == "good"}
        for c in checks
    ]
    logs = [{"path": log.path, "sha256": log.sha256} for log in extraction.logs]
    data = {
        "schema_version": EVALUATION_SCHEMA,
        "logs": logs,
        "notes": list(extraction.notes),
        **evaluation_data(found),
        "gates": gates,
    }
    return json.dumps(data, indent=1, sort_keys=True, allow_nan=False) + "\n"


def evaluation_rows(found: Evaluation) -> tuple[tuple[str, tuple[str, ...]], ...]:
    """Lines of a table: what is compared, then rms, median and worst with their unit."""
    rows = []
    for meaning, values, digits, unit in (
        ("corners carried from stop to stop", found.reprojection_px, 2, "px"),
        ("camera's rotation", np.degrees(found.rotation_rad), 3, "deg"),
        ("camera's place", found.translation_m * 1e3, 2, "mm"),
    ):
        spread = _spread(values)
        rows.append((meaning, (*(f"{spread[key]:.{digits}f}" for key in ("rms", "median", "worst")), unit)))
    return tuple(rows)


def drift_rows(found: Evaluation) -> tuple[tuple[str, tuple[str, str, str]], ...]:
    """Lines of a table: what drifts, before, after and the unit."""
    before = {} if found.before is None else drift_figures(found.before)
    after = drift_figures(found.after)
    return tuple(
        (meaning, (_number(before.get(key)), _number(after[key]), unit))
        for meaning, key, unit in (
            ("dead reckoning: place", "mm_per_m", "mm per m"),
            ("dead reckoning: heading", "deg_per_turn", "deg per turn"),
        )
    )


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"


def evaluation_text(found: Evaluation, checks: Sequence[Check]) -> str:
    """An evaluation for people."""
    lines = [
        f"{found.stations} stations, {len(found.legs)} legs; driven {found.driven_m:.2f} m, turned "
        f"{math.degrees(found.turned_rad):.0f} deg",
        "",
        f"  {'Predicted from stop to stop':<36}{'rms':>9}{'median':>9}{'worst':>9}",
        *(
            f"  {meaning:<36}{a:>9}{b:>9}{c:>9}  {unit}"
            for meaning, (a, b, c, unit) in evaluation_rows(found)
        ),
        "",
        f"  {'Drift':<36}{'before':>9}{'after':>9}",
        *(f"  {meaning:<36}{a:>9}{b:>9}  {unit}" for meaning, (a, b, unit) in drift_rows(found)),
    ]
    if checks:
        lines += [
            "",
            *(
                f"  {'kept' if c.outcome == 'good' else 'NOT KEPT'}: {c.name}: {c.measured} ({c.limit})"
                for c in checks
            ),
        ]
    return "\n".join(lines) + "\n"
