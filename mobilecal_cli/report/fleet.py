"""Results of many robots as one table, with the outliers of the fleet marked."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, ClassVar

import numpy as np
from pydantic import ConfigDict

from mobilecal_cli import se3
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.calibration import NINE
from mobilecal_cli.model.rig import FACTORS
from mobilecal_cli.model.text import listed, visible
from mobilecal_cli.report.formats import json_text
from mobilecal_cli.report.numbers import PARAMETERS, std_text, value_text
from mobilecal_cli.report.page import template

#: A robot is an outlier beyond both: this many times the spread of the fleet (1.4826 times the median absolute
#: deviation), and this many of its own standard deviations.
OUT_OF_FLEET, OUT_OF_SIGMA = 5.0, 3.0
_NAMED = 5  # number of skipped names that are listed
_FEWEST = 5  # among fewer robots there are no outliers


@dataclass(frozen=True, slots=True)
class FleetRow:
    """Result of one robot, or a directory entry that was skipped.

    Attributes:
        name: name of the robot, or of the entry.
        verdict: "PASS", "FAIL", "NOT ENOUGH", "GATE FAILED", "ERROR" without a result, or "SKIPPED" for an entry.
        exit_code: exit code of `mobilecal calibrate`.
        reason: one sentence.
        stations: number of stations used.
        values, stds: name → value and standard deviation of each number of the result, see `NumberData`; a standard
            deviation is None where it is unknown. Empty without a result.
        skipped: why the robot was not calibrated in this run; empty if it was.
        hint: what to do next, if it did not pass.
        seconds: how long it took, s.
    """

    #: A record of another version is none.
    __pydantic_config__: ClassVar[ConfigDict] = ConfigDict(extra="forbid")

    name: str
    verdict: str
    exit_code: int
    reason: str
    stations: int = 0
    values: Mapping[str, float] = field(default_factory=dict)
    stds: Mapping[str, float | None] = field(default_factory=dict)
    skipped: str = ""
    hint: str = ""
    seconds: float = 0.0


def robots_of(rows: Sequence[FleetRow]) -> list[FleetRow]:
    """The rows of robots, without entries that were skipped."""
    return [row for row in rows if row.verdict != "SKIPPED"]


def _heads(rows: Sequence[FleetRow]) -> list[tuple[str, str, float]]:
    """Name of each number, its unit for people, and how many of it one rad or m is; also of multipliers."""
    heads = [(parameter.name, parameter.shown_unit, parameter.factor) for parameter in PARAMETERS]
    return heads + [(name, "", 1.0) for name in FACTORS[:3] if any(name in row.values for row in rows)]


def fleet_numbers(rows: Sequence[FleetRow]) -> tuple[FloatArray, FloatArray]:
    """Numbers of each robot, (n, K), see `_heads`, and standard deviations, (n, K), NaN where there are none.

    Rotations are those of the camera in the head, as rotation vectors.
    """
    names, _, factors = zip(*_heads(rows), strict=True)
    numbers, std = (
        np.array([[of.get(name) for name in names] for of in columns], dtype=np.float64) * factors
        for columns in ([row.values for row in rows], [row.stds for row in rows])
    )
    return numbers, std


def compared(rows: Sequence[FleetRow]) -> tuple[FloatArray, FloatArray]:
    """As `fleet_numbers`, with rotations in the head frame relative to the first robot that passes.

    Rotation vectors of half a turn may have opposite signs and mean nearly the same.
    """
    numbers, std = fleet_numbers(rows)
    R_each = {
        k: se3.exp_so3(np.array([row.values[name] for name in NINE[:3]]))
        for k, row in enumerate(rows)
        if row.values
    }
    first = next((k for k in R_each if rows[k].verdict == "PASS"), next(iter(R_each), None))
    for k, R in R_each.items():
        assert first is not None
        numbers[k, :3] = np.degrees(se3.log_so3(R @ R_each[first].T))
    return numbers, std


def standing_out(rows: Sequence[FleetRow]) -> Mapping[str, tuple[str, ...]]:
    """Robot → names of its parameters that are outliers of the fleet; only robots that have any."""
    numbers, std = compared(rows)
    answered = np.isfinite(numbers[:, 0])
    if answered.sum() < _FEWEST:
        return {}
    known = np.isfinite(numbers).sum(axis=0) >= _FEWEST  # of wheels, and of odometry
    numbers = np.where(known, numbers, 0.0)
    off = np.abs(numbers - np.nanmedian(numbers, axis=0))
    spread = 1.4826 * np.nanmedian(off, axis=0)
    out = (off > OUT_OF_FLEET * spread) & (off > OUT_OF_SIGMA * np.nan_to_num(std)) & (off > 0)
    return {
        row.name: tuple(name for (name, *_), far in zip(_heads(rows), flags, strict=True) if far)
        for row, flags in zip(rows, out, strict=True)
        if flags.any()
    }


def _columns(rows: Sequence[FleetRow]) -> list[dict[str, Any]]:
    """Column → value of each robot, NaN where unknown."""
    numbers, std = fleet_numbers(rows)
    out = standing_out(rows)
    names = ["_".join(filter(None, head[:2])) for head in _heads(rows)]
    names += [f"std_{name}" for name in names]
    return [
        {
            "robot": row.name,
            "verdict": row.verdict,
            "exit_code": row.exit_code,
            "stations": row.stations,
            **dict(zip(names, values, strict=True)),
            "stands_out": " ".join(out.get(row.name, ())),
            "skipped": row.skipped,
            "reason": row.reason,
            "hint": row.hint,
        }
        for row, values in zip(rows, np.concatenate([numbers, std], axis=1).tolist(), strict=True)
    ]


def fleet_csv(rows: Sequence[FleetRow]) -> str:
    """One line per robot as CSV."""
    stream = io.StringIO()
    lines = _columns(rows)
    table = csv.writer(stream, lineterminator="\n")
    table.writerow(lines[0])
    table.writerows([_cell(value) for value in line.values()] for line in lines)
    return stream.getvalue()


def _cell(value: str | float) -> str:
    """A value for a spreadsheet; text after a quote if it would be a formula there."""
    if isinstance(value, float):
        return f"{value:.6f}" if np.isfinite(value) else ""
    shown = visible(str(value))
    return f"'{shown}" if shown[:1] in ("=", "+", "-", "@") else shown


def fleet_json(rows: Sequence[FleetRow]) -> str:
    """The lines of the robots as JSON, with the exit code of the batch: the largest."""
    robots = _columns(robots_of(rows))
    content = {"exit_code": max(line["exit_code"] for line in robots), "robots": robots}
    return json_text(content, sort_keys=False)


def fleet_html(rows: Sequence[FleetRow]) -> str:
    """The table as an HTML page with links to the reports."""
    robots = robots_of(rows)
    out, lines, names = standing_out(robots), [], [name for name, *_ in _heads(robots)]
    for row, values, sigmas in zip(robots, *compared(robots), strict=True):
        texts = [
            value_text(value, s, 2) if np.isfinite(value) else ""
            for value, s in zip(values, sigmas, strict=True)
        ]
        stds = [f"± {std_text(sigma)}" if np.isfinite(sigma) else "" for sigma in sigmas]
        lines.append((row, zip(names, texts, stds, strict=True), out.get(row.name, ())))
    levels = ("PASS", "FAIL", "NOT ENOUGH", "GATE FAILED", "ERROR")
    return template("fleet.html.jinja").render(
        lines=lines,
        remarks=[(row, marks) for row, _, marks in lines if marks or row.verdict != "PASS"],
        fleet_limit=OUT_OF_FLEET,
        sigma_limit=OUT_OF_SIGMA,
        counts={level: sum(row.verdict == level for row in rows) for level in levels},
        heads=[head[:2] for head in _heads(robots)],
        total=len(lines),
        skipped=skipped_text(rows),
        out=len(out),
    )


def fleet_text(rows: Sequence[FleetRow]) -> str:
    """One line per robot, for the terminal, and what was skipped; errors have a hint below."""
    skipped = skipped_text(rows)
    return "\n".join([*_lines(rows, robots_of(rows)), *([skipped] if skipped else [])]) + "\n"


def failed_text(rows: Sequence[FleetRow]) -> str:
    """The lines of `fleet_text` of the robots that do not pass; "" if all pass."""
    failed = [row for row in robots_of(rows) if row.verdict != "PASS"]
    return "".join(f"{line}\n" for line in _lines(rows, failed))


def _lines(rows: Sequence[FleetRow], shown: Sequence[FleetRow]) -> list[str]:
    """The lines of those robots of a fleet that are shown."""
    out = standing_out(rows)
    width = max((len(visible(row.name)) for row in shown), default=0)
    lines = []
    for row in shown:
        marks = f" [outlier: {', '.join(out[row.name])}]" if row.name in out else ""
        lines.append(f"  {visible(row.name):<{width}}  {row.verdict:<11}  {visible(row.reason)}{marks}")
        if row.hint and row.verdict != "PASS":
            lines.append(f"  {'':<{width}}  {'':<11}  hint: {visible(row.hint)}")
    return lines


def skipped_text(rows: Sequence[FleetRow]) -> str:
    """Number of skipped robots and directory entries by reason; "" if there are none."""
    names: dict[str, list[str]] = {}
    for row in rows:
        if row.skipped:
            names.setdefault(row.skipped, []).append(row.name)
    parts = [f"{reason}: {len(each)} ({visible(listed(each, _NAMED))})" for reason, each in names.items()]
    return f"Skipped, {'; '.join(parts)}." if parts else ""
