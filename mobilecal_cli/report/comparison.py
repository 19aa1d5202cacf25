"""Comparison of calibrations, as text and as JSON."""

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
from mobilecal_cli.report.parameters import PARAMETERS, decimals_of, std_text

COMPARISON_SCHEMA = 1
#: Significance level.
_UNLIKELY = 0.01


def comparison_text(names: Sequence[str], differences: Sequence[Difference], past: History | None) -> str:
    """Change from the first calibration to each other one; for three or more also a test of each parameter."""
    lines = []
    for name, found in zip(names[1:], differences, strict=True):
        lines += [f"Change from {visible(names[0])} to {visible(name)}", ""]
        lines += [f"  {'':<14}{'change':>12}{'1 sigma':>12}{'in sigma':>10}"]
        for k, parameter in enumerate(PARAMETERS):
            factor = parameter.factor
            s, digits = found.std[k] * factor, decimals_of(found.std[k] * factor)
            std, sigmas = (
                (std_text(s), f"{round(found.sigmas[k], 1) + 0.0:+.1f}") if found.known[k] else ("-", "-")
            )
            lines.append(
                f"  {parameter.name:<14}{found.change[k] * factor:>+12.{digits}f}{std:>12}{sigmas:>10}  "
                f"{parameter.shown_unit}"
            )
        lines += ["", "  r is a small rotation about the head's axes.", ""]
        lines += [*(f"  {meaning:<52}{value:>+10.3f}  {unit}" for meaning, value, unit in _felt(found))]
        lines += ["", f"  {_says(found)}", ""]
    if past is not None:
        lines += [f"All {len(names)} calibrations, tested against a robot that does not change", ""]
        for number, chance in zip(NINE, past.chance, strict=True):
            lines.append(f"  {number:<14}{_stays(chance)}")
        lines.append("")
    return "\n".join(lines)


def _felt(found: Difference) -> tuple[tuple[str, float, str], ...]:
    return (
        (f"Shift of a point {AHEAD_M:g} m ahead of the camera", found.ray_m * 1e3, "mm"),
        ("Dead reckoning: distance, driving straight", found.along_m_per_m * 1e3, "mm per m"),
        ("Dead reckoning: heading, driving straight", math.degrees(found.heading_rad_per_m), "deg per m"),
        ("Heading per full turn", math.degrees(found.heading_rad_per_turn), "deg"),
    )


def _says(found: Difference) -> str:
    names = ", ".join(name for name, ok in zip(NINE, found.unobservable, strict=True) if ok)
    blind = f"No conclusion about {names}: at least one calibration does not determine it." if names else ""
    if found.chance is None:
        return blind or "No significance test: at least one calibration has no standard deviations."
    verdict = (
        "The robot has changed, or one of the two calibrations is wrong."
        if found.chance < _UNLIKELY
        else f"The change{' of these' if blind else ''} is not significant."
    )
    note = " The calibrations share a recording, so this test is weak." if found.shared else ""
    if blind:
        note += f" {blind}"
    return (
        f"Chi-squared {found.chi2:.1f} for {int(found.known.sum())} parameters; probability by chance "
        f"{_percent(found.chance)}. {verdict}{note}"
    )


def _percent(probability: float) -> str:
    share = 100 * probability
    return f"{share:.0f} %" if share >= 10 else f"{share:.2g} %"


def _stays(chance: float) -> str:
    if not math.isfinite(chance):
        return "unknown in all but one calibration"
    return f"{'changed' if chance < _UNLIKELY else 'unchanged'} (probability by chance {_percent(chance)})"


def comparison_json(
    names: Sequence[str],
    robots: Sequence[CalibratedRobot],
    differences: Sequence[Difference],
    past: History | None,
) -> str:
    """The comparison as JSON: rad and m, or the unit in the key."""
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
        "unobservable": dict(zip(NINE, found.unobservable.tolist(), strict=True)),
        "ray_at_2m_mm": found.ray_m * 1e3,
        "along_mm_per_m": found.along_m_per_m * 1e3,
        "heading_deg_per_m": math.degrees(found.heading_rad_per_m),
        "heading_deg_per_turn": math.degrees(found.heading_rad_per_turn),
    }


def _numbers(values: FloatArray) -> list[float | None]:
    return [float(value) if math.isfinite(value) else None for value in values]
