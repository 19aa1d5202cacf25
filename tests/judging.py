"""The verdict on a solution, without the report."""

from mobilecal_cli.model.solution import Provenance
from mobilecal_cli.report.criteria import Case
from mobilecal_cli.report.verdict import Verdict, verdict_of

NOWHERE = Provenance("", "", "", (), {})


def judge(solution, extraction, gates=None, trial=None, change=None) -> Verdict:
    return verdict_of(Case(solution, extraction, NOWHERE, gates or {}, trial, change))
