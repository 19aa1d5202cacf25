"""How each kind of measurement moves the shared parameters: error budget, jackknife from the residuals, and bias."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mobilecal_cli.likelihood.corners import blocks_of
from mobilecal_cli.likelihood.effects import ChainEffect
from mobilecal_cli.likelihood.legs import SUPPOSED
from mobilecal_cli.likelihood.measurements import ERRORS, JOINTS, SWAY
from mobilecal_cli.likelihood.posterior import Posterior, moved_with, over_redundancy
from mobilecal_cli.likelihood.processes import LENGTHS
from mobilecal_cli.likelihood.views import of_each_image, roots, summed, whitened_rows
from mobilecal_cli.model.arrays import BoolArray, FloatArray, IntArray
from mobilecal_cli.model.calibration import NINE
from mobilecal_cli.model.rig import JointLink

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
        by_shared: (n, m, P) derivatives of the residuals by the shared parameters, all else following.
        share: (n, m) of the noise level in the variance of each residual, 0 of outliers; the rest is of readings that
            are interpolated.
    """

    lin: Posterior
    residual: FloatArray
    leverage: FloatArray
    parts: Mapping[str, FloatArray]
    by_shared: FloatArray
    share: FloatArray | float = 1.0

    def shown(self, level: str) -> tuple[FloatArray, FloatArray]:
        """(m,) sums of squares of the residuals of a noise level, and (m,) how many of them are redundant."""
        part = self.parts[level]
        squares = self.share * self.residual * (part @ self.residual[..., None])[..., 0]
        left = self.share * np.sum(part * (np.eye(self.residual.shape[1]) - self.leverage), axis=2)
        return squares.sum(axis=0), left.sum(axis=0)

    @property
    def covariances(self) -> Mapping[str, FloatArray]:
        """Noise level → (P, P) covariance of the shared parameters due to it, if it is correct."""
        C, K = self.lin.conditional_covariance, self.by_shared
        return {level: C @ summed(part @ K, K) @ C for level, part in self.parts.items()}

    @property
    def spread(self) -> FloatArray:
        """(P, P) the same from the residuals' scatter: sum over units of (K (I - h)^-1/2 r)(...)^T, K derivatives."""
        left = np.eye(self.residual.shape[1]) - self.leverage
        return _scatter(self.lin, self.residual, left, self.by_shared)


def _scatter(lin: Posterior, residual: FloatArray, left: FloatArray, by_shared: FloatArray) -> FloatArray:
    """`Influence.spread` of units with residuals (n, m), redundancies (n, m, m) and derivatives (n, m, P)."""
    pull = (over_redundancy(residual, left, _NO_REDUNDANCY)[:, None] @ by_shared)[:, 0]
    C = lin.conditional_covariance
    return np.asarray(C @ (pull.T @ pull) @ C)


def covariances(lin: Posterior) -> Mapping[str, FloatArray]:
    """Noise level → (P, P) covariance of the shared parameters due to it, if it is correct, at an optimum."""
    total = defaultdict[str, FloatArray](lambda: np.zeros_like(lin.covariance))
    total.update(_by_images(lin))
    for influence in _but_images(lin):
        for level, covariance in influence.covariances.items():
            total[level] += covariance
    return total


def spread(lin: Posterior) -> FloatArray:
    """(P, P) the same of all noise, from the residuals' scatter, see `Influence.spread`."""
    return _spread_by_images(lin) + sum(influence.spread for influence in _but_images(lin))


def _but_images(lin: Posterior) -> Iterator[Influence]:
    """Errors of the stations, and wheels."""
    yield from of_errors(lin, lin.state.base[:, ERRORS])
    yield of_legs(lin)


def of_errors(lin: Posterior, errors: FloatArray) -> Iterator[Influence]:
    """Of joint readings and sway, and of the base blocks' errors (N, K): encoders, floor, wheel scales, stamps."""
    data, sigma, marginal, processes = lin.data, lin.own_sigmas, lin.marginals, lin.processes
    used = np.broadcast_to(lin.inliers.views[:, None], sigma.shape).copy()
    used[:, JOINTS] &= lin.inliers.readings
    used[:, SWAY] &= data.drives[:, None]
    share = used.astype(np.float64)
    share[:, JOINTS] *= (lin.noise.joint_rad * data.joint_units / sigma[:, JOINTS]) ** 2
    root = np.where(used, 1 / sigma, 0.0)
    of_joints = {"joint_rad": np.eye(data.joints.shape[1])[None]}
    residual, by_shared = lin.state.own * root, root[:, :, None] * lin.normal.own_by_shared
    for columns, parts in ((JOINTS, of_joints), (SWAY, _by_level(["sway_rad", "sway_rad", "sway_m"]))):
        at = _diagonal(root)[:, :, columns]
        leverage = at.mT @ marginal.own @ at
        yield Influence(lin, residual[:, columns], leverage, parts, by_shared[:, columns], share[:, columns])
    root = 1 / np.sqrt(processes.variance)
    leverage = _diagonal(root) @ marginal.innovations(processes.rho) @ _diagonal(root)
    leverage[:, 0, 1] = leverage[:, 1, 0] = (
        0.0  # each of a station's two encoder readings is a unit by itself
    )
    residual = processes.innovations(errors) * root
    by_shared = root[:, :, None] * processes.innovations(lin.normal.base_by_shared[:, ERRORS])
    for group in ({"encoder_rad"}, {*LENGTHS}, {"stamp_s"}):
        mine = [k for k, level in enumerate(processes.levels) if level in group]
        yield Influence(
            lin,
            residual[:, mine],
            leverage[:, mine][:, :, mine],
            _by_level([processes.levels[k] for k in mine]),
            by_shared[:, mine],
            processes.share[:, mine],
        )


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
    C, views, T = lin.conditional_covariance, lin.views, lin.delta_by_shared
    of_level = {level: np.zeros_like(C) for level, _ in views.own}
    for k, (level, variance) in views.own_variances(lin.noise).items():
        by_own = views.onto_shared(views.rows[:, k : k + 1], T)[:, 0]
        of_level[level] += variance * by_own.T @ by_own
    of_level[lin.data.images_level] = lin.of_images - sum(of_level.values())
    return {level: C @ information @ C for level, information in of_level.items()}


def _spread_by_images(lin: Posterior) -> FloatArray:
    """(P, P) `Influence.spread` of the images, or of measured poses: each station's are a unit.

    Of sharp corners, the pose and the constants are known far better together than one by one: only products of roots
    keep the digits that are left.
    """
    every, total = np.arange(lin.data.stations), np.zeros_like(lin.covariance)
    priors, columns, level = lin.priors, lin.views.columns, getattr(lin.noise, lin.data.images_level)
    C_root = priors.from_free(np.linalg.inv(np.linalg.cholesky(priors.reduced(lin.information))).T)
    for block in blocks_of(lin.data):
        parts = []
        for of, A, r in whitened_rows(lin.state, lin.inliers, lin.rates, every[block]):
            A, r = _with_own(lin, of, A / level, r / level)
            K = A[:, :, :6] @ lin.delta_by_shared[block]
            K[:, :, columns[of[6:] - 6]] += A[:, :, 6:]
            parts.append((A[:, :, :6], r[..., 0], K))
        by_delta, residual, K = (np.concatenate(part, axis=1) for part in zip(*parts, strict=True))
        root = K @ C_root
        taken = by_delta @ lin.marginals.known[block] @ by_delta.mT + root @ root.mT
        total += _scatter(lin, residual, np.eye(residual.shape[1]) - taken, K)
    return total


def _with_own(
    lin: Posterior, columns: IntArray, A: FloatArray, r: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Rows and residuals, see `whitened_rows`, whitened also of what each image has of its own."""
    own = of_each_image(lin.data)
    mine = [k for k, column in enumerate(columns.tolist()) if column in own]
    if not mine:
        return A, r
    sigmas = [getattr(lin.noise, level) * unit for level, unit in (own[int(columns[k])] for k in mine)]
    along, size, _ = np.linalg.svd(A[:, :, mine] * sigmas, full_matrices=False)
    less = 1 - 1 / np.sqrt(1 + size**2)
    A, r = (part - along @ (less[:, :, None] * (along.mT @ part)) for part in (A, r))
    return A, r


def of_legs(lin: Posterior) -> Influence:
    """Of the legs' wheels, and of a planar sensor."""
    root, _ = roots(lin.leg_weight)
    return Influence(
        lin,
        (root.mT @ lin.legs.residual[..., None])[..., 0],
        root.mT @ lin.marginals.legs @ root,
        {level: root.mT @ share @ root for level, share in lin.leg_covariances.items()},
        root.mT @ lin.legs_by_shared,
    )


def shares(lin: Posterior, by_level: Mapping[str, FloatArray]) -> Mapping[str, FloatArray]:
    """Source → (P, P) share of the covariance of the shared parameters; the shares add up to it.

    With C = H^-1 and H the sum of J_s^T W_s J_s over the sources s, C is the sum of C J_s^T W_s J_s C. Joint readings
    that are outliers and bases that no measurement holds count as a source of their own ("other"). The others are noise
    levels, see `covariances`, kinds of constants for their priors, "nominal" for those of the nine parameters, and
    "unobservable" for the prior variance of unobservable directions.
    """
    C, layout = lin.conditional_covariance, lin.data.layout
    result = defaultdict[str, FloatArray](lambda: np.zeros_like(C))
    for level, covariance in by_level.items():
        result["wheel_rad_per_sqrt_rad" if level == SUPPOSED else level] += covariance
    for k, kind in enumerate(["nominal"] * len(NINE) + [row.kind for row in layout.constants]):
        if lin.priors.weight[k]:
            result[kind] += lin.priors.weight[k] * np.outer(C[:, k], C[:, k])
    result["unobservable"] += lin.considered @ lin.considered.T
    result["other"] += lin.covariance - sum(result.values())
    return result


def expected_gradient(lin: Posterior) -> FloatArray:
    """(P,) gradient that half the sum of squares is expected to have at the true parameters.

    The best values of the stations' unknowns make it least. In the likelihood of the other parameters alone, these
    integrated out, half the logarithm of the determinant of their information makes up for it (Laplace's
    approximation): so this is minus its derivative, see `_lengths` and `_of_levers`. It is less where the residuals are
    smaller than the noise levels say.
    """
    bias, (squares, redundancy) = np.zeros(lin.data.layout.size), _lengths(lin)
    if _SIZE in lin.data.layout.names:
        bias[lin.data.layout.names.index(_SIZE)] = min(squares, redundancy)
    share = min(squares / redundancy, 1.0) if redundancy else 0.0
    for joints, columns in _on_the_head(lin).items():
        of_levers = _of_levers(lin, np.array(joints, dtype=np.bool_), lin.views.by_shared[:, :, columns])
        bias[columns] = share * of_levers
    return bias


def _lengths(lin: Posterior) -> tuple[float, float]:
    """Sum of squares of the residuals that are lengths, and how many of them are redundant.

    If the whole world shrinks, the images stay; what the wheels miss by and the heights of floor and sway shrink, and
    half their sum of squares falls, whatever the size of the world. The derivative is minus the number of these
    residuals, less what the unknowns take up. Without noise they are zero, and so is the gradient.

    With 2,000 stations, a square size that is stated to 0.1 % would come out 1.5 of these sigmas too small.
    """
    W, left = lin.leg_weight[:, :2], lin.leg_covariance - lin.marginals.legs
    squares = float(np.einsum("la,lab,lb->", lin.legs.residual[:, :2], W, lin.legs.residual))
    redundancy = float(np.einsum("lab,lba->", W, left[:, :, :2]))
    for each in of_errors(lin, lin.state.base[:, ERRORS]):
        for level in filter(_HEIGHTS.__contains__, each.parts):
            of_level, free = each.shown(level)
            squares, redundancy = squares + float(of_level.sum()), redundancy + float(free.sum())
    # Far from the optimum, rounding is all.
    return squares, min(max(redundancy, 0.0), 2.0 * (len(left) + lin.data.stations))


def _on_the_head(lin: Posterior) -> Mapping[tuple[bool, ...], list[int]]:
    """Which joints (J,) are between the base and what moves the camera → the shared parameters that move it there."""
    chain, columns = lin.data.chain, defaultdict[tuple[bool, ...], list[int]](list)
    columns[(True,) * len(chain.joints)] += range(6)
    for column, _, effect in lin.data.layout.of(ChainEffect):
        before = {link.joint for link in chain.links[: effect.link] if isinstance(link, JointLink)}
        columns[tuple(name in before for name in chain.joints)].append(column)
    return columns


def _of_levers(lin: Posterior, joints: BoolArray, by_shared: FloatArray) -> FloatArray:
    """(n,) the part of `expected_gradient` by what moves the camera on the base, or beyond some joints (J,).

    The longer the lever of the camera, the better a lean of the base, or an error of a joint, explains what the wheels
    miss by. A twist of the camera changes the derivatives of delta by these to ``(1 + ad(twist))`` times them.

    In motion over a flat floor, the head would come out meters too high, ten sigmas of what the images show of it.

    Args:
        lin: the point.
        joints: see `_on_the_head`.
        by_shared: (N, 6, n) delta by the parameters.
    """
    pull = lin.views.rows[:, :6, :6] @ moved_with(lin, joints)
    turn, shift = _axial(pull[:, :3, :3] + pull[:, 3:, 3:]), _axial(pull[:, 3:, :3])
    return -np.asarray(np.einsum("nq,nqp->p", np.concatenate([turn, shift], axis=1), by_shared))


def _axial(M: FloatArray) -> FloatArray:
    """(N, 3) the derivative by w of the sum of the elements of M * [w]_x, (N, 3, 3)."""
    return np.stack([M[:, 2, 1] - M[:, 1, 2], M[:, 0, 2] - M[:, 2, 0], M[:, 1, 0] - M[:, 0, 1]], axis=1)
