"""The result in a few lines: plain text for the terminal, Markdown for a CI job, HTML for a notebook."""

from __future__ import annotations

import base64
import functools

import numpy as np

from mobilecal_cli.model.text import visible, wrapped
from mobilecal_cli.report.comparison import Change
from mobilecal_cli.report.numbers import NumberData, decimals_of, numbers_table
from mobilecal_cli.report.page import template
from mobilecal_cli.report.svg import standalone
from mobilecal_cli.report.values import ReportData
from mobilecal_cli.report.verdict import LEVELS

_wrapped = functools.partial(wrapped, indent="  ", width=80)
_LABEL = 22  # characters of the longest label, and two
_MOST_NOTES = 3  # on the terminal without --verbose
_COLORS = {"PASS": "#14875a", "NOT ENOUGH": "#a05f00"}  # red for others


def summary_text(report: ReportData, verbose: bool = False) -> str:
    """The numbers, the stations used, notes on the recording, and what limits the result; with more, everything.

    Names from the recording are escaped, so that they cannot control the terminal.
    """
    parameters, budget = report.parameters, report.error_budget
    frames = f"{visible(parameters.child_frame)} in {visible(parameters.parent_frame)}"
    sigma = " (± 1 sigma)" if report.uncertainty is not None else ""
    lines = _wrapped(f"{frames}, and wheels{sigma}", "")
    rows = numbers_table(report.numbers)
    wide = max(_LABEL, *(len(label) + 2 for label, _ in rows))
    lines += [f"  {label:<{wide}}{value}" for label, value in rows]
    lines += _wrapped(f"Stations used: {report.quality.stations_text}", "")
    most = len(report.notes) if verbose else _MOST_NOTES
    for note in report.notes[:most]:
        lines += _wrapped(note, "Note: ")
    if len(report.notes) > most:
        lines.append(f"Note: {len(report.notes) - most} more, see Input in the report")
    if budget is not None:
        lines += _wrapped(budget.limiting, "")
    if verbose:
        lines += _details(report)
    return "\n".join(lines) + "\n"


def _details(report: ReportData) -> list[str]:
    """All tables of the report, and the sentences on its findings."""
    quality = report.quality
    lines = ["", *_wrapped(report.parameters.orientation, "")]
    lines.append(f"  {'point error':<{_LABEL}}{quality.point_rms_mm:.2f} mm")
    if quality.reprojection_rms_px:
        lines.append(f"  {'reprojection error':<{_LABEL}}{quality.reprojection_rms_px:.2f} px")
    lines += [*_wrapped(quality.reprojection_text, ""), "", *report.verdict.checks.lines]
    for table in report.tables:
        if table.section != "checks":
            lines += ["", table.title, *table.lines()] if table.title else ["", *table.lines()]
    for each in report.contradictions:
        lines += _wrapped(f"{each.text} {each.cure}", "Robot description: ")
    for sentence in report.outliers_text:
        lines += _wrapped(sentence, "Outlier: ")
    return [visible(line) for line in lines]


def notebook_html(report: ReportData, path: str) -> str:
    """Verdict, numbers, and the picture of the path (an SVG element) for a notebook."""
    picture = base64.b64encode(standalone(path).encode()).decode("ascii")
    return template("card.html.jinja").render(
        report=report,
        rows=numbers_table(report.numbers),
        color=_COLORS.get(report.verdict.level, "#c4312b"),
        picture=picture,
    )


def job_summary(report: ReportData) -> str:
    """Verdict, numbers with their change, and the checks that do not pass, as Markdown."""
    verdict, change = report.verdict, report.change
    lines = [
        f"### {verdict.level}: {_cell(', '.join(log.path for log in report.provenance.logs))}",
        "",
        f"{_cell(verdict.reason)} **Next:** {_cell(verdict.next_step)}",
        "",
    ]
    rows: list[tuple[str, ...]] = [("parameter", "value (± 1 sigma)"), *numbers_table(report.numbers)]
    if change is not None:
        changes = (_change(change, k, number) for k, number in enumerate(report.numbers))
        column = (f"change from {change.against}", *changes)
        rows = [(*row, cell) for row, cell in zip(rows, column, strict=True)]
    first, *others = (f"| {' | '.join(map(_cell, row))} |" for row in rows)
    lines += [first, f"|{' --- |' * len(rows[0])}", *others]
    lines += ["", f"Stations used: {_cell(report.quality.stations_text)}."]
    open_checks = [check for check in verdict.checks if check.outcome != "pass"]
    lines += [""] if open_checks else []
    for check in open_checks:
        lines.append(f"- {'failed' if check.outcome in LEVELS else 'warning'}: {_cell(check.why)}")
    return "\n".join(lines) + "\n"


def _change(change: Change, k: int, number: NumberData) -> str:
    """Change of a number in its unit, and in standard deviations where these are known."""
    if k >= len(change.value) or not np.isfinite(change.value[k]):
        return ""
    if not number.unit:  # the change is that of the assumed wheels
        return f"{change.sigmas[k]:+.1f} sigma" if np.isfinite(change.sigmas[k]) else ""
    decimals = 5 if number.std is None else decimals_of(number.std, 5)
    sigmas = f" ({change.sigmas[k]:+.1f} sigma)" if np.isfinite(change.sigmas[k]) else ""
    return f"{change.value[k]:+.{decimals}f} {number.unit}{sigmas}"


def _cell(text: str) -> str:
    """Text of a recording for Markdown: no markup, no new column."""
    return visible(text).translate({ord(character): f"\\{character}" for character in "\\|*_`<>[]"})
