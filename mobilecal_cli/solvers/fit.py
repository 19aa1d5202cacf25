"""Maximum of the likelihood for a given selection, with noise estimation and fixed unobservable directions."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.errors import SolveError
from mobilecal_cli.likelihood.influence import Influence, influences
from mobilecal_cli.likelihood.marginals import Marginals, marginals
from mobilecal_cli.likelihood.noise import Noise, Selection
from mobilecal_cli.likelihood.observability import Directions, directions
from mobilecal_cli.likelihood.problem import Problem, State, problem_of
from mobilecal_cli.likelihood.shared import EXTRA_NAMES
from mobilecal_cli.likelihood.system import eliminated
from mobilecal_cli.model import NINE, BetweenLogs, Extraction, FloatArray, Parameters, WheelGeometry
from mobilecal_cli.solvers.asked import Asked
from mobilecal_cli.solvers.descent import NEAR, Optimum, Ties, descend, terms_before
from mobilecal_cli.solvers.linear import linear_estimate, linear_from
from mobilecal_cli.solvers.loops import Loops, closed_loops
from mobilecal_cli.solvers.start import Known, motion_seen, pulled_start
from mobilecal_cli.solvers.variance import (
    GUESS,
    UNIFORM,
    Component,
    components,
    estimated,
    guess_worth,
    settled,
)

_NOISE_ROUNDS = 60
_OBSERVABILITY_ROUNDS = 4


@dataclass(frozen=True, slots=True)
class Care:
    """Tolerances of a fit.

    Attributes:
        levels: relative tolerance of the noise levels, after which the last fit follows.
        enough: relative tolerance of the noise levels at which no further fit is needed; None: always do a last fit.
        near: tolerance of the optimization, see `descend`.
    """

    levels: float
    enough: float | None
    near: float


#: From this number of stations on, several outlier decisions are made at once, from fits accurate to 0.03 standard
#: deviations, to limit the computing time.
LONG_LOG = 100
_ROUGH, _QUICK = Care(levels=0.1, enough=None, near=NEAR), Care(levels=0.1, enough=0.02, near=1e-3)
FINE = Care(levels=0.01, enough=None, near=NEAR)


@dataclass(frozen=True, eq=False)
class Fit:
    """Maximum of the likelihood with its selection, noise levels and constraints.

    Attributes:
        problem, selection, noise, ties: the likelihood, its constraints and priors.
        optimum: the maximum.
        marginal: marginal covariances there.
        components: squares and redundancy of each noise level.
        directions: observable and unobservable directions.
        held: (K, named) unobservable directions, which are fixed, in units of the scales.
        given: names of the noise levels that are not estimated.
        between: the estimates of the single recordings, if there are several.
        over_logs: (named, named) covariance that includes the spread between recordings.
    """

    problem: Problem
    selection: Selection
    noise: Noise
    ties: Ties
    optimum: Optimum
    marginal: Marginals
    components: Mapping[str, Component]
    directions: Directions
    held: FloatArray
    given: frozenset[str]
    between: BetweenLogs | None = None
    over_logs: FloatArray | None = None

    def influences(self) -> Iterator[Influence]:
        """Influence of each kind of measurement on the global parameters."""
        return influences(
            self.problem,
            self.optimum.state,
            self.selection,
            self.noise,
            self.optimum.system,
            self.marginal,
            self.optimum.covariance,
        )

    @cached_property
    def covariance(self) -> FloatArray:
        """Covariance of the global parameters, (P, P); larger than the bound if noise levels have few residuals.

        A variance estimated from r residuals is itself uncertain: its mean is r / (r - 2) times the estimate. The
        contribution of each kind of noise is inflated by this factor.
        """
        covariance = self.optimum.covariance.copy()
        if self.over_logs is not None:
            named = len(self.over_logs)
            covariance[:named, :named] = self.over_logs
        for influence in self.influences():
            component = self.components.get(influence.level)
            if component is not None and influence.level not in self.given:
                rests_on = component.redundancy + guess_worth(component.redundancy)
                covariance += influence.covariance * 2 / max(rests_on - 2, 2.0)
        return covariance


def extras_for(extraction: Extraction, asked: Asked) -> tuple[str, ...]:
    """Additional parameters: the requested ones, and the time offsets where stations are not at rest."""
    moving = any(not o.at_rest for o in extraction.observations) and bool(extraction.joint_tracks)
    clocks = ("time_joints", "time_wheels") if moving else ()
    return tuple(name for name in EXTRA_NAMES if name in (*asked.extras, *clocks))


def _anchor(extraction: Extraction, asked: Asked, found: Parameters | None) -> Parameters:
    """Origin of displacements: nominal values if given, the estimate otherwise."""
    nominal, T_c_ref = extraction.rig.nominal, extraction.rig.cameras.T_c_reference
    T_h_c = nominal.T_h_reference @ se3.inverse(T_c_ref) if nominal.T_h_reference is not None else None
    wheels = nominal.wheels
    if found is not None:
        T_h_c = found.T_h_c if T_h_c is None else T_h_c
        wheels = found.wheels if wheels is None else wheels
    if T_h_c is None or wheels is None:
        raise SolveError(
            "a parameter must be fixed at its nominal value, but none is given",
            "set nominal.head_eye and nominal.wheels in rig.yaml, or use --fix NAME=VALUE",
        )
    return Parameters(T_h_c, wheels)


class Fitter:
    """Fits of one extraction under the user's constraints and priors."""

    def __init__(
        self, extraction: Extraction, asked: Asked, on_step: Callable[[], None] = lambda: None
    ) -> None:
        self._on_step = on_step
        self._extraction = extraction
        self._asked = asked
        self.problem = problem_of(extraction, extras_for(extraction, asked))
        self.loops = closed_loops(extraction)
        self.seen = motion_seen(self.loops)
        nominal = extraction.rig.nominal
        fixed = asked.fixed
        T_h_c = None
        if nominal.T_h_reference is not None:
            T_h_c = nominal.T_h_reference @ se3.inverse(extraction.rig.cameras.T_c_reference)
        self.known = Known(T_h_c, nominal.wheels, all(name in fixed for name in NINE[:6]))
        self._levels = extraction.rig.noise.given
        self.given = frozenset(self._levels)
        #: Tolerances while outliers are searched.
        self.rough = _QUICK if self.problem.stations >= LONG_LOG else _ROUGH
        self._guess = replace(GUESS, encoder_rad=self.problem.encoder_step_rad * UNIFORM)

    # -- initial estimate -------------------------------------------------------------------------

    @property
    def plain(self) -> bool:
        """Whether all nine parameters are observable, so that the plain linear method applies."""
        seen = self.seen
        return seen.tilts and seen.turns and seen.drives and not self.known.head_eye_fixed

    def linear(self) -> Parameters:
        """Linear estimate from all legs."""
        if self.plain:
            return linear_estimate(self.loops, self.known.wheels).parameters
        return pulled_start(self.loops, self.known, self.seen)

    def fit_few(self, rough: Parameters) -> Callable[[Loops], Parameters]:
        """Function that estimates the parameters from a subset of the legs."""
        if self.plain:
            return lambda loops: linear_from(loops, rough.wheels)
        return lambda loops: pulled_start(loops, self.known, self.seen)

    # -- constraints and priors -------------------------------------------------------------------

    def ties(self, anchor: Parameters, held: FloatArray) -> Ties:
        """Parameters fixed by the user, the unobservable directions, and the priors."""
        layout = self.problem.layout
        wheels = np.array(
            [anchor.wheels.radius_right_m, anchor.wheels.radius_left_m, anchor.wheels.separation_m]
        )
        scales = layout.scales(wheels)
        origin = np.concatenate([np.zeros(3), anchor.T_h_c[:3, 3], wheels, np.zeros(len(layout.extras))])
        fixed = [n for n in layout.names if n in self._asked.fixed]
        rows, at = [], []
        for name in fixed:
            k, value = layout.names.index(name), self._asked.fixed[name]
            rows.append(np.eye(layout.named)[k])
            at.append(0.0 if value is None else (value - origin[k]) / scales[k])
        prior, weight = np.zeros(layout.named), np.zeros(layout.named)
        for name, (value, sigma) in self._asked.priors.items():
            k = layout.names.index(name)
            prior[k], weight[k] = value - origin[k], sigma**-2
        return Ties(
            anchor,
            np.concatenate([np.array(rows).reshape(-1, layout.named), held]),
            np.concatenate([np.array(at), np.zeros(len(held))]),
            scales,
            prior,
            weight,
        )

    def free(self) -> FloatArray:
        """Unit columns of the parameters that the user did not fix, (named, F)."""
        layout = self.problem.layout
        kept = [k for k, name in enumerate(layout.names) if name not in self._asked.fixed]
        return np.eye(layout.named)[:, kept]

    def shown(self, information: FloatArray, at: WheelGeometry) -> Directions:
        """Observability from the information (P, P) about the global parameters."""
        wheels = np.array([at.radius_right_m, at.radius_left_m, at.separation_m])
        return directions(information, self.problem.layout, wheels, self.free(), len(self.problem.legs))

    # -- fits -------------------------------------------------------------------------------------

    def first_noise(self, own_px: FloatArray) -> Noise:
        """Initial noise levels: given levels, the scatter of the corners, and defaults for the rest."""
        return replace(self._guess, **{"pixel_px": max(float(np.median(own_px)), 1e-3), **self._levels})

    def fit(self, state: State, selection: Selection, noise: Noise, care: Care | None = None) -> Fit:
        """Optimize with unobservable directions fixed, until the set of them is stable; `rough` by default."""
        problem, near = self.problem, (care or self.rough).near
        for _ in range(_OBSERVABILITY_ROUNDS):
            anchor = _anchor(self._extraction, self._asked, state.parameters)
            free = self.ties(anchor, np.zeros((0, problem.layout.named)))
            start = terms_before(problem, state, selection, noise)
            information = eliminated(start).S + np.diag(free.prior_terms(problem, state)[0])
            held = self.shown(information, state.parameters.wheels).hidden
            if len(held) or self._asked.fixed:
                self._require_anchor(held)
            ties = self.ties(anchor, held)
            optimum = descend(start, ties, near, self._on_step)
            state = optimum.state
            again = self.shown(optimum.information, state.parameters.wheels)
            if _same_space(again.hidden, held):
                break
        return self._fitted(optimum, selection, noise, ties, again, held)

    def refit(self, fit: Fit, selection: Selection) -> Fit:
        """Optimize roughly with another selection, from a fit and with the same fixed directions."""
        start = terms_before(self.problem, fit.optimum.state, selection, fit.noise)
        optimum = descend(start, fit.ties, self.rough.near, self._on_step)
        return self._fitted(optimum, selection, fit.noise, fit.ties, fit.directions, fit.held)

    def _fitted(
        self,
        optimum: Optimum,
        selection: Selection,
        noise: Noise,
        ties: Ties,
        shown: Directions,
        held: FloatArray,
    ) -> Fit:
        marginal = marginals(self.problem, optimum.system, optimum.covariance)
        found = components(self.problem, optimum, marginal, selection, noise)
        return Fit(self.problem, selection, noise, ties, optimum, marginal, found, shown, held, self.given)

    def _require_anchor(self, held: FloatArray) -> None:
        """Refuse to fix parameters that have no nominal value."""
        names = self.problem.layout.names
        wanted = {names[k] for k in np.flatnonzero(np.abs(held).max(axis=0, initial=0.0) > 0.3)}
        wanted |= {name for name, value in self._asked.fixed.items() if value is None}
        missing = []
        if self.known.T_h_c is None and wanted & set(NINE[:6]):
            missing.append("nominal.head_eye")
        if self.known.wheels is None and wanted & set(NINE[6:]):
            missing.append("nominal.wheels")
        if missing:
            raise SolveError(
                f"no nominal value ({', '.join(missing)}) for unobservable or fixed parameters: "
                f"{', '.join(n for n in names if n in wanted)}",
                f"set {' and '.join(missing)} in rig.yaml, use --fix {sorted(wanted)[0]}=VALUE, or record the "
                "missing motion",
            )

    def levelled(self, fit: Fit, care: Care | None = None) -> Fit:
        """Estimate noise levels and parameters in turn until the levels converge; `rough` by default."""
        care = care or self.rough
        for _ in range(_NOISE_ROUNDS):
            noise = estimated(fit.noise, fit.components, self.given, self._guess)
            if care.enough is not None and settled(fit.noise, noise, care.enough):
                break
            done = settled(fit.noise, noise, care.levels)
            fit = self.fit(fit.optimum.state, fit.selection, noise, care)
            if done:
                break
        return fit


def _same_space(a: FloatArray, b: FloatArray) -> bool:
    """Whether two sets of orthonormal rows span nearly the same space."""
    if len(a) != len(b):
        return False
    return not len(a) or bool(np.linalg.svd(a @ b.T)[1].min() > 0.999)
