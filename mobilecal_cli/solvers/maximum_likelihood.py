"""The estimate that uses everything: maximum likelihood, robust, with noise levels from the residuals."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.stats import chi2

from mobilecal_cli import se3
from mobilecal_cli.errors import SolveError
from mobilecal_cli.likelihood.influence import Influence, influences
from mobilecal_cli.likelihood.legs import leg_covariance
from mobilecal_cli.likelihood.marginals import Marginals, marginals
from mobilecal_cli.likelihood.noise import Noise, Selection
from mobilecal_cli.likelihood.observability import Directions, directions
from mobilecal_cli.likelihood.problem import Problem, State, no_extras, problem_of
from mobilecal_cli.likelihood.shared import EXTRA_NAMES
from mobilecal_cli.likelihood.system import linearize
from mobilecal_cli.model import NINE, BetweenLogs, BoolArray, Extraction, FloatArray, Parameters
from mobilecal_cli.solvers.asked import Asked
from mobilecal_cli.solvers.carry import base_motion
from mobilecal_cli.solvers.consensus import agreed
from mobilecal_cli.solvers.descent import Optimum, Ties, descend
from mobilecal_cli.solvers.linear import linear_estimate, linear_from
from mobilecal_cli.solvers.loops import Loops, closed_loops
from mobilecal_cli.solvers.robust import (
    believed_statistics,
    doubted_legs,
    doubted_readings,
    doubted_views,
    gross_corners,
    limit,
)
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

_LOG = logging.getLogger(__name__)
_NOISE_ROUNDS = 60
_ROUGH, _FINE = 0.1, 0.01
_DECISIONS = 60
_OBSERVABILITY_ROUNDS = 4
_CONSENSUS_REDUNDANCY = 20.0  # of the noise that the agreeing legs show
_MANY = 1e6
_DEGREES = {"readings": 1, "legs": 3, "views": 6}
_STRIKING = 1e-3  # chance of a sound measurement to be looked at more closely
_FEWEST_VIEWS = 4
_LOUD = 4.0  # noise this many times (in variance) above what is supposed makes a consensus worth its time


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


def state_at(problem: Problem, parameters: Parameters, loops: Loops, selection: Selection) -> State:
    """Base poses and boards that go with some parameters: dead reckoning, and the boards' median poses.

    Over legs that are not believed the base is placed by what the cameras see of the board.
    """
    from mobilecal_cli.kinematics import integrate

    T_vi_vj = base_motion(integrate(loops.steps, parameters.wheels))
    psi = integrate(loops.steps, parameters.wheels).psi_rad
    count = problem.stations
    T_w_v = np.broadcast_to(np.eye(4), (count, 4, 4)).copy()
    heading = np.zeros(count)
    T_v_k = loops.T_v_h @ parameters.T_h_c @ loops.T_c_k
    boards = np.broadcast_to(np.eye(4), (problem.layout.boards, 4, 4)).copy()
    known = np.zeros(problem.layout.boards, dtype=np.bool_)
    into = {int(j): leg for leg, (_, j) in enumerate(problem.legs)}
    starts = [s for s in range(count) if s not in into or not selection.legs[into[s]]]
    for start, end in zip(starts, [*starts[1:], count], strict=True):
        for s in range(start + 1, end):
            i = problem.legs[into[s], 0]
            T_w_v[s], heading[s] = T_w_v[i] @ T_vi_vj[into[s]], heading[i] + psi[into[s]]
        members = np.arange(start, end)
        seeing = members[selection.views[members]]
        board = problem.board[start]
        if start in into and known[board] and len(seeing):
            # T_w_v with the board where it is known to be, flattened, at this stretch's start.
            placed = boards[board] @ se3.inverse(T_v_k[seeing]) @ se3.inverse(T_w_v[seeing])
            shift = _median_pose(placed)
            yaw = np.arctan2(shift[1, 0], shift[0, 0])
            flat = se3.transform(se3.rotation_z(yaw), np.array([shift[0, 3], shift[1, 3], 0.0]))
            T_w_v[members], heading[members] = flat @ T_w_v[members], heading[members] + yaw
        elif start in into:
            leg = into[start]
            shift = T_w_v[problem.legs[leg, 0]] @ T_vi_vj[leg]
            heading[members] += heading[problem.legs[leg, 0]] + psi[leg]
            T_w_v[members] = shift @ T_w_v[members]
        if not known[board] and len(seeing):
            boards[board] = _median_pose(T_w_v[seeing] @ T_v_k[seeing])
            known[board] = True
    return State(
        parameters,
        no_extras(),
        boards,
        np.concatenate([T_w_v[:, :2, 3], heading[:, None]], axis=1),
        np.zeros_like(problem.joints),
        np.zeros((count, 2)),
    )


def _median_pose(T: FloatArray) -> FloatArray:
    """A pose in the middle of several: medians of the twists from one of them."""
    best: FloatArray = T[len(T) // 2]
    for _ in range(3):
        best = best @ se3.exp(np.median(se3.log(se3.inverse(best) @ T), axis=0))
    return best


class Solver:
    """One extraction's problem with what the user bound; each method is a step of the recipe."""

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
        self._given = frozenset(self._levels)
        self._pose_cov = np.stack([o.T_c_k_cov for o in extraction.observations])
        self._square_free = "square_scale" in self.problem.layout.extras

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

    def _fit_few(self, rough: Parameters) -> Callable[[Loops], Parameters]:
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

    def shown(self, state: State, selection: Selection, noise: Noise, anchor: Parameters) -> Directions:
        """What the data show at a state."""
        covariance = leg_covariance(self.problem, state.parameters.wheels, noise)
        system = linearize(self.problem, state, selection, noise, covariance)
        prior, _, _ = self.ties(anchor, np.zeros((0, self.problem.layout.named))).prior_terms(
            self.problem, state
        )
        found = state.parameters.wheels
        wheels = np.array([found.radius_right_m, found.radius_left_m, found.separation_m])
        return directions(
            system.S + np.diag(prior), self.problem.layout, wheels, self.free(), len(self.problem.legs)
        )

    # -- the recipe -------------------------------------------------------------------------------

    def first_noise(self, own_px: FloatArray) -> Noise:
        """Supposed levels: given ones, the corners' own scatter, and a guess."""
        step = self.problem.encoder_step_rad
        noise = replace(GUESS, pixel_px=max(float(np.median(own_px)), 1e-3), encoder_rad=step * UNIFORM)
        return replace(noise, **self._levels)

    def solve(self, start: Parameters | None = None) -> Fit:
        """All of it."""
        problem = self.problem
        rough = start or self.linear()
        T_c_k = self.loops.T_c_k
        plain_state = state_at(problem, rough, self.loops, Selection.everything(problem))
        sound, boards, own_px = gross_corners(problem, plain_state, T_c_k)
        noise = self.first_noise(own_px)
        selection = replace(Selection.everything(problem), corners=sound, views=boards)
        fit = self._fit(plain_state, selection, noise)
        if not self._sound(fit):
            try:
                fit = self._by_consensus(rough, noise, selection)
            except SolveError as error:
                # Noise that is far from what was supposed, and no outliers: all of it, with noise levels to match.
                _LOG.info("no consensus of legs: %s", error.message)
        fit = self._levelled(fit, _ROUGH)
        before: list[Selection] = [fit.selection]
        for _ in range(_DECISIONS):
            again = self._decided(fit) or self._swapped(fit)
            if again is None or any(again.selection.same(other) for other in before):
                break
            before.append(again.selection)
            fit = again
        return self._levelled(fit, _FINE)

    def _by_consensus(self, rough: Parameters, noise: Noise, selection: Selection) -> Fit:
        """A fit of the legs that agree, with all that agrees with it taken back."""
        found = agreed(self.problem, self.loops, rough, noise, self._pose_cov, self._fit_few(rough))
        louder = {
            name: getattr(noise, name) * found.noise_factor
            for name in ("wheel_rad_per_sqrt_rad", "joint_rad")
            if name not in self._given
        }
        noise = replace(noise, **louder)
        legs = ~found.bad
        touched = np.zeros((self.problem.stations, 2), dtype=np.int64)
        for (i, j), good in zip(self.problem.legs, legs, strict=True):
            touched[[i, j], int(good)] += 1
        lonely = (touched[:, 0] > 0) & (touched[:, 1] == 0)
        selection = replace(selection, legs=legs, views=selection.views & ~lonely)
        state = state_at(self.problem, found.parameters, self.loops, selection)
        return self._taken_back(self._fit(state, selection, noise))

    def _fit(self, state: State, selection: Selection, noise: Noise) -> Fit:
        """Descend, holding what the data do not show, until that does not change."""
        problem = self.problem
        for _ in range(_OBSERVABILITY_ROUNDS):
            anchor = _anchor(self._extraction, self._asked, state.parameters)
            shown = self.shown(state, selection, noise, anchor)
            held = shown.hidden
            if len(held) or self._asked.fixed:
                self._require_anchor(held)
            ties = self.ties(anchor, held)
            optimum = descend(problem, state, selection, noise, ties)
            state = optimum.state
            again = self.shown(state, selection, noise, anchor)
            if _same_space(again.hidden, held):
                break
        return self._fitted(optimum, selection, noise, ties, again, held)

    def _refit(self, fit: Fit, selection: Selection) -> Fit:
        """Descend from a fit with another selection, holding what that fit holds."""
        optimum = descend(self.problem, fit.optimum.state, selection, fit.noise, fit.ties)
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
        return Fit(self.problem, selection, noise, ties, optimum, marginal, found, shown, held, self._given)

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

    def _levelled(self, fit: Fit, tolerance: float) -> Fit:
        """Noise levels and fit in turn, until the levels stand."""
        for _ in range(_NOISE_ROUNDS):
            noise = estimated(fit.noise, fit.components, self._given)
            done = settled(fit.noise, noise, tolerance)
            fit = self._fit(fit.optimum.state, fit.selection, noise)
            if done:
                break
        return fit

    def _redundancy(self, fit: Fit) -> float:
        if len(self._given) == 3:
            return 1e6
        return fit.components["joint_rad"].redundancy + fit.components["wheel_rad_per_sqrt_rad"].redundancy

    def _sound(self, fit: Fit) -> bool:
        """Whether a first fit of everything, with supposed noise, shows nothing odd."""
        stats = believed_statistics(self.problem, fit.optimum, fit.marginal, fit.selection, fit.noise)
        bound = _LOUD if len(self._given) < 3 else 1.0
        views = stats.views.max(initial=0) / limit(self.problem.stations, 6, 1e6)
        legs = stats.legs.max(initial=0) / limit(self.problem.stations, 3, 1e6)
        readings = stats.readings.max(initial=0) / limit(self.problem.stations, 1, 1e6)
        return bool(max(views, legs, readings) < bound and fit.selection.views.all())

    def _taken_back(self, fit: Fit) -> Fit:
        """Believe again what agrees with the rest: legs first, for a bad station breaks both of its legs."""
        for _ in range(2 * len(self.problem.legs)):
            out = ~fit.selection.legs
            if not out.any():
                break
            statistic = np.where(out, doubted_legs(fit.optimum, fit.marginal), np.inf)
            legs = self._agreeing(fit.selection, statistic)
            if legs is None:
                break
            fit = self._refit(fit, replace(fit.selection, legs=legs))
        for _ in range(self.problem.stations):
            again = self._view_back(fit, _CONSENSUS_REDUNDANCY)
            if again is None:
                break
            fit = self._refit(fit, again)
        return self._fit(fit.optimum.state, fit.selection, fit.noise)

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
        usable = selection.corners.mean(axis=2).min(axis=1) > 0.5
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
            found.append(
                (float(values[at]) / float(chi2.isf(_STRIKING, dof)), kind, tuple(int(k) for k in at))
            )
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
        return _MANY if level in self._given else redundancy + guess_worth(redundancy)

    def _swapped(self, fit: Fit) -> Fit | None:
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
                changed = replace(selection, views=views, legs=driven)
                try:
                    trial = self._refit(fit, changed)
                except SolveError:
                    continue
                if self._at_peace(trial):
                    return self._levelled(trial, _ROUGH)
        return None

    def _decided(self, fit: Fit) -> Fit | None:
        """One more measurement taken back or left out; None where all is well."""
        selection = fit.selection
        wheels, joints = fit.components["wheel_rad_per_sqrt_rad"], fit.components["joint_rad"]
        back = self._view_back(fit, self._known_by("joint_rad", wheels.redundancy + joints.redundancy))
        if back is not None:
            return self._levelled(self._fit(fit.optimum.state, back, fit.noise), _ROUGH)
        for leg in np.flatnonzero(~selection.legs):
            if self._external(fit, "legs", (int(leg),)) < 1:
                legs = selection.legs.copy()
                legs[leg] = True
                again = self._fit(fit.optimum.state, replace(selection, legs=legs), fit.noise)
                return self._levelled(again, _ROUGH)
        for _, kind, at in self._candidates(fit):
            believed = getattr(selection, kind).copy()
            believed[at] = False
            changed = replace(selection, **{kind: believed})
            if changed.views.sum() < _FEWEST_VIEWS:
                continue
            try:
                trial = self._levelled(self._fit(fit.optimum.state, changed, fit.noise), _ROUGH)
            except SolveError:
                continue  # without it the rest hangs on too little
            if self._external(trial, kind, at) > 1:
                return trial
        return None


def _same_space(a: FloatArray, b: FloatArray) -> bool:
    """Whether two sets of orthonormal rows span nearly the same space."""
    if len(a) != len(b):
        return False
    return not len(a) or bool(np.linalg.svd(a @ b.T)[1].min() > 0.999)


def maximum_likelihood(
    extraction: Extraction, asked: Asked | None = None, start: Parameters | None = None
) -> Fit:
    """Solve for all numbers by maximum likelihood.

    Args:
        extraction: at least four observations.
        asked: what the user binds and asks for.
        start: where to start; the linear solution by default.

    Raises:
        SolveError: not converged, or something to be held has no nominal value.
    """
    return Solver(extraction, asked or Asked()).solve(start)
