"""Outlier decisions: exclude or restore measurements one by one (in long recordings several at a time)."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import chdtri

from mobilecal_cli.errors import SolveError
from mobilecal_cli.likelihood.noise import Selection
from mobilecal_cli.model import BoolArray, FloatArray, IntArray
from mobilecal_cli.solvers.fit import LONG_LOG, Fit, Fitter
from mobilecal_cli.solvers.robust import (
    believed_statistics,
    doubted_legs,
    doubted_readings,
    doubted_views,
    limit,
)
from mobilecal_cli.solvers.variance import guess_worth

_CONSENSUS_REDUNDANCY = 20.0  # assumed redundancy of noise levels from the consistent legs
_MANY = 1e6
_DEGREES = {"readings": 1, "legs": 3, "views": 6}
_STRIKING = 0.2  # chance that a consistent measurement of a kind becomes an outlier candidate
_FEWEST_VIEWS = 4
# Candidates tested at the same time (one more per `LONG_LOG` stations) are more than this many stations apart, so
# that they do not affect one another.
_APART = 5
_LOUD = 4.0  # a variance ratio above this limit starts the search for a consensus


class Decisions:
    """Outlier decisions for the fits of one extraction."""

    def __init__(self, fitter: Fitter) -> None:
        self._fitter = fitter
        self.problem = fitter.problem

    def sound(self, fit: Fit) -> bool:
        """Whether a first fit of all measurements, at the assumed noise levels, contains no outlier candidate."""
        stats = believed_statistics(self.problem, fit.optimum, fit.marginal, fit.selection, fit.noise)
        bound = 1.0 if self._fitter.given >= set(fit.components) else _LOUD
        views = stats.views.max(initial=0) / limit(self.problem.stations, 6, 1e6)
        legs = stats.legs.max(initial=0) / limit(self.problem.stations, 3, 1e6)
        readings = stats.readings.max(initial=0) / limit(self.problem.stations, 1, 1e6)
        return bool(max(views, legs, readings) < bound and fit.selection.views.all())

    def taken_back(self, fit: Fit) -> Fit:
        """Restore measurements consistent with the inliers: legs first, since a bad station affects both its legs."""
        for _ in range(2 * len(self.problem.legs)):
            out = ~fit.selection.legs
            if not out.any():
                break
            statistic = np.where(out, doubted_legs(fit.optimum, fit.marginal), np.inf)
            legs = self._agreeing(fit.selection, statistic)
            if legs is None:
                break
            fit = self._fitter.refit(fit, replace(fit.selection, legs=legs))
        for _ in range(self.problem.stations):
            again = self._view_back(fit, _CONSENSUS_REDUNDANCY)
            if again is None:
                break
            fit = self._fitter.refit(fit, again)
        return self._fitter.fit(fit.optimum.state, fit.selection, fit.noise)

    def _agreeing(self, selection: Selection, statistic: FloatArray) -> BoolArray | None:
        """Inlier legs with consistent legs restored; None if no leg is consistent.

        A leg at a station without inlier images is not constrained until the last leg closes the gap: only one such
        leg is restored at a time.
        """
        legs, one_taken = selection.legs.copy(), False
        for leg in np.argsort(statistic):
            if statistic[leg] > limit(self.problem.stations, 3, _CONSENSUS_REDUNDANCY):
                break
            blind = not selection.views[self.problem.legs[leg]].all()
            if not (blind and one_taken):
                legs[leg], one_taken = True, one_taken or blind
        return None if np.array_equal(legs, selection.legs) else legs

    def _view_back(self, fit: Fit, redundancy: float) -> Selection | None:
        """The selection with a station's images restored, as read or with one joint reading excluded instead."""
        selection = fit.selection
        usable = np.all(selection.corners.sum(axis=2) > 0.5 * self.problem.seen.sum(axis=2), axis=1)
        out = ~selection.views & usable
        if not out.any():
            return None
        as_read, freed = doubted_views(self.problem, fit.optimum, fit.marginal, selection, fit.noise)
        agree = out & (as_read < limit(self.problem.stations, 6, redundancy))
        if agree.any():
            return replace(selection, views=selection.views | agree)
        least = np.where(out, freed.min(axis=1), np.inf)
        best = int(np.argmin(least))
        if least[best] < limit(self.problem.stations, 5, redundancy):
            views, readings = selection.views.copy(), selection.readings.copy()
            views[best], readings[best, int(np.argmin(freed[best]))] = True, False
            return replace(selection, views=views, readings=readings)
        return None

    def _candidates(self, fit: Fit) -> list[tuple[float, str, list[tuple[int, ...]]]]:
        """Outlier candidates of each kind, the largest statistic first: (statistic over limit, kind, indices)."""
        stats = believed_statistics(self.problem, fit.optimum, fit.marginal, fit.selection, fit.noise)
        found = []
        for kind, dof in _DEGREES.items():
            values = getattr(stats, kind)
            usual = float(chdtri(dof, _STRIKING / values.size))
            striking = np.argwhere(values > usual)
            places = self._some(striking[np.argsort(-values[values > usual], kind="stable")])
            if places:
                found.append((float(values[places[0]]) / usual, kind, places))
        return sorted(found, reverse=True)

    def _some(self, places: IntArray) -> list[tuple[int, ...]]:
        """The first of the places (n, indices) that are far apart: a single one except in long recordings."""
        most, some = 1 + self.problem.stations // LONG_LOG, list[tuple[int, ...]]()
        for at in places:
            if len(some) == most:
                break
            if all(abs(at[0] - other[0]) > _APART for other in some):
                some.append(tuple(int(k) for k in at))
        return some

    def _at_peace(self, fit: Fit) -> bool:
        """Whether all inliers are consistent at the present noise levels."""
        stats = believed_statistics(self.problem, fit.optimum, fit.marginal, fit.selection, fit.noise)
        count = self.problem.stations
        return all(
            float(getattr(stats, kind).max(initial=0)) < limit(count, dof, _MANY)
            for kind, dof in _DEGREES.items()
        )

    def _external(self, fit: Fit, kind: str) -> FloatArray:
        """Held-out statistic of each excluded measurement over its limit, at the noise levels of the inliers."""
        count = self.problem.stations
        wheels, joints = fit.components["wheel_rad_per_sqrt_rad"], fit.components["joint_rad"]
        if kind == "legs":
            statistic = doubted_legs(fit.optimum, fit.marginal)
            redundancy = self._known_by("wheel_rad_per_sqrt_rad", wheels.redundancy)
        elif kind == "views":
            statistic, _ = doubted_views(self.problem, fit.optimum, fit.marginal, fit.selection, fit.noise)
            redundancy = self._known_by("joint_rad", wheels.redundancy + joints.redundancy)
        else:
            statistic = doubted_readings(fit.optimum, fit.marginal, fit.noise)
            redundancy = self._known_by("joint_rad", joints.redundancy)
        return np.asarray(statistic / limit(count, _DEGREES[kind], redundancy))

    def _known_by(self, level: str, redundancy: float) -> float:
        """Effective number of residuals behind a noise level: very large for a given level."""
        return _MANY if level in self._fitter.given else redundancy + guess_worth(redundancy)

    def swapped(self, fit: Fit) -> Fit | None:
        """A fit with a station's images restored and an adjacent leg excluded instead: a slip resembles both."""
        selection, legs = fit.selection, self.problem.legs
        for station in np.flatnonzero(~selection.views):
            beside = np.flatnonzero((legs == station).any(axis=1))
            neighbours = np.setdiff1d(legs[beside], [station])
            if len(beside) == 2 and selection.legs[beside].all() and selection.views[neighbours].all():
                continue  # both adjacent legs are consistent, so the outlier is this station's images
            for slipped in beside:
                views, driven = selection.views.copy(), selection.legs.copy()
                views[station], driven[beside], driven[slipped] = True, True, False
                without = replace(selection, legs=driven)
                try:
                    trial = self._fitter.refit(fit, without)
                    off, _ = doubted_views(self.problem, trial.optimum, trial.marginal, without, trial.noise)
                    if off[station] > limit(self.problem.stations, 6, _CONSENSUS_REDUNDANCY):
                        continue
                    trial = self._fitter.refit(trial, replace(without, views=views))
                except SolveError:
                    continue
                if self._at_peace(trial):
                    return self._fitter.levelled(trial)
        return None

    def decided(self, fit: Fit) -> Fit | None:
        """A fit with measurements restored or excluded; None if no change is needed."""
        selection = fit.selection
        wheels, joints = fit.components["wheel_rad_per_sqrt_rad"], fit.components["joint_rad"]
        back = self._view_back(fit, self._known_by("joint_rad", wheels.redundancy + joints.redundancy))
        if back is not None:
            return self._levelled(fit, back)
        if not selection.legs.all():
            agreeing = self._some(np.argwhere(~selection.legs & (self._external(fit, "legs") < 1)))
            if agreeing:
                return self._levelled(fit, _changed(selection, "legs", agreeing, believed=True))
        for _, kind, places in self._candidates(fit):
            without = _changed(selection, kind, places, believed=False)
            if without.views.sum() < _FEWEST_VIEWS:
                continue
            try:
                trial = self._levelled(fit, without)
                beyond = self._external(trial, kind)
                wrong = [at for at in places if beyond[at] > 1]
                if wrong and len(wrong) < len(places):
                    trial = self._levelled(trial, _changed(selection, kind, wrong, believed=False))
            except SolveError:
                continue  # the remaining measurements do not determine the parameters
            if wrong:
                return trial
        return None

    def _levelled(self, fit: Fit, selection: Selection) -> Fit:
        """A fit of another selection with estimated noise levels, starting from an earlier fit."""
        return self._fitter.levelled(self._fitter.fit(fit.optimum.state, selection, fit.noise))


def _changed(selection: Selection, kind: str, places: list[tuple[int, ...]], believed: bool) -> Selection:
    """The selection with some measurements of a kind included or excluded."""
    values = getattr(selection, kind).copy()
    for at in places:
        values[at] = believed
    return replace(selection, **{kind: values})
