"""Reprojection residuals of each station in raw pixels, and their derivatives.

Whatever moves camera or board moves the board in the first camera's frame, T_c_k → exp(delta) T_c_k: six numbers per
station stand between the pixels and all poses.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.likelihood.corners import blocks_of, columns_of, of_camera, whitened
from mobilecal_cli.likelihood.dataset import Inliers
from mobilecal_cli.likelihood.effects import CameraEffect, ChainEffect, Clock, FloorEffect, JointReading
from mobilecal_cli.likelihood.measurements import BASE, FLOOR, STAMP
from mobilecal_cli.likelihood.state import State, Step, standing
from mobilecal_cli.model import FloatArray, IntArray, Noise


@dataclass(frozen=True, slots=True, eq=False)
class Images:
    """Residuals of the images at N stations, whitened. Unknowns are (delta, direct constants).

    Attributes:
        information: (N, Q, Q) J^T J of the whitened inliers.
        gradient: (N, Q) J^T r.
        cost: (N,) sum of squares.
        delays: which of the unknowns are the mean delays of D further cameras.
        across: (N, D, Q) rows of the information at these, if no image had a delay of its own.
        pull: (N, D) gradient there, the same way.
    """

    information: FloatArray
    gradient: FloatArray
    cost: FloatArray
    delays: tuple[int, ...]
    across: FloatArray
    pull: FloatArray

    def with_images(self, stations: IntArray, other: Images) -> Self:
        """The same with other images at some stations."""
        changed = {}
        for name in ("information", "gradient", "cost", "across", "pull"):
            changed[name] = getattr(self, name).copy()
            changed[name][stations] = getattr(other, name)
        return replace(self, **changed)

    def shifted(self, shift: FloatArray) -> Self:
        """The same after a step (N, Q) of each station's unknowns, to first order."""
        change = (self.information @ shift[..., None])[..., 0]
        cost = self.cost + np.sum(shift * (2 * self.gradient + change), axis=1)
        pull = self.pull + (self.across @ shift[..., None])[..., 0]
        return replace(self, gradient=self.gradient + change, cost=cost, pull=pull)

    def scaled(self, factor: FloatArray) -> Self:
        """The same with a noise of corners or measured poses, and of own delays, that is (N,) so many times larger."""
        weight = factor**-2
        return replace(
            self,
            information=weight[:, None, None] * self.information,
            gradient=weight[:, None] * self.gradient,
            cost=weight * self.cost,
            across=weight[:, None, None] * self.across,
            pull=weight[:, None] * self.pull,
        )

    def with_own_delays(self, before: float, after: float) -> Self:
        """The same if delays of further cameras vary from image to image by another variance, s^2.

        Each image's own delay is one more unknown, which is eliminated: with u the row of the information at the mean
        delay d, and v the variance, ``u u^T v / (1 + v u_d)`` is taken from the information.
        """
        if before == after:
            return self
        information, gradient, cost = self.information.copy(), self.gradient, self.cost
        for k, delay in enumerate(self.delays):
            u, pull = self.across[:, k], self.pull[:, k]
            weight = before / (1 + before * u[:, delay]) - after / (1 + after * u[:, delay])
            weighted = weight[:, None] * u
            for block in blocks_of(len(u)):
                information[block] += weighted[block, :, None] * u[block, None, :]
            gradient = gradient + pull[:, None] * weighted
            cost = cost + weight * pull**2
        return replace(self, information=information, gradient=gradient, cost=cost)

    def own_delays(self, variance: float) -> FloatArray:
        """(N, D) likeliest delay of each image beside its camera's mean, s; variance: as eliminated."""
        return -variance * self.gradient[:, [*self.delays]]


@dataclass(frozen=True, slots=True, eq=False)
class Views(Images):
    """Images at a state, and how all unknowns move the board in them.

    Attributes:
        by_base: (N, 6, B) delta by the station's base block: by base pose, floor and stamp error.
        by_own: (N, 6, J + 3) delta by joint errors and by the sway.
        by_board: (N, 6, 6) delta by the pose of the recording's board.
        by_shared: (N, 6, P) delta by the parameters that all recordings share.
        log: (N,) the recording of each station.
        direct: (Q - 6,) columns of the direct constants among these parameters.
    """

    by_base: FloatArray
    by_own: FloatArray
    by_board: FloatArray
    by_shared: FloatArray
    log: IntArray
    direct: IntArray

    def onto_shared(self, A: FloatArray, stations: IntArray | slice = slice(None)) -> FloatArray:
        """(n, k, Q) derivatives by (delta, direct constants) of some stations → (n, k, P) by the shared parameters."""
        out: FloatArray = A[:, :, :6] @ self.by_shared[stations]
        out[:, :, self.direct] += A[:, :, 6:]
        return out

    def moved(self, step: Step) -> Views:
        """The same after a step of all unknowns, to first order."""
        delta = self.by_base @ step.base[..., None] + self.by_own @ step.own[..., None]
        delta += self.by_board @ step.boards[self.log, :, None]
        shift = np.empty_like(self.gradient)
        shift[:, :6] = delta[..., 0] + self.by_shared @ step.shared
        shift[:, 6:] = step.shared[self.direct]
        return self.shifted(shift)


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
        rates = data.joint_rates(state.clock_s("joints"))
        by_base[..., STAMP] = (by_own[..., :joints] @ rates[..., None])[..., 0]

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


def linearize_views(state: State, inliers: Inliers, noise: Noise, rates: FloatArray) -> Views:
    """Residuals and information of all stations' images; rates: (C, N, 6) see `State.view_rates`."""
    data = state.data
    i = images_of(state, inliers, noise, rates, np.arange(data.stations))
    direct = np.array([column for column, _, _ in data.layout.direct], dtype=np.int64)
    images = i.information, i.gradient, i.cost, i.delays, i.across, i.pull
    return Views(*images, *_pose_columns(state), data.log, direct)


def images_of(state: State, inliers: Inliers, noise: Noise, rates: FloatArray, stations: IntArray) -> Images:
    """Residuals of some stations' images, or of measured poses."""
    data, direct = state.data, state.data.layout.direct
    if data.posed:
        return _measured_poses(state, inliers, noise, stations)
    Q = 6 + len(direct)
    information, gradient, cost = (np.zeros((len(stations), *shape)) for shape in ((Q, Q), (Q,), ()))
    for block in blocks_of(len(stations)):
        mine = stations[block]
        weight = np.where(inliers.used_corners[mine], 1 / noise.pixel_px, 0.0)
        W = data.whitening[mine] * weight[..., None, None]
        for k in range(len(data.cameras.each)):
            columns, effects = columns_of(direct, k)
            residual, J = of_camera(state, k, state.T_c_k[mine], mine, rates[:, mine], effects)
            A = whitened(W[:, k], J).reshape(len(mine), -1, len(columns))
            r = whitened(W[:, k], residual).reshape(len(mine), -1)
            information[block, columns[:, None], columns] += A.mT @ A
            gradient[block, columns] += (A.mT @ r[..., None])[..., 0]
            cost[block] += np.sum(r**2, axis=1)
    delays = [
        column
        for column, (_, _, effect) in enumerate(direct, 6)
        if isinstance(effect, CameraEffect) and effect.of == "delay_s"
    ]
    together = Images(information, gradient, cost, tuple(delays), information[:, delays], gradient[:, delays])
    return together.with_own_delays(0.0, noise.pair_s**2)


def _measured_poses(state: State, inliers: Inliers, noise: Noise, stations: IntArray) -> Images:
    """The same of measured poses: their residual is the left twist from the measured to the predicted pose."""
    off = se3.log(state.T_c_k[stations] @ se3.inverse(state.data.T_c_k[stations]))
    by_delta = _by_left_twist(off)
    used = inliers.views[stations] / noise.pose_scale**2
    weight = state.data.pose_weight[stations] * used[:, None, None]
    pull = (weight @ off[..., None])[..., 0]
    information = by_delta.mT @ weight @ by_delta
    gradient = np.einsum("nab,na->nb", by_delta, pull)
    return Images(information, gradient, np.sum(off * pull, axis=1), (), information[:, :0], gradient[:, :0])


def _by_left_twist(twist: FloatArray) -> FloatArray:
    """(N, 6, 6) derivative of log(exp(delta) exp(twist)) by delta, to second order in the twist."""
    ad = np.zeros((len(twist), 6, 6))
    ad[:, :3, :3] = ad[:, 3:, 3:] = se3.skew(twist[:, :3])
    ad[:, 3:, :3] = se3.skew(twist[:, 3:])
    return np.eye(6) - ad / 2 + ad @ ad / 12
