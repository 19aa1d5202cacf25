"""Maximum of the likelihood for given inliers: noise levels, observability, optimization."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.errors import SolveError
from mobilecal_cli.kinematics import motion_seen
from mobilecal_cli.likelihood import jumps, nuisance
from mobilecal_cli.likelihood.board_corners import KIND as CORNERS
from mobilecal_cli.likelihood.board_corners import corner_modes
from mobilecal_cli.likelihood.dataset import Dataset, MotionPairs, dataset_of
from mobilecal_cli.likelihood.linearization import Linearization
from mobilecal_cli.likelihood.noise import Inliers
from mobilecal_cli.likelihood.observability import Directions
from mobilecal_cli.likelihood.priors import Priors
from mobilecal_cli.likelihood.processes import LENGTHS
from mobilecal_cli.likelihood.state import State, cameras_at
from mobilecal_cli.model import NINE, BetweenLogs, Extraction, FloatArray, Noise, Parameters
from mobilecal_cli.solvers.constraints import Constraints
from mobilecal_cli.solvers.initial import initial_with_prior, linear_estimate
from mobilecal_cli.solvers.linear import FEW_ROUNDS, InitialPrior, few_rounds, ratios_of
from mobilecal_cli.solvers.noise import (
    UNIFORM,
    Component,
    LevelSearch,
    components,
    converged,
    estimated,
    guess_worth,
    lengths,
    widths,
)
from mobilecal_cli.solvers.optimize import NEAR, optimize, proposed

NO_SQUARE = 0.1  # prior sigma of the squares' size where none is stated: the baseline gives the scale
_NOISE_ROUNDS, _NOISE_FITS = 60, 20
_GUESS_FREEDOM = 4.0  # a guessed level's variance is uncertain like that of so many residuals and two
#: Levels whose effects differ little, each with the other.
_PAIRS = (("floor_rad", "sway_rad"), ("floor_m", "sway_m"), ("wheel_rad_per_sqrt_rad", "wheel_share"))
_ALIKE = dict(_PAIRS) | {b: a for a, b in _PAIRS}
_OBSERVABILITY_ROUNDS = 8
#: A jump is significant beyond the first; beyond the second it is tested at noise levels of its own.
JUMP_SIGMAS, _CANDIDATE_SIGMAS = 4.0, 0.5
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


#: From so many stations on, decisions are made a few at a time, from fits that are 0.03 standard deviations off: so
#: that their cost does not grow with the recording.
LONG_RECORDING = 100
_COARSE, _QUICK = Tolerances(0.1, NEAR), Tolerances(0.1, 1e-3)
FINE = Tolerances(0.015, NEAR)
_HELD = 2.0


@dataclass(frozen=True, eq=False)
class Fit:
    """A maximum of the likelihood.

    Attributes:
        lin: the likelihood there.
        costs: (n,) sums of squares of the optimization, from its start on.
        components: what each noise level rests on.
        directions: what the data show.
        given: names of the noise levels that are not estimated.
        noisy: kinds of measurements whose many outliers were taken as noise.
        between: the recordings one by one, where there are several.
        pooled_covariance: (P, P) covariance that allows for the spread between recordings.
    """

    lin: Linearization
    costs: FloatArray
    components: Mapping[str, Component]
    directions: Directions
    given: frozenset[str]
    noisy: tuple[str, ...] = ()
    between: BetweenLogs | None = None
    pooled_covariance: FloatArray | None = None

    @property
    def data(self) -> Dataset:
        """The measurements."""
        return self.lin.data

    @property
    def inliers(self) -> Inliers:
        """The measurements that are used."""
        return self.lin.inliers

    @property
    def noise(self) -> Noise:
        """The noise levels."""
        return self.lin.noise

    @cached_property
    def covariance(self) -> FloatArray:
        """(P, P) of the shared parameters, wider than the bound where the noise levels rest on few residuals.

        A variance that r residuals show is itself uncertain: its mean is r / (r - 2) times what they show. So much
        wider is the share of each kind of noise; at most 3 / 2, as a guess is right within a factor of about 1.6. The
        residuals of two levels that act alike show their sum.
        """
        considered, pooled = self.lin.considered, self.pooled_covariance
        covariance = self.lin.covariance.copy() if pooled is None else pooled + considered @ considered.T
        for influence in self.lin.influences:
            for level in influence.parts:
                component = self.components.get(level)
                if component is not None and level not in self.given:
                    alike = self.components.get(_ALIKE.get(level, ""))
                    redundancy = component.redundancy + (alike.redundancy if alike else 0.0)
                    rests_on = redundancy + guess_worth(redundancy)
                    covariance += influence.covariance(level) * 2 / max(rests_on - 2, _GUESS_FREEDOM)
        return covariance


def dataset_for(extraction: Extraction, constraints: Constraints, data: Dataset) -> Dataset:
    """The measurements, with all constants that they can show under the priors of rig.yaml and of the user.

    Raises:
        ConfigError: see `Constraints.check`.
    """
    rig = extraction.rig
    rows = (*nuisance.table(rig.cameras, rig.chain), *corner_modes(data))
    constraints.check([row.name for row in rows], rig.nominal)
    sigmas = dict(rig.prior_sigmas)
    if extraction.board.square_m is None:
        sigmas["square_scale"] = NO_SQUARE
    sigmas |= dict.fromkeys(nuisance.names_of(constraints.constants, rows), math.inf)
    sigmas |= {name: sigma for name, (_, sigma) in constraints.priors.items()}
    sigmas |= dict.fromkeys(constraints.fixed, math.inf)
    offered = (row for row in rows if row.effect.offered(data))
    return data.with_constants(tuple(nuisance.with_priors(offered, sigmas)))


class Fitter:
    """Fits of one extraction under the user's constraints and priors.

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
        self._levels = extraction.rig.noise.given
        self.given = frozenset(self._levels)
        #: Tolerances while outliers are searched for.
        self.coarse = _QUICK if self.data.stations >= LONG_RECORDING else _COARSE
        self._guess = Noise(
            **Noise.limits("guess") | {"encoder_rad": float(self.data.encoder_step_rad.max()) * UNIFORM},
            wider={},
        )

    # -- initial parameters -----------------------------------------------------------------------

    @property
    def full_motion(self) -> bool:
        """Whether the motion shows all nine, so that the linear method applies as it is."""
        seen = self.motion
        return seen.tilts and seen.turns and seen.drives and not self.nominal.head_eye_fixed

    def initial(self) -> Parameters:
        """Linear parameters from all legs."""
        if self.full_motion:
            return linear_estimate(self.data.pairs, self.nominal.wheels).parameters
        return initial_with_prior(self.data.pairs, self.nominal, self.motion)

    def initial_of(self, pairs: MotionPairs, near: Parameters) -> Parameters:
        """Linear parameters from a few legs, from parameters that are nearly right."""
        if self.full_motion:
            return few_rounds(pairs, ratios_of(near.wheels), FEW_ROUNDS)
        return initial_with_prior(pairs, self.nominal, self.motion)

    # -- priors -----------------------------------------------------------------------------------

    def _anchor(self, found: Parameters) -> Parameters:
        """Where displacements count from: nominal values where there are any, the present ones otherwise."""
        T_h_c, wheels = self.nominal.T_h_c, self.nominal.wheels
        return Parameters(found.T_h_c if T_h_c is None else T_h_c, wheels or found.wheels)

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

    # -- the recipe -------------------------------------------------------------------------------

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
        start = Linearization.at(self.data, state, inliers, noise, self.priors(state))
        return self._fit_from(start, (tolerances or self.coarse).near)

    def _fit_from(self, start: Linearization, near: float) -> Fit:
        for _ in range(_OBSERVABILITY_ROUNDS):
            user = self._user_weight(start.priors)
            unobservable = start.observable_directions(user).unobservable
            self._require_nominal(unobservable)
            priors = self.priors(start.state, unobservable)
            optimum = optimize(start.under(priors), near, self._on_step)
            shown = optimum.lin.observable_directions(user)
            again = self.priors(optimum.lin.state, unobservable)
            still = bool(np.all(np.abs(again.mean - priors.mean)[priors.fixed] < _STILL))
            if _same_space(shown.unobservable, unobservable) and still:
                break
            start = optimum.lin.under(self.priors(optimum.lin.state))
        return self._fitted(optimum.lin, optimum.history, shown)

    def refit(self, fit: Fit, inliers: Inliers) -> Fit:
        """Optimize coarsely from a fit with other inliers and the same unobservable directions."""
        start = Linearization.at(self.data, fit.lin.state, inliers, fit.noise, fit.lin.priors)
        optimum = optimize(start, self.coarse.near, self._on_step)
        return self._fitted(optimum.lin, optimum.history, fit.directions)

    def _fitted(self, lin: Linearization, costs: FloatArray, shown: Directions) -> Fit:
        return Fit(lin, costs, components(lin), shown, self.given)

    def refit_near(self, fit: Fit, inliers: Inliers) -> Fit:
        """A fit of other inliers, with noise levels of its own, to first order: residuals follow the parameters.

        Raises:
            SolveError: a singular matrix.
        """
        lin = fit.lin.with_inliers(inliers)
        lin = lin.predicted(proposed(lin)[0])
        lin, found, _ = self._levels_near(lin, components(lin), self.coarse.levels)
        return replace(fit, lin=lin, components=found)

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
        found = jumps.likeliest(fit.lin)
        if found is None or found.sigmas < _CANDIDATE_SIGMAS:
            return None
        lin = jumps.without(fit.lin, found)
        lin = lin.predicted(proposed(lin)[0])
        lin, _, _ = self._levels_near(lin, components(lin), self.coarse.levels, frozenset(LENGTHS))
        found = jumps.again(lin, found)
        return found if found.sigmas > JUMP_SIGMAS and jumps.lasts(lin, found) else None

    def _levels_near(
        self,
        lin: Linearization,
        found: Mapping[str, Component],
        tolerance: float,
        kept: frozenset[str] = frozenset(),
    ) -> tuple[Linearization, Mapping[str, Component], Noise]:
        """Noise levels that agree with the residuals, which follow the parameters to first order.

        Args:
            lin, found: where to start, and what its residuals show.
            tolerance: relative.
            kept: names of levels that stay, beside those that are given.

        Returns:
            The last point, what its residuals show, and the levels that follow from them.
        """
        given = self.given | kept
        search = LevelSearch(given)
        for _ in range(_NOISE_ROUNDS):
            noise = estimated(lin.noise, found, given, self._guess)
            noise = replace(noise, **lengths(lin, given, self._guess), wider=widths(lin))
            if converged(lin.noise, noise, tolerance):
                break
            lin = lin.with_noise(search.next(lin.noise, noise))
            lin = lin.predicted(proposed(lin)[0])
            found = components(lin)
        return lin, found, noise


def _same_space(a: FloatArray, b: FloatArray) -> bool:
    """Whether two sets of orthonormal rows span nearly the same space."""
    if len(a) != len(b):
        return False
    return not len(a) or bool(np.linalg.svd(a @ b.T)[1].min() > 0.999)
