"""Comparison of calibrations, and the change from the last one or from the nominal values: text, JSON and plot."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from mobilecal_cli.comparison import Difference, History, difference, nine_apart
from mobilecal_cli.likelihood.predict import AHEAD_M
from mobilecal_cli.model import NINE, CalibratedRobot, FloatArray, Nominal
from mobilecal_cli.model.text import visible
from mobilecal_cli.report.formats import NumberRow, Table, json_text
from mobilecal_cli.report.numbers import PARAMETERS, decimals_of, factors_of, percent_text, std_text
from mobilecal_cli.report.svg import Axes, Canvas, Scale, standalone

#: Significance level.
_UNLIKELY = 0.01
_MOST_LABELS = 20
_WIDE, _HIGH = 300.0, 210.0


_UNKNOWN: FloatArray = np.full(len(NINE), np.nan)


@dataclass(frozen=True, slots=True, eq=False)
class Change:
    """Change from the last calibration or from the nominal values, in the order of `order`.

    Attributes:
        against: what they are compared with.
        order: names of the nine parameters.
        value: (9,) rad and m, NaN where there is nothing to compare with.
        sigmas: (9,) divided by the standard deviation of the difference, NaN where none is known.
        percent: (9,) change of the wheel parameters in percent of the nominal values, NaN for the others.
        p_value: probability of a change this large if the robot did not change; None where it is not known.
    """

    against: str
    order: tuple[str, ...] = field(default=NINE, init=False)
    value: NumberRow
    sigmas: NumberRow
    percent: NumberRow
    p_value: float | None


def change_since(robot: CalibratedRobot, last: CalibratedRobot, name: str) -> Change:
    """Change from an earlier calibration, also in standard deviations of the difference.

    Raises:
        ConfigError: the earlier calibration is of other frames.
    """
    found = difference(last, robot)
    return Change(name, found.change, found.sigmas, _UNKNOWN, None if found.shared else found.chance)


def change_from_nominal(robot: CalibratedRobot, nominal: Nominal) -> Change | None:
    """Change from the nominal values, which have no standard deviations; None where there are no nominal values."""
    if nominal.T_h_reference is None and nominal.wheels is None:
        return None
    T = robot.T_parent_child if nominal.T_h_reference is None else nominal.T_h_reference
    before = CalibratedRobot(robot.parent_frame, robot.child_frame, T, nominal.wheels or robot.wheels)
    value, percent = nine_apart(before, robot), _UNKNOWN.copy()
    if nominal.T_h_reference is None:
        value[:6] = np.nan
    if nominal.wheels is None:
        value[6:] = np.nan
    else:
        percent[6:] = 100 * value[6:] / nominal.wheels.vector
    return Change("the nominal values", value, _UNKNOWN, percent, None)


def comparison_text(names: Sequence[str], differences: Sequence[Difference], past: History | None) -> str:
    """Change from the first calibration to each other one; for three or more also a test of each parameter.

    The first lines, one for each other calibration, say whether it has changed.
    """
    pairs = zip(names[1:], differences, strict=True)
    lines = [*(headline(found, visible(names[0]), visible(name)) for name, found in pairs), ""]
    for name, found in zip(names[1:], differences, strict=True):
        lines += [f"Change from {visible(names[0])} to {visible(name)}", ""]
        rows = []
        nine = PARAMETERS if found.assumed is None else factors_of(found.assumed)
        for k, parameter in enumerate(nine):
            change, s = found.change[k] * parameter.factor, found.std[k] * parameter.factor
            std = std_text(s) if found.known[k] else "-"
            sigmas = f"{round(found.sigmas[k], 1) + 0.0:+.1f}" if found.known[k] else "-"
            name = parameter.factor_name or parameter.name
            rows.append((name, f"{change:+.{decimals_of(s)}f}", std, sigmas, parameter.shown_unit))
        heads = ("", "number:change", "number:1 sigma", "number:in sigma", "")
        lines += Table.of(heads, rows).lines((14 if found.assumed is None else 32, 12, 12, 10))
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
        "schema_version": 1,
        "order": list(NINE),
        "calibrations": [
            {"name": name, "created": robot.created} for name, robot in zip(names, robots, strict=True)
        ],
        "against_first": [
            {
                "change": found.change,
                "std": np.where(found.known, found.std, np.nan),
                "sigmas": found.sigmas,
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
            for found in differences
        ],
        "chance_unchanged": None if past is None else past.chance,
    }
    return json_text(data, sort_keys=False)


def effects(found: Difference) -> tuple[tuple[str, float, str], ...]:
    """What a change means for the robot: (effect, value, unit)."""
    return (
        (f"Shift of a point {AHEAD_M:g} m ahead of the camera", found.ray_m * 1e3, "mm"),
        ("Dead reckoning: distance, driving straight", found.along_m_per_m * 1e3, "mm per m"),
        ("Dead reckoning: heading, driving straight", math.degrees(found.heading_rad_per_m), "deg per m"),
        ("Heading per full turn", math.degrees(found.heading_rad_per_turn), "deg"),
    )


def changed(found: Difference) -> bool | None:
    """Whether the robot has changed, or one of the calibrations is wrong; None where that is unknown."""
    return None if found.chance is None else found.chance < _UNLIKELY


def headline(found: Difference, first: str, second: str) -> str:
    """Whether the second calibration differs from the first, with the largest change in sigmas."""
    change = changed(found)
    if change is None:
        return (
            f"Unknown: {first} and {second} have no parameter that both determine with a standard deviation."
        )
    sigmas = np.where(found.known, np.abs(found.sigmas), 0.0)
    worst = int(np.argmax(sigmas))
    said = "Changed" if change else "Unchanged"
    note = f"; no conclusion about {hidden}" if (hidden := _unobservable(found)) else ""
    return f"{said}: from {first} to {second}, at most {sigmas[worst]:.1f} sigma ({NINE[worst]}){note}."


def _unobservable(found: Difference) -> str:
    return ", ".join(name for name, hides in zip(NINE, found.unobservable, strict=True) if hides)


def conclusion(found: Difference) -> str:
    """Whether the robot has changed, and how certain that is."""
    names = _unobservable(found)
    blind = f"No conclusion about {names}: at least one calibration does not determine it." if names else ""
    if found.chance is None:
        return blind or "No significance test: at least one calibration has no standard deviations."
    verdict = (
        "The robot has changed, or one of the two calibrations is wrong."
        if changed(found)
        else f"The change{' of these' if blind else ''} is not significant."
    )
    note = " The calibrations share a recording, so this test is weak." if found.shared else ""
    if blind:
        note += f" {blind}"
    return (
        f"Chi-squared {found.chi2:.1f} for {int(found.known.sum())} parameters; probability by chance "
        f"{percent_text(found.chance)}. {verdict}{note}"
    )


def constancy(chance: float) -> str:
    """Whether a parameter changed over several calibrations, by the probability of such a spread by chance."""
    if not math.isfinite(chance):
        return "unknown in all but one calibration"
    return (
        f"{'changed' if chance < _UNLIKELY else 'unchanged'} (probability by chance {percent_text(chance)})"
    )


def history_plot(labels: Sequence[str], past: History) -> str:
    """An SVG file: change of each parameter since the first calibration, with bars of 2 sigma.

    The labels of the calibrations are, for example, dates; the plot numbers them from 1.
    """
    title = "change of each parameter since the first calibration, with bars of 2 sigma"
    shown = [f"{n}: {visible(label)}" for n, label in enumerate(labels[:_MOST_LABELS], 1)]
    if len(labels) > len(shown):
        shown.append(f"and {len(labels) - len(shown)} more")
    canvas = Canvas(3 * _WIDE, 3 * _HIGH + 10 + 16 * ((len(shown) + 2) // 3), title)
    for k, parameter in enumerate(PARAMETERS):
        unit, factor = parameter.shown_unit, parameter.factor
        change, std = past.change[:, k] * factor, past.std[:, k] * factor
        left, top = k % 3 * _WIDE, k // 3 * _HIGH
        y = Scale.of([0.0, *(change - 2 * std), *(change + 2 * std)], margin=0.1)
        box = (left, top, left + _WIDE, top + _HIGH)
        axes = Axes.of(canvas, Scale(0.5, len(labels) + 0.5), y, f"{parameter.name} [{unit}]", box)
        axes.grid(x=False)
        axes.level(0.0, "faint thin")
        for n, (value, s) in enumerate(zip(change.tolist(), std.tolist(), strict=True), 1):
            if s > 0:
                axes.line([(n, value - 2 * s), (n, value + 2 * s)], "blue")
            axes.dot(n, value, "blue" if s > 0 else "orange", tip=f"{n}: {value:+.3g} {unit}")
            canvas.text(axes.x(n), axes.y.start + 14, str(n), anchor="middle")
    for n, label in enumerate(shown):
        canvas.text(8 + n % 3 * _WIDE, 3 * _HIGH + 12 + 16 * (n // 3), label)
    return standalone(canvas.svg)
