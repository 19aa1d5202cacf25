"""Maximum-likelihood estimate from all measurements: robust, with noise levels from the residuals."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace

import numpy as np

from mobilecal_cli.errors import SolveError
from mobilecal_cli.likelihood.dataset import Dataset
from mobilecal_cli.likelihood.evidence import equivalent_sigmas
from mobilecal_cli.likelihood.noise import Inliers, Noise
from mobilecal_cli.model import Evidence, Extraction, Parameters
from mobilecal_cli.solvers.consensus import consensus
from mobilecal_cli.solvers.constraints import Constraints
from mobilecal_cli.solvers.corners import gross_corners
from mobilecal_cli.solvers.fit import FINE, Fit, Fitter
from mobilecal_cli.solvers.initial_state import initial_state
from mobilecal_cli.solvers.outliers import OutlierSearch

_LOG = logging.getLogger(__name__)
_MOST_DECISIONS = 60
#: Data that contradict stated constants by more than this are evidence of a wrong description.
CONTRADICTION_SIGMAS = 4.0
#: From so many contradictions on, the description as a whole is less exact than its priors say.
SEVERAL_CONTRADICTIONS = 2
_MOST_CONTRADICTIONS = 10
#: A kind of constants, all parts together, that is less probable than this gets the prior that its scatter suggests.
_DOUBTFUL_SIGMAS = 3.0
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

    def solve_with_wider_priors(self, start: Parameters) -> tuple[Fit, tuple[Evidence, ...]]:
        """A solution whose priors are wide enough for the data, and the stated constants that the data contradict.

        As long as the data contradict the stated values of a group of constants, its priors are widened to what was
        found, also those of the same kind in other parts, which come from the same drawing or calibration, and
        everything is solved again. Where several groups are contradicted, the priors of all others are widened too, by
        the scatter of what the data say of them; at the end, also those of a kind that is improbable as a whole, though
        none of its parts is contradicted.
        """
        found, sigmas = list[Evidence](), dict(self._extraction.rig.prior_sigmas)
        fit = self.solve(start)
        while len(found) < _MOST_CONTRADICTIONS:
            evidence = tuple(fit.lin.evidence())
            told = {(e.kind, e.part) for e in found if e.values.keys() <= self._constraints.priors.keys()}
            untold = (e for e in evidence if (e.kind, e.part) not in told)
            worst = max(untold, key=lambda e: e.sigmas, default=None)
            if worst is None or worst.sigmas < CONTRADICTION_SIGMAS:
                break
            found.append(worst)
            if worst.values.keys() <= self._constraints.priors.keys():
                continue  # the user's own priors stay
            rows = {row.name: row.sigma for row in fit.data.layout.constants}
            wider = max(math.sqrt(worst.chi2 / len(worst.values)), CONTRADICTION_SIGMAS)
            alike = (e for e in evidence if e.kind == worst.kind)
            sigmas |= {name: rows[name] * wider for e in alike for name in e.values}
            if len(found) >= SEVERAL_CONTRADICTIONS:
                widened = {e.kind for e in found}
                others = [e for e in evidence if e.kind not in widened]
                common = math.sqrt(sum(e.chi2 for e in others) / max(1, sum(e.dof for e in others)))
                sigmas |= {name: rows[name] * max(1.0, common) for e in others for name in e.values}
            fit = self._solved_again(fit, sigmas)
        doubtful = _doubtful(fit.lin.evidence())
        wide = {
            row.name: row.sigma * doubtful[row.kind]
            for row in fit.data.layout.constants
            if row.kind in doubtful
        }
        if wide:
            fit = self._solved_again(fit, sigmas | wide)
        return fit, tuple(found)

    def _solved_again(self, fit: Fit, sigmas: Mapping[str, float]) -> Fit:
        """A solution under other priors, from where an earlier one ended."""
        rig = replace(self._extraction.rig, prior_sigmas=sigmas)
        solver = Solver(replace(self._extraction, rig=rig), self._constraints, self._on_step, fit.data)
        return solver.solve(fit.lin.state.parameters)

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


def _doubtful(evidence: Iterable[Evidence]) -> dict[str, float]:
    """Kind of constants → how much its priors are too narrow, where the data say so."""
    sums: dict[str, tuple[float, int]] = {}
    for each in evidence:
        chi2, dof = sums.get(each.kind, (0.0, 0))
        sums[each.kind] = (chi2 + each.chi2, dof + each.dof)
    return {
        kind: math.sqrt(chi2 / dof)
        for kind, (chi2, dof) in sums.items()
        if dof and equivalent_sigmas(chi2, dof) > _DOUBTFUL_SIGMAS
    }


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
