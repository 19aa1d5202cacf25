"""Maximum-likelihood estimate from all measurements: robust, with noise levels from the residuals."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from mobilecal_cli.errors import SolveError
from mobilecal_cli.likelihood.dataset import Dataset
from mobilecal_cli.likelihood.noise import Inliers
from mobilecal_cli.model import Extraction, Noise, Parameters
from mobilecal_cli.solvers.consensus import consensus
from mobilecal_cli.solvers.constraints import Constraints
from mobilecal_cli.solvers.corners import gross_corners
from mobilecal_cli.solvers.fit import FINE, Fit, Fitter
from mobilecal_cli.solvers.initial_state import initial_state
from mobilecal_cli.solvers.outliers import OutlierSearch

_LOG = logging.getLogger(__name__)
_MOST_DECISIONS = 60
_CORNER_ROUNDS = 4


class Solver:
    """The recipe for one extraction."""

    def __init__(
        self,
        extraction: Extraction,
        constraints: Constraints,
        on_step: Callable[[], None] = lambda: None,
        data: Dataset | None = None,
    ) -> None:
        self._extraction, self._constraints, self._on_step = extraction, constraints, on_step
        self._fitter = Fitter(extraction, constraints, on_step, data)
        self._search = OutlierSearch(self._fitter)

    @property
    def fitter(self) -> Fitter:
        """The fits that the recipe is made of."""
        return self._fitter

    @property
    def data(self) -> Dataset:
        """The measurements."""
        return self._fitter.data

    @property
    def full_motion(self) -> bool:
        """Whether the motion shows all nine, so that the linear method applies as it is."""
        return self._fitter.full_motion

    def initial(self) -> Parameters:
        """Linear parameters from all legs."""
        return self._fitter.initial()

    def solve(self, start: Parameters | None = None) -> Fit:
        """Initial fit, noise levels, outliers, and a fine fit at the end."""
        fitter, search = self._fitter, self._search
        data = fitter.data
        initial = start or fitter.initial()
        everything = Inliers.all_of(data)
        state = initial_state(data, initial, everything)
        corners, boards, own_px = gross_corners(data, state)
        noise = fitter.first_noise(own_px)
        inliers = replace(everything, corners=corners, views=boards)
        fit = self._first_fit(initial, noise, inliers)
        fit = self._corners_restored(fitter.estimate_noise(fit))
        before: list[Inliers] = [fit.inliers]
        for _ in range(_MOST_DECISIONS):
            again = search.decided(fit) or search.swapped(fit)
            if again is None or any(again.inliers.same(other) for other in before):
                break
            before.append(again.inliers)
            fit = again
        noisy = search.too_many(fit)
        fit = self._with_all(fit, noisy) if noisy else fit
        return replace(fitter.estimate_noise(fit, FINE), noisy=noisy)

    def _corners_restored(self, fit: Fit) -> Fit:
        """The fit with corners restored that fit the board in the estimated cameras: the stated ones may be wrong."""
        for _ in range(_CORNER_ROUNDS):
            if np.array_equal(fit.inliers.corners, fit.data.seen):
                break
            corners, _, _ = gross_corners(fit.data, fit.lin.state)
            restored = fit.inliers.corners | (corners & fit.inliers.corners.any(axis=2, keepdims=True))
            if np.array_equal(restored, fit.inliers.corners):
                break
            inliers = replace(fit.inliers, corners=restored)
            fit = self._fitter.estimate_noise(self._fitter.fit(fit.lin.state, inliers, fit.noise))
        return fit

    def _with_all(self, fit: Fit, noisy: tuple[str, ...]) -> Fit:
        """A fit of all measurements of some kinds: so many outliers are noise, larger than supposed."""
        all_of = Inliers.all_of(fit.data)
        inliers = replace(fit.inliers, **{kind: getattr(all_of, kind) for kind in noisy})
        _LOG.info("more than a third of the %s are outliers: taken as noise", " and ".join(noisy))
        return self._fitter.estimate_noise(self._fitter.fit(fit.lin.state, inliers, fit.noise))

    def _first_fit(self, initial: Parameters, noise: Noise, inliers: Inliers) -> Fit:
        """A fit of all measurements, or of those on which most legs agree if all together are implausible."""
        fitter = self._fitter
        failure: SolveError | None = None
        fit: Fit | None = None
        try:
            state = initial_state(fitter.data, initial, Inliers.all_of(fitter.data))
            fit = fitter.fit(state, inliers, noise)
            if self._search.plausible(fit) or not len(fitter.data.legs):  # no legs that could agree
                return fit
        except SolveError as error:
            failure = error
        try:
            return self._by_consensus(initial, noise, inliers)
        except SolveError as error:
            # Noise far above the supposed one, and no outliers: all measurements, with noise levels to match.
            _LOG.info("no consensus of legs: %s", error.message)
        if fit is None:
            assert failure is not None
            raise failure
        return fit

    def _by_consensus(self, initial: Parameters, noise: Noise, inliers: Inliers) -> Fit:
        """A fit of the legs that agree, with all measurements restored that are consistent with it."""
        fitter = self._fitter
        data = fitter.data
        found = consensus(data, initial, noise, lambda pairs: fitter.initial_of(pairs, initial))
        inflated = {
            name: getattr(noise, name) * found.noise_factor
            for name in ("wheel_rad_per_sqrt_rad", "joint_rad")
            if name not in fitter.given
        }
        noise = replace(noise, **inflated)
        legs = ~found.bad
        touched = np.zeros((data.stations, 2), dtype=np.int64)
        for (i, j), good in zip(data.legs, legs, strict=True):
            touched[[i, j], int(good)] += 1
        lonely = (touched[:, 0] > 0) & (touched[:, 1] == 0)
        inliers = replace(inliers, legs=legs, views=inliers.views & ~lonely)
        state = initial_state(data, found.parameters, inliers)
        return self._search.restore(fitter.fit(state, inliers, noise))


def maximum_likelihood(
    extraction: Extraction, constraints: Constraints | None = None, start: Parameters | None = None
) -> Fit:
    """Solve for all parameters by maximum likelihood.

    Args:
        extraction: at least four observations.
        constraints: fixed parameters, priors, and constants to estimate.
        start: where to start; the linear solution by default.

    Raises:
        SolveError: not converged, or an unobservable parameter without a nominal value.
    """
    return Solver(extraction, constraints or Constraints()).solve(start)
