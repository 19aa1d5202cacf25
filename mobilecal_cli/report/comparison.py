"""Comparison of calibrations, as text and as JSON."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np

from mobilecal_cli.comparison import Difference, History
from mobilecal_cli.model import NINE, CalibratedRobot, FloatArray
from mobilecal_cli.model.text import visible
from mobilecal_cli.report.parameters import PARAMETERS, decimals_of, std_text
from mobilecal_cli.report.values import json_text
from mobilecal_cli.report.wording.comparison import changed, conclusion, constancy, effects, headline

COMPARISON_SCHEMA = 1


def comparison_text(names: Sequence[str], differences: Sequence[Difference], past: History | None) -> str:
    """Change from the first calibration to each other one; for three or more also a test of each parameter.

    The first lines, one for each other calibration, say whether it has changed.
    """
    pairs = zip(names[1:], differences, strict=True)
    lines = [*(headline(found, visible(names[0]), visible(name)) for name, found in pairs), ""]
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
        lines += [*(f"  {meaning:<52}{value:>+10.3f}  {unit}" for meaning, value, unit in effects(found))]
        lines += ["", f"  {conclusion(found)}", ""]
    if past is not None:
        lines += [f"All {len(names)} calibrations, tested against a robot that does not change", ""]
        for number, chance in zip(NINE, past.chance, strict=True):
            lines.append(f"  {number:<14}{constancy(chance)}")
        lines.append("")
    return "\n".join(lines)


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
    return json_text(data, sort_keys=False)


def _plain(found: Difference) -> dict[str, Any]:
    return {
        "change": found.change,
        "std": _numbers(np.where(found.known, found.std, np.nan)),
        "sigmas": _numbers(found.sigmas),
        "chi2": found.chi2,
        "chance": found.chance,
        "changed": changed(found),
        "share_a_recording": found.shared,
        "unobservable": dict(zip(NINE, found.unobservable.tolist(), strict=True)),
        "ray_at_2m_mm": found.ray_m * 1e3,
        "along_mm_per_m": found.along_m_per_m * 1e3,
        "heading_deg_per_m": math.degrees(found.heading_rad_per_m),
        "heading_deg_per_turn": math.degrees(found.heading_rad_per_turn),
    }


def _numbers(values: FloatArray) -> list[float | None]:
    return [float(value) if math.isfinite(value) else None for value in values]
