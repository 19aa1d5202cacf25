"""Which measurements are believed: what is left out, what is taken back, one by one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import chdtri

from mobilecal_cli.errors import SolveError
from mobilecal_cli.likelihood.noise import Selection
from mobilecal_cli.model import BoolArray, FloatArray
from mobilecal_cli.solvers.fit import Fit, Fitter
from mobilecal_cli.solvers.robust import (
    believed_statistics,
    doubted_legs,
    doubted_readings,
    doubted_views,
    limit,
)
from mobilecal_cli.solvers.variance import guess_worth

ROUGH = 0.1  # how well the noise levels are to stand while decisions are made
_CONSENSUS_REDUNDANCY = 20.0  # of the noise that the agreeing legs show
_MANY = 1e6
_DEGREES = {"readings": 1, "legs": 3, "views": 6}
_STRIKING = 0.2  # chance that any sound measurement of a kind is looked at more closely
_FEWEST_VIEWS = 4
_LOUD = 4.0  # noise this many times (in variance) above what is supposed makes a consensus worth its time


class Decisions:
    """Judges fits of one extraction."""

    def __init__(self, fitter: Fitter) -> None:
        self._fitter = fitter
        self.problem = fitter.problem

    def sound(self, fit: Fit) -> bool:
        """Whether a first fit of everything, with supposed noise, shows nothing odd."""
        stats = believed_statistics(self.problem, fit.optimum, fit.marginal, fit.selection, fit.noise)
        bound = 1.0 if self._fitter.given >= set(fit.components) else _LOUD
        views = stats.views.max(initial=0) / limit(self.problem.stations, 6, 1e6)
        legs = stats.legs.max(initial=0) / limit(self.problem.stations, 3, 1e6)
        readings = stats.readings.max(initial=0) / limit(self.problem.stations, 1, 1e6)
        return bool(max(views, legs, readings) < bound and fit.selection.views.all())

    def taken_back(self, fit: Fit) -> Fit:
        """Believe again what agrees with the rest: legs first, for a bad station breaks both of its legs."""
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
        """Legs with those believed again that agree; None where none does.

        Legs along a stretch where no picture is believed agree with anything one by one, until the last of them
        closes the stretch: only one of them is taken at a time.
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
        """The selection with a station's pictures believed again, as read or with one reading doubted instead."""
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

    def _candidates(self, fit: Fit) -> list[tuple[float, str, tuple[int, ...]]]:
        """Believed measurements that stand out, the most striking first: (by how much, kind, index)."""
        stats = believed_statistics(self.problem, fit.optimum, fit.marginal, fit.selection, fit.noise)
        found = []
        for kind, dof in _DEGREES.items():
            values = getattr(stats, kind)
            at = np.unravel_index(int(np.argmax(values)), values.shape)
            usual = float(chdtri(dof, _STRIKING / values.size))
            found.append((float(values[at]) / usual, kind, tuple(int(k) for k in at)))
        return sorted((item for item in found if item[0] > 1), reverse=True)

    def _at_peace(self, fit: Fit) -> bool:
        """Whether nothing that is believed stands out, at the present noise."""
        stats = believed_statistics(self.problem, fit.optimum, fit.marginal, fit.selection, fit.noise)
        count = self.problem.stations
        return all(
            float(getattr(stats, kind).max(initial=0)) < limit(count, dof, _MANY)
            for kind, dof in _DEGREES.items()
        )

    def _external(self, fit: Fit, kind: str, at: tuple[int, ...]) -> float:
        """How far beyond its limit a measurement is that a fit does not believe; the noise is that of the others."""
        count = self.problem.stations
        wheels, joints = fit.components["wheel_rad_per_sqrt_rad"], fit.components["joint_rad"]
        if kind == "legs":
            statistic = doubted_legs(fit.optimum, fit.marginal)[at]
            redundancy = self._known_by("wheel_rad_per_sqrt_rad", wheels.redundancy)
        elif kind == "views":
            statistic = doubted_views(self.problem, fit.optimum, fit.marginal, fit.selection, fit.noise)[0][
                at
            ]
            redundancy = self._known_by("joint_rad", wheels.redundancy + joints.redundancy)
        else:
            statistic = doubted_readings(fit.optimum, fit.marginal, fit.noise)[at]
            redundancy = self._known_by("joint_rad", joints.redundancy)
        return float(statistic) / limit(count, _DEGREES[kind], redundancy)

    def _known_by(self, level: str, redundancy: float) -> float:
        """How many residuals a noise level rests on: very many where it is given."""
        return _MANY if level in self._fitter.given else redundancy + guess_worth(redundancy)

    def swapped(self, fit: Fit) -> Fit | None:
        """A station's pictures believed again with one leg beside it left out instead: a slip looks like both."""
        selection, legs = fit.selection, self.problem.legs
        for station in np.flatnonzero(~selection.views):
            beside = np.flatnonzero((legs == station).any(axis=1))
            neighbours = np.setdiff1d(legs[beside], [station])
            if len(beside) == 2 and selection.legs[beside].all() and selection.views[neighbours].all():
                continue  # two legs from stations in sight agree about this one: they speak against its pictures
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
                    return self._fitter.levelled(trial, ROUGH)
        return None

    def decided(self, fit: Fit) -> Fit | None:
        """One more measurement taken back or left out; None where all is well."""
        selection = fit.selection
        wheels, joints = fit.components["wheel_rad_per_sqrt_rad"], fit.components["joint_rad"]
        back = self._view_back(fit, self._known_by("joint_rad", wheels.redundancy + joints.redundancy))
        if back is not None:
            return self._fitter.levelled(self._fitter.fit(fit.optimum.state, back, fit.noise), ROUGH)
        for leg in np.flatnonzero(~selection.legs):
            if self._external(fit, "legs", (int(leg),)) < 1:
                legs = selection.legs.copy()
                legs[leg] = True
                again = self._fitter.fit(fit.optimum.state, replace(selection, legs=legs), fit.noise)
                return self._fitter.levelled(again, ROUGH)
        for _, kind, at in self._candidates(fit):
            believed = getattr(selection, kind).copy()
            believed[at] = False
            changed = replace(selection, **{kind: believed})
            if changed.views.sum() < _FEWEST_VIEWS:
                continue
            try:
                trial = self._fitter.levelled(self._fitter.fit(fit.optimum.state, changed, fit.noise), ROUGH)
            except SolveError:
                continue  # without it the rest hangs on too little
            if self._external(trial, kind, at) > 1:
                return trial
        return None
