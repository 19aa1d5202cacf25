"""Robust maximum-likelihood estimate from all measurements, with noise levels from the residuals."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mobilecal_cli.errors import SolveError
from mobilecal_cli.likelihood.noise import Noise, Selection
from mobilecal_cli.model import Extraction, Parameters
from mobilecal_cli.solvers.asked import Asked
from mobilecal_cli.solvers.consensus import agreed
from mobilecal_cli.solvers.decisions import Decisions
from mobilecal_cli.solvers.fit import FINE, Fit, Fitter
from mobilecal_cli.solvers.placing import state_at
from mobilecal_cli.solvers.robust import gross_corners

_LOG = logging.getLogger(__name__)
_MOST_DECISIONS = 60


class Solver:
    """Robust maximum-likelihood solver for one extraction."""

    def __init__(
        self, extraction: Extraction, asked: Asked, on_step: Callable[[], None] = lambda: None
    ) -> None:
        self._fitter = Fitter(extraction, asked, on_step)
        self._decisions = Decisions(self._fitter)
        self._pose_cov = np.stack([o.T_c_k_cov for o in extraction.observations])

    @property
    def plain(self) -> bool:
        """Whether all nine parameters are observable, so that the plain linear method applies."""
        return self._fitter.plain

    def linear(self) -> Parameters:
        """Linear estimate from all legs."""
        return self._fitter.linear()

    def solve(self, start: Parameters | None = None) -> Fit:
        """Estimate parameters, noise levels and outliers."""
        fitter, decisions = self._fitter, self._decisions
        problem = fitter.problem
        rough = start or fitter.linear()
        T_c_k = fitter.loops.T_c_k
        plain_state = state_at(problem, rough, fitter.loops, Selection.everything(problem))
        sound, boards, own_px = gross_corners(problem, plain_state, T_c_k)
        noise = fitter.first_noise(own_px)
        selection = replace(Selection.everything(problem), corners=sound, views=boards)
        fit = fitter.fit(plain_state, selection, noise)
        if not decisions.sound(fit):
            try:
                fit = self._by_consensus(rough, noise, selection)
            except SolveError as error:
                # The noise levels may be far from the assumed ones, without outliers: estimate them from all data.
                _LOG.info("no consensus among the legs: %s", error.message)
        fit = fitter.levelled(fit)
        before: list[Selection] = [fit.selection]
        for _ in range(_MOST_DECISIONS):
            again = decisions.decided(fit) or decisions.swapped(fit)
            if again is None or any(again.selection.same(other) for other in before):
                break
            before.append(again.selection)
            fit = again
        return fitter.levelled(fit, FINE)

    def _by_consensus(self, rough: Parameters, noise: Noise, selection: Selection) -> Fit:
        """A fit of the consensus legs, with all measurements consistent with it restored."""
        fitter = self._fitter
        found = agreed(fitter.problem, fitter.loops, rough, noise, self._pose_cov, fitter.fit_few(rough))
        louder = {
            name: getattr(noise, name) * found.noise_factor
            for name in ("wheel_rad_per_sqrt_rad", "joint_rad")
            if name not in fitter.given
        }
        noise = replace(noise, **louder)
        legs = ~found.bad
        touched = np.zeros((fitter.problem.stations, 2), dtype=np.int64)
        for (i, j), good in zip(fitter.problem.legs, legs, strict=True):
            touched[[i, j], int(good)] += 1
        lonely = (touched[:, 0] > 0) & (touched[:, 1] == 0)
        selection = replace(selection, legs=legs, views=selection.views & ~lonely)
        state = state_at(fitter.problem, found.parameters, fitter.loops, selection)
        return self._decisions.taken_back(fitter.fit(state, selection, noise))


def maximum_likelihood(
    extraction: Extraction, asked: Asked | None = None, start: Parameters | None = None
) -> Fit:
    """Robust maximum-likelihood fit of all parameters.

    Args:
        extraction: at least four observations.
        asked: constraints, priors and additional parameters.
        start: initial estimate; the linear solution by default.

    Raises:
        SolveError: did not converge, or a parameter to be fixed has no nominal value.
    """
    return Solver(extraction, asked or Asked()).solve(start)
