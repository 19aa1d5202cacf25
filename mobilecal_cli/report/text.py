"""The result in a few lines: plain text for the terminal, Markdown for a CI job, HTML for a notebook."""

from __future__ import annotations

import base64
import functools

from mobilecal_cli.model.text import visible, wrapped
from mobilecal_cli.report.criteria import check_lines
from mobilecal_cli.report.formats import markdown
from mobilecal_cli.report.numbers import numbers_table
from mobilecal_cli.report.page import style_of, template
from mobilecal_cli.report.svg import standalone
from mobilecal_cli.report.values import ReportData

_wrapped = functools.partial(wrapped, indent="  ")
_MOST_NOTES = 3  # on the terminal without --verbose
_COLORS = {"pass": "#14875a", "short": "#a05f00", "fail": "#c4312b"}


def summary_text(report: ReportData, verbose: bool = False) -> str:
    """The numbers, the stations used, notes on the recording, and what limits the result; with more, everything.

    Names from the recording are escaped, so that they cannot control the terminal.
    """
    parameters, budget = report.parameters, report.error_budget
    frames = f"{visible(parameters.child_frame)} in {visible(parameters.parent_frame)}"
    sigma = " (± 1 sigma)" if report.uncertainty is not None else ""
    lines = _wrapped(f"{frames}, and wheels{sigma}", "")
    lines += numbers_table(report.numbers).lines()[1:]
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
    errors = [f"Point error: {quality.point_rms_mm:.2f} mm"]
    if quality.reprojection_rms_px:
        errors.append(f"reprojection error: {quality.reprojection_rms_px:.2f} px")
    lines.append("; ".join(errors))
    lines += [*_wrapped(quality.reprojection_text, ""), "", *check_lines(report.verdict.checks)]
    for table in report.tables:
        if table.section != "checks":
            lines += ["", table.title, *table.lines()] if table.title else ["", *table.lines()]
    for sentence in report.outliers_text:
        lines += _wrapped(sentence, "Outlier: ")
    return [visible(line) for line in lines]


def notebook_html(report: ReportData, path: str) -> str:
    """Verdict, numbers, and the picture of the path (an SVG element) for a notebook."""
    picture = base64.b64encode(standalone(path).encode()).decode("ascii")
    return template("card.html.jinja").render(
        report=report,
        rows=numbers_table(report.numbers).rows,
        color=_COLORS[style_of(report.verdict.level)],
        picture=picture,
    )


def job_summary(report: ReportData) -> str:
    """Verdict, numbers, their change, and the checks that do not pass, as Markdown."""
    verdict = report.verdict
    lines = [
        f"### {verdict.level}: {markdown(', '.join(log.path for log in report.provenance.logs))}",
        "",
        f"{markdown(verdict.reason)} **Next:** {markdown(verdict.next_step)}",
        "",
        *numbers_table(report.numbers).markdown(),
        "",
        f"Stations used: {markdown(report.quality.stations_text)}.",
    ]
    for table in report.tables:
        if table.title == "Change":
            lines += ["", markdown(table.note), "", *table.markdown()]
    open_checks = [check for check in verdict.checks if check.outcome != "pass"]
    lines += [""] if open_checks else []
    for check in open_checks:
        lines.append(f"- {'warning' if check.met else 'failed'}: {markdown(check.why)}")
    return "\n".join(lines) + "\n"
