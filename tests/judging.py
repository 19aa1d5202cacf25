"""The verdict on a solution, without the report."""

from mobilecal_cli.report.criteria import Calibration
from mobilecal_cli.report.verdict import Verdict, verdict_of


def judge(solution, extraction, gates=None, trial=None, change=None) -> Verdict:
    return verdict_of(Calibration(solution, extraction, gates or {}, trial, change))
