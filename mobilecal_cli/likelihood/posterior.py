"""What the likelihood says of the parameters at one point: normal equations, covariances, steps.

And covariances of the predicted measurements, for redundancies and for outlier tests; and the directions of the shared
parameters that the measurements show.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Self

import numpy as np

from mobilecal_cli.kinematics import unseen_height
from mobilecal_cli.likelihood.constants import WHEEL_SIGMA
from mobilecal_cli.likelihood.linearization import Linearization, solvable
from mobilecal_cli.likelihood.measurements import ERRORS
from mobilecal_cli.likelihood.normal import NormalEquations, eliminated, station_rows
from mobilecal_cli.likelihood.state import Step
from mobilecal_cli.likelihood.views import summed
from mobilecal_cli.model.arrays import BoolArray, FloatArray
from mobilecal_cli.model.calibration import NINE

_SCATTERS = 5.0  # of what noise alone would show, in its standard deviations
_UPRIGHT = 0.5  # length of what is free of the vertical, beyond which the height is free


class Posterior(Linearization):
    """The likelihood at one point with its normal equations solved.

    What follows from it are functions: `budget`, `evidence`, `jumps`, `residual_tests`, `suggest`.
    """

    @cached_property
    def normal(self) -> NormalEquations:
        """The normal equations without damping."""
        return eliminated(self)

    @cached_property
    def station_rows(self) -> FloatArray:
        """(N, T, Q) see `normal.station_rows`."""
        return station_rows(self)

    @cached_property
    def information(self) -> FloatArray:
        """(P, P) information of the shared parameters, priors included."""
        return np.asarray(self.normal.S + np.diag(self.priors.weight))

    @cached_property
    def conditional_covariance(self) -> FloatArray:
        """(P, P) covariance of the shared parameters for correct values along all directions that keep their mean."""
        reduced = self.priors.reduced(self.information)
        with solvable():
            if not np.all(np.diag(reduced) > 0):
                raise np.linalg.LinAlgError("not positive definite")
            scale = 1 / np.sqrt(np.diag(reduced))
            inverse = np.linalg.inv(reduced * np.outer(scale, scale)) * np.outer(scale, scale)
        return self.priors.spread(inverse)

    @cached_property
    def considered(self) -> FloatArray:
        """(P, K) errors of the shared parameters by one prior sigma along each unobservable direction."""
        return self.priors.considered(self.information, self.conditional_covariance)

    @cached_property
    def covariance(self) -> FloatArray:
        """(P, P) of the shared parameters. Unobservable directions keep their prior variance."""
        return self.conditional_covariance + self.considered @ self.considered.T

    @cached_property
    def delta_by_shared(self) -> FloatArray:
        """(N, 6, P) each station's board pose in the camera by the shared parameters, all else following.

        What follows does so as the measurements make it: so residuals pull at the shared parameters, all else
        eliminated.
        """
        normal, views = self.normal, self.views
        delta = views.by_base @ normal.base_by_shared + views.by_own @ normal.own_by_shared
        delta += views.by_board @ normal.board_by_shared[self.data.log]
        return np.asarray(delta + views.by_shared)

    @cached_property
    def legs_by_shared(self) -> FloatArray:
        """(L, K, P) the legs' residuals by the shared parameters, all else following."""
        base, legs, (i, j) = self.normal.base_by_shared, self.legs, self.data.legs.T
        return np.asarray(legs.by_start @ base[i] + legs.by_end @ base[j] + legs.by_shared)

    @cached_property
    def base_covariance(self) -> tuple[FloatArray, FloatArray]:
        """Covariances of the base blocks for known boards and shared parameters, see `BlockTridiagonal.covariance`."""
        return self.normal.stations.covariance()

    @cached_property
    def marginals(self) -> Marginals:
        """Covariances of the predicted measurements."""
        return marginals(self)

    @cached_property
    def of_images(self) -> FloatArray:
        """(P, P) information of the images about the shared parameters where all other unknowns follow."""
        views, delta = self.views, self.delta_by_shared
        rows, columns = views.rows[:, :6], views.columns
        total = summed(delta, views.onto_shared(rows, delta))
        total[columns] += summed(rows[:, :, 6:], delta)
        total[np.ix_(columns, columns)] += views.direct.sum(axis=0)
        return total

    @solvable()
    def spread_in_images(self, A: FloatArray) -> FloatArray:
        """(N, k, k) covariance of sums A (N, k, Q) of each station's (delta, direct constants).

        Raises:
            SolveError: beyond all numbers, far off.
        """
        by_shared = self.views.onto_shared(A, self.delta_by_shared)
        with np.errstate(over="raise"):
            known = _sandwich(A[:, :, :6], self.marginals.known)
            return known + _sandwich(by_shared, self.conditional_covariance)

    def extrapolated(self, step: Step) -> Self:
        """The likelihood after an undamped step, all to first order: residuals follow, derivatives stay."""
        known = {
            "images": self.images.moved(step),
            "legs": self.legs.moved(self.data, step),
            "normal": self.normal.after(step.shared),
            "conditional_covariance": self.conditional_covariance,
        }
        return self.changed(known=known, state=self.state.plus(step))


@dataclass(frozen=True, slots=True, eq=False)
class Marginals:
    """Posterior covariances at an optimum.

    Attributes:
        known: (N, 6, 6) of each station's board pose in the camera (delta), for known shared parameters.
        own: (N, J + 3, J + 3) of the joint errors and of the sway.
        legs: (L, 3, 3) of the legs' residuals.
        errors: (N, K, K) of the base blocks' errors.
        before: (N, K, K) of these at the station before (rows) with those here; 0 for a first station.
    """

    known: FloatArray
    own: FloatArray
    legs: FloatArray
    errors: FloatArray
    before: FloatArray

    def innovations(self, rho: FloatArray) -> FloatArray:
        """(N, K, K) of the errors' innovations f_j - rho f_i; rho: (N, K)."""
        mixed = rho[:, :, None] * self.before
        out: FloatArray = self.errors - mixed - mixed.mT
        return out + rho[:, :, None] * np.roll(self.errors, 1, axis=0) * rho[:, None, :]


def over_redundancy(residual: FloatArray, left: FloatArray, least: float) -> FloatArray:
    """(n, m) residuals times the inverse roots of their redundancies (n, m, m), 0 along what is not above `least`."""
    values, vectors = np.linalg.eigh(left)
    usable = values > least
    root = np.where(usable, 1 / np.sqrt(np.where(usable, values, 1.0)), 0.0)
    along = root * np.einsum("nkm,nk->nm", vectors, residual)
    return np.asarray((vectors @ along[..., None])[..., 0])


def _by_errors(
    lin: Posterior, by_own: FloatArray, by_board: FloatArray | float
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Delta, or a part of it, by the base blocks, the stations' own errors and the board, all else following.

    Args:
        lin: the point.
        by_own, by_board: its derivatives by the stations' own errors and by the board.
    """
    normal, by_base = lin.normal, lin.views.by_base
    followed = by_base @ normal.base_by_board + by_own @ normal.own_by_board
    return by_base + by_own @ normal.own_by_base, by_own, followed + by_board


def moved_with(lin: Posterior, joints: BoolArray) -> FloatArray:
    """(N, 6, 6) covariance of delta (rows) with the part of it (columns) by base, stance and some joints (J,).

    For known shared parameters.
    """
    normal, of = lin.normal, np.append(joints, [True] * 3)
    covariances = lin.base_covariance[0], normal.own_covariance, normal.board_covariance[lin.data.log]
    delta = _by_errors(lin, lin.views.by_own, lin.views.by_board)
    part = _by_errors(lin, lin.views.by_own * of, 0.0)
    return np.asarray(sum(A @ C @ B.mT for A, C, B in zip(delta, covariances, part, strict=True)))


def _sandwich(A: FloatArray, C: FloatArray) -> FloatArray:
    """(n, m, m) A C A^T; C is (n, P, P), or the same (P, P) for all."""
    return (A @ C if C.ndim > 2 else np.tensordot(A, C, 1)) @ A.mT


@solvable()
def marginals(lin: Posterior) -> Marginals:
    """Marginal covariances of every station and leg, given correct values along unobservable directions.

    Raises:
        SolveError: a singular matrix.
    """
    normal, C = lin.normal, lin.conditional_covariance
    with_board, by_base = normal.base_by_board, normal.own_by_base
    views, legs, log = lin.views, lin.legs, lin.data.log
    # The board of a recording is one unknown of all its stations: their covariance for a known board comes first.
    V = normal.board_covariance[log]
    known, cross = lin.base_covariance[0], lin.base_covariance[1].copy()
    own = known + _sandwich(with_board, V)
    cross[:-1] += with_board[:-1] @ V[:-1] @ with_board[1:].mT

    by_errors = zip(
        _by_errors(lin, views.by_own, views.by_board), (known, normal.own_covariance, V), strict=True
    )
    of_views = np.asarray(sum(_sandwich(A, covariance) for A, covariance in by_errors))
    errors = normal.own_covariance + _sandwich(by_base, known) + _sandwich(normal.own_by_board, V)
    i, j = lin.data.legs.T
    of_base = normal.base_by_shared[:, ERRORS]
    along, transposed = np.tensordot(of_base, C, 1), of_base.mT
    of_errors, before = own[:, ERRORS, ERRORS] + along @ transposed, np.zeros_like(along @ transposed)
    before[j] = cross[i, ERRORS, ERRORS] + along[i] @ transposed[j]
    mixed = legs.by_start @ cross[i] @ legs.by_end.mT
    both = _sandwich(legs.by_start, own[i]) + _sandwich(legs.by_end, own[j])
    return Marginals(
        known=of_views,
        own=errors + _sandwich(normal.own_by_shared, C),
        legs=both + mixed + mixed.mT + _sandwich(lin.legs_by_shared, C),
        errors=of_errors,
        before=before,
    )


@solvable()
def directions(lin: Posterior, user_weight: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Singular directions of the information about the nine, the constants (with their priors) eliminated.

    Noisy readings look like a little motion: a leg without a turn seems to turn by as much as its noise, and so seems
    to show the separation to 100 %. Over n such legs that makes a squared singular value of ``WHEEL_SIGMA^2 n`` of the
    wheels' share of a direction, with a scatter of ``WHEEL_SIGMA^2 sqrt(2 n)``. A direction is observable if it shows
    more than this, and five times the scatter, and a drawing.

    The height of a camera that never tilts is none: only its lever shows it where the base leans, and what turns it in
    its mount, or the base on springs, shows another lever.

    Args:
        lin: where.
        user_weight: (P,) inverse variances of priors that count as measurements: the user's, and the constants'.

    Returns:
        (9,) falling singular values: prior sigma of a nominal value over standard deviation along each direction of
        the free parameters; and the unobservable directions, (K, 9) rows, orthonormal in units of these sigmas: of
        which the measurements show less than a drawing, or no more than their noise alone would.

    Raises:
        SolveError: the constants are not determined.
    """
    nine = len(NINE)
    scales, fixed = lin.priors.scales[:nine], lin.priors.fixed
    S = lin.normal.S + np.diag(user_weight)
    others = nine + np.flatnonzero(~fixed[nine:])
    own = np.diag(S)[others]
    unit = 1 / np.sqrt(np.where(own > 0, own, 1.0))  # far from the optimum, rounding may exceed what is known
    across = S[:nine, others] * unit
    inner = S[np.ix_(others, others)] * np.outer(unit, unit)
    reduced = S[:nine, :nine] - across @ np.linalg.solve(inner, across.T)
    reduced = reduced * np.outer(scales, scales)
    kept, height = np.eye(nine)[:, ~fixed[:nine]], _unseen_height(lin)
    if height is not None:
        reduced -= np.outer(height, height @ reduced)
        reduced -= np.outer(reduced @ height, height)
    values, vectors = np.linalg.eigh(kept.T @ reduced @ kept)
    order = np.argsort(-values)
    singular = np.sqrt(np.maximum(values[order], 0.0))
    along = (kept @ vectors[:, order]).T
    legs = len(lin.data.legs)
    by_noise = WHEEL_SIGMA**2 * (legs + _SCATTERS * np.sqrt(2 * legs))
    least = np.sqrt(1 + by_noise * np.sum(along[:, 6:] ** 2, axis=1))
    return singular, along[singular < least]


def _unseen_height(lin: Posterior) -> FloatArray | None:
    """(9,) direction of the height of a camera that never tilts; None if it tilts, or if the user fixed its height."""
    vertical = unseen_height(lin.data.chain)
    if vertical is None:
        return None
    free = np.where(lin.priors.fixed[3:6], 0.0, vertical)
    length = float(np.linalg.norm(free))
    return np.concatenate([np.zeros(3), free / length, np.zeros(3)]) if length > _UPRIGHT else None
