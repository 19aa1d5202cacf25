"""Results for people and programs: the verdict, the terminal summary, report.json and report.html. Pure functions."""

from mobilecal_cli.report.at_work import recommendation
from mobilecal_cli.report.build import build_report
from mobilecal_cli.report.case import Case
from mobilecal_cli.report.changes import Change, change_checks, change_from_nominal, change_since
from mobilecal_cli.report.check import Check, Checks
from mobilecal_cli.report.checklist import checklist, checklist_json, checklist_text
from mobilecal_cli.report.checks.recording import MIN_STATIONS
from mobilecal_cli.report.comparison import comparison_json, comparison_text
from mobilecal_cli.report.draft import draft_text
from mobilecal_cli.report.drawn import Drawings, draw_all
from mobilecal_cli.report.evaluation import evaluation_data, evaluation_json, evaluation_text
from mobilecal_cli.report.evaluation_verdict import OwnEstimate, judge_evaluation
from mobilecal_cli.report.fleet import fleet_csv, fleet_html, fleet_text
from mobilecal_cli.report.gates import (
    Gate,
    evaluated_figures,
    figures_of,
    gate_checks,
    gate_names,
    gates_of,
    use_limits,
)
from mobilecal_cli.report.history import history_plot
from mobilecal_cli.report.html import report_html
from mobilecal_cli.report.inspection import inspection_json, inspection_text
from mobilecal_cli.report.junit import junit_error_xml, junit_xml
from mobilecal_cli.report.numbers import reference_frame, reference_pose, reference_std
from mobilecal_cli.report.text import summary_text
from mobilecal_cli.report.values import ReportData, json_text
from mobilecal_cli.report.verdict import Verdict, judge
from mobilecal_cli.report.wording import words
from mobilecal_cli.report.wording.evaluation import dependence
from mobilecal_cli.report.wording.findings import suggestion_sentences

__all__ = [
    "MIN_STATIONS",
    "Case",
    "Change",
    "Check",
    "Checks",
    "Drawings",
    "Gate",
    "OwnEstimate",
    "ReportData",
    "Verdict",
    "build_report",
    "change_checks",
    "change_from_nominal",
    "change_since",
    "checklist",
    "checklist_json",
    "checklist_text",
    "comparison_json",
    "comparison_text",
    "dependence",
    "draft_text",
    "draw_all",
    "evaluated_figures",
    "evaluation_data",
    "evaluation_json",
    "evaluation_text",
    "figures_of",
    "fleet_csv",
    "fleet_html",
    "fleet_text",
    "gate_checks",
    "gate_names",
    "gates_of",
    "history_plot",
    "inspection_json",
    "inspection_text",
    "json_text",
    "judge",
    "judge_evaluation",
    "junit_error_xml",
    "junit_xml",
    "recommendation",
    "reference_frame",
    "reference_pose",
    "reference_std",
    "report_html",
    "suggestion_sentences",
    "summary_text",
    "use_limits",
    "words",
]
