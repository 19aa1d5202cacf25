"""Several recordings of one robot: the estimate from each alone, and their spread beyond its own noise."""

from __future__ import annotations

import math

import numpy as np
from scipy.special import chdtrc, stdtrit

from mobilecal_cli.likelihood.posterior import Posterior
from mobilecal_cli.model.arrays import BoolArray, FloatArray
from mobilecal_cli.model.calibration import NINE
from mobilecal_cli.model.findings import BetweenLogs

_SHOWN = 1.0  # a recording shows a direction that it knows better than its scale
_SHARE = 0.1  # largest share of a shown parameter in directions that are not shown
_TWO_SIGMA = 0.97725  # probability below two standard deviations
#: What changes between recordings does so together: the mount, or the wheels. These differ where chance alone would
#: make as much in fewer cases, and the spread counts the more the fewer these are: nothing hangs on the limit.
_CHANGE_TOGETHER, _CHANCE = (slice(6), slice(6, 9)), 0.005
_NO_VARIANCE = 1e-14  # in scaled units, of a direction that a recording does not show


def _own(
    A: FloatArray, a: FloatArray, basis: FloatArray
) -> tuple[FloatArray, FloatArray, BoolArray, list[float], list[int]]:
    """The estimate of the nine from one recording, for the common values of all constants, in scaled units.

    Args:
        A, a: (F, F) information about the free directions of the nine, and (F,) its gradient.
        basis: (9, F) these directions.

    Returns:
        (9,) step from the common optimum and (9,) its standard deviation, both 0 where the recording does not show a
        parameter; (9,) whether it does; for each of `_CHANGE_TOGETHER`, the chi-squared of the common optimum and its
        degrees of freedom.
    """
    values, vectors = np.linalg.eigh(A)
    known = values > _SHOWN**2
    inverse = np.where(known, 1 / np.where(known, values, 1.0), 0.0)
    onto = basis @ (vectors * inverse) @ vectors.T
    covariance, step = onto @ basis.T, -onto @ a
    std = np.sqrt(np.diag(covariance))
    # Of fixed and unobservable parameters, the share is zero.
    shown = np.sum((basis @ vectors[:, known]) ** 2, axis=1) > 1 - _SHARE**2
    distances, ranks = [], []
    for of in _CHANGE_TOGETHER:
        variances, along = np.linalg.eigh(covariance[of, of])
        some = variances > _NO_VARIANCE
        distances.append(float(np.sum((step[of] @ along[:, some]) ** 2 / variances[some])))
        ranks.append(int(some.sum()))
    return np.where(shown, step, 0.0), np.where(shown, std, 0.0), shown, distances, ranks


def between_variance(values: FloatArray, std: FloatArray) -> float:
    """Variance between groups beyond their own (DerSimonian and Laird's moment estimate); (L,), (L,) → its unit."""
    if len(values) < 2:
        return 0.0
    weight = std**-2
    mean = np.sum(weight * values) / weight.sum()
    Q = float(np.sum(weight * (values - mean) ** 2))
    spare = float(weight.sum() - np.sum(weight**2) / weight.sum())
    return max(0.0, (Q - (len(values) - 1)) / spare)


def few_logs_factor(values: FloatArray, std: FloatArray, variance: float) -> float:
    """What the spread between few recordings is multiplied by, so that two standard deviations of a mean hold 95.4 %.

    Knapp and Hartung's variance (Statistics in Medicine 22, 2003; at least the usual one), and Student's t in place of
    the normal distribution: the spread between n recordings is known from n - 1 differences.

    Args:
        values, std: (L,) each recording's own estimate and its standard deviation.
        variance: between the recordings, see `between_variance`.
    """
    spare = len(values) - 1
    if spare < 1:
        return 1.0
    weight = 1 / (std**2 + variance)
    mean = np.sum(weight * values) / weight.sum()
    q = float(np.sum(weight * (values - mean) ** 2)) / spare
    return math.sqrt(max(1.0, q)) * float(stdtrit(spare, _TWO_SIGMA)) / 2


def weigh_logs(lin: Posterior) -> tuple[BetweenLogs, FloatArray, FloatArray]:
    """Weigh the recordings with the spread between them.

    Where chance explains how far the recordings are apart (a chi-squared test of the head-eye transform, and one of the
    wheels) there is no spread. Else each recording's information W = (A^-1 + T)^-1 = (I + A T)^-1 A allows for the
    spread T, so that many stations of one recording do not count for more than one robot's worth of evidence. In the
    covariance, the standard deviations of T are larger by `few_logs_factor`.

    Args:
        lin: the optimum of all measurements.

    Returns:
        Each recording by itself and the spread between them; (P,) step from the optimum of all measurements to the
        estimate that allows for the spread; and (P, P) covariance of that estimate.
    """
    priors, size = lin.priors, lin.data.layout.size
    normals = [lin.of_log(log).normal for log in np.unique(lin.data.log).tolist()]
    parts = [(priors.reduced(normal.S), priors.onto_free(normal.s)) for normal in normals]
    nine, own_basis = slice(len(NINE)), priors.nine_basis
    scales = priors.scales[nine]
    own = slice(own_basis.shape[1])
    each = (_own(A[own, own], a[own], own_basis) for A, a in parts)
    step, std, shown, distances, ranks = (np.array(part) for part in zip(*each, strict=True))
    variance, factor = np.zeros(len(NINE)), np.ones(len(NINE))
    for of, distance, rank in zip(_CHANGE_TOGETHER, distances.T, ranks.T, strict=True):
        spare = int(rank.sum()) - int(np.linalg.matrix_rank(own_basis[of]))
        chance = float(chdtrc(spare, distance.sum())) if spare > 0 else 1.0
        for k in range(len(NINE))[of] if chance < _CHANCE else ():
            of_shown = step[shown[:, k], k], std[shown[:, k], k]
            variance[k] = (1 - chance / _CHANCE) * between_variance(*of_shown)
            factor[k] = few_logs_factor(*of_shown, variance[k])

    def pooled_with(spread: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Information of all recordings and priors, and its gradient, with (9,) variances between recordings."""
        T = priors.reduced(np.diag(np.pad(spread / scales**2, (0, size - len(NINE)))))
        total, right = priors.reduced(np.diag(priors.weight)), priors.onto_free(priors.gradient(lin.state))
        for A, a in parts:
            shrink = np.linalg.inv(np.eye(len(a)) + A @ T)
            total += shrink @ A
            right += shrink @ a
        return (total + total.T) / 2, right

    pooled = np.zeros(size)
    if variance.any():
        pooled -= priors.from_free(np.asarray(np.linalg.solve(*pooled_with(variance))))
    between = BetweenLogs(
        np.where(shown, step * scales - pooled[nine], 0.0), std * scales, shown, np.sqrt(variance) * scales
    )
    return between, pooled, priors.spread(np.asarray(np.linalg.inv(pooled_with(factor**2 * variance)[0])))
