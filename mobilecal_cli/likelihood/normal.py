"""The normal equations with the stations eliminated: the cost is linear in the number of stations.

Joint errors and sway belong to one station each and go first, station by station. Base poses, encoder errors, floor,
wheel scales and stamp errors form a chain along the legs: a banded matrix. A small dense system for the shared
parameters is left.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

from mobilecal_cli.likelihood.chain import banded, chain_covariance
from mobilecal_cli.likelihood.dataset import BASE, ENCODERS, PROCESSES, STAMP
from mobilecal_cli.likelihood.noise import FREE_BASE, FREE_BOARD
from mobilecal_cli.likelihood.state import Step
from mobilecal_cli.model import FloatArray, IntArray

if TYPE_CHECKING:
    from mobilecal_cli.likelihood.linearization import Linearization


@dataclass(frozen=True, slots=True, eq=False)
class NormalEquations:
    """Normal equations of the measurements, H d = -gradient, with stations eliminated.

    Attributes:
        S: (P, P) information of the shared parameters, all others eliminated.
        s: (P,) their gradient, the same way.
        gain: decrease of the cost, to second order, by the best step of the stations alone.
    """

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

    def step(self, shared: FloatArray) -> Step:
        """The step of all unknowns that goes with a step (P,) of the shared parameters."""
        base = (-self._y - self._Y @ shared).reshape(len(self._diagonal), -1)
        coupled = self._e + np.einsum("njb,nb->nj", self._E_base, base) + self._E_shared @ shared
        return Step(shared, base, -np.einsum("njk,nk->nj", self._E_inverse, coupled))

    def onto_shared(
        self, station: IntArray, base: FloatArray, own: FloatArray, shared: FloatArray
    ) -> FloatArray:
        """Gradients at single stations as gradients of the shared parameters, all else eliminated.

        Args:
            station: (n,) where each gradient acts.
            base: (n, B, m) by the station's base block.
            own: (n, J + 3, m) by its joint errors and its sway.
            shared: (n, P, m) by the shared parameters.

        Returns:
            (n, P, m).
        """
        E_inverse, E_base, E_shared = (
            part[station] for part in (self._E_inverse, self._E_base, self._E_shared)
        )
        solved = E_inverse @ own
        follow = -self.base_by_shared[station]
        left = base - np.swapaxes(E_base, 1, 2) @ solved
        out: FloatArray = shared - np.swapaxes(E_shared, 1, 2) @ solved - np.swapaxes(follow, 1, 2) @ left
        return out

    def base_covariance(self) -> tuple[FloatArray, FloatArray]:
        """Covariance of the stations' base block for known shared parameters.

        Returns:
            (N, B, B) of each station, and (N, B, B) of each station with the one after it (the last is empty).
        """
        return chain_covariance(self._diagonal, self._off)

    @property
    def chain(self) -> tuple[FloatArray, FloatArray]:
        """(N, B, B) information of the stations' base blocks, and (N, B, B) of each with the next one."""
        return self._diagonal, self._off

    def own_conditional(self) -> tuple[FloatArray, FloatArray, FloatArray]:
        """A station's own errors for a known rest: covariance (N, E, E), slopes by base (N, E, B), shared (N, E, P)."""
        return self._E_inverse, -self._E_inverse @ self._E_base, -self._E_inverse @ self._E_shared

    @property
    def base_by_shared(self) -> FloatArray:
        """(N, B, P) derivative of the stations' base blocks by the shared parameters."""
        return -self._Y.reshape(*self._diagonal.shape[:2], self._Y.shape[1])


def eliminated(lin: Linearization, damping: float = 0.0) -> NormalEquations:
    """Build the normal equations of the measurements and eliminate the stations.

    Args:
        lin: where.
        damping: each diagonal element grows by this share of itself (Levenberg-Marquardt).

    Raises:
        LinAlgError: a singular matrix.
    """
    data, views, legs, weight = lin.data, lin.views, lin.legs, lin.leg_weight
    count, P, B = data.stations, data.layout.size, data.base_width

    own = _eliminated_own(lin, damping)
    E_base, E_shared = own.across[:, :, :6] @ views.by_base, views.onto_shared(own.across)
    GS = views.onto_shared(own.information)
    Bt = np.swapaxes(views.by_base, 1, 2)
    D, C = Bt @ (own.information[:, :, :6] @ views.by_base), Bt @ GS
    b = np.einsum("nqb,nq->nb", views.by_base, own.gradient)
    H, h = _summed(views.by_shared, GS), np.einsum("nqp,nq->p", views.by_shared, own.gradient)
    H[views.direct] += _summed(own.information[:, :, 6:], views.by_shared)
    H[np.ix_(views.direct, views.direct)] += own.direct_information
    h[views.direct] += own.direct_gradient

    # Legs.
    off = np.zeros((count, B, B))
    i, j = data.legs.T
    shared = legs.by_shared(data.layout)
    Wi, Wj = weight @ legs.by_start, weight @ legs.by_end
    Ws = weight @ shared
    We = np.einsum("lab,lb->la", weight, legs.residual)
    it, jt = np.swapaxes(legs.by_start, 1, 2), np.swapaxes(legs.by_end, 1, 2)
    D[i] += it @ Wi  # a station starts one leg and ends one at most
    D[j] += jt @ Wj
    off[i] += it @ Wj
    C[i] += it @ Ws
    C[j] += jt @ Ws
    b[i] += np.einsum("lab,la->lb", legs.by_start, We)
    b[j] += np.einsum("lab,la->lb", legs.by_end, We)
    H += _summed(shared, Ws)
    h += np.einsum("lap,la->p", shared, We)
    _process_terms(lin, D, off, b)
    _weak_terms(lin, D, b)
    unseen = _unseen_boards(lin)
    H[unseen, unseen] += FREE_BOARD**-2

    blocks = np.arange(B)
    D[:, blocks, blocks] *= 1 + damping
    H[np.arange(P), np.arange(P)] *= 1 + damping

    gain = float(np.einsum("nj,njk,nk->", own.e, own.inverse, own.e))

    factor = cholesky_banded(banded(D, off), lower=True, check_finite=False)
    C_flat = C.reshape(-1, P)
    right = np.concatenate([C_flat, b.reshape(-1, 1)], axis=1)
    Yy = cho_solve_banded((factor, True), right, check_finite=False)
    Y, y = Yy[:, :-1], Yy[:, -1]
    gain += float(b.ravel() @ y)
    return NormalEquations(
        S=H - C_flat.T @ Y,
        s=h - C_flat.T @ y,
        gain=gain,
        _E_inverse=own.inverse,
        _E_base=E_base,
        _E_shared=E_shared,
        _e=own.e,
        _Y=Y,
        _y=y,
        _diagonal=D,
        _off=off,
    )


@dataclass(frozen=True, slots=True, eq=False)
class _Own:
    """Joint errors and sway, eliminated station by station.

    Attributes:
        information: (N, 6, Q) of delta with (delta, direct constants), without them.
        gradient: (N, 6) of delta, the same way.
        direct_information, direct_gradient: (D, D) and (D,) of the direct constants, summed over the stations.
        inverse: (N, E, E) their covariance for a known rest.
        e: (N, E) their gradient.
        across: (N, E, Q) their information with (delta, direct constants).
    """

    information: FloatArray
    gradient: FloatArray
    direct_information: FloatArray
    direct_gradient: FloatArray
    inverse: FloatArray
    e: FloatArray
    across: FloatArray


def _eliminated_own(lin: Linearization, damping: float) -> _Own:
    """Eliminate each station's own errors without cancellation.

    They move the board in the camera by A = J P J^T, with their prior covariance P. The corners' information G about
    delta becomes (G^-1 + A)^-1 = (I + G A)^-1 G. The usual G - G J (P^-1 + J^T G J)^-1 J^T G is the difference of two
    matrices that agree to all digits where the corners are much better than the joints.
    """
    views, sigma = lin.views, lin.own_sigmas
    J, G = views.by_own, views.information
    P = sigma**2 / (1 + damping)
    A = (J * P[:, None, :]) @ np.swapaxes(J, 1, 2)
    shrink = np.asarray(np.linalg.inv(np.eye(6) + G[:, :6, :6] @ A), dtype=np.float64)
    information, forth = shrink @ G[:, :6], A @ G[:, :6, 6:]
    # With the present errors o the gradient is that of delta - J o: moved back by them.
    wanted = views.gradient - (G[:, :, :6] @ (J @ lin.own_errors[..., None]))[..., 0]
    gradient = (shrink @ wanted[:, :6, None])[..., 0]
    root = np.sqrt(P)
    across = np.swapaxes(J, 1, 2) @ G[:, :6]
    M = np.eye(root.shape[1]) + root[:, :, None] * (across[:, :, :6] @ J) * root[:, None, :]
    inverse = root[:, :, None] * np.asarray(np.linalg.inv(M), dtype=np.float64) * root[:, None, :]
    e = np.einsum("nqj,nq->nj", J, views.gradient[:, :6]) + lin.own_errors / P
    return _Own(
        information,
        gradient,
        G[:, 6:, 6:].sum(axis=0) - _summed(forth, information[:, :, 6:]),
        wanted[:, 6:].sum(axis=0) - _summed(forth, gradient[..., None])[:, 0],
        inverse,
        e,
        across,
    )


def station_information(lin: Linearization) -> FloatArray:
    """(N, Q, Q) information of each station's images about (delta, direct constants), its own errors eliminated."""
    own, G = _eliminated_own(lin, 0.0), lin.views.information.copy()
    G[:, :6] = own.information
    G[:, 6:, :6] = np.swapaxes(own.information[:, :, 6:], 1, 2)
    J, sigma = lin.views.by_own, lin.own_sigmas
    A = (J * sigma[:, None, :] ** 2) @ np.swapaxes(J, 1, 2)
    across = lin.views.information[:, :6, 6:]
    G[:, 6:, 6:] -= np.swapaxes(across, 1, 2) @ A @ own.information[:, :, 6:]
    return G


def _summed(A: FloatArray, B: FloatArray) -> FloatArray:
    """Sum over n and q of A^T B: (n, q, P) and (n, q, R) → (P, R), as one matrix product."""
    rows = A.shape[0] * A.shape[1]
    product: FloatArray = A.reshape(rows, A.shape[2]).T @ B.reshape(rows, B.shape[2])
    return product


def _unseen_boards(lin: Linearization) -> IntArray:
    """Columns of the boards that no used image shows."""
    data = lin.data
    unseen = np.setdiff1d(
        np.arange(data.layout.boards), data.board[lin.inliers.used_corners.any(axis=(1, 2))]
    )
    return np.asarray(data.layout.named + (6 * unseen[:, None] + np.arange(6)).ravel(), dtype=np.int64)


def _process_terms(lin: Linearization, D: FloatArray, off: FloatArray, b: FloatArray) -> None:
    """Add the processes' innovations, see `processes`."""
    processes, at = lin.processes, np.arange(PROCESSES.start, PROCESSES.stop)
    i, j = lin.data.legs.T
    weight = 1 / processes.variance
    pull, rho = weight * processes.innovations(lin.state.processes), processes.rho[j]
    D[:, at, at] += weight
    D[i[:, None], at, at] += rho**2 * weight[j]
    off[i[:, None], at, at] -= rho * weight[j]
    b[:, PROCESSES] += pull
    b[i, PROCESSES] -= rho * pull[j]


def _weak_terms(lin: Linearization, D: FloatArray, b: FloatArray) -> None:
    """Keep the base blocks regular: the gauge, encoder errors, and bases that no measurement holds."""
    data, inliers = lin.data, lin.inliers
    first = data.first
    gauge = np.arange(BASE.start, BASE.stop)
    D[np.ix_(first, gauge, gauge)] += np.eye(3)
    lost = ~inliers.views
    lost[data.legs[~inliers.legs].ravel()] = True
    D[np.ix_(lost & ~first, gauge, gauge)] += np.eye(3) / FREE_BASE**2
    if data.base_width > STAMP:
        D[:, STAMP, STAMP] += lin.noise.stamp_s**-2
        b[:, STAMP] += lin.state.stamp_errors * lin.noise.stamp_s**-2
    encoders = np.arange(ENCODERS.start, ENCODERS.stop)
    if lin.noise.encoder_rad:
        information = lin.encoder_sigmas**-2
        D[:, encoders, encoders] += information
        b[:, ENCODERS] += lin.state.encoder_errors * information
        return
    D[:, encoders, encoders] = 1.0
