"""Reprojection residuals of each station in raw pixels, and their derivatives.

Whatever moves camera or board moves the board in the first camera's frame, T_c_k → exp(delta) T_c_k: six numbers per
station stand between the pixels and all poses.
"""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.likelihood.corners import blocks_of, columns_of, of_camera, whitened
from mobilecal_cli.likelihood.dataset import Dataset, Inliers
from mobilecal_cli.likelihood.effects import CameraEffect, ChainEffect, Clock, FloorEffect, JointReading
from mobilecal_cli.likelihood.measurements import BASE, FLOOR, STAMP
from mobilecal_cli.likelihood.state import State, Step, standing
from mobilecal_cli.model.arrays import FloatArray, IntArray
from mobilecal_cli.model.solution import Noise

_ROUNDING = 1e-12  # of the cost of images that are so far off that it is all that is left
#: Attribute of `CameraChange` of which each image has its own value, with several cameras → level of that noise.
_OWN = {"delay_s": "pair_s", "principal": "shift_px"}


@dataclass(frozen=True, slots=True, eq=False)
class Views:
    """Residuals of the images at N stations, whitened, and how all unknowns move the board in them.

    They are functions of Q unknowns each: (delta, direct constants). The information J^T J of the inliers and the
    gradient J^T r are kept station by station for some of these, and in sums over the stations of a group for all
    direct constants: there may be hundreds of these.

    Attributes:
        traced: (T,) which of the Q unknowns are kept station by station: delta, constants of which each image has its
            own, others.
        own: noise level and its unit, in that of the constant, of each of these constants.
        rows: (N, T, Q) rows of the information at these.
        pull: (N, T) gradient by these.
        cost: (N,) sum of squares.
        group: (N,) group of each station, ascending; a recording, or the station itself.
        direct: (G, Q - 6, Q - 6) information about the direct constants, of each group.
        gradient: (G, Q - 6) gradient by these.
        by_base: (N, 6, B) delta by the station's base block: by base pose, floor and stamp error.
        by_own: (N, 6, J + 3) delta by joint errors and by the sway.
        by_board: (N, 6, 6) delta by the pose of the recording's board.
        by_shared: (N, 6, P) delta by the parameters that all recordings share.
        log: (N,) the recording of each station.
        columns: (Q - 6,) of the direct constants among these parameters.
    """

    traced: IntArray
    own: tuple[tuple[str, float], ...]
    rows: FloatArray
    pull: FloatArray
    cost: FloatArray
    group: IntArray
    direct: FloatArray
    gradient: FloatArray
    by_base: FloatArray
    by_own: FloatArray
    by_board: FloatArray
    by_shared: FloatArray
    log: IntArray
    columns: IntArray

    def own_variances(self, noise: Noise) -> dict[int, tuple[str, float]]:
        """Traced unknown of which each image has its own → its noise level, and the variance beside the mean."""
        variances = ((level, (getattr(noise, level) * unit) ** 2) for level, unit in self.own)
        return dict(enumerate(variances, 6))

    def shifted(self, traced: FloatArray, direct: FloatArray | float = 0.0) -> Self:
        """The same after a step of the unknowns, to first order.

        Args:
            traced: (N, T) of those that are kept station by station.
            direct: (Q - 6,) of all stations' direct constants, beside it. What it adds to the cost of a group is shared
                by the stations of the group.
        """
        along = np.broadcast_to(direct, self.gradient.shape[1:])
        change = (self.rows[:, :, self.traced] @ traced[..., None])[..., 0]
        of_direct = self.rows[:, :, 6:] @ along
        cost = self.cost + np.sum(traced * (2 * (self.pull + of_direct) + change), axis=1)
        further = self.direct @ along
        if along.any():
            added = np.sum(along * (2 * self.gradient + further), axis=1) / np.maximum(
                np.bincount(self.group), 1
            )
            cost = cost + added[self.group]
        moved = self._summed(traced[..., None], self.rows[:, :, 6:])[:, 0]
        gradient = self.gradient + further + moved
        return replace(self, pull=self.pull + change + of_direct, cost=cost, gradient=gradient)

    def _summed(self, A: FloatArray, B: FloatArray) -> FloatArray:
        """Sums of A^T B over the stations of each group: (N, q, P) and (N, q, R) → (G, P, R)."""
        out = np.zeros((len(self.direct), A.shape[2], B.shape[2]))
        if out.size:
            groups, sums = _by_group(self.group, A, B)
            out[groups] = sums
        return out

    def scaled(self, factor: FloatArray) -> Self:
        """The same with a noise of corners or measured poses, and of own constants, that is (N,) so many times larger.

        It is the same for all stations of a group.
        """
        weight = factor**-2
        of_group = np.ones(len(self.direct))
        of_group[self.group] = weight
        return replace(
            self,
            rows=weight[:, None, None] * self.rows,
            pull=weight[:, None] * self.pull,
            cost=weight * self.cost,
            direct=of_group[:, None, None] * self.direct,
            gradient=of_group[:, None] * self.gradient,
        )

    def with_own(self, noise: Noise) -> Self:
        """The same where constants that are alike here vary from image to image as a noise says.

        Each image's own values are further unknowns, which are eliminated: with the rows u of the information at
        their constants o, and their variances v, ``u^T (1 + v u_o)^-1 v u`` is taken from the information.
        """
        variance = np.array([variance for _, variance in self.own_variances(noise).values()])[:, None]
        if not variance.any():
            return self
        own = slice(6, 6 + len(variance))
        u, pull = self.rows[:, own], self.pull[:, own, None]
        free = np.eye(len(variance)) + variance * u[:, :, self.traced[own]]
        taken = np.linalg.solve(free, variance * np.concatenate([u, pull], axis=2))
        rounding = np.where(self.cost > 1 / _ROUNDING, _ROUNDING * self.cost, -np.inf)
        of_traced, of_direct = u[:, :, self.traced].mT @ taken, self._summed(u[:, :, 6:], taken[:, :, 6:])
        return replace(
            self,
            rows=self.rows - of_traced[:, :, :-1],
            pull=self.pull - of_traced[:, :, -1],
            cost=np.maximum(self.cost - np.sum(pull * taken[:, :, -1:], axis=(1, 2)), rounding),
            direct=self.direct - of_direct[:, :, :-1],
            gradient=self.gradient - of_direct[:, :, -1],
        )

    def own_values(self, noise: Noise) -> dict[int, FloatArray]:
        """Traced unknown → (N,) likeliest value of each image beside the constant, under the noise here."""
        return {k: -variance * self.pull[:, k] for k, (_, variance) in self.own_variances(noise).items()}

    def onto_shared(self, A: FloatArray, delta: FloatArray) -> FloatArray:
        """(N, k, Q) derivatives by (delta, direct constants) → (N, k, P) by the shared parameters.

        `delta` is (N, 6, P), by these: `by_shared`, or where all other unknowns follow, too.
        """
        out: FloatArray = A[:, :, :6] @ delta
        out[:, :, self.columns] += A[:, :, 6:]
        return out

    def moved(self, step: Step) -> Self:
        """The same after a step of all unknowns, to first order."""
        delta = self.by_base @ step.base[..., None] + self.by_own @ step.own[..., None]
        delta += self.by_board @ step.boards[self.log, :, None]
        traced = np.zeros_like(self.pull)
        traced[:, :6] = delta[..., 0] + self.by_shared @ step.shared
        return self.shifted(traced, step.shared[self.columns])


def _by_group(group: IntArray, A: FloatArray, B: FloatArray) -> tuple[IntArray, FloatArray]:
    """Groups of ascending ones (N,), and the sums of A^T B, (N, q, P) and (N, q, R), over each: (g,) and (g, P, R)."""
    groups, starts = np.unique(group, return_index=True)
    if len(groups) == len(group):
        return groups, A.mT @ B
    of_each = zip(np.split(A, starts[1:]), np.split(B, starts[1:]), strict=True)
    return groups, np.stack([summed(a, b) for a, b in of_each])


def summed(A: FloatArray, B: FloatArray) -> FloatArray:
    """Sum over n and q of A^T B: (n, q, P) and (n, q, R) → (P, R), as one matrix product."""
    rows = A.shape[0] * A.shape[1]
    return A.reshape(rows, A.shape[2]).T @ B.reshape(rows, B.shape[2])


def _pose_columns(state: State) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    data, X, frames, stance = state.data, state.parameters.T_h_c, state.frames, state.stance
    layout, (count, joints) = data.layout, data.joints.shape
    T_v_c = frames.T_v_h @ X
    Ad_c_floor, Ad_c_v = se3.adjoint(se3.inverse(np.stack([standing(stance) @ T_v_c, T_v_c])))
    by_base = np.zeros((count, 6, data.base_width))
    by_base[..., 0], by_base[..., 1], by_base[..., 2] = (-Ad_c_floor[:, :, k] for k in (3, 4, 2))
    by_own = np.empty((count, 6, data.own_width))
    by_own[..., :joints] = -Ad_c_v @ frames.by_joints()
    by_own[..., joints:] = -Ad_c_floor @ _stance_twists(stance)
    for value, effect in state.present(FloorEffect):
        by_base[..., BASE] += by_own[..., joints:] @ (value * effect.stance_by_base(data, state.base))
    by_base[data.first] = 0.0  # the world is the base at its first station
    by_base[..., FLOOR] = by_own[..., joints:]
    if data.base_width > STAMP:
        by_base[..., STAMP] = (by_own[..., :joints] @ state.rates[:, :-2, None])[..., 0]

    by_shared = np.zeros((count, 6, layout.size))
    by_shared[:, :3, :3] = by_shared[:, 3:6, 3:6] = -X[:3, :3].T
    of_chain = layout.of(ChainEffect)
    if of_chain:
        twists = np.stack([effect.twist(frames, state.chain_change) for _, _, effect in of_chain], axis=2)
        by_shared[..., [column for column, _, _ in of_chain]] = -Ad_c_v @ twists
    for column, _, joint in layout.of(JointReading):
        by_shared[..., column] = (by_own[..., :joints] @ joint.rate(data)[:, :, None])[..., 0]
    for column, _, clock in layout.of(Clock):
        if clock.of == "joints" and data.base_width > STAMP:
            by_shared[..., column] = by_base[..., STAMP] * clock.stations(data)[:, None]
    for column, _, floor in layout.of(FloorEffect):
        stance = floor.stance(data, state.base)
        by_shared[..., column] = (by_own[..., joints:] @ stance[..., None])[..., 0]
    return by_base, by_own, se3.adjoint(state.T_c_k), by_shared


def _stance_twists(stance: FloatArray) -> FloatArray:
    """(N, 6, 3) left twists of the base in its level frame by roll, pitch and height."""
    twists = np.zeros((len(stance), 6, 3))
    twists[:, :3, :2] = se3.left_jacobian_so3(stance * [1.0, 1.0, 0.0])[:, :, :2]
    twists[:, 3:, :2] = np.cross((stance * [0.0, 0.0, 1.0])[:, :, None], twists[:, :3, :2], axis=1)
    twists[:, 5, 2] = 1.0
    return twists


def linearize_views(
    state: State, inliers: Inliers, rates: FloatArray, group: IntArray, traced: Collection[int]
) -> Views:
    """Residuals and information of all stations' images, or of measured poses, for a noise level of one.

    Args:
        state, inliers: the point.
        rates: (C, N, 6) see `State.view_rates`.
        group: (N,) see `Views`.
        traced: further ones of (delta, direct constants) that are kept station by station.
    """
    data, every = state.data, np.arange(state.data.stations)
    own = of_each_image(data)
    kept = np.array([*range(6), *own, *(column for column in traced if column not in own)])
    direct = np.array([column for column, _, _ in data.layout.direct], dtype=np.int64)
    Q, count = 6 + len(direct), int(group.max(initial=-1)) + 1
    rows, pull, cost = (np.zeros((len(every), *shape)) for shape in ((len(kept), Q), (len(kept),), ()))
    information, gradient = np.zeros((count, Q, Q)), np.zeros((count, Q))
    for block in blocks_of(data):
        for columns, A, r in whitened_rows(state, inliers, rates, every[block]):
            mine_of, at = (found[:, None] for found in np.nonzero(columns[:, None] == kept))
            of_kept = A[:, :, mine_of[:, 0]].mT
            rows[block, at, columns] += of_kept @ A
            pull[block, at[:, 0]] += (of_kept @ r)[..., 0]
            cost[block] += np.sum(r**2, axis=(1, 2))
            groups, products = _by_group(group[block], A, A)
            information[groups[:, None, None], columns[:, None], columns] += products
            groups, products = _by_group(group[block], A, r)
            gradient[groups[:, None], columns] += products[..., 0]
    by_base, by_own, by_board, by_shared = _pose_columns(state)
    return Views(
        traced=kept,
        own=tuple(own.values()),
        rows=rows,
        pull=pull,
        cost=cost,
        group=group,
        direct=information[:, 6:, 6:],
        gradient=gradient[:, 6:],
        by_base=by_base,
        by_own=by_own,
        by_board=by_board,
        by_shared=by_shared,
        log=data.log,
        columns=direct,
    )


def of_each_image(data: Dataset) -> dict[int, tuple[str, float]]:
    """Which of (delta, direct constants) each image has of its own → noise level and its unit in the constant's."""
    if len(data.cameras.each) < 2:
        return {}
    cameras = (
        (column, effect.of, data.cameras.each[effect.camera].width)
        for column, (_, _, effect) in enumerate(data.layout.direct, 6)
        if isinstance(effect, CameraEffect) and effect.camera is not None and effect.of in _OWN
    )
    return {column: (_OWN[of], 1 / width if of == "principal" else 1.0) for column, of, width in cameras}


def whitened_rows(
    state: State, inliers: Inliers, rates: FloatArray, stations: IntArray
) -> Iterator[tuple[IntArray, FloatArray, FloatArray]]:
    """Residuals of each camera at some stations, or of measured poses, for a noise level of one; 0 of what is not used.

    Yields:
        (K,) on which of (delta, direct constants) they depend, (n, m, K) derivatives by these, and (n, m, 1) residuals.
    """
    data = state.data
    if data.posed:  # left twist from the measured to the predicted pose
        off = se3.log(state.T_c_k[stations] @ se3.inverse(data.T_c_k[stations]))
        root = roots(data.pose_weight[stations])[0].mT * inliers.views[stations, None, None]
        yield np.arange(6), root @ _by_left_twist(off), root @ off[..., None]
        return
    W = data.whitening[stations] * inliers.used_corners[stations][..., None, None]
    for k in range(len(data.cameras.each)):
        columns, effects = columns_of(data.layout.direct, k)
        residual, J = of_camera(state, k, state.T_c_k[stations], stations, rates[:, stations], effects)
        A = whitened(W[:, k], J).reshape(len(stations), -1, len(columns))
        yield columns, A, whitened(W[:, k], residual).reshape(len(stations), -1, 1)


def roots(information: FloatArray) -> tuple[FloatArray, FloatArray]:
    """R with R R^T = information, and its pseudo-inverse, (n, Q, Q) each."""
    values, vectors = np.linalg.eigh(information)
    size = np.sqrt(np.maximum(values, 0.0))
    positive = size > 1e-9 * size.max(axis=1, initial=1e-300, keepdims=True)
    inverse = np.where(positive, 1 / np.where(positive, size, 1.0), 0.0)
    return vectors * size[:, None, :], (vectors * inverse[:, None, :]).mT


def _by_left_twist(twist: FloatArray) -> FloatArray:
    """(N, 6, 6) derivative of log(exp(delta) exp(twist)) by delta, to second order in the twist."""
    ad = np.zeros((len(twist), 6, 6))
    ad[:, :3, :3] = ad[:, 3:, 3:] = se3.skew(twist[:, :3])
    ad[:, 3:, :3] = se3.skew(twist[:, 3:])
    return np.eye(6) - ad / 2 + ad @ ad / 12
