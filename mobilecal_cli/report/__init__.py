"""Results for people and programs: the verdict, the terminal summary, report.json and report.html. Pure functions."""

from mobilecal_cli.report.at_work import recommendation
from mobilecal_cli.report.changes import Change, change_checks, change_from_nominal, change_since
from mobilecal_cli.report.check import Check, Checks
from mobilecal_cli.report.checklist import checklist, checklist_json, checklist_text
from mobilecal_cli.report.checks.recording import MIN_STATIONS
from mobilecal_cli.report.comparison import comparison_json, comparison_text
from mobilecal_cli.report.data import report_json
from mobilecal_cli.report.drawn import Figures, draw_figures
from mobilecal_cli.report.evaluation import dependence, evaluation_json, evaluation_text
from mobilecal_cli.report.evaluation_verdict import OwnEstimate, judge_evaluation
from mobilecal_cli.report.findings import suggestion_sentences
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
from mobilecal_cli.report.text import summary_table
from mobilecal_cli.report.verdict import Verdict, judge
from mobilecal_cli.report.wording import words

__all__ = [
    "MIN_STATIONS",
    "Change",
    "Check",
    "Checks",
    "Figures",
    "Gate",
    "OwnEstimate",
    "Verdict",
    "change_checks",
    "change_from_nominal",
    "change_since",
    "checklist",
    "checklist_json",
    "checklist_text",
    "comparison_json",
    "comparison_text",
    "dependence",
    "draw_figures",
    "evaluated_figures",
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
    "judge",
    "judge_evaluation",
    "junit_error_xml",
    "junit_xml",
    "recommendation",
    "reference_frame",
    "reference_pose",
    "reference_std",
    "report_html",
    "report_json",
    "suggestion_sentences",
    "summary_table",
    "use_limits",
    "words",
]
