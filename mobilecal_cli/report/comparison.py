"""Calibrations side by side, as text and as JSON."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from mobilecal_cli.comparison import Difference, History
from mobilecal_cli.likelihood.predict import AHEAD_M
from mobilecal_cli.model import NINE, CalibratedRobot, FloatArray
from mobilecal_cli.model.text import visible
from mobilecal_cli.report.units import SHOWN

COMPARISON_SCHEMA = 1
#: Chance is blamed for what it does once in so many.
_UNLIKELY = 0.01


def comparison_text(names: Sequence[str], differences: Sequence[Difference], past: History | None) -> str:
    """Every calibration against the first; with three and more also whether each number stays."""
    lines = []
    for name, found in zip(names[1:], differences, strict=True):
        lines += [f"{visible(name)} less {visible(names[0])}", ""]
        lines += [f"  {'':<14}{'change':>12}{'std':>12}{'sigmas':>9}"]
        for k, number in enumerate(NINE):
            unit, factor = SHOWN[number]
            std = f"{found.std[k] * factor:.3f}" if found.known[k] else "-"
            sigmas = f"{found.sigmas[k]:+.1f}" if found.known[k] else "-"
            lines.append(f"  {number:<14}{found.change[k] * factor:>+12.3f}{std:>12}{sigmas:>9}  {unit}")
        lines += ["", *(f"  {meaning:<52}{value:>+10.3f}  {unit}" for meaning, value, unit in _felt(found))]
        lines += ["", f"  {_says(found)}", ""]
    if past is not None:
        lines += [f"Over all {len(names)} calibrations, against a robot that does not change:", ""]
        for number, chance in zip(NINE, past.chance, strict=True):
            lines.append(f"  {number:<14}{_stays(chance)}")
        lines.append("")
    return "\n".join(lines)


def _felt(found: Difference) -> tuple[tuple[str, float, str], ...]:
    return (
        (f"a point that the camera sees {AHEAD_M:g} m ahead", found.ray_m * 1e3, "mm"),
        ("dead reckoning straight on: distance", found.along_m_per_m * 1e3, "mm per m"),
        ("dead reckoning straight on: heading", math.degrees(found.heading_rad_per_m), "deg per m"),
        ("dead reckoning on the spot: heading", math.degrees(found.heading_rad_per_turn), "deg per turn"),
    )


def _says(found: Difference) -> str:
    if found.chance is None:
        return "Without standard deviations of both nothing says whether this is chance."
    verdict = (
        "more than chance: the robot has changed, or one of the two is wrong"
        if found.chance < _UNLIKELY
        else "no more than chance does"
    )
    note = "; they share a recording, so this says little" if found.shared else ""
    return (
        f"chi-squared {found.chi2:.1f} of {int(found.known.sum())} numbers, as large by chance in "
        f"{100 * found.chance:.2g} % of cases: {verdict}{note}."
    )


def _stays(chance: float) -> str:
    if not math.isfinite(chance):
        return "not known by two or more"
    return f"{'moves' if chance < _UNLIKELY else 'stays'} (as far apart by chance in {100 * chance:.2g} % of cases)"


def comparison_json(
    names: Sequence[str],
    robots: Sequence[CalibratedRobot],
    differences: Sequence[Difference],
    past: History | None,
) -> str:
    """The same for programs: rad and m, units in the keys."""
    data: dict[str, Any] = {
        "schema_version": COMPARISON_SCHEMA,
        "order": list(NINE),
        "calibrations": [
            {"name": name, "created": robot.created} for name, robot in zip(names, robots, strict=True)
        ],
        "against_first": [_plain(found) for found in differences],
        "chance_unchanged": None if past is None else _numbers(past.chance),
    }
    return json.dumps(data, indent=1, allow_nan=False) + "\n"


def _plain(found: Difference) -> dict[str, Any]:
    return {
        "change": found.change.tolist(),
        "std": _numbers(np.where(found.known, found.std, np.nan)),
        "sigmas": _numbers(found.sigmas),
        "chi2": found.chi2,
        "chance": found.chance,
        "share_a_recording": found.shared,
        "ray_at_2m_mm": found.ray_m * 1e3,
        "along_mm_per_m": found.along_m_per_m * 1e3,
        "heading_deg_per_m": math.degrees(found.heading_rad_per_m),
        "heading_deg_per_turn": math.degrees(found.heading_rad_per_turn),
    }


def _numbers(values: FloatArray) -> list[float | None]:
    return [float(value) if math.isfinite(value) else None for value in values]
