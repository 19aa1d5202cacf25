"""Do the data contradict what the robot description states? One test for each kind of constants of each part."""

from __future__ import annotations

import math

import numpy as np
from scipy.special import chdtrc, ndtri

from mobilecal_cli.likelihood.constants import FAMILIES, UNSTATED, Constant, family
from mobilecal_cli.likelihood.linearization import solvable
from mobilecal_cli.likelihood.patterns import UNDERSTATED
from mobilecal_cli.likelihood.posterior import Posterior
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.findings import Evidence, EvidenceValue

_LEAST_CHANCE = 1e-300
_FIXED = 1e-12  # rad, m: standard deviation of a parameter that is fixed, up to rounding
_SHOWN = 0.997  # posterior variance over the prior's, below which the data show a direction


def equivalent_sigmas(chi2: float, dof: int, tried: int = 1) -> float:
    """Standard deviations of a normal distribution that are exceeded as rarely as this chi-squared, of so many."""
    return from_chance(min(1.0, float(chdtrc(dof, chi2)) * tried))


def from_chance(chance: float) -> float:
    """Standard deviations of a normal distribution that are exceeded with this chance."""
    return float(-ndtri(max(chance, _LEAST_CHANCE) / 2))


@solvable()
def evidence(lin: Posterior, parts: bool = True) -> tuple[Evidence, ...]:
    """Evidence against the stated values of every group of constants at an optimum, one group at a time.

    A group is what one part of the robot has of a kind, or all of a kind together.

    With the prior covariance P and the posterior mean m and covariance C of a group, ignoring its stated values
    decreases the cost by m^T (P - C)^-1 m. In units of its prior, P - C has eigenvalues between 0 (the data show
    nothing) and 1. A group whose prior was made wider is tested against the stated one; the others stay as wide.
    """
    layout, C = lin.data.layout, lin.covariance
    usual = np.array([np.inf] * 9 + [row.of_kind.sigma for row in layout.constants])
    values = lin.priors.displacement(lin.state)
    groups: dict[tuple[str, str], dict[int, Constant]] = {}
    for column, row in enumerate(layout.constants, 9):
        if lin.priors.weight[column] and row.kind not in UNSTATED:
            kind = family(row.kind)
            groups.setdefault((kind, row.part if parts and kind not in FAMILIES else ""), {})[column] = row
    tested = []
    for (kind, _), members in groups.items():
        columns, rows = list(members), list(members.values())
        if kind in FAMILIES and lin.data.scale_of_squares:
            continue
        first = next((row for row in rows if row.kind == kind), rows[0])
        prior, factors = 1 / np.sqrt(lin.priors.stated_weight[columns]), lin.priors.factors[columns]
        tight = np.minimum(prior / usual[columns], 1.0)
        m = (values - lin.priors.mean)[columns] / prior
        own = C[np.ix_(columns, columns)] / np.outer(prior, prior)
        across = C[:9, columns] / prior @ np.linalg.pinv(own)
        std = np.sqrt(np.diag(C)[:9])
        if np.any(factors > 1):
            precision = np.linalg.inv(own)
            stated = np.linalg.inv(precision + np.diag(1 - 1 / factors**2))
            std = np.sqrt(np.maximum(std**2 - np.sum(across @ (own - stated) * across, axis=1), 0.0))
            own, m = stated, stated @ precision @ m
        if kind in FAMILIES and len(columns) > 1:
            # What all of them share is no contradiction, as in `noise.widths`.
            along = np.linalg.svd(1 / prior[None], full_matrices=True)[2][1:]
            apart = along @ m
            chi2, dof, value, _ = _without_prior(apart, along @ own @ along.T, np.sqrt(along**2 @ tight**2))
            value, wide = m + along.T @ (value - apart), np.full(len(m), np.inf)
        else:
            chi2, dof, value, wide = _without_prior(m, own, tight)
        names = [layout.names[k] for k in columns]
        estimates = {
            name: EvidenceValue(float(v * s), float(d * s) if math.isfinite(d) else None, float(s))
            for name, v, d, s in zip(names, value, wide, prior, strict=True)
        }
        # The nine follow as their covariance with the group says; of kinds that show only together, one may be wrong.
        shifts, free = [0.0], std > _FIXED
        for kind in {row.kind for row in rows}:
            of = [k for k, row in enumerate(rows) if row.kind == kind]
            alone = _without_prior(m[of], own[np.ix_(of, of)], tight[of])[2]
            follow = across @ own[:, of] @ np.linalg.pinv(own[np.ix_(of, of)]) @ (alone - m[of])
            shifts += (np.abs(follow[free]) / std[free]).tolist()
        sigmas = equivalent_sigmas(chi2, dof) if dof else 0.0
        asked = tuple(layout.names[k] for k in columns if lin.priors.mean[k])
        tested.append(Evidence(first.kind, first.part, estimates, chi2, sigmas, max(shifts), asked))
    return tuple(tested)


def _without_prior(
    m: FloatArray, C: FloatArray, tight: FloatArray
) -> tuple[float, int, FloatArray, FloatArray]:
    """Decrease of the cost without a prior of N(0, I), degrees of freedom that the data show, and the estimate then.

    The posterior mean varies by I - C, and by the share of C that the patterns of corners which are left out add: of a
    direction that the data hardly show, they may be most of what moves it. What they move is less under a prior that
    is tighter than usual, by its variance.

    Args:
        m, C: posterior mean (k,) and covariance (k, k), in units of the prior.
        tight: (k,) the prior's sigma over the usual one, at most 1.

    Returns:
        Chi-squared, degrees of freedom, and (k,) values and standard deviations without the prior; a standard deviation
        is infinite where the data show nothing.
    """
    values, vectors = np.linalg.eigh((C + C.T) / 2)
    shown = values < _SHOWN
    along = vectors.T @ m
    left = np.where(shown, 1 - values, 1.0)
    by_patterns = UNDERSTATED * values * (tight**2 @ vectors**2)
    chi2 = float(np.sum(np.where(shown, along**2 / (left + by_patterns), 0.0)))
    value = vectors @ np.where(shown, along / left, along)
    variance = np.where(shown, values / left, math.inf)
    with np.errstate(invalid="ignore"):
        std = np.sqrt(np.nansum(vectors**2 * variance, axis=1))
    return chi2, int(shown.sum()), value, std
