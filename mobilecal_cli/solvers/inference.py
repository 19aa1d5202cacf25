"""Fits of one extraction to given inliers: parameters, noise levels and scales of the priors, found together."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from mobilecal_cli.errors import SolveError
from mobilecal_cli.kinematics import MotionSeen, head_eye_words, motion_seen, unseen_height
from mobilecal_cli.likelihood import jumps
from mobilecal_cli.likelihood.budget import expected_gradient
from mobilecal_cli.likelihood.constants import FEW_PLACES, PATTERNS, clocks_of, floors_of, table, with_priors
from mobilecal_cli.likelihood.dataset import Dataset, Inliers, dataset_of
from mobilecal_cli.likelihood.patterns import patterns
from mobilecal_cli.likelihood.posterior import Posterior, directions
from mobilecal_cli.likelihood.priors import Priors
from mobilecal_cli.likelihood.processes import LENGTHS
from mobilecal_cli.likelihood.state import State
from mobilecal_cli.model.arrays import FloatArray, IntArray
from mobilecal_cli.model.calibration import NINE, WHEEL_WORDS, Parameters
from mobilecal_cli.model.findings import MATERIAL_SIGMAS
from mobilecal_cli.model.observations import Extraction
from mobilecal_cli.model.solution import Noise
from mobilecal_cli.solvers import outliers
from mobilecal_cli.solvers.constraints import Constraints
from mobilecal_cli.solvers.fit import LikelihoodFit
from mobilecal_cli.solvers.initial import linear_estimate, linear_with_prior
from mobilecal_cli.solvers.linear import NominalPrior, nominal_of
from mobilecal_cli.solvers.noise import (
    UNIFORM,
    LevelSearch,
    components,
    converged,
    slopes,
    widths,
)
from mobilecal_cli.solvers.optimize import MOST_STEPS, optimize, to_first_order

NO_SQUARE = 0.1  # prior sigma of the squares' size where none is stated: the baseline gives the scale
_NOISE_ROUNDS, _NOISE_FITS = 60, 20
_OBSERVABILITY_ROUNDS = 8
#: A jump is significant beyond the first; beyond the second it is tested at noise levels of its own.
JUMP_SIGMAS, _CANDIDATE_SIGMAS = 3.3, 0.5
_MOST_JUMPS = 3  # that are searched for one after another
_LARGE_STEPS = 6  # to the size of a jump that explains outliers: of a wheel, it is no small one
_SEVERAL = 2  # outliers that a single number explains: one more than it has itself
_UNEXPLAINED, _OF_STRETCH = 0.1, 0.5  # share of their misfit that a jump may leave; of outliers in a row
#: Noise levels that a jump may make large: those of the processes, and others.
_CONCEALING = (*LENGTHS, "joint_rad", "shift_px", "sway_rad", "sway_m", "wheel_rad_per_sqrt_rad")
#: Relative tolerance of noise levels that are found to first order; after a fit, `_HELD` times it.
_COARSE, _FINE, _HELD = 0.1, 0.005, 2.0
_STILL = 1e-9  # rad, m: a fixed value of the reference camera follows the cameras no more


def dataset_for(extraction: Extraction, constraints: Constraints) -> Dataset:
    """The measurements, with all constants that they can show under the priors of rig.yaml and of the user.

    Raises:
        ConfigError: see `Constraints.check`.
    """
    data, rig = dataset_of(extraction), extraction.rig
    described = table(rig.cameras, rig.chain)
    clocks = clocks_of(np.unique(data.log[data.moving])[1:].tolist())
    floors = floors_of(np.flatnonzero(np.bincount(data.log) > FEW_PLACES).tolist())
    rows = (*described, *patterns(data, described), *clocks, *floors)
    constraints.check([row.name for row in rows], rig.nominal)
    sigmas = dict(rig.prior_sigmas)
    if extraction.board.square_m is None:
        sigmas["square_scale"] = NO_SQUARE
    sigmas |= {row.name: math.inf for row in rows if {row.name, row.kind} & {*constraints.constants}}
    sigmas |= {name: sigma for name, (_, sigma) in constraints.priors.items()}
    sigmas |= dict.fromkeys(constraints.fixed, math.inf)
    offered = (row for row in rows if row.effect.offered(data))
    return data.with_constants(tuple(with_priors(offered, sigmas)))


@dataclass(frozen=True, eq=False)
class Inference:
    """One extraction under the user's constraints and priors.

    Attributes:
        data: the measurements, and the constants that are estimated.
        constraints: the user's.
        motion: what joints and wheels move.
        nominal: where the linear method starts from.
        levels: noise levels that rig.yaml states.
        guess: noise levels before the residuals are known.
        scales_stay: the priors of each kind of constants keep their scale.
        on_step: called before each step of an optimization.
    """

    data: Dataset
    constraints: Constraints
    motion: MotionSeen
    nominal: NominalPrior
    levels: Mapping[str, float]
    guess: Noise
    scales_stay: bool
    on_step: Callable[[], None]

    @classmethod
    def of(
        cls,
        extraction: Extraction,
        constraints: Constraints,
        on_step: Callable[[], None] = lambda: None,
    ) -> Inference:
        """That of an extraction.

        Raises:
            ConfigError: a constraint that this robot cannot have.
        """
        data = dataset_for(extraction, constraints)
        head_eye_fixed = all(name in constraints.fixed for name in NINE[:6])
        encoder_rad = float(data.encoder_step_rad.max()) * UNIFORM
        return cls(
            data=data,
            constraints=constraints,
            motion=motion_seen(data.pairs.T_v_h, data.pairs.steps.totals_rad, data.encoder_step_rad),
            nominal=nominal_of(extraction.rig, head_eye_fixed),
            levels=extraction.rig.noise,
            guess=Noise(**Noise.limits("guess") | {"encoder_rad": encoder_rad}, wider={}),
            scales_stay=False,
            on_step=on_step,
        )

    @property
    def given(self) -> frozenset[str]:
        """Names of the noise levels that are not estimated."""
        return frozenset(self.levels)

    # -- initial parameters -----------------------------------------------------------------------

    @property
    def full_motion(self) -> bool:
        """Whether the motion shows all nine, so that the linear method applies as it is."""
        motion = self.motion
        return motion.tilts and motion.turns and motion.drives and not self.nominal.head_eye_fixed

    def initial(self, legs: IntArray | None = None) -> Parameters:
        """Linear parameters from some legs, or from all.

        Raises:
            SolveError: these legs determine none.
        """
        pairs = self.data.pairs if legs is None else self.data.pairs.select(legs)
        if self.full_motion:
            return linear_estimate(pairs, self.nominal.wheels).parameters
        return linear_with_prior(pairs, self.nominal, self.motion)

    # -- priors -------------------------------------------------------------------------------------

    def priors(self, state: State, unobservable: FloatArray | None = None) -> Priors:
        """Priors from nominal values and from the user, and what the user fixed.

        Values of the head-eye transform are those of the reference camera. Displacements are the first camera's: the
        reference camera's differ from them as far as the state's cameras differ from the stated ones.

        Args:
            state: where displacements count from without a nominal value, and the cameras.
            unobservable: (K, 9) directions that keep their prior.
        """
        layout, nominal, present = self.data.layout, self.nominal, state.parameters
        # Displacements count from nominal values where there are any, from the present ones otherwise.
        T_h_c = present.T_h_c if nominal.T_h_c is None else nominal.T_h_c
        anchor = Parameters(T_h_c, nominal.wheels or present.wheels)
        stated = self.data.cameras.T_c_reference
        meant = anchor.seen_from(stated)
        seen = present.seen_from(state.cameras.T_c_reference)
        apart = seen.minus(meant) - present.minus(anchor)
        origin = np.concatenate([np.zeros(3), meant.vector[3:], np.zeros(len(layout.constants))])
        mean, weight = np.zeros(layout.size), layout.prior_sigmas(anchor.wheels) ** -2
        weight[:6] *= nominal.T_h_c is not None
        weight[6:9] *= nominal.wheels is not None
        for name, (value, sigma) in self.constraints.priors.items():
            if name in layout.names:  # one of several recordings may not show a constant
                k = layout.names.index(name)
                mean[k], weight[k] = value - origin[k], sigma**-2
        fixed = np.array([name in self.constraints.fixed for name in layout.names])
        for k in np.flatnonzero(fixed).tolist():
            exact = self.constraints.fixed[layout.names[k]]
            mean[k], weight[k] = 0.0 if exact is None else exact - origin[k], 0.0
        mean[: len(NINE)] -= apart
        alike = [False] * len(NINE) + [
            row.kind not in PATTERNS and row.name not in self.constraints.priors for row in layout.constants
        ]
        kept = np.zeros((0, len(NINE))) if unobservable is None else unobservable
        return Priors(layout, anchor, mean, weight, fixed, kept, np.array(alike), {})

    def _require_nominal(self, unobservable: FloatArray) -> None:
        """Refuse to keep the prior of a parameter that has none, neither a nominal value nor the user's.

        Raises:
            SolveError: naming the parameters and what is missing.
        """
        needed = [
            NINE[k]
            for k in np.flatnonzero(np.abs(unobservable).max(axis=0, initial=0.0) > 0.3)
            if NINE[k] not in self.constraints.priors
        ]
        missing = []
        if self.nominal.T_h_c is None and set(needed) & set(NINE[:6]):
            missing.append("nominal.head_eye")
        if self.nominal.wheels is None and set(needed) & set(NINE[6:]):
            missing.append("nominal.wheels")
        if missing:
            # Rotations are relative to the nominal one.
            fixable = [name for name in needed if name not in NINE[:3]]
            cures = [f"set {' and '.join(missing)} in rig.yaml"]
            cures += [f"use --fix {name}=VALUE or --prior {name}=VALUE±SIGMA" for name in fixable[:1]]
            cures += ["record the missing motion"] * (unseen_height(self.data.chain) is None)
            words = head_eye_words(needed, self.data.chain, self.data.joints)
            of_wheels = zip(NINE[6:], WHEEL_WORDS, strict=True)
            words += [f"the {word}" for name, word in of_wheels if name in needed]
            raise SolveError(
                f"the recording does not show {' and '.join(words)} ({', '.join(needed)}), and "
                f"{' and '.join(missing)} {'is' if len(missing) == 1 else 'are'} not stated",
                ", or ".join(cures),
            )

    # -- fits ---------------------------------------------------------------------------------------

    def first_noise(self, own_px: FloatArray) -> Noise:
        """Supposed levels: given ones, the corners' own scatter, and a guess."""
        return self.guess.with_levels({"pixel_px": max(float(np.median(own_px)), 1e-3), **self.levels})

    def fit(
        self, state: State, inliers: Inliers, noise: Noise, most_steps: int = MOST_STEPS
    ) -> LikelihoodFit:
        """Optimize. Unobservable directions keep their prior; repeated until these do not change."""
        return self._fit_from(Posterior.at(state, inliers, noise, self.priors(state)), most_steps)

    def _fit_from(self, start: Posterior, most_steps: int = MOST_STEPS) -> LikelihoodFit:
        # Priors that count as measurements: the user's, and the constants'.
        nominal = [name in NINE and name not in self.constraints.priors for name in self.data.layout.names]
        for _ in range(_OBSERVABILITY_ROUNDS):
            user = np.where(nominal, 0.0, start.priors.weight)
            _, unobservable = directions(start, user)
            self._require_nominal(unobservable)
            start = _unbiased(start.under(self.priors(start.state, unobservable)))
            lin, costs = optimize(start, self.on_step, most_steps)
            singular_values, hidden = directions(lin, user)
            again = self.priors(lin.state, unobservable)
            still = bool(np.all(np.abs(again.mean - start.priors.mean)[again.fixed] < _STILL))
            if _same_space(hidden, unobservable) and still:
                break
            start = lin.under(self.priors(lin.state))
        return LikelihoodFit(lin, costs, components(lin), singular_values, self.given)

    def refit(self, fit: LikelihoodFit, inliers: Inliers) -> LikelihoodFit:
        """Optimize from a fit with other inliers and the same unobservable directions."""
        start = Posterior.at(fit.lin.state, inliers, fit.noise, fit.lin.priors)
        lin, costs = optimize(start, self.on_step)
        return replace(fit, lin=lin, costs=costs, components=components(lin))

    def refit_near(self, fit: LikelihoodFit, inliers: Inliers) -> LikelihoodFit:
        """A fit of other inliers, with noise levels of its own, to first order: residuals follow the parameters.

        Raises:
            SolveError: a singular matrix.
        """
        lin = to_first_order(fit.lin.with_inliers(inliers))
        lin, _ = self._levels_near(lin)
        return replace(fit, lin=lin, components=components(lin))

    def estimate_noise(self, fit: LikelihoodFit, fine: bool = False) -> LikelihoodFit:
        """Estimate noise levels and parameters in turn until the levels converge.

        The priors' scales stay in a round in which they lead to where the first order does not hold, and more is left
        over than there was: what it leaves out looks like a contradiction of what hardly shows, such as the height of a
        joint on a floor that is level.
        """
        tolerance = _FINE if fine else _COARSE
        for _ in range(_NOISE_FITS):
            near, noise = self._levels_near(fit.lin, tolerance)
            if converged(fit.noise, noise, _HELD * tolerance):
                break
            start = fit.lin.with_noise(noise).renewed()
            if noise.wider != fit.noise.wider:
                there = start.at(near.state, start.inliers, noise, start.priors)
                if there.cost - near.cost > start.cost:
                    noise = replace(self, scales_stay=True)._levels_near(fit.lin, tolerance)[1]
                    start = fit.lin.with_noise(noise).renewed()
            fit = self._fit_from(start.under(self.priors(start.state)))
        return fit

    def jump(self, fit: LikelihoodFit) -> jumps.ScoredJump | None:
        """The jump that explains the residuals best; None where none is significant.

        One that explains several outliers comes first; an unexplained stretch of them leaves no other to be found.
        What looks like one is tested at the noise levels of the residuals without it. One that does not move the
        result, as of a board that is moved, conceals no other: the next is then searched for without it.
        """
        behind = self._behind_outliers(fit)
        if behind is not None or outliers.longest_stretch(fit) is not None:
            return behind
        found, without, left = None, fit, 0.0
        for _ in range(_MOST_JUMPS):
            further = self._likeliest_jump(without, fit)
            if further is None or further[0].chi2 < left:
                break
            jump, without = further
            if jump.shift_sigmas >= MATERIAL_SIGMAS:
                return jump
            found, left = found or jump, left + jumps.left_by_first_order(fit.lin, jump)
        return found

    def beside(self, fit: LikelihoodFit, jump: jumps.ScoredJump) -> LikelihoodFit:
        """The fit of the images on one side of a jump, where there are more: what contradicts them is no jump.

        Wheels without images contradict nothing. The fit of all where one side alone does not determine the rest.
        """
        was, after = fit.inliers, jumps.stations_after(fit.lin, jump.station)
        kept = after if was.views[after].sum() > was.views[~after].sum() else ~after
        across = ~kept[self.data.legs].all(axis=1)
        try:
            one_side = self.refit(fit, replace(was, views=was.views & kept, legs=was.legs | across))
            return self.estimate_noise(one_side)
        except (SolveError, np.linalg.LinAlgError):
            return fit

    def _likeliest_jump(
        self, fit: LikelihoodFit, written: LikelihoodFit
    ) -> tuple[jumps.ScoredJump, LikelihoodFit] | None:
        """The likeliest jump and the fit without it; of parts that explain about the same, the worst one."""
        # Noise levels that a jump has made large conceal it: it shows at the usual ones. Which part explains most is
        # then compared at the levels of the residuals without it.
        usual = {name: min(getattr(fit.noise, name), getattr(self.guess, name)) for name in _CONCEALING}
        noise = fit.noise.with_levels({name: usual[name] for name in usual.keys() - self.given})
        inliers, start = fit.inliers, jumps.traced(fit.lin)
        for _ in range(2):
            # The score test is that of an optimum: what little is left to it looks like a jump of what hardly shows.
            optimum = to_first_order(start.with_inliers(inliers).with_noise(noise))
            ranked = jumps.likeliest(optimum)
            across = self.data.legs[:, 1] == ranked[0].station if ranked else np.zeros_like(inliers.legs)
            if not inliers.legs[across].all():  # it may be no slip, but what the jump is along the floor
                inliers = replace(inliers, legs=inliers.legs | across)
                optimum = to_first_order(optimum.with_inliers(inliers))
                ranked = jumps.likeliest(optimum)
            ranked = [jump for jump in ranked if jumps.lasts(optimum, jump)]
            if not ranked or ranked[0].sigmas < _CANDIDATE_SIGMAS:
                return None
            lin = to_first_order(jumps.without(optimum, ranked[0]))
            lin, _ = self._levels_near(lin, kept=frozenset(LENGTHS.values()))
            jump = jumps.again(lin, ranked[0])
            if jump.sigmas < _CANDIDATE_SIGMAS:
                return None
            noise = lin.noise
        uneven = to_first_order(lin.with_noise(self._uneven(noise)))
        if min(jump.sigmas, jumps.again(uneven, jump).sigmas) < JUMP_SIGMAS:
            return None
        jump = replace(jump, sigmas=jumps.significance(start, lin, jump))
        if jump.sigmas < JUMP_SIGMAS:
            return None
        points = [(jump, lin)]
        for other in jumps.alike(ranked):
            past = to_first_order(jumps.without(optimum, other))
            points.append((replace(jumps.again(past, other), sigmas=jump.sigmas, also=jump.part), past))
        worst = max((_sized(written, *point) for point in points), key=lambda each: each.shift_sigmas)
        return worst, replace(fit, lin=lin)

    def _uneven(self, noise: Noise) -> Noise:
        """Levels of a floor that is no flatter than usual: one that steps once looks like a board that moves."""
        names = {"floor_rad", "floor_m"} - self.given
        return noise.with_levels(
            {name: max(getattr(noise, name), getattr(self.guess, name)) for name in names}
        )

    def _behind_outliers(self, fit: LikelihoodFit) -> jumps.ScoredJump | None:
        """The jump with which most outliers of a recording, several, fit the others.

        All measurements on one side of a large one look like outliers: of a wheel, all legs look like slips. Without
        the legs beside outlier stations, the images agree better; the jump then explains these measurements, and what
        misfit they bring. It explains few of those that are scattered over the recording.
        """
        was = fit.inliers
        images = replace(
            was,
            views=was.views | outliers.usable(fit),
            readings=np.ones_like(was.readings),
            legs=fit.sure_legs,
        )
        everything = replace(fit, lin=fit.lin.with_inliers(replace(images, legs=np.ones_like(was.legs))))
        every = outliers.restored(was, everything)
        if every.max() < _SEVERAL:
            return None
        try:
            lin = to_first_order(jumps.traced(self.refit(fit, images).lin).with_inliers(everything.inliers))
            jump = next((each for each in jumps.likeliest(lin) if jumps.lasts(lin, each)), None)
            if jump is None:
                return None
            corners, legs = (
                getattr(lin.inliers, kind).sum() - getattr(was, kind).sum()
                for kind in ("used_corners", "legs")
            )
            good = fit.lin.cost + 2 * int(corners) + 3 * int(legs)
            misfit, optimum = lin.cost - good, lin
            for _ in range(_LARGE_STEPS):
                lin = to_first_order(jumps.without(optimum, jump, large=True))
                jump = jumps.again(lin, jump)
            most = _UNEXPLAINED if outliers.longest_stretch(fit) is None else _OF_STRETCH
            if lin.cost - good > most * misfit:
                return None
            jump, without = _sized(fit, jump, lin), replace(fit, lin=lin)
        except (SolveError, np.linalg.LinAlgError):
            return None  # the images alone do not fit, or do not determine all parameters
        log = self.data.log[jump.station]
        explained = outliers.restored(was, without, everything)[log]
        return jump if explained >= max(_SEVERAL, (every[log] + 1) / 2) else None

    def _levels_near(
        self, lin: Posterior, tolerance: float = _COARSE, kept: frozenset[str] = frozenset()
    ) -> tuple[Posterior, Noise]:
        """Noise levels that agree with the residuals, which follow the parameters to first order.

        Args:
            lin: where to start.
            tolerance: relative.
            kept: names of levels that stay, beside those that are given.

        Returns:
            The last point, and the levels that follow from its residuals.
        """
        given = self.given | kept
        search = LevelSearch()
        for _ in range(_NOISE_ROUNDS):
            wider = lin.noise.wider if self.scales_stay else widths(lin)
            noise = search.next(lin.noise, slopes(lin, given, self.guess), wider)
            if converged(lin.noise, noise, tolerance):
                break
            lin = to_first_order(lin.with_noise(noise))
        return lin, noise


def _unbiased(lin: Posterior) -> Posterior:
    """The same point with the bias of the sum of squares, see `Priors`, at the optimum that the first order shows."""
    try:
        return lin.under(replace(lin.priors, bias=expected_gradient(to_first_order(lin))))
    except SolveError:
        return lin


def _sized(written: LikelihoodFit, jump: jumps.ScoredJump, lin: Posterior) -> jumps.ScoredJump:
    """A jump with how far it moves the result that is written, from the point without it."""
    return replace(jump, shift_sigmas=jumps.shift(written.lin, written.covariance, lin, jump))


def _same_space(a: FloatArray, b: FloatArray) -> bool:
    """Whether two sets of orthonormal rows span nearly the same space."""
    if len(a) != len(b):
        return False
    return not len(a) or bool(np.linalg.svd(a @ b.T)[1].min() > 0.999)
