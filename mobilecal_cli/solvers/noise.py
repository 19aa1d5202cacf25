"""Noise levels from the residuals: variance components by restricted maximum likelihood."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from mobilecal_cli.likelihood.budget import of_errors, of_legs
from mobilecal_cli.likelihood.legs import SUPPOSED
from mobilecal_cli.likelihood.measurements import ERRORS
from mobilecal_cli.likelihood.nuisance import FAMILIES, family
from mobilecal_cli.likelihood.posterior import Posterior
from mobilecal_cli.likelihood.processes import LENGTHS
from mobilecal_cli.model import EXACT, NINE, FloatArray, Noise

_LEAST, _MOST = Noise.limits("least"), Noise.limits("most")
#: A guessed correlation length is right within this factor (one sigma of its logarithm).
_LENGTH_FACTOR = 3.0
_LENGTHS = np.geomspace(0.02, 50.0, 241)  # of the present length: those that are compared
#: Tolerance of a correlation length over that of a level. Few recordings show one within half of itself, and it moves
#: far along a ridge on which the standard deviations stay.
_LENGTH_TOLERANCE = 5.0
_WORTH, _FADES_AT = 2.0, 4.0
# Stated priors are right with this chance, or too narrow, those of one kind or all of them: by more than s times with a
# chance that falls as these powers of 1 / s.
_AS_STATED, _TOO_NARROW, _ALL_TOO_NARROW = 0.95, 1.0, 1.5
# What the data show of a kind's constants by less than the first is not used; and the largest factor.
_SHOWN, _WIDEST = 0.01, 1e3
_LOG_FACTORS = np.linspace(0.0, math.log(_WIDEST), 500)  # that are compared
_EXACT = 1e-12  # variance over the prior's of a constant that the data show completely
# Rounds that are remembered, and how far a level may move (as a logarithm): times what its residuals say, and this.
_MEMORY, _FARTHEST, _ANYWAY = 5, 3.0, 0.3
UNIFORM = 1 / math.sqrt(12)  # sigma of an encoder's reading, in steps


def guess_worth(redundancy: float) -> float:
    """How many residuals the guess counts for: a few where few others are, hardly any where many are."""
    return _WORTH / (1 + (max(redundancy, 0.0) / _FADES_AT) ** 2)


@dataclass(frozen=True, slots=True)
class Component:
    """One kind of noise, as the residuals show it.

    Attributes:
        squares: sum of squares of the whitened residuals.
        redundancy: number of residuals minus what the unknowns take up.
    """

    squares: float
    redundancy: float

    def factor(self, guess: float) -> float:
        """Estimated variance over the present one; guess: the guessed variance over the present one."""
        worth = guess_worth(self.redundancy)
        return (self.squares + worth * guess) / (max(self.redundancy, 0.0) + worth)


def components(lin: Posterior) -> dict[str, Component]:
    """Sums of squares and redundancies of each kind of noise at an optimum (Foerstner's estimate)."""
    views = lin.views
    sums = defaultdict[str, FloatArray](lambda: np.zeros(2))

    def add(level: str, squares: FloatArray, left: FloatArray) -> None:
        """Squares of whitened residuals of a level, and how much of them is redundant."""
        sums[level] += squares.sum(), left.sum()

    measured = np.sum(np.diagonal(lin.data.pose_weight, axis1=1, axis2=2) > 0, axis=1)
    corners = 2 * lin.inliers.used_corners.sum(axis=(1, 2))
    squares, left = views.cost, np.where(lin.inliers.views, corners + measured, 0)
    for delay in views.of_delays:
        across, variance = views.rows[:, delay], lin.noise.pair_s**2
        own = variance * views.pull[:, delay] ** 2
        free = variance * (across[:, views.traced[delay]] - lin.marginals.variance_along(across))
        add("pair_s", own, free)
        squares, left = squares - own, left - free
    add(lin.data.images_level, squares, left.sum() - lin.marginals.leverage(views))

    means = int(lin.data.log.max())
    for each in of_errors(lin, _within(lin)):
        for level in each.parts:
            squares, free = each.shown(level)
            if level != "encoder_rad" or lin.noise.encoder_rad:  # encoders without steps show none
                add(level, squares, np.maximum(free - means, 0.0) if level in LENGTHS else free)
    of_wheels = of_legs(lin)
    for level in of_wheels.parts:
        if level != SUPPOSED:
            add(level, *of_wheels.shown(level))
    return {level: Component(*of_level.tolist()) for level, of_level in sums.items()}


def _within(lin: Posterior) -> FloatArray:
    """(N, K) errors of the base blocks, processes without their mean in each recording, where there are several.

    Means that differ say how the recordings differ, not how a process varies along the way.
    """
    processes, errors, log = lin.processes, lin.state.base[:, ERRORS], lin.data.log
    if not log.max():
        return errors
    ones = processes.innovations(np.ones_like(errors))
    sums = np.zeros((2, int(log.max()) + 1, errors.shape[1]))
    np.add.at(sums[0], log, ones / processes.variance * processes.innovations(errors))
    np.add.at(sums[1], log, ones / processes.variance * ones)
    along = [level in LENGTHS for level in processes.levels]
    return np.where(along, errors - (sums[0] / sums[1])[log], errors)


def lengths(lin: Posterior, given: frozenset[str], guess: Noise) -> dict[str, float]:
    """Correlation lengths of the processes after one step of expectation-maximization (Dempster et al., 1977).

    The expected logarithm of the innovations' density, at the present posterior of the processes, is largest there,
    under a log-normal prior around the guess.
    """
    processes, posterior, values = lin.processes, lin.marginals, _within(lin)
    j = lin.data.legs[lin.inliers.legs, 1]
    lengths_m: dict[str, float] = {}
    variance, before = (np.diagonal(part, axis1=1, axis2=2) for part in (posterior.errors, posterior.before))
    here, past = values[j], values[j - 1]
    squares, mixed, earlier = here**2 + variance[j], here * past + before[j], past**2 + variance[j - 1]
    for length in dict.fromkeys(LENGTHS.values()):
        if length in given:
            continue
        tried = getattr(lin.noise, length) * _LENGTHS
        score = -((np.log(tried / getattr(guess, length)) / math.log(_LENGTH_FACTOR)) ** 2)
        mine = [k for k, level in enumerate(processes.levels) if LENGTHS.get(level) == length]
        precision = np.array([max(getattr(lin.noise, processes.levels[k]), EXACT) for k in mine]) ** -2
        paths, path = np.unique(processes.distance_m[np.ix_(j, mine)], axis=1, return_inverse=True)
        for number, distance_m in enumerate(paths.T):
            alike = np.where(path == number, precision, 0.0)  # processes along this path
            x = distance_m / tried[:, None]
            rho, spread = np.exp(-x), np.maximum(-np.expm1(-2 * x), EXACT**2)
            at_end, across, at_start = (part[:, mine] @ alike for part in (squares, mixed, earlier))
            innovation = at_end - 2 * rho * across + rho**2 * at_start
            score -= np.sum(np.count_nonzero(alike) * np.log(spread) + innovation / spread, axis=1)
        likeliest = float(np.exp(_maximum(np.log(tried), score)))
        lengths_m[length] = min(max(likeliest, _LEAST[length]), _MOST[length])
    return lengths_m


def _maximum(x: FloatArray, y: FloatArray) -> float:
    """Where y is largest, by a parabola through the largest value and its neighbors; x is evenly spaced.

    A fixed point that moves in steps of x is not found by acceleration, and hangs on rounding.
    """
    k = min(max(int(np.argmax(y)), 1), len(y) - 2)
    before, at, after = y[k - 1 : k + 2].tolist()
    bend = before - 2 * at + after
    offset = (before - after) / (2 * bend) if bend < 0 else 0.0
    return float(x[k] + min(max(offset, -1.0), 1.0) * (x[1] - x[0]))


def estimated(noise: Noise, shown: Mapping[str, Component], given: frozenset[str], guess: Noise) -> Noise:
    """The noise after one step of the fixed point; levels that are given stay."""
    changes: dict[str, float] = {}
    for name, component in shown.items():
        if name in given:
            continue
        before, supposed = getattr(noise, name), getattr(guess, name)
        factor = np.clip(component.factor((supposed / before) ** 2), 1e-4, 1e4)
        level = before * float(np.sqrt(factor))
        changes[name] = min(max(level, _LEAST[name]), _MOST[name])
    return noise.with_levels(changes)


def widths(lin: Posterior) -> dict[str, float]:
    """Kind of constants → how many times as wide as stated its priors are expected to be, the others as they are.

    In units of the stated priors, a kind's constants c have the posterior covariance C and mean m, under a prior of
    variance f0^2. The measurements' gradient ``g = C^-1 m`` by them varies by their information
    ``I = C^-1 - 1 / f0^2``, and by ``f^2 I^2`` as c varies under a prior of f^2: that is its likelihood for any f,
    direction by direction. What the measurements show of a direction by less than `_SHOWN` is as good as nothing.
    """
    priors, off = lin.priors, lin.priors.displacement(lin.state) - lin.priors.mean
    root, used = np.sqrt(priors.stated_weight), priors.alike & (priors.weight > 0)
    columns: dict[str, list[int]] = {}
    for k, row in enumerate(lin.data.layout.constants, len(NINE)):
        if used[k]:
            columns.setdefault(family(row.kind), []).append(k)
    misfit = np.zeros((len(columns), len(_LOG_FACTORS)))
    for i, (name, mine) in enumerate(columns.items()):
        along = np.eye(len(mine))
        if name in FAMILIES and len(mine) > 1:  # what all of them share is no contradiction
            along = np.linalg.svd(root[None, mine], full_matrices=True)[2][1:]
        along = along * root[mine]
        values, vectors = np.linalg.eigh(along @ lin.covariance[np.ix_(mine, mine)] @ along.T)
        values = np.maximum(values, _EXACT)
        gradient = vectors.T @ (along @ off[mine]) / values
        information = np.maximum(1 / values - 1 / priors.factors[mine[0]] ** 2, 0.0)
        spread = information + _SHOWN + np.outer(np.exp(2 * _LOG_FACTORS), information**2)
        misfit[i] = np.sum(np.log(spread) + gradient**2 / spread, axis=1)
    return dict(zip(columns, expected_factors(misfit).tolist(), strict=True))


def expected_factors(misfit: FloatArray) -> FloatArray:
    """(K,) factors of the priors of all kinds, at least 1, from each kind's likelihood.

    Each is the product of a kind's own factor and that of the whole description: where many kinds are off, those that
    the data do not show are likely off, too. Either is 1 (as stated), or more, with the density of Pareto. The priors'
    precision is the one that is expected then, over the one that is expected where nothing is known of any kind.

    Args:
        misfit: (K, F) minus twice the logarithm of each kind's likelihood, for `_LOG_FACTORS`.
    """
    logs, step = _LOG_FACTORS, _LOG_FACTORS[1]

    def of_own(values: FloatArray) -> FloatArray:
        """(K, F) mean of values at the total factor over the own one, for each common factor."""
        falling = np.cumsum((np.exp(-_TOO_NARROW * logs) * values)[:, ::-1], axis=1)[:, ::-1]
        beyond = _TOO_NARROW * step * np.exp(_TOO_NARROW * logs) * falling
        return np.asarray(_AS_STATED * values + (1 - _AS_STATED) * beyond)

    common = (1 - _AS_STATED) * _ALL_TOO_NARROW * step * np.exp(-_ALL_TOO_NARROW * logs)
    common[0] += _AS_STATED

    def precision(misfit: FloatArray) -> FloatArray:
        likelihood = np.exp((misfit.min(axis=1, keepdims=True) - misfit) / 2)
        each, weighted = of_own(likelihood), of_own(likelihood * np.exp(-2 * logs))
        chance = np.log(common) + np.log(each).sum(axis=0)
        chance = np.exp(chance - chance.max())
        return np.asarray((weighted / each) @ chance / chance.sum())

    return np.sqrt(np.maximum(precision(np.zeros((1, len(logs)))) / precision(misfit), 1.0))


class LevelSearch:
    """Anderson's acceleration of the fixed point of noise levels, on their logarithms.

    Levels that few residuals show converge slowly by themselves: tens of rounds.

    Args:
        given: names of levels that stay.
    """

    def __init__(self, given: frozenset[str]) -> None:
        self._given = given
        self._levels: list[FloatArray] = []
        self._changes: list[FloatArray] = []

    def next(self, noise: Noise, shown: Noise) -> Noise:
        """Levels for the next round, from those of this round and what its residuals say."""
        here, there = noise.all_levels, shown.all_levels
        names = [name for name in there if name not in self._given and here.get(name, 1.0) > 0]
        at = np.log([here.get(name, 1.0) for name in names])
        change = np.log([there[name] for name in names]) - at
        if self._changes and np.linalg.norm(change) > 2 * np.linalg.norm(self._changes[-1]):
            self._levels, self._changes = [], []
        self._levels, self._changes = [*self._levels[-_MEMORY:], at], [*self._changes[-_MEMORY:], change]
        step = change
        if len(self._changes) > 1:
            dX, dF = (np.diff(np.array(part), axis=0).T for part in (self._levels, self._changes))
            weights = np.linalg.lstsq(dF, change, rcond=1e-6)[0]
            step = change - (dX + dF) @ weights
        farthest = _FARTHEST * np.abs(change) + _ANYWAY
        step = np.clip(step, -farthest, farthest)
        return noise.with_levels(
            {
                name: min(max(level, _LEAST.get(name, 1.0)), _MOST.get(name, _WIDEST))
                for name, level in zip(names, np.exp(at + step).tolist(), strict=True)
            }
        )


def converged(before: Noise, after: Noise, tolerance: float) -> bool:
    """Whether no level moved by more than a share of itself, and no correlation length by more than five times that."""
    a, b = before.all_levels, after.all_levels
    allowed = dict.fromkeys(LENGTHS.values(), _LENGTH_TOLERANCE * tolerance)
    return all(
        abs(level - a.get(name, 1.0)) <= allowed.get(name, tolerance) * a.get(name, 1.0)
        for name, level in b.items()
    )
