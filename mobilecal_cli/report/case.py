"""What a report is about."""

from __future__ import annotations

from dataclasses import dataclass

from mobilecal_cli.model import Evaluation, Extraction, Provenance, Solution
from mobilecal_cli.report.comparison import Change
from mobilecal_cli.report.verdict import Verdict


@dataclass(frozen=True, slots=True, eq=False)
class Case:
    """A solution with all that belongs to it.

    Attributes:
        solution: the solution.
        extraction: the data it was computed from.
        provenance: time, version, recordings and settings.
        verdict: result of `judge`.
        trial: evaluation on the held-out stations, if any.
        change: difference from the last calibration or from the nominal values, if there is either.
    """

    solution: Solution
    extraction: Extraction
    provenance: Provenance
    verdict: Verdict
    trial: Evaluation | None = None
    change: Change | None = None
