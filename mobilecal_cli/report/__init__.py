"""Values to what people read: a verdict, a table for the terminal, report.json and report.html. Pure functions."""

from mobilecal_cli.report.check import Check
from mobilecal_cli.report.data import report_json
from mobilecal_cli.report.findings import suggestion_sentences
from mobilecal_cli.report.html import report_html
from mobilecal_cli.report.inspection import inspection_json, inspection_text
from mobilecal_cli.report.text import summary_table
from mobilecal_cli.report.verdict import MIN_STATIONS, Verdict, judge

__all__ = [
    "MIN_STATIONS",
    "Check",
    "Verdict",
    "inspection_json",
    "inspection_text",
    "judge",
    "report_html",
    "report_json",
    "suggestion_sentences",
    "summary_table",
]
