"""Maximum-likelihood estimate from all measurements: robust, with noise levels from the residuals."""

from __future__ import annotations

import logging
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.errors import SolveError
from mobilecal_cli.kinematics import motion_seen
from mobilecal_cli.likelihood import jumps, nuisance
from mobilecal_cli.likelihood.board_corners import KIND as CORNERS
from mobilecal_cli.likelihood.board_corners import corner_modes
from mobilecal_cli.likelihood.dataset import Dataset, dataset_of
from mobilecal_cli.likelihood.measurements import MotionPairs
from mobilecal_cli.likelihood.noise import Inliers
from mobilecal_cli.likelihood.observability import Directions, directions
from mobilecal_cli.likelihood.posterior import Posterior
from mobilecal_cli.likelihood.priors import Priors
from mobilecal_cli.likelihood.processes import LENGTHS
from mobilecal_cli.likelihood.residual_tests import limit
from mobilecal_cli.likelihood.state import State, cameras_at
from mobilecal_cli.model import NINE, Extraction, FloatArray, Noise, Parameters
from mobilecal_cli.solvers import outliers
from mobilecal_cli.solvers.consensus import consensus
from mobilecal_cli.solvers.constraints import Constraints
from mobilecal_cli.solvers.fit import Fit
from mobilecal_cli.solvers.initial import initial_state, initial_with_prior, linear_estimate
from mobilecal_cli.solvers.linear import FEW_ROUNDS, InitialPrior, Rounds, ratios_of
from mobilecal_cli.solvers.noise import (
    UNIFORM,
    Component,
    LevelSearch,
    components,
    converged,
    estimated,
    lengths,
    widths,
)
from mobilecal_cli.solvers.optimize import NEAR, optimize, proposed

_LOG = logging.getLogger(__name__)
_MOST_DECISIONS = 60
_CORNER_ROUNDS = 4
NO_SQUARE = 0.1  # prior sigma of the squares' size where none is stated: the baseline gives the scale
_NOISE_ROUNDS, _NOISE_FITS = 60, 20
_OBSERVABILITY_ROUNDS = 8
#: A jump is significant beyond the first; beyond the second it is tested at noise levels of its own.
JUMP_SIGMAS, _CANDIDATE_SIGMAS = 4.0, 0.5
#: Scale of priors beyond which the outliers are decided again.
_CLEARLY_WIDER = 1.5
_STILL = 1e-9  # rad, m: a fixed value of the right camera follows the stereo pair no more


@dataclass(frozen=True, slots=True)
class Tolerances:
    """Accuracy of a fit.

    Attributes:
        levels: relative tolerance of the noise levels that are found to first order; after a fit, `_HELD` times it.
        near: end of an optimization, see `optimize`.
    """

    levels: float
    near: float


_COARSE, _QUICK = Tolerances(0.1, NEAR), Tolerances(0.1, 1e-3)
FINE = Tolerances(0.015, NEAR)
_HELD = 2.0


def dataset_for(extraction: Extraction, constraints: Constraints, data: Dataset) -> Dataset:
    """The measurements, with all constants that they can show under the priors of rig.yaml and of the user.

    Raises:
        ConfigError: see `Constraints.check`.
    """
    rig = extraction.rig
    described = nuisance.table(rig.cameras, rig.chain)
    rows = (*described, *corner_modes(data, described))
    constraints.check([row.name for row in rows], rig.nominal)
    sigmas = dict(rig.prior_sigmas)
    if extraction.board.square_m is None:
        sigmas["square_scale"] = NO_SQUARE
    sigmas |= dict.fromkeys(nuisance.names_of(constraints.constants, rows), math.inf)
    sigmas |= {name: sigma for name, (_, sigma) in constraints.priors.items()}
    sigmas |= dict.fromkeys(constraints.fixed, math.inf)
    offered = (row for row in rows if row.effect.offered(data))
    return data.with_constants(tuple(nuisance.with_priors(offered, sigmas)))


class Solver:
    """The recipe for one extraction under the user's constraints and priors.

    `data` has the measurements of the extraction, if they were gathered before.
    """

    def __init__(
        self,
        extraction: Extraction,
        constraints: Constraints,
        on_step: Callable[[], None] = lambda: None,
        data: Dataset | None = None,
    ) -> None:
        self._on_step = on_step
        self._constraints = constraints
        self.data = dataset_for(extraction, constraints, data or dataset_of(extraction))
        pairs = self.data.pairs
        self.motion = motion_seen(pairs.T_v_h, pairs.steps.totals_rad, self.data.encoder_step_rad)
        nominal, fixed = extraction.rig.nominal, constraints.fixed
        T_h_c = None
        if nominal.T_h_reference is not None:
            T_h_c = nominal.T_h_reference @ se3.inverse(extraction.rig.cameras.T_c_reference)
        self.nominal = InitialPrior(T_h_c, nominal.wheels, all(name in fixed for name in NINE[:6]))
        self._scales_stay = False
        self._levels = extraction.rig.noise.given
        self.given = frozenset(self._levels)
        #: Tolerances while outliers are searched for.
        self.coarse = _QUICK if self.data.stations >= outliers.LONG_RECORDING else _COARSE
        self._guess = Noise(
            **Noise.limits("guess") | {"encoder_rad": float(self.data.encoder_step_rad.max()) * UNIFORM},
            wider={},
        )

    # -- initial parameters -----------------------------------------------------------------------

    @property
    def full_motion(self) -> bool:
        """Whether the motion shows all nine, so that the linear method applies as it is."""
        motion = self.motion
        return motion.tilts and motion.turns and motion.drives and not self.nominal.head_eye_fixed

    def initial(self) -> Parameters:
        """Linear parameters from all legs."""
        if self.full_motion:
            return linear_estimate(self.data.pairs, self.nominal.wheels).parameters
        return initial_with_prior(self.data.pairs, self.nominal, self.motion)

    def initial_of(self, pairs: MotionPairs, near: Parameters) -> Parameters:
        """Linear parameters from a few legs, from parameters that are nearly right."""
        if self.full_motion:
            return Rounds(pairs).after(ratios_of(near.wheels), FEW_ROUNDS)
        return initial_with_prior(pairs, self.nominal, self.motion)

    # -- priors -----------------------------------------------------------------------------------

    def _anchor(self, present: Parameters) -> Parameters:
        """Where displacements count from: nominal values where there are any, the present ones otherwise."""
        T_h_c, wheels = self.nominal.T_h_c, self.nominal.wheels
        return Parameters(present.T_h_c if T_h_c is None else T_h_c, wheels or present.wheels)

    def _user_weight(self, priors: Priors) -> FloatArray:
        """(P,) inverse variances of the priors that count as measurements: the user's, and the constants'."""
        given = [name in self._constraints.priors for name in NINE]
        return np.where(given + [True] * len(self.data.layout.constants), priors.weight, 0.0)

    def priors(self, state: State, unobservable: FloatArray | None = None) -> Priors:
        """Priors from nominal values and from the user, and what the user fixed.

        Values of the head-eye transform are those of the reference camera. Displacements are the left camera's: the
        right one's differ from them as far as the state's stereo pair differs from the stated one.

        Args:
            state: where displacements count from without a nominal value, and the stereo pair.
            unobservable: (K, 9) directions that keep their prior.
        """
        layout, anchor = self.data.layout, self._anchor(state.parameters)
        scales = layout.prior_sigmas(anchor.wheels)
        stated, cameras = self.data.cameras.T_c_reference, cameras_at(self.data, state)
        meant = anchor.seen_from(stated)
        apart = state.parameters.seen_from(cameras.T_c_reference).minus(meant) - state.parameters.minus(
            anchor
        )
        origin = np.concatenate([np.zeros(3), meant.vector[3:], np.zeros(len(layout.constants))])
        has_prior = np.ones(layout.size, dtype=np.bool_)
        has_prior[:6], has_prior[6:9] = self.nominal.T_h_c is not None, self.nominal.wheels is not None
        mean, weight = np.zeros(layout.size), np.where(has_prior, scales**-2, 0.0)
        for name, (value, sigma) in self._constraints.priors.items():
            if name in layout.names:  # one of several recordings may not show a constant
                k = layout.names.index(name)
                mean[k], weight[k] = value - origin[k], sigma**-2
        fixed = np.array([name in self._constraints.fixed for name in layout.names])
        for k in np.flatnonzero(fixed).tolist():
            exact = self._constraints.fixed[layout.names[k]]
            mean[k], weight[k] = 0.0 if exact is None else exact - origin[k], 0.0
        mean[: len(NINE)] -= apart
        kinds = {row.name: row.kind for row in layout.constants}
        alike = [
            kinds.get(name, CORNERS) != CORNERS and name not in self._constraints.priors
            for name in layout.names
        ]
        kept = np.zeros((0, len(NINE))) if unobservable is None else unobservable
        return Priors(layout, anchor, mean, weight, fixed, scales, kept, np.array(alike), {})

    def _require_nominal(self, unobservable: FloatArray) -> None:
        """Refuse to keep the prior of a parameter that has none.

        Raises:
            SolveError: naming the parameters and what is missing.
        """
        names = NINE
        needed = {names[k] for k in np.flatnonzero(np.abs(unobservable).max(axis=0, initial=0.0) > 0.3)}
        missing = []
        if self.nominal.T_h_c is None and needed & set(NINE[:6]):
            missing.append("nominal.head_eye")
        if self.nominal.wheels is None and needed & set(NINE[6:]):
            missing.append("nominal.wheels")
        if missing:
            fixable = sorted(needed - {*NINE[:3]})  # rotations are relative to the nominal one
            other = f", use --fix {fixable[0]}=VALUE" if fixable else ""
            raise SolveError(
                f"no nominal value ({', '.join(missing)}) for unobservable parameters: "
                f"{', '.join(n for n in names if n in needed)}",
                f"set {' and '.join(missing)} in rig.yaml{other}, or record the missing motion",
            )

    # -- fits -------------------------------------------------------------------------------------

    def first_noise(self, own_px: FloatArray) -> Noise:
        """Supposed levels: given ones, the corners' own scatter, and a guess."""
        return self._guess.with_levels({"pixel_px": max(float(np.median(own_px)), 1e-3), **self._levels})

    def fit(self, state: State, inliers: Inliers, noise: Noise, tolerances: Tolerances | None = None) -> Fit:
        """Optimize. Unobservable directions keep their prior; repeated until these directions do not change.

        Args:
            state: where to start.
            inliers, noise: the measurements that are used, and their noise.
            tolerances: `coarse` by default.
        """
        start = Posterior.at(self.data, state, inliers, noise, self.priors(state))
        return self._fit_from(start, (tolerances or self.coarse).near)

    def _fit_from(self, start: Posterior, near: float) -> Fit:
        for _ in range(_OBSERVABILITY_ROUNDS):
            user = self._user_weight(start.priors)
            unobservable = directions(start, user).unobservable
            self._require_nominal(unobservable)
            priors = self.priors(start.state, unobservable)
            optimum = optimize(start.under(priors), near, self._on_step)
            shown = directions(optimum.lin, user)
            again = self.priors(optimum.lin.state, unobservable)
            still = bool(np.all(np.abs(again.mean - priors.mean)[priors.fixed] < _STILL))
            if _same_space(shown.unobservable, unobservable) and still:
                break
            start = optimum.lin.under(self.priors(optimum.lin.state))
        return self._fitted(optimum.lin, optimum.history, shown)

    def refit(self, fit: Fit, inliers: Inliers) -> Fit:
        """Optimize coarsely from a fit with other inliers and the same unobservable directions."""
        start = Posterior.at(self.data, fit.lin.state, inliers, fit.noise, fit.lin.priors)
        optimum = optimize(start, self.coarse.near, self._on_step)
        return self._fitted(optimum.lin, optimum.history, fit.directions)

    def _fitted(self, lin: Posterior, costs: FloatArray, shown: Directions) -> Fit:
        return Fit(lin, costs, components(lin), shown, self.given)

    def refit_near(self, fit: Fit, inliers: Inliers) -> Fit:
        """A fit of other inliers, with noise levels of its own, to first order: residuals follow the parameters.

        Raises:
            SolveError: a singular matrix.
        """
        lin = fit.lin.with_inliers(inliers)
        lin = lin.predicted(proposed(lin)[0])
        lin, shown, _ = self._levels_near(lin, components(lin), self.coarse.levels)
        return replace(fit, lin=lin, components=shown)

    def estimate_noise(self, fit: Fit, tolerances: Tolerances | None = None) -> Fit:
        """Estimate noise levels and parameters in turn until the levels converge; `coarse` by default."""
        tolerances = tolerances or self.coarse
        fitted = self.coarse.near <= tolerances.near
        for _ in range(_NOISE_FITS):
            _, _, noise = self._levels_near(fit.lin, fit.components, tolerances.levels)
            if fitted and converged(fit.noise, noise, _HELD * tolerances.levels):
                break
            lin = fit.lin.with_noise(noise).renewed()
            fit = self._fit_from(lin.under(self.priors(lin.state)), tolerances.near)
            fitted = True
        return fit

    def jump(self, fit: Fit) -> jumps.Jump | None:
        """The jump inside a recording that explains the residuals best; None where none is significant.

        What looks like one is tested at the noise levels of the residuals without it.
        """
        jump = jumps.likeliest(fit.lin)
        if jump is None or jump.sigmas < _CANDIDATE_SIGMAS:
            return None
        lin = jumps.without(fit.lin, jump)
        lin = lin.predicted(proposed(lin)[0])
        lin, _, _ = self._levels_near(lin, components(lin), self.coarse.levels, frozenset(LENGTHS))
        jump = jumps.again(lin, jump)
        return jump if jump.sigmas > JUMP_SIGMAS and jumps.lasts(lin, jump) else None

    def _levels_near(
        self,
        lin: Posterior,
        shown: Mapping[str, Component],
        tolerance: float,
        kept: frozenset[str] = frozenset(),
    ) -> tuple[Posterior, Mapping[str, Component], Noise]:
        """Noise levels that agree with the residuals, which follow the parameters to first order.

        Args:
            lin, shown: where to start, and what its residuals show.
            tolerance: relative.
            kept: names of levels that stay, beside those that are given.

        Returns:
            The last point, what its residuals show, and the levels that follow from them.
        """
        given = self.given | kept
        search = LevelSearch(given)
        for _ in range(_NOISE_ROUNDS):
            noise = estimated(lin.noise, shown, given, self._guess)
            wider = lin.noise.wider if self._scales_stay else widths(lin)
            noise = replace(noise, **lengths(lin, given, self._guess), wider=wider)
            if converged(lin.noise, noise, tolerance):
                break
            lin = lin.with_noise(search.next(lin.noise, noise))
            lin = lin.predicted(proposed(lin)[0])
            shown = components(lin)
        return lin, shown, noise

    # -- outliers ---------------------------------------------------------------------------------

    def _restored(self, fit: Fit) -> Fit:
        """Restore measurements consistent with the inliers: legs first, as a bad station breaks both of its legs."""
        for _ in range(2 * len(self.data.legs)):
            legs = None if fit.inliers.legs.all() else outliers.consistent_legs(fit)
            if legs is None:
                break
            fit = self.refit(fit, replace(fit.inliers, legs=legs))
        for _ in range(self.data.stations):
            again = outliers.restored_views(fit, outliers.CONSENSUS_REDUNDANCY)
            if again is None:
                break
            fit = self.refit(fit, again)
        return self.fit(fit.lin.state, fit.inliers, fit.noise)

    def _swapped(self, fit: Fit) -> Fit | None:
        """A fit with a station's images restored and a leg beside it rejected instead: a slip looks like both."""
        inliers, legs = fit.inliers, self.data.legs
        for station in np.flatnonzero(~inliers.views & outliers.usable(fit)):
            beside = np.flatnonzero((legs == station).any(axis=1))
            neighbors = np.setdiff1d(legs[beside], [station])
            if len(beside) == 2 and inliers.legs[beside].all() and inliers.views[neighbors].all():
                continue  # two legs from used stations agree about this one: its images are wrong
            for slipped in beside:
                views, driven = inliers.views.copy(), inliers.legs.copy()
                views[station], driven[beside], driven[slipped] = True, True, False
                without = replace(inliers, legs=driven)
                try:
                    trial = self.refit(fit, without)
                    off, _ = trial.tests.predicted_views
                    if off[station] > limit(self.data.stations, 6, outliers.CONSENSUS_REDUNDANCY):
                        continue
                    trial = self.refit(trial, replace(without, views=views))
                except SolveError:
                    continue
                if outliers.worst(trial) < 1.0:
                    return self.estimate_noise(trial)
        return None

    def decided(self, fit: Fit) -> Fit | None:
        """A fit with measurements restored or rejected; None where all are consistent."""
        inliers = fit.inliers
        back = outliers.restored_views(fit, outliers.known_by(fit, "views"))
        if back is not None:
            return self._refitted(fit, back)
        for kind in ("legs", "readings"):
            out = ~getattr(inliers, kind)
            agreeing = (
                outliers.some_of(self.data, kind, np.argwhere(out & (outliers.external(fit, kind) < 1)))
                if out.any()
                else []
            )
            if agreeing:
                return self._refitted(fit, outliers.changed(inliers, kind, agreeing, to=True))
        for _, kind, places in outliers.candidates(fit):
            without = outliers.changed(inliers, kind, places, to=False)
            if without.views.sum() < outliers.FEWEST_VIEWS:
                continue
            try:
                beyond = outliers.external(self.refit_near(fit, without), kind)
                wrong = [at for at in places if beyond[at] > 1]
                if not wrong:
                    continue
                trial = self._refitted(fit, outliers.changed(inliers, kind, wrong, to=False))
                beyond = outliers.external(trial, kind)
            except SolveError:
                continue  # the other measurements alone do not determine all parameters
            if any(beyond[at] > 1 for at in wrong):
                return trial
        return None

    def _refitted(self, fit: Fit, inliers: Inliers) -> Fit:
        """A fit of other inliers, from where an earlier one ended, with noise levels of its own."""
        return self.estimate_noise(self.fit(fit.lin.state, inliers, fit.noise))

    # -- the recipe -------------------------------------------------------------------------------

    def solve(self, start: Parameters | None = None) -> Fit:
        """Outliers under the stated priors, then the scales of the priors, and a fine fit at the end.

        Where scales are clearly above 1, the outliers are decided again under these scales: from the beginning, if
        there were any.
        """
        self._scales_stay = True  # a gross error of a measurement must not look like a wrong description
        fit = self._without_outliers(start or self.initial(), {})
        self._scales_stay = False
        supposed = self.first_noise(
            np.array([fit.noise.pixel_px])
        )  # levels that a wrong description made large
        fit = self.estimate_noise(self.fit(fit.lin.state, fit.inliers, supposed))
        wider = fit.noise.wider
        if max(wider.values(), default=1.0) > _CLEARLY_WIDER:
            self._scales_stay = True
            everything = fit.inliers.same(Inliers.all_of(self.data))
            fit = (
                self._decided(fit) if everything else self._without_outliers(fit.lin.state.parameters, wider)
            )
            self._scales_stay = False
        noisy = outliers.too_many(fit)
        fit = self._with_all(fit, noisy) if noisy else fit
        return replace(self.estimate_noise(fit, FINE), noisy=noisy)

    def _without_outliers(self, initial: Parameters, wider: Mapping[str, float]) -> Fit:
        """Initial fit, noise levels and outliers, for some scales of the priors."""
        data = self.data
        everything = Inliers.all_of(data)
        state = initial_state(data, initial, everything)
        corners, boards, own_px = outliers.gross_corners(data, state)
        noise = replace(self.first_noise(own_px), wider=wider)
        inliers = replace(everything, corners=corners, views=boards)
        fit = self._first_fit(initial, noise, inliers)
        return self._decided(self._corners_restored(self.estimate_noise(fit)))

    def _decided(self, fit: Fit) -> Fit:
        """The fit after all decisions on outliers that follow from it."""
        before: list[Inliers] = [fit.inliers]
        for _ in range(_MOST_DECISIONS):
            again = self.decided(fit) or self._swapped(fit)
            if again is None or any(again.inliers.same(other) for other in before):
                break
            before.append(again.inliers)
            fit = again
        return fit

    def _corners_restored(self, fit: Fit) -> Fit:
        """The fit with corners restored that fit the board in the estimated cameras: the stated ones may be wrong."""
        for _ in range(_CORNER_ROUNDS):
            if np.array_equal(fit.inliers.corners, fit.data.seen):
                break
            corners, _, _ = outliers.gross_corners(fit.data, fit.lin.state)
            restored = fit.inliers.corners | (corners & fit.inliers.corners.any(axis=2, keepdims=True))
            if np.array_equal(restored, fit.inliers.corners):
                break
            inliers = replace(fit.inliers, corners=restored)
            fit = self._refitted(fit, inliers)
        return fit

    def _with_all(self, fit: Fit, noisy: tuple[str, ...]) -> Fit:
        """A fit of all measurements of some kinds: so many outliers are noise, larger than supposed."""
        all_of = Inliers.all_of(fit.data)
        inliers = replace(fit.inliers, **{kind: getattr(all_of, kind) for kind in noisy})
        _LOG.info("more than a third of the %s are outliers: taken as noise", " and ".join(noisy))
        return self._refitted(fit, inliers)

    def _first_fit(self, initial: Parameters, noise: Noise, inliers: Inliers) -> Fit:
        """A fit of all measurements, or of those on which most legs agree if all together are implausible."""
        failure: SolveError | None = None
        fit: Fit | None = None
        try:
            state = initial_state(self.data, initial, Inliers.all_of(self.data))
            fit = self.fit(state, inliers, noise)
            if outliers.plausible(fit) or not len(self.data.legs):  # no legs that could agree
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
        data = self.data
        agreed = consensus(data, initial, noise, lambda pairs: self.initial_of(pairs, initial))
        inflated = {
            name: getattr(noise, name) * agreed.noise_factor
            for name in ("wheel_rad_per_sqrt_rad", "joint_rad")
            if name not in self.given
        }
        noise = replace(noise, **inflated)
        legs = ~agreed.bad
        touched = np.zeros((data.stations, 2), dtype=np.int64)
        for (i, j), good in zip(data.legs, legs, strict=True):
            touched[[i, j], int(good)] += 1
        lonely = (touched[:, 0] > 0) & (touched[:, 1] == 0)
        inliers = replace(inliers, legs=legs, views=inliers.views & ~lonely)
        state = initial_state(data, agreed.parameters, inliers)
        return self._restored(self.fit(state, inliers, noise))


def _same_space(a: FloatArray, b: FloatArray) -> bool:
    """Whether two sets of orthonormal rows span nearly the same space."""
    if len(a) != len(b):
        return False
    return not len(a) or bool(np.linalg.svd(a @ b.T)[1].min() > 0.999)


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
