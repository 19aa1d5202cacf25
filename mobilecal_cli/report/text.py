"""The summary for the terminal, as plain text."""

from __future__ import annotations

from mobilecal_cli.model.text import visible, wrapped
from mobilecal_cli.report.evaluation import evaluation_text
from mobilecal_cli.report.numbers import numbers_table, std_text, value_text
from mobilecal_cli.report.values import ReportData

_WIDTH = 80
_LABEL = 22


def summary_text(report: ReportData, verbose: bool = False) -> str:
    """The numbers, the stations used and what limits the result; with more, everything that the report knows.

    Names from the recording are escaped, so that they cannot control the terminal.
    """
    found, budget = report.parameters, report.error_budget
    frames = f"{visible(found.child_frame)} in {visible(found.parent_frame)}"
    sigma = " (± 1 sigma)" if report.uncertainty is not None else ""
    lines = wrapped(f"{frames}, and wheels{sigma}", "", "  ", _WIDTH)
    rows = numbers_table(report.numbers)
    wide = max(_LABEL, *(len(label) + 2 for label, _ in rows))
    lines += [f"  {label:<{wide}}{value}" for label, value in rows]
    lines += wrapped(f"Stations used: {report.quality.stations_text}", "", "  ", _WIDTH)
    if budget is not None and budget.limiting:
        lines += wrapped(budget.limiting, "", "  ", _WIDTH)
    if verbose:
        lines += _details(report)
    return "\n".join(lines) + "\n"


def _details(report: ReportData) -> list[str]:
    quality = report.quality
    lines = ["", *wrapped(report.parameters.orientation, "", "  ", _WIDTH)]
    keys = {"time_joints": "clock of the joints", "time_wheels": "clock of the wheels"}
    for key, name in keys.items():
        if key in report.constants:
            value, std = (
                1e3 * number for number in (report.constants[key].value, report.constants[key].std or 0.0)
            )
            sigma = f"± {std_text(std)} ms" if std else "ms, fixed"
            lines.append(
                f"  {name:<{_LABEL}}{value_text(value, std or None, 3)} {sigma}, added to the image stamps"
            )
    lines.append(f"  {'point error':<{_LABEL}}{quality.point_rms_mm:.2f} mm")
    if quality.reprojection_rms_px:
        lines.append(f"  {'reprojection error':<{_LABEL}}{quality.reprojection_rms_px:.2f} px")
    lines += wrapped(quality.reprojection_text, "", "  ", _WIDTH) if quality.reprojection_text else []
    lines += ["", *(f"  {check.label:<11} {check.name}: {check.measured_text} ({check.limit_text})"
              for check in report.verdict.checks)]  # fmt: skip
    if report.hold_out is not None:
        lines += ["", "Test on the held-out stations", evaluation_text(report.hold_out).rstrip("\n")]
    for each in report.contradictions:
        lines += wrapped(f"{each.text} {each.cure}", "Robot description: ", "  ", _WIDTH)
    for sentence in report.outliers_text:
        lines += wrapped(sentence, "Outlier: ", "  ", _WIDTH)
    return [visible(line) if line else line for line in lines]
