"""Which measurements are outliers: rejected and restored one by one, in long recordings a few at a time."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import chdtri

from mobilecal_cli.errors import SolveError
from mobilecal_cli.likelihood.noise import Inliers
from mobilecal_cli.likelihood.residual_tests import ResidualTests, limit
from mobilecal_cli.model import BoolArray, FloatArray, IntArray
from mobilecal_cli.solvers.fit import LONG_RECORDING, Fit, Fitter
from mobilecal_cli.solvers.noise import guess_worth

_CONSENSUS_REDUNDANCY = 20.0  # of the noise level that the consensus legs show
_MANY = 1e6
_DEGREES = {"readings": 1, "legs": 3, "views": 6}
_STRIKING = 0.2  # chance that any good measurement of a kind becomes a candidate
_FEWEST_VIEWS = 4
_TOO_MANY = 1 / 3  # outliers among the measurements of a kind: that kind's noise is larger than supposed
# Measurements that are judged at once, one more for every `LONG_RECORDING` stations, lie so many stations apart that
# none is mistaken for another.
_APART = 5
_MUCH = 4.0  # a first fit with statistics beyond this many times their limit calls for a consensus


#: Noise levels that decide where a measurement of each kind is expected, the one that counts most first.
_JUDGED_BY = {
    "views": ("pose_scale", "joint_rad", "wheel_rad_per_sqrt_rad"),
    "legs": ("pose_scale", "wheel_rad_per_sqrt_rad"),
    "readings": ("joint_rad",),
}


class OutlierSearch:
    """Judges fits of one extraction."""

    def __init__(self, fitter: Fitter) -> None:
        self._fitter = fitter
        self._data = fitter.data

    def _worst(self, tests: ResidualTests) -> float:
        """Largest statistic of an inlier over its limit, for known noise levels."""
        count = self._data.stations
        return max(
            float(getattr(tests, kind).max(initial=0)) / limit(count, dof, _MANY)
            for kind, dof in _DEGREES.items()
        )

    def plausible(self, fit: Fit) -> bool:
        """Whether a first fit of everything, with supposed noise, shows no gross outlier."""
        bound = 1.0 if self._fitter.given >= set(fit.components) else _MUCH
        return self._worst(fit.lin.tests) < bound and bool(fit.inliers.views.all())

    def _all_consistent(self, fit: Fit) -> bool:
        """Whether no inlier stands out at the present noise levels."""
        return self._worst(fit.lin.tests) < 1.0

    def restore(self, fit: Fit) -> Fit:
        """Restore measurements consistent with the inliers: legs first, as a bad station breaks both of its legs."""
        for _ in range(2 * len(self._data.legs)):
            out = ~fit.inliers.legs
            if not out.any():
                break
            statistic = np.where(out, fit.lin.tests.predicted_legs, np.inf)
            legs = self._consistent_legs(fit.inliers, statistic)
            if legs is None:
                break
            fit = self._fitter.refit(fit, replace(fit.inliers, legs=legs))
        for _ in range(self._data.stations):
            again = self._restored_views(fit, _CONSENSUS_REDUNDANCY)
            if again is None:
                break
            fit = self._fitter.refit(fit, again)
        return self._fitter.fit(fit.lin.state, fit.inliers, fit.noise)

    def _consistent_legs(self, inliers: Inliers, statistic: FloatArray) -> BoolArray | None:
        """Inlier legs with consistent ones restored; None where there is none.

        Along a stretch without a used image, legs agree with anything one by one, until the last of them closes the
        stretch: only one of them is restored at a time.
        """
        legs, one_taken = inliers.legs.copy(), False
        for leg in np.argsort(statistic):
            if statistic[leg] > limit(self._data.stations, 3, _CONSENSUS_REDUNDANCY):
                break
            blind = not inliers.views[self._data.legs[leg]].all()
            if not (blind and one_taken):
                legs[leg], one_taken = True, one_taken or blind
        return None if np.array_equal(legs, inliers.legs) else legs

    def _usable(self, inliers: Inliers) -> BoolArray:
        """(N,) stations most of whose corners fit the board's shape."""
        most = inliers.corners.sum(axis=2) >= 0.5 * self._data.seen.sum(axis=2)
        return np.asarray(most.all(axis=1), dtype=np.bool_)

    def _restored_views(self, fit: Fit, redundancy: float) -> Inliers | None:
        """The inliers with a station's images restored, as read or with one joint reading rejected instead."""
        inliers = fit.inliers
        out = ~inliers.views & self._usable(inliers)
        if not out.any():
            return None
        as_read, freed = fit.lin.tests.predicted_views
        near = fit.lin.tests.small_views
        agree = out & (near | (as_read < limit(self._data.stations, 6, redundancy)))
        if agree.any():
            return replace(inliers, views=inliers.views | agree)
        least = np.where(out, freed.min(axis=1, initial=np.inf), np.inf)  # a fixed camera has no joint
        best = int(np.argmin(least))
        if least[best] < limit(self._data.stations, 5, redundancy):
            views, readings = inliers.views.copy(), inliers.readings.copy()
            views[best], readings[best, int(np.argmin(freed[best]))] = True, False
            return replace(inliers, views=views, readings=readings)
        return None

    def _candidates(self, fit: Fit) -> list[tuple[float, str, list[tuple[int, ...]]]]:
        """Inliers that stand out, of each kind the most striking: (by how much, kind, indices)."""
        tests = fit.lin.tests
        found = []
        for kind, dof in _DEGREES.items():
            values = getattr(tests, kind)
            if not values.size:
                continue
            usual = float(chdtri(dof, _STRIKING / values.size))
            striking = np.argwhere(values > usual)
            places = self._some(kind, striking[np.argsort(-values[values > usual], kind="stable")])
            if places:
                found.append((float(values[places[0]]) / usual, kind, places))
        return sorted(found, reverse=True)

    def _some(self, kind: str, places: IntArray) -> list[tuple[int, ...]]:
        """The first of some places of a kind, (n, indices), that are far from one another.

        One of each recording, of long ones a few.
        """
        log = self._data.log[self._data.legs[:, 0]] if kind == "legs" else self._data.log
        left = 1 + np.bincount(self._data.log) // LONG_RECORDING
        some: dict[int, list[tuple[int, ...]]] = {}
        for at in places:
            mine = int(log[at[0]])
            beside = some.setdefault(mine, [])
            if left[mine] and all(abs(at[0] - other[0]) > _APART for other in beside):
                beside.append(tuple(int(k) for k in at))
                left[mine] -= 1
        return [at for beside in some.values() for at in beside]

    def _external(self, fit: Fit, kind: str) -> FloatArray:
        """Statistic of each measurement over its limit, against what all others predict; for outliers of the fit."""
        tests = fit.lin.tests
        statistic = tests.predicted_views[0] if kind == "views" else getattr(tests, f"predicted_{kind}")
        beyond = statistic / limit(self._data.stations, _DEGREES[kind], self._known_by(fit, kind))
        return np.where(getattr(tests, f"small_{kind}"), 0.0, beyond)

    def _known_by(self, fit: Fit, kind: str) -> float:
        """Number of residuals that the noise rests on that a kind is judged by: very many where a level is given."""
        levels = [level for level in _JUDGED_BY[kind] if level in fit.components]
        if levels[0] in self._fitter.given:
            return _MANY
        redundancy = sum(fit.components[level].redundancy for level in levels)
        return redundancy + guess_worth(redundancy)

    def swapped(self, fit: Fit) -> Fit | None:
        """A fit with a station's images restored and a leg beside it rejected instead: a slip looks like both."""
        inliers, legs = fit.inliers, self._data.legs
        for station in np.flatnonzero(~inliers.views & self._usable(inliers)):
            beside = np.flatnonzero((legs == station).any(axis=1))
            neighbors = np.setdiff1d(legs[beside], [station])
            if len(beside) == 2 and inliers.legs[beside].all() and inliers.views[neighbors].all():
                continue  # two legs from used stations agree about this one: its images are wrong
            for slipped in beside:
                views, driven = inliers.views.copy(), inliers.legs.copy()
                views[station], driven[beside], driven[slipped] = True, True, False
                without = replace(inliers, legs=driven)
                try:
                    trial = self._fitter.refit(fit, without)
                    off, _ = trial.lin.tests.predicted_views
                    if off[station] > limit(self._data.stations, 6, _CONSENSUS_REDUNDANCY):
                        continue
                    trial = self._fitter.refit(trial, replace(without, views=views))
                except SolveError:
                    continue
                if self._all_consistent(trial):
                    return self._fitter.estimate_noise(trial)
        return None

    def decided(self, fit: Fit) -> Fit | None:
        """A fit with measurements restored or rejected; None where all are consistent."""
        inliers = fit.inliers
        back = self._restored_views(fit, self._known_by(fit, "views"))
        if back is not None:
            return self._refitted(fit, back)
        if not inliers.legs.all():
            agreeing = self._some("legs", np.argwhere(~inliers.legs & (self._external(fit, "legs") < 1)))
            if agreeing:
                return self._refitted(fit, _changed(inliers, kind="legs", places=agreeing, to=True))
        if not inliers.readings.all():
            agreeing = self._some(
                "readings", np.argwhere(~inliers.readings & (self._external(fit, "readings") < 1))
            )
            if agreeing:
                return self._refitted(fit, _changed(inliers, kind="readings", places=agreeing, to=True))
        for _, kind, places in self._candidates(fit):
            without = _changed(inliers, kind, places, to=False)
            if without.views.sum() < _FEWEST_VIEWS:
                continue
            try:
                beyond = self._external(self._fitter.refit_near(fit, without), kind)
                wrong = [at for at in places if beyond[at] > 1]
                if not wrong:
                    continue
                trial = self._refitted(fit, _changed(inliers, kind, wrong, to=False))
                beyond = self._external(trial, kind)
            except SolveError:
                continue  # the other measurements alone do not determine all parameters
            if any(beyond[at] > 1 for at in wrong):
                return trial
        return None

    def too_many(self, fit: Fit) -> tuple[str, ...]:
        """Kinds of measurements more than a third of which are outliers."""
        used = {kind: getattr(fit.inliers, kind) for kind in _DEGREES}
        return tuple(kind for kind, of in used.items() if np.sum(~of) > _TOO_MANY * of.size)

    def _refitted(self, fit: Fit, inliers: Inliers) -> Fit:
        """A fit of other inliers, from where an earlier one ended, with noise levels of its own."""
        return self._fitter.estimate_noise(self._fitter.fit(fit.lin.state, inliers, fit.noise))


def _changed(inliers: Inliers, kind: str, places: list[tuple[int, ...]], to: bool) -> Inliers:
    """The inliers with some measurements of a kind restored or rejected."""
    values = getattr(inliers, kind).copy()
    for at in places:
        values[at] = to
    return replace(inliers, **{kind: values})
