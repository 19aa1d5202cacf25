"""The normal equations with stations and boards eliminated: the cost is linear in the number of stations.

Joint errors and sway belong to one station each and go first, station by station. Base poses and the errors of the base
blocks form a chain along the legs. Then the board of each recording goes, recording by recording. A small dense system
for the shared parameters is left, however many recordings there are.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from typing import Self

import numpy as np

from mobilecal_cli.likelihood.dataset import Dataset
from mobilecal_cli.likelihood.linearization import Linearization, solvable
from mobilecal_cli.likelihood.measurements import BASE, ERRORS
from mobilecal_cli.likelihood.state import Step
from mobilecal_cli.likelihood.views import roots, summed
from mobilecal_cli.model.arrays import FloatArray, IntArray
from mobilecal_cli.model.solution import EXACT

_FREE_BASE = 1e2  # m, rad: sigma of a base pose that no measurement may hold
_AS_NOTHING = 1e-6  # of the information of a stated prior: rounding may be so large
_FREE_BOARD = 100.0  # m, rad: sigma of a board that no used image shows, which nothing else depends on


@dataclass(frozen=True, slots=True, eq=False)
class BlockTridiagonal:
    """A positive definite matrix of N x N blocks of size B that couples each station to the next only.

    The stations of a chain are eliminated one after the other; chains that nothing couples, as of several
    recordings, side by side. Given the next one, a station has the covariance S^-1, and the mean
    ``x = S^-1 r + after x_after``, where r is what the stations before leave of its right side.

    Attributes:
        inverse: (N, B, B) S^-1 of each.
        after: (N, B, B); the last is zero.
        places: the first stations of all chains, then the second ones, and so on.
    """

    inverse: FloatArray
    after: FloatArray
    places: tuple[int | IntArray, ...]

    @classmethod
    def of(cls, D: FloatArray, off: FloatArray) -> Self:
        """The matrix with some blocks.

        Args:
            D: (N, B, B) diagonal blocks.
            off: (N, B, B), off[i] couples i (rows) to i + 1 (columns); the last is not used.

        Raises:
            LinAlgError: not positive definite.
        """
        S, inverse, after, places = D.copy(), np.empty_like(D), np.zeros_like(D), _places(off)
        for number, at in enumerate(places):
            if number:
                before = at - 1
                after[before] = -inverse[before] @ off[before]
                S[at] += off[before].mT @ after[before]
            inverse[at] = np.linalg.inv(S[at])
        np.linalg.cholesky(S)
        return cls(inverse, after, places)

    def solve(self, right: FloatArray) -> FloatArray:
        """(N, B, R) right sides → (N, B, R)."""
        x = right.copy()
        for at in self.places[1:]:
            x[at] += self.after[at - 1].mT @ x[at - 1]
        x = self.inverse @ x
        for at in self.places[:0:-1]:
            x[at - 1] += self.after[at - 1] @ x[at]
        return np.asarray(x)

    def covariance(self) -> tuple[FloatArray, FloatArray]:
        """Blocks of the inverse on and next to its diagonal.

        Returns:
            (N, B, B) of each station, and (N, B, B) of each station with the next one (the last is zero).
        """
        own, cross = self.inverse.copy(), np.zeros_like(self.inverse)
        for at in self.places[:0:-1]:
            cross[at - 1] = self.after[at - 1] @ own[at]
            own[at - 1] += cross[at - 1] @ self.after[at - 1].mT
        return own, cross


def _places(off: FloatArray) -> tuple[int | IntArray, ...]:
    """Index or indices of the stations that have as many before them in their chain: none, one, and so on."""
    coupled = np.append(False, off[:-1].any(axis=(1, 2)))
    every = np.arange(len(off))
    place = every - np.maximum.accumulate(np.where(coupled, 0, every))
    order = np.argsort(place, kind="stable")
    together = np.split(order, np.flatnonzero(np.diff(place[order])) + 1)
    return tuple(int(at[0]) if len(at) == 1 else at for at in together)


@dataclass(frozen=True, slots=True, eq=False)
class NormalEquations:
    """Normal equations of the measurements, H d = -gradient, with stations and boards eliminated.

    Attributes:
        S: (P, P) information of the shared parameters, all others eliminated.
        s: (P,) their gradient, the same way.
        gain: decrease of the cost, to second order, by the best step of stations and boards alone.
        rest: the best step of all others, without one of the shared parameters.
        own_by_shared: (N, J + 3, P) derivative of the stations' own errors by the shared parameters, all else
            following.
        base_by_shared, board_by_shared: (N, B, P) and (logs, 6, P) those of the base blocks and of the boards.
        own_by_base: (N, J + 3, B) derivative of the stations' own errors by the base block, for a known board.
        own_by_board, base_by_board: (N, J + 3, 6) and (N, B, 6) by the board of the recording, all else following.
        own_covariance: (N, J + 3, J + 3) of the stations' own errors for a known rest.
        board_covariance: (logs, 6, 6) of the boards for known shared parameters.
        stations: information of the stations' base blocks.
    """

    S: FloatArray
    s: FloatArray
    gain: float
    rest: Step
    own_by_shared: FloatArray
    base_by_shared: FloatArray
    board_by_shared: FloatArray
    own_by_base: FloatArray
    own_by_board: FloatArray
    base_by_board: FloatArray
    own_covariance: FloatArray
    board_covariance: FloatArray
    stations: BlockTridiagonal

    def step(self, shared: FloatArray) -> Step:
        """The step of all unknowns that goes with a step (P,) of the shared parameters."""
        boards = self.rest.boards + self.board_by_shared @ shared
        base = self.rest.base + self.base_by_shared @ shared
        return Step(shared, boards, base, self.rest.own + self.own_by_shared @ shared)

    def after(self, shared: FloatArray) -> NormalEquations:
        """The same after the step of all unknowns that goes with a step (P,) of the shared parameters."""
        still = Step(*(np.zeros_like(getattr(self.rest, each.name)) for each in fields(Step)))
        return replace(self, s=self.s + self.S @ shared, gain=0.0, rest=still)


@solvable()
def eliminated(lin: Linearization, damping: float = 0.0) -> NormalEquations:
    """Build the normal equations of the measurements and eliminate the stations and the boards.

    With damping, each diagonal element grows by this share of itself (Levenberg-Marquardt).

    Raises:
        SolveError: a singular matrix.
    """
    data, views, legs, weight = lin.data, lin.views, lin.legs, lin.leg_weight
    count, P, B = data.stations, data.layout.size, data.base_width

    # Own errors: their covariance for a known rest, their gradient, and their information with all else.
    J, root = views.by_own, lin.own_sigmas / np.sqrt(1 + damping)
    across = J.mT @ views.rows[:, :6]
    M = np.eye(root.shape[1]) + root[:, :, None] * (across[:, :, :6] @ J) * root[:, None, :]
    E_inverse = root[:, :, None] * np.asarray(np.linalg.inv(M), dtype=np.float64) * root[:, None, :]
    e = np.einsum("nqj,nq->nj", J, views.pull[:, :6]) + lin.state.own / lin.own_sigmas**2
    E_base, E_board = across[:, :, :6] @ views.by_base, across[:, :, :6] @ views.by_board
    E_shared = views.onto_shared(across, views.by_shared)

    G, A = _without_own(lin, damping)
    # The gradients where own errors are at their best, which move the board by so much less.
    back = J @ (E_inverse @ e[..., None])
    gradient = views.pull[:, :6] - (views.rows[:, :6, :6] @ back)[..., 0]
    h = summed(views.by_shared, gradient[..., None])[:, 0]
    h[views.columns] += views.gradient.sum(axis=0) - summed(views.rows[:, :6, 6:], back)[:, 0]
    GS, GK = views.onto_shared(G, views.by_shared), G[:, :, :6] @ views.by_board
    # By the shared parameters, delta where own errors follow; its rows of the direct constants lack ``direct``.
    delta = views.by_shared.copy()
    delta[:, :, views.columns] = -A @ views.rows[:, :6, 6:]
    direct = views.direct.sum(axis=0)
    diagonal = np.einsum("nqp,nqp->p", delta, GS)
    diagonal[views.columns] += np.diag(direct)
    Bt, Kt = views.by_base.mT, views.by_board.mT
    D, C, CK = Bt @ (G[:, :, :6] @ views.by_base), Bt @ GS, Bt @ GK
    b = np.einsum("nqb,nq->nb", views.by_base, gradient)
    HK, hK = _by_log(data, Kt @ GK), _by_log(data, Kt @ gradient[..., None])
    HK += np.eye(6) / _FREE_BOARD**2  # a board that no used image shows stays where it is

    # Legs, which show few of the shared parameters.
    off = np.zeros((count, B, B))
    driven = np.flatnonzero(legs.by_shared.any(axis=(0, 1)))
    shared, We = legs.by_shared[:, :, driven], weight @ legs.residual[..., None]
    Ws, by_driven = weight @ shared, np.zeros((count, B, len(driven)))
    for ends, by in zip(data.legs.T, (legs.by_start, legs.by_end), strict=True):
        D[ends] += by.mT @ (weight @ by)  # a station starts one leg and ends one at most
        by_driven[ends] += by.mT @ Ws
        b[ends] += (by.mT @ We)[..., 0]
    off[data.legs[:, 0]] += legs.by_start.mT @ (weight @ legs.by_end)
    C[:, :, driven] += by_driven
    own = summed(shared, Ws)
    h[driven] += summed(shared, We)[:, 0]
    diagonal[driven] += np.diag(own)
    _prior_terms(lin, D, off, b)

    for matrix in (D, HK):
        of = np.arange(matrix.shape[-1])
        matrix[..., of, of] *= 1 + damping

    # The stations, then the boards.
    stations = BlockTridiagonal.of(D, off)
    solved = stations.solve(np.concatenate([C, CK, b[..., None]], axis=2))
    Y, YK, y = solved[:, :, :P], solved[:, :, P:-1], solved[:, :, -1:]
    CKt = CK.mT
    V = np.asarray(np.linalg.inv(HK - _by_log(data, CKt @ YK)), dtype=np.float64)
    SKS, sK = _by_log(data, Kt @ GS - CKt @ Y), hK - _by_log(data, CKt @ y)
    Z, z = V @ SKS, V @ sK
    S = summed(delta - views.by_base @ Y, GS)
    S[:, driven] -= summed(Y, by_driven)
    S[np.ix_(driven, driven)] += own
    S[np.ix_(views.columns, views.columns)] += direct
    S[views.columns] = S[:, views.columns].T
    S[np.diag_indices(P)] += damping * diagonal
    gain = float(np.einsum("nj,njk,nk->", e, E_inverse, e)) + float(np.sum(b * y[..., 0]))
    own_by_base = -E_inverse @ E_base
    base_by_shared, base = YK @ Z[data.log] - Y, YK @ z[data.log] - y
    own_rest = own_by_base @ base - E_inverse @ (e[..., None] - E_board @ z[data.log])
    return NormalEquations(
        S=_none_negative(
            S - summed(SKS, Z), (1 + damping) * diagonal, _AS_NOTHING * lin.priors.stated_weight
        ),
        s=h - summed(C, y)[:, 0] - summed(SKS, z)[:, 0],
        gain=gain + float(np.sum(sK * z)),
        rest=Step(np.zeros(P), -z[..., 0], base[..., 0], own_rest[..., 0]),
        own_by_shared=own_by_base @ base_by_shared - E_inverse @ (E_shared - E_board @ Z[data.log]),
        base_by_shared=base_by_shared,
        board_by_shared=-Z,
        own_by_base=own_by_base,
        own_by_board=-own_by_base @ YK - E_inverse @ E_board,
        base_by_board=-YK,
        own_covariance=E_inverse,
        board_covariance=V,
        stations=stations,
    )


def _none_negative(S: FloatArray, before: FloatArray, nothing: FloatArray) -> FloatArray:
    """Information (P, P) without what rounding made negative.

    With corners of a hundredth of a pixel, a direction that the images do not show is what the elimination leaves of
    numbers that are 10^13 times as large. It has the information of its prior then.

    Args:
        S: the information.
        before: (P,) its diagonal before the elimination.
        nothing: (P,) information about each parameter that makes no difference.

    Raises:
        LinAlgError: values that are too large, at a trial that is lost.
    """
    scale = np.sqrt(np.where(before > 0, before, 1.0))
    scaled = S / np.outer(scale, scale)
    try:
        np.linalg.cholesky(scaled + np.diag(nothing / scale**2))
        return S
    except np.linalg.LinAlgError:
        values, vectors = np.linalg.eigh(scaled)
    negative = values < 0
    lost = scale[:, None] * vectors[:, negative] * np.sqrt(-values[negative])
    with np.errstate(over="ignore"):
        mended = np.asarray(S + lost @ lost.T)
    if not np.all(np.isfinite(mended)):
        raise np.linalg.LinAlgError("too large to be solved")  # a trial that is lost
    return mended


def _by_log(data: Dataset, values: FloatArray) -> FloatArray:
    """Sums over the stations of each recording: (N, ...) → (logs, ...)."""
    out = np.zeros((data.logs, *values.shape[1:]))
    starts = np.flatnonzero(np.diff(data.log, prepend=-1))
    out[data.log[starts]] = np.add.reduceat(values, starts, axis=0)
    return out


def _without_own(
    lin: Linearization, damping: float = 0.0, beside: FloatArray | float = 0.0
) -> tuple[FloatArray, FloatArray]:
    """Eliminate each station's own errors from the information without cancellation.

    They move the board in the camera by A = J P J^T, with their prior covariance P. The corners' information G = R R^T
    about delta becomes (G^-1 + A)^-1 = R (I + R^T A R)^-1 R^T. The usual G - G J (P^-1 + J^T G J)^-1 J^T G is the
    difference of two matrices that agree to all digits where the corners are much better than the joints.

    Args:
        lin, damping: see `eliminated`.
        beside: see `station_rows`.

    Returns:
        (N, 6, Q) information of delta with (delta, direct constants), and (N, 6, 6) A.
    """
    views, J, P = lin.views, lin.views.by_own, lin.own_sigmas**2 / (1 + damping)
    A = (J * P[:, None]) @ J.mT + beside
    root, inverse = roots(views.rows[:, :6, :6])
    return root @ (np.linalg.inv(np.eye(6) + root.mT @ A @ root) @ (inverse @ views.rows[:, :6])), A


def station_rows(lin: Linearization, beside: FloatArray | float = 0.0) -> FloatArray:
    """(N, T, Q) rows of each station's information at its traced unknowns, its own errors eliminated.

    Args:
        lin: the point.
        beside: (N, 6, 6) covariance of whatever else moves the board in the camera.
    """
    G, A = _without_own(lin, beside=beside)
    further = lin.views.rows[:, 6:]
    further = further - further[:, :, :6] @ (A @ G)
    further[:, :, :6] = G[:, :, lin.views.traced[6:]].mT
    return np.concatenate([G, further], axis=1)


def _prior_terms(lin: Linearization, D: FloatArray, off: FloatArray, b: FloatArray) -> None:
    """Add the errors' innovations, see `processes`, the gauge, and bases that no measurement holds."""
    data, inliers, processes, first = lin.data, lin.inliers, lin.processes, lin.data.first
    at, gauge = np.arange(data.base_width)[ERRORS], np.arange(data.base_width)[BASE]
    i, j = data.legs.T
    weight, rho = 1 / processes.variance, processes.rho[j]
    pull = weight * processes.innovations(lin.state.base[:, ERRORS])
    D[:, at, at] += weight
    D[i[:, None], at, at] += rho**2 * weight[j]
    off[i[:, None], at, at] -= rho * weight[j]
    b[:, ERRORS] += pull
    b[i, ERRORS] -= rho * pull[j]
    D[np.ix_(first, gauge, gauge)] += np.eye(3) / EXACT**2
    lost = ~inliers.views
    lost[data.legs[~inliers.legs].ravel()] = True
    D[np.ix_(lost & ~first, gauge, gauge)] += np.eye(3) / _FREE_BASE**2
