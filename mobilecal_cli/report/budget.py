"""The error budget as numbers: shares of sources, and of groups of sources."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from mobilecal_cli.model import NINE, FloatArray, Solution
from mobilecal_cli.report.wording.budget import FAMILIES, source


def shares_of(solution: Solution, field: str) -> Sequence[tuple[float, str]]:
    """(share, source) of an expected error, a field of `AtWork`, largest first; empty if unknown or zero."""
    found = solution.uncertainty
    if found is None or field not in found.budget.at_work:
        return []
    pairs = zip(found.budget.at_work[field].tolist(), found.budget.sources, strict=True)
    return sorted(((share, name) for share, name in pairs if share > 0), reverse=True)


def families(solution: Solution) -> tuple[tuple[str, ...], FloatArray]:
    """Groups of sources and their shares, (G, 9 + F), of the nine parameters and of the fields of `AtWork`."""
    found = solution.uncertainty
    if found is None:
        return (), np.zeros((0, len(NINE)))
    budget = found.budget
    columns = np.concatenate([budget.nine, np.stack(list(budget.at_work.values()), axis=1)], axis=1)
    sums: dict[str, FloatArray] = {family: np.zeros(columns.shape[1]) for family in FAMILIES}
    for name, row in zip(budget.sources, columns, strict=True):
        sums[source(name).family] += np.maximum(row, 0.0)
    return tuple(sums), np.array(list(sums.values()))
