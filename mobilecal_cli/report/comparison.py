"""Comparison of calibrations, and the change from the last one or from the nominal values: text, JSON and plot."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np

from mobilecal_cli.comparison import UNLIKELY, Difference, History, difference, history, nine_apart
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.likelihood.predict import AHEAD_M
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.calibration import NINE, CalibratedRobot
from mobilecal_cli.model.rig import Nominal
from mobilecal_cli.model.text import listed, visible, wrapped
from mobilecal_cli.report.formats import NumberRow, Table, json_text
from mobilecal_cli.report.numbers import PARAMETERS, decimals_of, parameters_of, percent_text, std_text
from mobilecal_cli.report.svg import Axes, Canvas, Scale, standalone

_MOST_LABELS = 20  # names of calibrations below a plot
_WIDE, _HIGH = 300.0, 210.0  # of the plot of one parameter


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
        ConfigError: the earlier calibration is of other frames, or of a head with other joints.
    """
    if robot.head_joints and last.head_joints and {*robot.head_joints} != {*last.head_joints}:
        joints, others = (listed(each.head_joints) for each in (robot, last))
        raise ConfigError(
            f"{name} is a calibration of another robot: its head has the joints {others}, the recording's {joints}",
            "give the last calibration of this robot",
        )
    change = difference(last, robot)
    return Change(name, change.change, change.sigmas, _UNKNOWN, None if change.shared else change.chance)


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


@dataclass(frozen=True, eq=False)
class Comparison:
    """Several calibrations by the names of their files, two or more."""

    names: tuple[str, ...]
    robots: tuple[CalibratedRobot, ...]

    @cached_property
    def differences(self) -> tuple[Difference, ...]:
        """Change from the first to each other one."""
        return tuple(difference(self.robots[0], robot) for robot in self.robots[1:])

    @cached_property
    def past(self) -> History:
        """Change of all from the first, with a test of each parameter."""
        return history(self.robots)


def comparison_text(comparison: Comparison) -> str:
    """Change from the first calibration to each other one; for three or more also a test of each parameter.

    The first lines, one for each other calibration, say whether it has changed.
    """
    first, *others = (visible(name) for name in comparison.names)
    pairs = list(zip(others, comparison.differences, strict=True))
    lines = [line for other, each in pairs for line in wrapped(conclusion(each, first, other), "", "  ")]
    for other, robot in zip(others, comparison.robots[1:], strict=True):
        joints = [each.head_joints for each in (comparison.robots[0], robot)]
        if all(joints) and set(joints[0]) != set(joints[1]):
            of_each = f"{listed(joints[0])} in {first}, {listed(joints[1])} in {other}"
            lines += wrapped(f"These are two robots: the head joints differ ({of_each}).", "Note: ", "  ")
    for other, each in pairs:
        rows = []
        for k, parameter in enumerate(parameters_of(each.assumed)):
            change, s = each.change[k] * parameter.factor, each.std[k] * parameter.factor
            std = std_text(s) if each.known[k] else "-"
            sigmas = f"{round(each.sigmas[k], 1) + 0.0:+.1f}" if each.known[k] else "-"
            rows.append((parameter.name, f"{change:+.{decimals_of(s)}f}", std, sigmas, parameter.shown_unit))
        for _, meaning, value, unit in effects(each):
            rows.append((meaning, f"{value:+.{decimals_of(abs(value))}f}", "", "", unit))
        heads = ("", "number:change", "number:1 sigma", "number:in sigma", "")
        lines += ["", f"Change from {first} to {other}", "", *Table.of(heads, rows).lines()]
        lines.append("  r is a small rotation about the head's axes.")
    if len(others) > 1:
        count = len(comparison.names)
        lines += ["", f"All {count} calibrations, tested against a robot that does not change", ""]
        chances = zip(NINE, map(constancy, comparison.past.chance), strict=True)
        lines += Table.of(("", ""), list(chances)).lines()
    return "\n".join(lines) + "\n"


def comparison_json(comparison: Comparison) -> str:
    """The comparison as JSON: rad and m, or the unit in the key."""
    data: dict[str, Any] = {
        "schema_version": 1,
        "order": list(NINE),
        "calibrations": [
            {"name": name, "created": robot.created}
            for name, robot in zip(comparison.names, comparison.robots, strict=True)
        ],
        "against_first": [
            {
                "change": each.change,
                "std": np.where(each.known, each.std, np.nan),
                "sigmas": each.sigmas,
                "chi2": each.chi2,
                "chance": each.chance,
                "changed": changed(each),
                "share_a_recording": each.shared,
                "unobservable": dict(zip(NINE, each.unobservable.tolist(), strict=True)),
                "head_chain_sigmas": each.moved_joints,
                **{key: value for key, _, value, _ in effects(each)},
            }
            for each in comparison.differences
        ],
        "chance_unchanged": comparison.past.chance if len(comparison.robots) > 2 else None,
    }
    return json_text(data, sort_keys=False)


def effects(difference: Difference) -> tuple[tuple[str, str, float, str], ...]:
    """What a change means for the robot: (key for programs, effect, value, unit)."""
    heading, turn = map(math.degrees, (difference.heading_rad_per_m, difference.heading_rad_per_turn))
    return (
        ("ray_at_2m_mm", f"shift of a point {AHEAD_M:g} m ahead", difference.ray_m * 1e3, "mm"),
        ("along_mm_per_m", "distance, driving straight", difference.along_m_per_m * 1e3, "mm per m"),
        ("heading_deg_per_m", "heading, driving straight", heading, "deg per m"),
        ("heading_deg_per_turn", "heading per full turn", turn, "deg"),
    )


def changed(difference: Difference) -> bool | None:
    """Whether the robot has changed, or one of the calibrations is wrong; None where that is unknown."""
    if difference.moved_joints:
        return True
    return None if difference.chance is None else difference.chance < UNLIKELY


def conclusion(difference: Difference, first: str, second: str) -> str:
    """Whether the second calibration differs from the first, how much at most, and how certain that is."""
    hidden = ", ".join(name for name, hides in zip(NINE, difference.unobservable, strict=True) if hides)
    note = f" No conclusion about {hidden}: at least one calibration does not determine it." if hidden else ""
    if difference.chance is None:
        unknown = "have no parameter that both determine with a standard deviation"
        return f"Unknown: {first} and {second} {unknown}.{note}"
    sigmas = np.where(difference.known, np.abs(difference.sigmas), 0.0)
    worst = int(np.argmax(sigmas))
    weak = " They share a recording, so this test is weak." if difference.shared else ""
    moved = [
        f"{name} {difference.joints[name][0]:+.2g} {difference.joints[name][2]} ({abs(away):.1f} sigma)"
        for name, away in difference.moved_joints.items()
    ]
    head = f" in the head chain, {', '.join(moved)}; of the nine parameters," if moved else ""
    return (
        f"{'Changed' if changed(difference) else 'Unchanged'}: from {first} to {second},{head} largest "
        f"change {sigmas[worst]:.1f} sigma ({NINE[worst]}). Probability by chance {percent_text(difference.chance)} "
        f"(chi-squared {difference.chi2:.1f} for {int(difference.known.sum())} parameters).{weak}{note}"
    )


def constancy(chance: float) -> str:
    """Whether a parameter changed over several calibrations, by the probability of such a spread by chance."""
    if not math.isfinite(chance):
        return "no conclusion: fewer than two calibrations determine it"
    said = "changed" if chance < UNLIKELY else "unchanged"
    return f"{said} (probability by chance {percent_text(chance)})"


def history_plot(comparison: Comparison) -> str:
    """An SVG file: change of each parameter since the first calibration, with bars of 2 sigma.

    The plot numbers the calibrations from 1, and has their dates, or the names of those without one.
    """
    title = "change of each parameter since the first calibration, with bars of 2 sigma"
    past, named = comparison.past, zip(comparison.robots, comparison.names, strict=True)
    labels = [robot.created or name for robot, name in named]
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
