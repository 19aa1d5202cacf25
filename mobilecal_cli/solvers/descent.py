"""Maximize the likelihood by Levenberg-Marquardt on the reduced normal equations."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from mobilecal_cli import se3
from mobilecal_cli.errors import SolveError
from mobilecal_cli.likelihood.legs import leg_covariance
from mobilecal_cli.likelihood.noise import Noise, Selection
from mobilecal_cli.likelihood.problem import Problem, State, moved
from mobilecal_cli.likelihood.shared import INDEX
from mobilecal_cli.likelihood.system import System, Terms, eliminated, terms_at
from mobilecal_cli.model import FloatArray, Parameters

_MAX_STEPS = 120
_LARGEST_DAMPING = 1e6
_CONVERGED = 1e-10  # of the cost
NEAR, _ROUNDING = 1e-7, 1e-12  # 0.0003 standard deviations; and of the cost
_CREEPING = 1e-6  # of the cost: after the last allowed step, a smaller gain counts as converged
# Interpolated readings make the cost non-smooth in the time offsets, where the steps shrink slowly: stop where a step
# gains less than the first value and more than the second share of the step before.
_KINKED, _LEAP = 1e-4, 0.05


@dataclass(frozen=True, slots=True, eq=False)
class Ties:
    """Constraints and priors on the named global parameters.

    Both refer to the displacement from an anchor: small rotation vector in the head's frame, translation,
    wheels, and the additional parameters themselves.

    Attributes:
        anchor: the origin of displacements.
        held: (K, named) fixed directions, along which the displacement is `held_at`, orthonormal in units of `scales`.
        held_at: (K,) in those units.
        scales: (named,) units.
        prior: (named,) expected displacement.
        prior_weight: (named,) inverse variance of it, 0 for none.
    """

    anchor: Parameters
    held: FloatArray
    held_at: FloatArray
    scales: FloatArray
    prior: FloatArray
    prior_weight: FloatArray

    def displacement(self, problem: Problem, state: State) -> FloatArray:
        """Displacement of a state from the anchor, (named,), rad, m, and the units of the additional parameters."""
        found, anchor = state.parameters, self.anchor
        turn = se3.log_so3(found.T_h_c[:3, :3] @ anchor.T_h_c[:3, :3].T)
        a, b = found.wheels, anchor.wheels
        wheels = [
            a.radius_right_m - b.radius_right_m,
            a.radius_left_m - b.radius_left_m,
            a.separation_m - b.separation_m,
        ]
        extras = [state.extras[INDEX[name]] for name in problem.layout.extras]
        return np.concatenate([turn, found.T_h_c[:3, 3] - anchor.T_h_c[:3, 3], wheels, extras])

    def named_basis(self) -> FloatArray:
        """Free directions of the named parameters, (named, named - K), orthonormal in units of `scales`."""
        if not len(self.held):
            return np.eye(len(self.scales))
        _, _, Vt = np.linalg.svd(self.held, full_matrices=True)
        return np.asarray(Vt[len(self.held) :].T)

    def free_basis(self, size: int) -> FloatArray:
        """Free directions of a step, (P, P - K)."""
        named = len(self.scales)
        basis = np.zeros((size, size - len(self.held)))
        free = named - len(self.held)
        basis[:named, :free] = self.scales[:, None] * self.named_basis()
        basis[named:, free:] = np.eye(size - named)
        return basis

    def onto(self, problem: Problem, state: State) -> FloatArray:
        """Shortest step from a state to the fixed values, (P,)."""
        step = np.zeros(problem.layout.size)
        if len(self.held):
            off = self.held_at - self.held @ (self.displacement(problem, state) / self.scales)
            step[: len(self.scales)] = self.scales * (self.held.T @ off)
        return step

    def prior_terms(self, problem: Problem, state: State) -> tuple[FloatArray, FloatArray, float]:
        """Diagonal information of the priors (P,), their gradient (P,) and their sum of squares."""
        information, gradient = np.zeros(problem.layout.size), np.zeros(problem.layout.size)
        named = len(self.scales)
        if not np.any(self.prior_weight):
            return information, gradient, 0.0
        off = self.displacement(problem, state) - self.prior
        information[:named] = self.prior_weight
        gradient[:named] = self.prior_weight * off
        return information, gradient, float(np.sum(self.prior_weight * off**2))


@dataclass(frozen=True, slots=True, eq=False)
class Optimum:
    """Result of the optimization.

    Attributes:
        state: the maximum of the likelihood.
        system: normal equations there, without damping.
        information: (P, P) of the global parameters, priors included.
        basis: (P, F) free directions.
        leg_covariance: (L, 3, 3) as used.
        cost: sum of squares there.
        history: (n,) cost at the start and after each step.
    """

    state: State
    system: System
    information: FloatArray
    basis: FloatArray
    leg_covariance: FloatArray
    cost: float
    history: FloatArray

    @property
    def covariance(self) -> FloatArray:
        """Covariance of the global parameters, (P, P), 0 in fixed directions: the Cramer-Rao bound."""
        reduced = self.basis.T @ self.information @ self.basis
        scale = 1 / np.sqrt(np.diag(reduced))
        inverse = np.linalg.inv(reduced * np.outer(scale, scale)) * np.outer(scale, scale)
        C: FloatArray = self.basis @ inverse @ self.basis.T
        return C


def terms_before(problem: Problem, state: State, selection: Selection, noise: Noise) -> Terms:
    """Terms of the sum of squares at a state, with the legs' covariance evaluated for its wheels."""
    covariance = leg_covariance(problem, state.parameters.wheels, noise)
    return terms_at(problem, state, selection, noise, covariance)


def _creeps(history: list[float]) -> bool:
    """Whether the last step gained little, and not much less than the one before."""
    if len(history) < 3:
        return False
    before, last = history[-3] - history[-2], history[-2] - history[-1]
    return last < _KINKED and last > _LEAP * before


def _solved(S: FloatArray, s: FloatArray) -> FloatArray:
    try:
        return np.asarray(cho_solve(cho_factor(S), s))
    except np.linalg.LinAlgError as error:
        raise SolveError(
            "the inlier measurements do not determine all parameters",
            "record more stations, with the whole board in both images",
        ) from error


def descend(
    start: Terms, ties: Ties, near: float = NEAR, on_step: Callable[[], None] = lambda: None
) -> Optimum:
    """Minimize the sum of squares of all inlier measurements by Levenberg-Marquardt.

    The legs' covariance stays that of the start; call again from the result to update it.

    Args:
        start: see `terms_before`; fixed directions are first moved to their fixed values.
        ties: constraints and priors on the named global parameters.
        near: a step that would reduce the sum of squares by less is not taken: the result is within about the square
            root of this from the minimum, in standard deviations.
        on_step: called before each step.

    Raises:
        SolveError: did not converge within 120 steps, or the normal equations are singular.
    """
    problem, selection, noise, terms = start.problem, start.selection, start.noise, start
    basis = ties.free_basis(problem.layout.size)
    if len(ties.held):
        still = np.zeros((problem.stations, 5)), np.zeros(problem.joints.shape)
        terms = terms_before(
            problem, moved(problem, start.state, ties.onto(problem, start.state), *still), selection, noise
        )
    state, covariance = terms.state, terms.leg_covariance
    system = eliminated(terms)
    cost = terms.cost + ties.prior_terms(problem, state)[2]
    damping, history, arrived = 0.0, [cost], False
    while len(history) <= _MAX_STEPS + 1:
        on_step()
        information, gradient, _ = ties.prior_terms(problem, state)
        S = basis.T @ (system.S + np.diag(information)) @ basis
        s = basis.T @ (system.s + gradient)
        unit = 1 / np.sqrt(np.diag(S))
        along = -unit * _solved(S * np.outer(unit, unit), unit * s)
        gain = system.gain - float(s @ along)
        if arrived or (damping == 0 and gain <= near + _ROUNDING * cost):
            full = system.S + np.diag(information)
            return Optimum(state, system, full, basis, covariance, cost, np.array(history))
        step = basis @ along
        trial = moved(problem, state, step, *system.back(step))
        ahead = terms_at(problem, trial, selection, noise, covariance)
        trial_cost = ahead.cost + ties.prior_terms(problem, trial)[2]
        if trial_cost <= cost * (1 + 1e-13) and trial.parameters.wheels.separation_m > 0:
            arrived = cost - trial_cost <= _CONVERGED * cost + 1e-14 and damping < 1e-3
            terms, state, cost = ahead, trial, trial_cost
            history.append(cost)
            arrived |= len(history) > _MAX_STEPS and history[-2] - cost < _CREEPING * cost
            arrived |= _creeps(history)
            damping = damping / 10 if damping > 1e-9 and not arrived else 0.0
        else:
            damping = max(damping * 10, 1e-6)
            if damping > _LARGEST_DAMPING or gain < max(near, _KINKED):
                arrived, damping = True, 0.0  # no step reduces the cost: converged to rounding error
                history.append(cost)
        system = eliminated(terms, damping)
    raise SolveError(
        f"the maximum-likelihood estimate did not converge in {_MAX_STEPS} steps",
        "check the residuals of --method linear",
    )
