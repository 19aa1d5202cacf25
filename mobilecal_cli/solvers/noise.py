"""Noise levels from the residuals: variance components by restricted maximum likelihood."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from mobilecal_cli.likelihood.budget import of_errors, of_legs
from mobilecal_cli.likelihood.constants import FAMILIES, family
from mobilecal_cli.likelihood.legs import SUPPOSED
from mobilecal_cli.likelihood.measurements import ERRORS
from mobilecal_cli.likelihood.posterior import Posterior
from mobilecal_cli.likelihood.processes import LENGTHS
from mobilecal_cli.model.arrays import BoolArray, FloatArray
from mobilecal_cli.model.calibration import NINE
from mobilecal_cli.model.solution import EXACT, Noise

_LEAST, _MOST = Noise.limits("least"), Noise.limits("most")
#: A guessed correlation length is right within this factor (one sigma of its logarithm).
_LENGTH_FACTOR = 3.0
_NEAR = 0.02  # logarithm of lengths that are compared with the present one
_WORTH, _FADES_AT = 2.0, 4.0
# Stated priors are right with this chance, or too narrow, those of one kind or all of them: by more than s times with a
# chance that falls as these powers of 1 / s.
_AS_STATED, _TOO_NARROW, _ALL_TOO_NARROW = 0.95, 1.0, 1.5
# What the data show of a kind's constants by less than the first is not used; and the largest factor.
_SHOWN, _WIDEST = 1e-3, 1e3
_LOG_FACTORS = np.linspace(0.0, math.log(_WIDEST), 500)  # that are compared
_EXACT = 1e-12  # variance over the prior's of a constant that the data show completely
# How far a level may move in a round (as a logarithm): times what its own residuals say and so much more, up to this.
_FARTHEST, _ANYWAY, _AT_ONCE = 3.0, 0.3, 1.0
_AT_LIMIT = 1e-9  # relative: rounding
_WORSE = 4.0  # times what the slopes promise, beyond which the search begins again
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
        """Squares of whitened residuals of a level, if there are any, and how much of them is redundant."""
        if np.size(squares):
            sums[level] += np.sum(squares), np.sum(left)

    measured = np.sum(np.diagonal(lin.data.pose_weight, axis1=1, axis2=2) > 0, axis=1)
    corners = 2 * lin.inliers.used_corners.sum(axis=(1, 2))
    squares, left = views.cost, np.where(lin.inliers.views, corners + measured, 0)
    for k, (level, variance) in views.own_variances(lin.noise).items():
        across = views.rows[:, k : k + 1]
        own = variance * views.pull[:, k] ** 2
        free = variance * (across[:, 0, views.traced[k]] - lin.spread_in_images(across)[:, 0, 0])
        add(level, own, free)
        squares, left = squares - own, left - free
    # How much of the information of all images the unknowns take up.
    leverage = np.sum(views.rows[:, :6, :6] * lin.marginals.known)
    leverage += np.sum(lin.of_images * lin.conditional_covariance)
    add(lin.data.images_level, squares, left.sum() - leverage)

    means = max(int(_driven(lin).sum()) - 1, 0)
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

    Means that differ say how the recordings differ, not how a process varies along the way. A recording without a leg
    has none.
    """
    processes, errors, log = lin.processes, lin.state.base[:, ERRORS], lin.data.log
    driven = _driven(lin)
    if driven.sum() < 2:
        return errors
    ones = processes.innovations(np.ones_like(errors))
    sums = np.zeros((2, int(log.max()) + 1, errors.shape[1]))
    np.add.at(sums[0], log, ones / processes.variance * processes.innovations(errors))
    np.add.at(sums[1], log, ones / processes.variance * ones)
    along = np.outer(driven[log], [level in LENGTHS for level in processes.levels])
    means = sums[0] / np.where(driven[:, None], sums[1], 1.0)
    return np.where(along, errors - means[log], errors)


def _driven(lin: Posterior) -> BoolArray:
    """(logs,) recordings with a leg."""
    return np.isin(np.arange(lin.data.log.max() + 1), lin.data.log[lin.data.legs[:, 0]])


class Slope(NamedTuple):
    """How minus twice the logarithm of the restricted likelihood rises with that of a level, and how the slope does."""

    rise: float
    bend: float


def slopes(lin: Posterior, given: frozenset[str], guess: Noise) -> dict[str, Slope]:
    """Slope of each level and correlation length that is not given, with what the guess says of it.

    Of a level, it is that of the fixed point `Component.factor`. At a limit that it leads beyond, it is 0.
    """
    shown, found = components(lin), {}
    for name, component in shown.items():
        if name not in given:
            change = 0.5 * math.log(component.factor((getattr(guess, name) / getattr(lin.noise, name)) ** 2))
            bend = 4 * (max(component.redundancy, 0.0) + guess_worth(component.redundancy))
            found[name] = Slope(-bend * change, bend)
    found |= _of_lengths(lin, shown, given, guess)
    for name, (rise, bend) in found.items():
        level = getattr(lin.noise, name)
        least, most = _LEAST[name] * (1 + _AT_LIMIT), _MOST[name] * (1 - _AT_LIMIT)
        if (level <= least and rise > 0) or (level >= most and rise < 0):
            found[name] = Slope(0.0, bend)
    return found


def _of_lengths(
    lin: Posterior, shown: Mapping[str, Component], given: frozenset[str], guess: Noise
) -> dict[str, Slope]:
    """Slopes of the correlation lengths of the processes, under a log-normal prior around the guess.

    The likelihood's is that of the expected logarithm of the innovations' density, at the present posterior of the
    processes (Dempster et al., 1977). It bends less than that: as much of the innovations as the residuals show.
    """
    processes, posterior, values = lin.processes, lin.marginals, _within(lin)
    j = lin.data.legs[lin.inliers.legs, 1]
    found: dict[str, Slope] = {}
    variance, before = (np.diagonal(part, axis1=1, axis2=2) for part in (posterior.errors, posterior.before))
    here, past = values[j], values[j - 1]
    squares, mixed, earlier = here**2 + variance[j], here * past + before[j], past**2 + variance[j - 1]
    for length in dict.fromkeys(LENGTHS.values()):
        if length in given:
            continue
        tried = getattr(lin.noise, length) * np.exp([-_NEAR, 0.0, _NEAR])
        mine = [k for k, level in enumerate(processes.levels) if LENGTHS.get(level) == length]
        precision = np.array([max(getattr(lin.noise, processes.levels[k]), EXACT) for k in mine]) ** -2
        x = processes.distance_m[np.ix_(j, mine)] / tried[:, None, None]
        rho, spread = np.exp(-x), np.maximum(-np.expm1(-2 * x), EXACT**2)
        innovation = squares[:, mine] - 2 * rho * mixed[:, mine] + rho**2 * earlier[:, mine]
        misfit = np.sum(np.log(spread) + innovation * precision / spread, axis=(1, 2))
        prior = 2 / math.log(_LENGTH_FACTOR) ** 2
        free = sum(shown[level].redundancy for level in {processes.levels[k] for k in mine})
        share = min(max(free / max(len(j) * len(mine), 1), 0.0), 1.0)
        rise = float(misfit[2] - misfit[0]) / (2 * _NEAR)
        bend = float(misfit[2] - 2 * misfit[1] + misfit[0]) / _NEAR**2
        away = math.log(getattr(lin.noise, length) / getattr(guess, length))
        found[length] = Slope(rise + prior * away, prior + share * max(bend, 0.0))
    return found


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
        if name in FAMILIES and (
            len(mine) > 1 or lin.data.scale_of_squares
        ):  # what all share is no contradiction
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
    """Search for the levels with the largest restricted likelihood, on their logarithms: BFGS, from slopes alone.

    Without it, levels that few residuals show converge slowly. Where two explain nearly the same, such as a floor and
    its correlation length, a search for slopes of zero may also climb, and wander along the ridge without an end.
    """

    def __init__(self) -> None:
        self._at: FloatArray = np.zeros(0)
        self._rise: FloatArray = np.zeros(0)
        self._inverse: FloatArray = np.zeros((0, 0))  # of the second derivatives
        self._promise = 0.0

    def next(self, noise: Noise, found: Mapping[str, Slope], wider: Mapping[str, float]) -> Noise:
        """Levels for the next round, from those of this round and their slopes; with these scales of the priors."""
        at = np.log([getattr(noise, name) for name in found])
        rise, bend = np.reshape([*found.values()], (-1, 2)).T
        promise = float(np.sum(rise**2 / bend))
        self._inverse = self._updated(at, rise) if promise < _WORSE * self._promise else np.diag(1 / bend)
        self._at, self._rise, self._promise = at, rise, promise
        farthest = np.minimum(_FARTHEST * np.abs(rise / bend) + _ANYWAY, _AT_ONCE)
        step = np.where(rise == 0, 0.0, np.clip(-self._inverse @ rise, -farthest, farthest))
        levels = dict(zip(found, np.exp(at + step).tolist(), strict=True))
        within = {name: min(max(level, _LEAST[name]), _MOST[name]) for name, level in levels.items()}
        # Half-way on the logarithms: of two kinds that explain the same, each looks too narrow while both are as they
        # are stated, and neither while both are wide. Whole steps go to and fro without an end.
        half = {name: math.sqrt(noise.wider.get(name, 1.0) * factor) for name, factor in wider.items()}
        return replace(noise.with_levels(within), wider=half)

    def _updated(self, at: FloatArray, rise: FloatArray) -> FloatArray:
        """The inverse after what the last step showed; unchanged where it bent the wrong way."""
        free = (rise != 0) & (self._rise != 0)  # what is at a limit says nothing
        moved, steeper = (at - self._at) * free, (rise - self._rise) * free
        curved = float(moved @ steeper)
        if curved <= 0:
            return self._inverse
        along = np.eye(len(at)) - np.outer(moved, steeper) / curved
        updated: FloatArray = along @ self._inverse @ along.T + np.outer(moved, moved) / curved
        return updated


def converged(before: Noise, after: Noise, tolerance: float) -> bool:
    """Whether no level moved by more than a share of itself."""
    a, b = before.all_levels, after.all_levels
    return all(abs(level / a.get(name, 1.0) - 1) <= tolerance for name, level in b.items() if level)
