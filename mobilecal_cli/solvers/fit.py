"""A maximum of the likelihood for a given selection, and how one is reached: noise levels, held directions, descent."""

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
    """How exactly a fit is made.

    Attributes:
        levels: the noise levels are to stand to this share of themselves before the last fit.
        enough: levels that stand as well as this need no other fit; None: a last fit is made in any case.
        near: where a descent ends, see `descend`.
    """

    levels: float
    enough: float | None
    near: float


#: In logs of so many stations decisions are made a few at a time, from fits that are 0.03 standard deviations off: so
#: that what they cost does not grow with the log.
LONG_LOG = 100
_ROUGH, _QUICK = Care(levels=0.1, enough=None, near=NEAR), Care(levels=0.1, enough=0.02, near=1e-3)
FINE = Care(levels=0.01, enough=None, near=NEAR)


@dataclass(frozen=True, eq=False)
class Fit:
    """A maximum of the likelihood with all that was decided on the way.

    Attributes:
        problem, selection, noise, ties: what it is the maximum of.
        optimum: the maximum.
        marginal: covariances there.
        components: what each noise level rests on.
        directions: what the data show.
        held: (K, named) directions that are held because the data do not show them, in units of the scales.
        given: names of the noise levels that are not estimated.
        between: the logs one by one, where there are several.
        over_logs: (named, named) covariance that allows for the spread between them.
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
        """How each kind of measurement moves the shared numbers."""
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
        """(P, P) of the shared numbers. Where the noise levels rest on few residuals it is wider than the bound.

        A variance that r residuals show is itself uncertain: its mean is r / (r - 2) times what they show. So much
        wider is what each kind of noise makes of the shared numbers.
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
    """The numbers beside the nine: those asked for, and the clocks' offsets where stations are not at rest."""
    moving = any(not o.at_rest for o in extraction.observations) and bool(extraction.joint_tracks)
    clocks = ("time_joints", "time_wheels") if moving else ()
    return tuple(name for name in EXTRA_NAMES if name in (*asked.extras, *clocks))


def _anchor(extraction: Extraction, asked: Asked, found: Parameters | None) -> Parameters:
    """Where displacements count from: nominal values where there are any, what was found otherwise."""
    nominal, T_c_ref = extraction.rig.nominal, extraction.rig.cameras.T_c_reference
    T_h_c = nominal.T_h_reference @ se3.inverse(T_c_ref) if nominal.T_h_reference is not None else None
    wheels = nominal.wheels
    if found is not None:
        T_h_c = found.T_h_c if T_h_c is None else T_h_c
        wheels = found.wheels if wheels is None else wheels
    if T_h_c is None or wheels is None:
        raise SolveError(
            "a value is to be held at its nominal one, and there is none",
            "state nominal.head_eye and nominal.wheels in rig.yaml, or give --fix a value",
        )
    return Parameters(T_h_c, wheels)


class Fitter:
    """One extraction's problem with what the user bound."""

    def __init__(self, extraction: Extraction, asked: Asked) -> None:
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
        #: The care that is enough while it is decided what to believe.
        self.rough = _QUICK if self.problem.stations >= LONG_LOG else _ROUGH
        self._guess = replace(GUESS, encoder_rad=self.problem.encoder_step_rad * UNIFORM)

    # -- where to start ---------------------------------------------------------------------------

    @property
    def plain(self) -> bool:
        """Whether the motion shows all nine, so that the linear method applies as it is."""
        seen = self.seen
        return seen.tilts and seen.turns and seen.drives and not self.known.head_eye_fixed

    def linear(self) -> Parameters:
        """Linear parameters from all legs."""
        if self.plain:
            return linear_estimate(self.loops, self.known.wheels).parameters
        return pulled_start(self.loops, self.known, self.seen)

    def fit_few(self, rough: Parameters) -> Callable[[Loops], Parameters]:
        """What gives parameters from a few legs."""
        if self.plain:
            return lambda loops: linear_from(loops, rough.wheels)
        return lambda loops: pulled_start(loops, self.known, self.seen)

    # -- what binds -------------------------------------------------------------------------------

    def ties(self, anchor: Parameters, held: FloatArray) -> Ties:
        """What the user fixed, what is held, and the priors."""
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
        """(named, F) unit columns of what the user did not fix."""
        layout = self.problem.layout
        kept = [k for k, name in enumerate(layout.names) if name not in self._asked.fixed]
        return np.eye(layout.named)[:, kept]

    def shown(self, information: FloatArray, at: WheelGeometry) -> Directions:
        """What the data show, by the information (P, P) about the shared numbers."""
        wheels = np.array([at.radius_right_m, at.radius_left_m, at.separation_m])
        return directions(information, self.problem.layout, wheels, self.free(), len(self.problem.legs))

    # -- the recipe -------------------------------------------------------------------------------

    def first_noise(self, own_px: FloatArray) -> Noise:
        """Supposed levels: given ones, the corners' own scatter, and a guess."""
        return replace(self._guess, **{"pixel_px": max(float(np.median(own_px)), 1e-3), **self._levels})

    def fit(self, state: State, selection: Selection, noise: Noise, care: Care | None = None) -> Fit:
        """Descend, holding what the data do not show, until that does not change; `rough` by default."""
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
            optimum = descend(start, ties, near)
            state = optimum.state
            again = self.shown(optimum.information, state.parameters.wheels)
            if _same_space(again.hidden, held):
                break
        return self._fitted(optimum, selection, noise, ties, again, held)

    def refit(self, fit: Fit, selection: Selection) -> Fit:
        """Descend roughly from a fit with another selection, holding what that fit holds."""
        start = terms_before(self.problem, fit.optimum.state, selection, fit.noise)
        optimum = descend(start, fit.ties, self.rough.near)
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
        """Refuse to hold what has no nominal value."""
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
                f"not observable in this log, or fixed: {', '.join(n for n in names if n in wanted)}; and there is no "
                f"nominal value to hold it at ({', '.join(missing)})",
                f"state {' and '.join(missing)} in rig.yaml, give --fix {sorted(wanted)[0]}=VALUE, or record the "
                "missing motion",
            )

    def levelled(self, fit: Fit, care: Care | None = None) -> Fit:
        """Noise levels and fit in turn, until the levels stand; `rough` by default."""
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
