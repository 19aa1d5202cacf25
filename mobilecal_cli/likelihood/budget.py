"""How each kind of measurement moves the shared parameters: error budget, jackknife from the residuals, and bias."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from itertools import chain

import numpy as np

from mobilecal_cli.likelihood.corners import blocks_of
from mobilecal_cli.likelihood.legs import SUPPOSED
from mobilecal_cli.likelihood.measurements import ERRORS, JOINTS, SWAY
from mobilecal_cli.likelihood.normal import roots
from mobilecal_cli.likelihood.posterior import Posterior, over_redundancy
from mobilecal_cli.likelihood.processes import LENGTHS
from mobilecal_cli.likelihood.views import images_of, summed
from mobilecal_cli.model import NINE, FloatArray, IntArray

_NO_REDUNDANCY = 1e-6
#: The constant that stands for the size of the world in the images.
_SIZE = "square_scale"
_HEIGHTS = ("floor_m", "sway_m")


@dataclass(frozen=True, eq=False)
class Influence:
    """One kind of measurement at an optimum, in units whose noise is independent: stations, or legs.

    Attributes:
        lin: the optimum.
        residual: (n, m) whitened residuals of each unit.
        leverage: (n, m, m) each unit's block of the hat matrix.
        parts: noise level (see `Noise`) → (n or 1, m, m) its share of the residuals' covariance, the identity.
        gradients: gives (n, P, m) gradients of the shared parameters by each unit's residuals, all else eliminated.
        share: (n, m) of the noise level in the variance of each residual, 0 of outliers; the rest is of readings that
            are interpolated.
    """

    lin: Posterior
    residual: FloatArray
    leverage: FloatArray
    parts: Mapping[str, FloatArray]
    gradients: Callable[[], FloatArray]
    share: FloatArray | float = 1.0

    @cached_property
    def onto_shared(self) -> FloatArray:
        """(n, P, m) see `gradients`."""
        return self.gradients()

    def shown(self, level: str) -> tuple[FloatArray, FloatArray]:
        """(m,) sums of squares of the residuals of a noise level, and (m,) how many of them are redundant."""
        part = self.parts[level]
        squares = self.share * self.residual * (part @ self.residual[..., None])[..., 0]
        left = self.share * np.sum(part * (np.eye(self.residual.shape[1]) - self.leverage), axis=2)
        return squares.sum(axis=0), left.sum(axis=0)

    @property
    def covariances(self) -> Mapping[str, FloatArray]:
        """Noise level → (P, P) covariance of the shared parameters due to it, if it is correct."""
        C, onto = self.lin.conditional_covariance, self.onto_shared
        return {level: C @ summed((onto @ part).mT, onto.mT) @ C for level, part in self.parts.items()}

    @property
    def spread(self) -> FloatArray:
        """(P, P) the same from the residuals' scatter: sum over units of (K (I - h)^-1/2 r)(...)^T, K derivatives."""
        left = np.eye(self.residual.shape[1]) - self.leverage
        pull = (self.onto_shared @ over_redundancy(self.residual, left, _NO_REDUNDANCY)[..., None])[..., 0]
        C = self.lin.conditional_covariance
        return np.asarray(C @ (pull.T @ pull) @ C)


@dataclass(frozen=True, slots=True, eq=False)
class Moved:
    """How all measurements move the shared parameters.

    Attributes:
        covariances: noise level → (P, P) covariance due to it, if it is correct.
        spread: (P, P) the same of all, from the residuals' scatter, see `Influence.spread`.
    """

    covariances: Mapping[str, FloatArray]
    spread: FloatArray


def moved(lin: Posterior) -> Moved:
    """Sums over images, errors of the stations, see `of_errors`, and wheels, at an optimum."""
    spread = np.zeros_like(lin.covariance)
    covariances = defaultdict[str, FloatArray](lambda: np.zeros_like(spread))
    covariances.update(_by_images(lin))
    for influence in chain(_of_images(lin), of_errors(lin, lin.state.base[:, ERRORS]), [of_legs(lin)]):
        for level, covariance in influence.covariances.items():
            covariances[level] += covariance
        spread += influence.spread
    return Moved(covariances, spread)


def of_errors(lin: Posterior, errors: FloatArray) -> Iterator[Influence]:
    """Of joint readings and sway, and of the base blocks' errors (N, K): encoders, floor, wheel scales, stamps."""
    data, sigma, marginal, processes = lin.data, lin.own_sigmas, lin.marginals, lin.processes
    stations = np.arange(data.stations)
    used = np.broadcast_to(lin.inliers.views[:, None], sigma.shape).copy()
    used[:, JOINTS] &= lin.inliers.readings
    used[:, SWAY] &= data.drives[:, None]
    share = used.astype(np.float64)
    share[:, JOINTS] *= (lin.noise.joint_rad * data.joint_units / sigma[:, JOINTS]) ** 2
    root = np.where(used, 1 / sigma, 0.0)
    of_joints = {"joint_rad": np.eye(data.joints.shape[1])[None]}
    for columns, parts in ((JOINTS, of_joints), (SWAY, _by_level(["sway_rad", "sway_rad", "sway_m"]))):
        at = _diagonal(root)[:, :, columns]
        leverage = at.mT @ marginal.own @ at
        onto = partial(lin.normal.onto_shared, stations, own=at)
        residual = (lin.state.own * root)[:, columns]
        yield Influence(lin, residual, leverage, parts, onto, share[:, columns])
    root = 1 / np.sqrt(processes.variance)
    leverage = _diagonal(root) @ marginal.innovations(processes.rho) @ _diagonal(root)
    leverage[:, 0, 1] = leverage[:, 1, 0] = (
        0.0  # each of a station's two encoder readings is a unit by itself
    )
    here, before = np.zeros((2, data.stations, data.base_width, root.shape[1]))
    here[:, ERRORS], before[:, ERRORS] = _diagonal(root), -_diagonal(processes.rho * root)
    residual = processes.innovations(errors) * root
    for group in ({"encoder_rad"}, {*LENGTHS}, {"stamp_s"}):
        mine = [k for k, level in enumerate(processes.levels) if level in group]
        yield Influence(
            lin,
            residual[:, mine],
            leverage[:, mine][:, :, mine],
            _by_level([processes.levels[k] for k in mine]),
            partial(_of_innovations, lin, here[:, :, mine], before[:, :, mine]),
            processes.share[:, mine],
        )


def _of_innovations(lin: Posterior, here: FloatArray, before: FloatArray) -> FloatArray:
    """`Influence.gradients` by a station's base block and by that of the one before, (N, B, m) each."""
    stations, onto = np.arange(lin.data.stations), lin.normal.onto_shared
    return onto(stations, here) + onto(np.roll(stations, 1), before)


def _diagonal(values: FloatArray) -> FloatArray:
    """(N, K) → (N, K, K) diagonal matrices."""
    return np.asarray(values[:, :, None] * np.eye(values.shape[1]))


def _by_level(levels: Sequence[str]) -> dict[str, FloatArray]:
    """Noise level → (1, m, m) its share in residuals of m levels."""
    return {
        level: np.diag([float(level == other) for other in levels])[None] for level in dict.fromkeys(levels)
    }


def _by_images(lin: Posterior) -> dict[str, FloatArray]:
    """Noise level → (P, P) covariance of the shared parameters due to the images' noise, if it is correct."""
    C, views = lin.conditional_covariance, lin.views
    every, (_, _, Q) = np.arange(lin.data.stations), views.rows.shape
    T = _of_views(
        lin, every, np.broadcast_to(np.eye(Q)[:, :6], (len(every), Q, 6))
    ).mT  # delta by the shared ones
    G = views.rows[:, :6, :6] @ T
    G[:, :, views.columns] += views.rows[:, :6, 6:]
    total = summed(T, G)
    total[views.columns] += summed(views.rows[:, :6, 6:], T)
    total[np.ix_(views.columns, views.columns)] += views.direct.sum(axis=0)
    of_level = {level: np.zeros_like(C) for level, _ in views.own}
    for k, (level, variance) in views.own_variances(lin.noise).items():
        by_own = (views.rows[:, k, None, :6] @ T)[:, 0]
        by_own[:, views.columns] += views.rows[:, k, 6:]
        of_level[level] += variance * by_own.T @ by_own
    of_level[lin.data.images_level] = total - sum(of_level.values())
    return {level: C @ information @ C for level, information in of_level.items()}


def _of_images(lin: Posterior) -> Iterator[Influence]:
    """Of corners, or of measured poses, without their parts, see `_by_images`; some stations at once."""
    every = np.arange(lin.data.stations)
    for block in blocks_of(len(every)):
        stations = every[block]
        images = images_of(lin.state, lin.inliers, lin.noise, lin.rates, stations)
        gradient = np.concatenate([images.pull[:, :6], images.gradient], axis=1)
        root, inverse = roots(images.information)
        yield Influence(
            lin,
            (inverse @ gradient[..., None])[..., 0],
            root.mT @ lin.marginals.images(stations) @ root,
            {},
            partial(_of_views, lin, stations, root),
        )


def _of_views(lin: Posterior, stations: IntArray, root: FloatArray) -> FloatArray:
    """`Influence.gradients` of some stations' images with roots (n, Q, Q) of their information."""
    views = lin.views
    base, own, board = (
        part[stations].mT @ root[:, :6] for part in (views.by_base, views.by_own, views.by_board)
    )
    return lin.normal.onto_shared(stations, base, own, board, views.onto_shared(root.mT, stations).mT)


def of_legs(lin: Posterior) -> Influence:
    """Of the legs' wheels, and of a planar sensor."""
    root, _ = roots(lin.leg_weight)
    return Influence(
        lin,
        (root.mT @ lin.legs.residual[..., None])[..., 0],
        root.mT @ lin.marginals.legs @ root,
        {level: root.mT @ share @ root for level, share in lin.leg_covariances.items()},
        partial(_of_ends, lin, root),
    )


def _of_ends(lin: Posterior, root: FloatArray) -> FloatArray:
    """`Influence.gradients` of legs with roots (L, K, K) of their weight."""
    legs, (i, j) = lin.legs, lin.data.legs.T
    start, end, shared = (by.mT @ root for by in (legs.by_start, legs.by_end, legs.by_shared))
    return lin.normal.onto_shared(i, start, shared=shared) + lin.normal.onto_shared(j, end)


def shares(lin: Posterior, by: Moved) -> Mapping[str, FloatArray]:
    """Source → (P, P) share of the covariance of the shared parameters; the shares add up to it.

    With C = H^-1 and H the sum of J_s^T W_s J_s over the sources s, C is the sum of C J_s^T W_s J_s C. Joint readings
    that are outliers and bases that no measurement holds count as a source of their own ("other"). The others are noise
    levels, kinds of constants for their priors, "nominal" for those of the nine parameters, and "unobservable" for the
    prior variance of unobservable directions.
    """
    C, layout = lin.conditional_covariance, lin.data.layout
    result = defaultdict[str, FloatArray](lambda: np.zeros_like(C))
    for level, covariance in by.covariances.items():
        result["wheel_rad_per_sqrt_rad" if level == SUPPOSED else level] += covariance
    for k, kind in enumerate(["nominal"] * len(NINE) + [row.kind for row in layout.constants]):
        if lin.priors.weight[k]:
            result[kind] += lin.priors.weight[k] * np.outer(C[:, k], C[:, k])
    result["unobservable"] += lin.considered @ lin.considered.T
    result["other"] += lin.covariance - sum(result.values())
    return result


def expected_gradient(lin: Posterior) -> FloatArray:
    """(P,) gradient that half the sum of squares is expected to have at the true parameters.

    If the whole world shrinks, the images stay; what the wheels miss by and the heights of floor and sway
    shrink, and half their sum of squares falls, whatever the size of the world. The best values of the stations'
    unknowns make it least. In the likelihood of the other parameters alone, these integrated out, half the logarithm of
    the determinant of their information makes up for it (Laplace's approximation): its derivative is minus the number
    of these residuals, less what the unknowns take up. Without noise they are zero, and so is the gradient.

    With 2,000 stations, a square size that is stated to 0.1 % would come out 1.5 of these sigmas too small.
    """
    bias = np.zeros(lin.data.layout.size)
    if _SIZE in lin.data.layout.names:
        W, left = lin.leg_weight[:, :2], lin.leg_covariance - lin.marginals.legs
        squares = float(np.einsum("la,lab,lb->", lin.legs.residual[:, :2], W, lin.legs.residual))
        redundancy = float(np.einsum("lab,lba->", W, left[:, :, :2]))
        for each in of_errors(lin, lin.state.base[:, ERRORS]):
            for level in filter(_HEIGHTS.__contains__, each.parts):
                of_level, free = each.shown(level)
                squares, redundancy = squares + float(of_level.sum()), redundancy + float(free.sum())
        # Far from the optimum, rounding is all.
        redundancy = min(max(redundancy, 0.0), 2.0 * (len(left) + lin.data.stations))
        bias[lin.data.layout.names.index(_SIZE)] = min(squares, redundancy)
    return bias
