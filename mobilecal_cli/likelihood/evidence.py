"""Score tests of constants: does the data support estimating them? (Rao's test, from one linearization.)"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from mobilecal_cli.likelihood import nuisance
from mobilecal_cli.likelihood.nuisance import Constant
from mobilecal_cli.model import Evidence, FloatArray

if TYPE_CHECKING:
    from mobilecal_cli.likelihood.linearization import Linearization


@dataclass(frozen=True, slots=True, eq=False)
class _Scores:
    """Normal equations with every constant that the recording can show.

    Attributes:
        names: columns before the boards'.
        information, gradient: (P, P) and (P,), priors of the estimated parameters included.
        free: (P, F) directions that are estimated already.
        price: of one more parameter, in chi-squared (Bayesian information criterion).
    """

    names: tuple[str, ...]
    information: FloatArray
    gradient: FloatArray
    free: FloatArray
    price: float


def evidence(lin: Linearization) -> Iterator[Evidence]:
    """Evidence for every group of constants at an optimum, one group at a time."""
    layout = lin.data.layout
    known = {row.name for row in layout.constants}
    table = tuple(row for row in nuisance.CONSTANTS if row.name in known or row.effect.offered(lin.data))
    whole = lin.estimating(table)
    named = whole.data.layout.names
    old = [named.index(name) for name in layout.names]
    old += list(range(whole.data.layout.named, whole.data.layout.size))
    free = np.zeros((whole.data.layout.size, lin.priors.basis.shape[1]))
    free[old] = lin.priors.basis
    information = whole.normal.S.copy()
    information[old, old] += lin.priors.information
    scores = _Scores(named, information, whole.normal.s, free, math.log(lin.inliers.count))
    for group in dict.fromkeys(row.group for row in table):
        members = [row for row in table if row.group == group]
        estimated = [row for row in members if row.name in known]
        yield _of_group(lin, scores, estimated or members, bool(estimated))


def _of_group(lin: Linearization, scores: _Scores, rows: list[Constant], estimated: bool) -> Evidence:
    group, names = rows[0].group, [row.name for row in rows]
    columns = [scores.names.index(name) for name in names]
    sigmas = np.array([row.sigma for row in rows])
    rest = scores.free[:, ~np.any(scores.free[columns] != 0, axis=0)]
    unit = 1 / np.sqrt(np.einsum("pf,pq,qf->f", rest, scores.information, rest))
    inner = unit[:, None] * (rest.T @ scores.information @ rest) * unit
    across = (rest.T @ scores.information[:, columns]) * unit[:, None] * sigmas
    own = scores.information[np.ix_(columns, columns)] * np.outer(sigmas, sigmas)
    schur = own - across.T @ np.linalg.solve(inner, across)
    values, vectors = np.linalg.eigh(schur)
    if values[0] < 1.0:  # in some direction the data shows no more than the prior
        return Evidence(group, dict.fromkeys(names, (0.0, math.inf)), "unobservable", 0.0, 0.0)
    covariance = (vectors / values) @ vectors.T
    if estimated:
        found = np.array([lin.state.value(name) for name in names]) / sigmas
    else:
        found = -covariance @ (scores.gradient[columns] * sigmas)
    chi2 = float(found @ schur @ found)
    std = np.sqrt(np.diag(covariance)) * sigmas
    known = {n: (float(v), float(s)) for n, v, s in zip(names, found * sigmas, std, strict=True)}
    return Evidence(
        group, known, "estimated" if estimated else "offered", chi2, chi2 - len(names) * scores.price
    )
