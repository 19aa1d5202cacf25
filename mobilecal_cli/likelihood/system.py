"""Normal equations with the stations eliminated; computing time linear in the number of stations.

Joint errors belong to one station each and are eliminated first, per station. Base poses and encoder errors form a
chain along the legs, a banded matrix. A small dense system for the global parameters remains.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

from mobilecal_cli.likelihood.chain import banded, chain_covariance
from mobilecal_cli.likelihood.legs import Legs, linearize_legs
from mobilecal_cli.likelihood.noise import FREE_JOINT, LOST_BASE, Noise, Selection
from mobilecal_cli.likelihood.problem import Problem, State
from mobilecal_cli.likelihood.views import Views, linearize_views
from mobilecal_cli.model import FloatArray, IntArray

_B = 5  # base pose and encoder errors of one station


def joint_sigmas(problem: Problem, selection: Selection, noise: Noise) -> FloatArray:
    """Standard deviation of each joint reading, (N, J), rad or m."""
    unit = np.array([1.0 if kind == "revolute" else 0.1 for kind in problem.joint_kinds])
    return np.where(selection.readings, noise.joint_rad * unit, FREE_JOINT)


@dataclass(frozen=True, slots=True, eq=False)
class Terms:
    """Terms of the sum of squares at a state, with derivatives, before elimination.

    Attributes:
        problem, state, selection, noise, leg_covariance: point of evaluation.
        views, legs: terms of the images and of the wheels.
        leg_weight: (L, 3, 3) inverse covariance of each leg, 0 for excluded legs.
        cost: sum of squares of all whitened residuals.
    """

    problem: Problem
    state: State
    selection: Selection
    noise: Noise
    leg_covariance: FloatArray
    views: Views
    legs: Legs
    leg_weight: FloatArray
    cost: float


@dataclass(frozen=True, slots=True, eq=False)
class System:
    """Normal equations H d = -gradient at a state, with the stations eliminated.

    Attributes:
        terms: the terms before elimination.
        S: (P, P) information of the global parameters, all others eliminated.
        s: (P,) their gradient, all others eliminated.
        gain: decrease of the cost, to second order, by the best step of the stations alone.
    """

    terms: Terms
    S: FloatArray
    s: FloatArray
    gain: float
    _E_inverse: FloatArray
    _E_base: FloatArray
    _E_shared: FloatArray
    _e: FloatArray
    _Y: FloatArray
    _y: FloatArray
    _diagonal: FloatArray
    _off: FloatArray

    @property
    def cost(self) -> float:
        """Sum of squares of all whitened residuals."""
        return self.terms.cost

    @property
    def views(self) -> Views:
        """Terms of the images."""
        return self.terms.views

    @property
    def legs(self) -> Legs:
        """Terms of the wheels."""
        return self.terms.legs

    @property
    def leg_weight(self) -> FloatArray:
        """Inverse covariance of each leg, (L, 3, 3), 0 for excluded legs."""
        return self.terms.leg_weight

    def back(self, shared: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Back substitution: steps of the stations for a step of the global parameters, (P,) → (N, 5), (N, J)."""
        base = (-self._y - self._Y @ shared).reshape(-1, _B)
        coupled = self._e + np.einsum("njb,nb->nj", self._E_base, base) + self._E_shared @ shared
        return base, -np.einsum("njk,nk->nj", self._E_inverse, coupled)

    def onto_shared(
        self, station: IntArray, base: FloatArray, joints: FloatArray, shared: FloatArray
    ) -> FloatArray:
        """Gradients of single stations reduced to the global parameters, (n, P, m).

        Args:
            station: (n,) station of each gradient.
            base: (n, 5, m) by the station's base block.
            joints: (n, J, m) by its joint errors.
            shared: (n, P, m) by the global parameters.
        """
        E_inverse, E_base, E_shared = (
            part[station] for part in (self._E_inverse, self._E_base, self._E_shared)
        )
        solved = E_inverse @ joints
        follow = self._Y.reshape(-1, _B, self._Y.shape[1])[station]
        left = base - np.swapaxes(E_base, 1, 2) @ solved
        out: FloatArray = shared - np.swapaxes(E_shared, 1, 2) @ solved - np.swapaxes(follow, 1, 2) @ left
        return out

    def base_covariance(self) -> tuple[FloatArray, FloatArray]:
        """Conditional covariance of the stations' base blocks for known global parameters.

        Returns:
            (N, 5, 5) of each station, and (N, 5, 5) of each station with the next one (the last is zero).
        """
        return chain_covariance(self._diagonal, self._off)

    def joint_conditional(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """Conditional joint errors: covariance (N, J, J), slopes by base (N, J, 5) and global parameters (N, J, P)."""
        return self._E_inverse, -self._E_inverse @ self._E_base, -self._E_inverse @ self._E_shared

    @property
    def base_by_shared(self) -> FloatArray:
        """Derivatives of the stations' base blocks by the global parameters, (N, 5, P)."""
        return -self._Y.reshape(-1, _B, self._Y.shape[1])


def leg_weights(covariance: FloatArray, selection: Selection) -> FloatArray:
    """Inverse covariance of each leg, (L, 3, 3), 0 for excluded legs."""
    return np.asarray(np.linalg.inv(covariance) * selection.legs[:, None, None], dtype=np.float64)


def terms_at(
    problem: Problem, state: State, selection: Selection, noise: Noise, leg_covariance: FloatArray
) -> Terms:
    """Terms of the sum of squares at a state; leg_covariance: (L, 3, 3), see `legs.leg_covariance`."""
    views = linearize_views(problem, state, selection, noise)
    legs = linearize_legs(problem, state, noise.encoder_rad > 0)
    weight = leg_weights(leg_covariance, selection)
    cost = float(views.cost.sum()) + float(np.einsum("la,lab,lb->", legs.residual, weight, legs.residual))
    cost += float(np.sum((state.joint_errors / joint_sigmas(problem, selection, noise)) ** 2))
    if noise.encoder_rad:
        cost += float(np.sum((state.encoder_errors / noise.encoder_rad) ** 2))
    return Terms(problem, state, selection, noise, leg_covariance, views, legs, weight, cost)


def linearize(
    problem: Problem, state: State, selection: Selection, noise: Noise, leg_covariance: FloatArray
) -> System:
    """Reduced normal equations at a state, with the stations eliminated."""
    return eliminated(terms_at(problem, state, selection, noise, leg_covariance))


def eliminated(terms: Terms, damping: float = 0.0) -> System:
    """Reduced normal equations, with the stations eliminated.

    Args:
        terms: the terms at a state.
        damping: relative increase of each diagonal element (Levenberg-Marquardt).
    """
    problem, state, selection, noise = terms.problem, terms.state, terms.selection, terms.noise
    views, legs, weight = terms.views, terms.legs, terms.leg_weight
    count, P = problem.stations, problem.layout.size

    # Joint errors, eliminated per station.
    sigma = joint_sigmas(problem, selection, noise)
    GJ = views.information @ views.by_joints
    JtG = np.swapaxes(GJ, 1, 2)
    E = np.swapaxes(views.by_joints, 1, 2) @ GJ
    diagonal = np.arange(E.shape[1])
    E[:, diagonal, diagonal] += sigma**-2
    E[:, diagonal, diagonal] *= 1 + damping
    E_inverse: FloatArray = np.asarray(np.linalg.inv(E), dtype=np.float64)
    e = np.einsum("nqj,nq->nj", views.by_joints, views.gradient) + state.joint_errors / sigma**2
    E_base, E_shared = JtG @ views.by_base, JtG @ views.by_shared
    GB, GS = views.information @ views.by_base, views.information @ views.by_shared
    Bt = np.swapaxes(views.by_base, 1, 2)
    D, C, H = Bt @ GB, Bt @ GS, np.einsum("nqp,nqr->pr", views.by_shared, GS)
    b = np.einsum("nqb,nq->nb", views.by_base, views.gradient)
    h = np.einsum("nqp,nq->p", views.by_shared, views.gradient)

    # Legs.
    off = np.zeros((count, _B, _B))
    i, j = problem.legs.T
    shared = legs.by_all_shared(problem.layout)
    Wi, Wj = weight @ legs.by_start, weight @ legs.by_end
    Ws = weight @ shared
    We = np.einsum("lab,lb->la", weight, legs.residual)
    it, jt = np.swapaxes(legs.by_start, 1, 2), np.swapaxes(legs.by_end, 1, 2)
    D[i] += it @ Wi  # += is safe: a station starts at most one leg and ends at most one
    D[j] += jt @ Wj
    off[i] += it @ Wj
    C[i] += it @ Ws
    C[j] += jt @ Ws
    b[i] += np.einsum("lab,la->lb", legs.by_start, We)
    b[j] += np.einsum("lab,la->lb", legs.by_end, We)
    H += np.einsum("lap,lar->pr", shared, Ws)
    h += np.einsum("lap,la->p", shared, We)
    _weak_terms(problem, state, selection, noise, D, b)

    blocks = np.arange(_B)
    D[:, blocks, blocks] *= 1 + damping
    H[np.arange(P), np.arange(P)] *= 1 + damping

    reduce = np.swapaxes(E_base, 1, 2) @ E_inverse
    D -= reduce @ E_base
    C -= reduce @ E_shared
    b -= np.einsum("nbj,nj->nb", reduce, e)
    solved = E_inverse @ E_shared
    H -= np.einsum("njp,njr->pr", E_shared, solved)
    h -= np.einsum("njp,nj->p", solved, e)
    gain = float(np.einsum("nj,njk,nk->", e, E_inverse, e))

    factor = cholesky_banded(banded(D, off), lower=True, check_finite=False)
    C_flat = C.reshape(-1, P)
    right = np.concatenate([C_flat, b.reshape(-1, 1)], axis=1)
    Yy = cho_solve_banded((factor, True), right, check_finite=False)
    Y, y = Yy[:, :-1], Yy[:, -1]
    gain += float(b.ravel() @ y)
    return System(
        terms=terms,
        S=H - C_flat.T @ Y,
        s=h - C_flat.T @ y,
        gain=gain,
        _E_inverse=E_inverse,
        _E_base=E_base,
        _E_shared=E_shared,
        _e=e,
        _Y=Y,
        _y=y,
        _diagonal=D,
        _off=off,
    )


def _weak_terms(
    problem: Problem, state: State, selection: Selection, noise: Noise, D: FloatArray, b: FloatArray
) -> None:
    """Add terms that keep the base blocks regular: gauge, encoder errors, and unconstrained base poses."""
    first = problem.first
    gauge = np.arange(3)
    D[np.ix_(first, gauge, gauge)] += np.eye(3)
    lost = ~selection.views
    lost[problem.legs[~selection.legs].ravel()] = True
    D[np.ix_(lost & ~first, gauge, gauge)] += np.eye(3) / LOST_BASE**2
    encoders = np.arange(3, _B)
    if noise.encoder_rad:
        D[:, encoders, encoders] += noise.encoder_rad**-2
        b[:, 3:] += state.encoder_errors / noise.encoder_rad**2
        return
    D[:, encoders, encoders] = 1.0
