"""Reprojection residuals of each station in raw pixels, and their derivatives.

Whatever moves camera or board moves the board in the first camera's frame, T_c_k → exp(delta) T_c_k: six numbers per
station stand between the pixels and all poses. Constants that change the cameras or the board itself have columns of
their own ("direct").
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from mobilecal_cli import camera as lens
from mobilecal_cli import se3
from mobilecal_cli.kinematics import JointFrames
from mobilecal_cli.likelihood.dataset import Dataset
from mobilecal_cli.likelihood.effects import (
    BoardEffect,
    CameraChange,
    CameraEffect,
    ChainEffect,
    Clock,
    FloorEffect,
    ImageEffect,
    JointReading,
)
from mobilecal_cli.likelihood.measurements import BASE, FLOOR, LEAST_DEPTH_M, STAMP
from mobilecal_cli.likelihood.noise import FEWEST_CORNERS, Inliers
from mobilecal_cli.likelihood.nuisance import camera_change
from mobilecal_cli.likelihood.state import (
    State,
    Step,
    board_in_camera,
    chain_change,
    clock_s,
    joints_at,
    points_at,
    stance_at,
    standing,
)
from mobilecal_cli.model import BoolArray, CameraRig, FloatArray, IntArray, Noise

_BLOCK = 200
#: Gauss-Newton steps of a board pose, and rad and m: the last ones move no corner visibly.
_POSE_STEPS, _STILL = 12, 1e-6
_LARGEST_DEEPER = 0.5  # of its depth: the board's way along the camera's axis in one step


@dataclass(frozen=True, slots=True, eq=False)
class Views:
    """Residuals of all stations' images at a state, whitened.

    Attributes:
        information: (N, Q, Q) of (delta, direct constants): J^T J of the whitened inliers.
        gradient: (N, Q) J^T r.
        cost: (N,) sum of squares.
        by_base: (N, 6, B) delta by the station's base block: by base pose, floor and stamp error.
        by_own: (N, 6, J + 3) delta by joint errors and by the sway.
        by_board: (N, 6, 6) delta by the pose of the recording's board.
        by_shared: (N, 6, P) delta by the parameters that all recordings share.
        log: (N,) the recording of each station.
        direct: (Q - 6,) columns of the direct constants among these parameters.
    """

    information: FloatArray
    gradient: FloatArray
    cost: FloatArray
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

    def shifted(self, shift: FloatArray) -> Views:
        """The same after a step (N, Q) of each station's (delta, direct constants)."""
        change = (self.information @ shift[..., None])[..., 0]
        cost = self.cost + np.sum(shift * (2 * self.gradient + change), axis=1)
        return replace(self, gradient=self.gradient + change, cost=cost)

    def with_images(self, stations: IntArray, images: tuple[FloatArray, FloatArray, FloatArray]) -> Views:
        """The same with other images at some stations, see `images_of`."""
        changed = []
        for before, after in zip((self.information, self.gradient, self.cost), images, strict=True):
            changed.append(before.copy())
            changed[-1][stations] = after
        information, gradient, cost = changed
        return replace(self, information=information, gradient=gradient, cost=cost)

    def scaled(self, factor: FloatArray) -> Views:
        """The same with a noise of corners or measured poses that is (N,) so many times larger."""
        weight = factor**-2
        return replace(
            self,
            information=weight[:, None, None] * self.information,
            gradient=weight[:, None] * self.gradient,
            cost=weight * self.cost,
        )


def whitened(W: FloatArray, values: FloatArray, out: FloatArray | None = None) -> FloatArray:
    """Corner residuals (N, C, M, 2) or their derivatives (N, Q, C, M, 2), px, by lower triangles W (N, C, M, 2, 2).

    `out` may be the values.
    """
    W = W if values.ndim == 4 else W[:, None]
    x, y = values[..., 0], values[..., 1]
    result = np.empty_like(values) if out is None else out
    np.multiply(W[..., 1, 1], y, out=result[..., 1])
    result[..., 1] += W[..., 1, 0] * x
    np.multiply(W[..., 0, 0], x, out=result[..., 0])
    return result


def blocks_of(stations: int) -> Iterator[slice]:
    """The stations cut into blocks, so that the derivatives of their corners take a few MB however many there are."""
    yield from (slice(i, i + _BLOCK) for i in range(0, stations, _BLOCK))


def corner_residuals(
    data: Dataset,
    state: State,
    T_c_k: FloatArray,
    stations: slice | IntArray = slice(None),
    rates: FloatArray | None = None,
    by_constants: bool = True,
) -> tuple[FloatArray, FloatArray]:
    """Predicted minus detected pixels of some stations' boards at T_c_k, (N, C, M, 2), and their derivatives.

    Args:
        data, state: all stations.
        T_c_k: (N, 4, 4) of these stations.
        stations: which.
        rates: (N, 6) see `view_rates`, of these stations; at rest if None.
        by_constants: whether the derivatives by the direct constants are needed.

    Returns:
        The residuals, and (N, Q, C, M, 2) derivatives by (delta, direct constants), or by delta alone.
    """
    change = camera_change(data.cameras, data.layout.constants, state.constants)
    direct = [effect for _, _, effect in data.layout.direct] if by_constants else []
    rig, points_k = change.apply(data.cameras), se3.act(T_c_k, points_at(data, state))
    rates = (np.zeros((len(points_k), 6)) if rates is None else rates)[:, None]
    shape = len(data.cameras.each), points_k.shape[1], 2
    residual, J = np.empty((len(points_k), *shape)), np.zeros((len(points_k), 6 + len(direct), *shape))
    for k in range(len(data.cameras.each)):
        at = stations, k
        residual[:, k] = _one_camera(data, change, rig, direct, at, T_c_k, points_k, rates, J[:, :, k])
    return residual, J


def _one_camera(
    data: Dataset,
    change: CameraChange,
    rig: CameraRig,
    direct: Sequence[ImageEffect],
    at: tuple[slice | IntArray, int],
    T_c_k: FloatArray,
    points_k: FloatArray,
    rates: FloatArray,
    J: FloatArray,
) -> FloatArray:
    """Predicted minus detected pixels of one camera, (n, M, 2), px.

    Args:
        data: all stations.
        change, rig: what the constants change in the cameras, and the cameras after it.
        direct: effects of the direct constants, as J has columns.
        at: which stations, and index of the camera.
        T_c_k, rates: (n, 4, 4) and (n, 1, 6) of these stations.
        points_k: (n, M, 3) corners in the first camera's frame at the stamp, m.
        J: (n, Q, M, 2) zeros, to which the derivatives by (delta, direct constants) are written.
    """
    k = at[1]
    stated, camera, T_camera_c = data.cameras.each[k], rig.each[k], se3.inverse(rig.T_c_each[k])
    velocity_c = np.cross(rates[..., :3], points_k) + rates[..., 3:]
    rows = ((data.pixels[at][..., 1] + 0.5) / stated.height - 0.5)[..., None]
    late_s = change.late_s(k, rows)
    points_c = points_k + late_s * velocity_c
    points = points_c if k == 0 else se3.act(T_camera_c, points_c)
    # A camera without the board may look elsewhere; its corners count for nothing, and stay finite.
    elsewhere = (points[..., 2] < LEAST_DEPTH_M) & ~data.seen[at]
    points = np.where(elsewhere[..., None], [0.0, 0.0, 1.0], points) if elsewhere.any() else points
    pixels, J_p = lens.project_with_jacobian(replace(camera, correction=None), points)
    shares = change.lens[k]
    if not (direct or np.any(shares[4:])):
        shares = shares[:4]  # the waves are not needed
    terms, by_pixels = lens.lens_terms(stated, stated.K[:2, 2], pixels, shares)
    through = np.eye(2) + by_pixels
    J_p = through @ J_p
    J_c = J_p if k == 0 else (J_p.reshape(-1, 3) @ T_camera_c[:3, :3]).reshape(J_p.shape)
    by_exposed = by_point = np.ascontiguousarray(np.moveaxis(J_c, -1, 0))
    if np.any(late_s):  # points at the stamp turn until they are exposed
        J_c = J_c + np.cross(J_c, (late_s * rates[..., :3])[..., None, :])
        by_point = np.ascontiguousarray(np.moveaxis(J_c, -1, 0))
    x, y, z = np.moveaxis(points_k, -1, 0)[..., None]
    by_x, by_y, by_z = by_point
    J[:, 0] = y * by_z - z * by_y  # point x J_c
    J[:, 1] = z * by_x - x * by_z
    J[:, 2] = x * by_y - y * by_x
    J[:, 3:6] = np.moveaxis(by_point, 0, 1)

    # A camera that moves moves the points the other way.
    position = rig.T_c_each[k][:3, 3]
    turn, swing = (se3.left_jacobian_so3(by[k]) for by in (change.turn, change.swing))
    shifts: dict[str, Callable[[FloatArray], FloatArray]] = {
        "turn": lambda about: -np.cross(turn @ about, points_c - position),
        "swing": lambda about: -np.cross(swing @ about, position),
        "length": lambda share: -share * position / (1 + change.length[k]),
        "shift": lambda along: -along,
        "delay_s": lambda along: along * velocity_c,
        "readout_s": lambda along: along * velocity_c * rows,
    }
    for column, effect in enumerate(direct, 6):
        if isinstance(effect, BoardEffect):
            moved = effect.displacement(data.points_k) @ T_c_k[:, :3, :3].mT
            J[:, column] = _along(by_point, moved)
        elif isinstance(effect, CameraEffect) and effect.concerns(k):
            along = np.array(effect.along)
            if effect.of in shifts:
                J[:, column] = _along(by_exposed, shifts[effect.of](along))
            elif effect.of == "lens":
                J[:, column] = np.tensordot(along, terms[: len(along)], 1)
            else:
                off = (
                    (pixels - camera.K[:2, 2]) / (1 + change.focal[k])
                    if effect.of == "focal"
                    else stated.width
                )
                J[:, column] = (through @ np.broadcast_to(along * off, pixels.shape)[..., None])[..., 0]
    return np.asarray(pixels + np.tensordot(shares, terms, 1) - data.pixels[at])


def _along(by_point: FloatArray, shift: FloatArray) -> FloatArray:
    """(3, n, M, 2) derivative by a point, and its displacement (n, M, 3) or (3,) → (n, M, 2)."""
    by_x, by_y, by_z = by_point
    moved: FloatArray = by_x * shift[..., 0, None]
    moved += by_y * shift[..., 1, None]
    moved += by_z * shift[..., 2, None]
    return moved


def board_poses(data: Dataset, state: State, corners: BoolArray) -> FloatArray:
    """(N, 4, 4) T_c_k with which the cameras and the board of a state show what was detected at each station.

    Measured poses stay.

    Args:
        data, state: all stations.
        corners: (N, C, M) those that count, unless they are too few at a station.
    """
    poses, rates = data.T_c_k.copy(), view_rates(data, state)
    few = corners.sum(axis=(1, 2)) < FEWEST_CORNERS
    counted = np.where(few[:, None, None], data.seen, corners)
    for block in blocks_of(0 if data.posed.any() else data.stations):
        poses[block] = fitted_poses(data, state, poses[block], block, counted[block], rates[block])
    return poses


def median_size(size: FloatArray, corners: BoolArray) -> FloatArray:
    """(N,) median over the corners (N, C, M) that count."""
    return np.asarray(np.nanmedian(np.where(corners, size, np.nan), axis=(1, 2)))


def fitted_poses(
    data: Dataset,
    state: State,
    T_c_k: FloatArray,
    stations: slice | IntArray,
    corners: BoolArray,
    rates: FloatArray | None = None,
    robust: bool = False,
) -> FloatArray:
    """Poses (n, 4, 4) of the board at some stations that fit the corners best, each station by itself.

    Args:
        data, state: all stations.
        T_c_k: (n, 4, 4) where to start.
        stations: which.
        corners: (n, C, M) those that count.
        rates: see `corner_residuals`.
        robust: whether the pull of a corner fades with its distance (Cauchy's weight, in units of the median).
    """
    for _ in range(_POSE_STEPS):
        residual, J = corner_residuals(data, state, T_c_k, stations, rates, by_constants=False)
        W = data.whitening[stations]
        residual, J = whitened(W, residual), whitened(W, J)
        root = corners.astype(np.float64)[..., None]
        if robust:
            size = np.linalg.norm(residual, axis=-1)
            scale = np.maximum(median_size(size, corners), 1e-9)[:, None, None]
            root = (corners / np.sqrt(1 + (size / (2 * scale)) ** 2))[..., None]
        At = (J * root[:, None]).reshape(len(T_c_k), 6, -1)
        r = (residual * root).reshape(len(T_c_k), -1)
        step = np.asarray(np.linalg.solve(At @ At.mT, -(At @ r[..., None]))[..., 0])
        # Far off, a step may lead behind the camera, where nothing leads back.
        deeper = np.abs(np.cross(step[:, :3], T_c_k[:, :3, 3])[:, 2] + step[:, 5])
        share = np.minimum(_LARGEST_DEEPER * np.abs(T_c_k[:, 2, 3]) / np.maximum(deeper, _STILL), 1.0)
        T_c_k = se3.exp(share[:, None] * step) @ T_c_k
        if np.abs(step).max() < _STILL:
            break
    return T_c_k


def view_rates(data: Dataset, state: State) -> FloatArray:
    """(N, 6) rates of delta: how the board moves in the first camera, rad/s and m/s; 0 at rest."""
    T_h_c, wheels = state.parameters.T_h_c, state.parameters.wheels
    rates = np.zeros((data.stations, 6))
    if not data.moving.any() or not data.joint_tracks:
        return rates
    frames = JointFrames.at(chain_change(data, state).apply(data.chain), joints_at(data, state))
    rolled = data.wheel_rates(clock_s(data, state, "wheels")) * wheels.vector[:2]
    rates[:, 2] = (rolled[:, 0] - rolled[:, 1]) / wheels.separation_m
    rates[:, 3] = rolled.mean(axis=1)
    rates += (frames.by_joints() @ data.joint_rates(clock_s(data, state, "joints"))[..., None])[..., 0]
    moved: FloatArray = -(se3.adjoint(se3.inverse(frames.T_v_h @ T_h_c)) @ rates[..., None])[..., 0]
    return moved * data.moving[:, None]


def _pose_columns(
    data: Dataset, state: State, T_c_k: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    X, layout = state.parameters.T_h_c, data.layout
    count, joints = data.joints.shape
    change, positions = chain_change(data, state), joints_at(data, state)
    chain = change.apply(data.chain)
    frames = JointFrames.at(chain, positions)
    T_v_c = frames.T_v_h @ X
    stance = stance_at(data, state)
    Ad_c_floor, Ad_c_v = se3.adjoint(se3.inverse(np.stack([standing(stance) @ T_v_c, T_v_c])))
    by_base = np.zeros((count, 6, data.base_width))
    by_base[..., 0], by_base[..., 1], by_base[..., 2] = (-Ad_c_floor[:, :, k] for k in (3, 4, 2))
    by_own = np.empty((count, 6, data.own_width))
    by_own[..., :joints] = -Ad_c_v @ frames.by_joints()
    by_own[..., joints:] = -Ad_c_floor @ _stance_twists(stance)
    for value, effect in state.present(layout, FloorEffect):
        by_base[..., BASE] += by_own[..., joints:] @ (value * effect.stance_by_base(data, state.base))
    by_base[data.first] = 0.0  # the world is the base at its first station
    by_base[..., FLOOR] = by_own[..., joints:]
    if data.base_width > STAMP:
        rates = data.joint_rates(clock_s(data, state, "joints"))
        by_base[..., STAMP] = (by_own[..., :joints] @ rates[..., None])[..., 0]

    by_shared = np.zeros((count, 6, layout.size))
    by_shared[:, :3, :3] = by_shared[:, 3:6, 3:6] = -X[:3, :3].T
    of_chain = layout.of(ChainEffect)
    if of_chain:
        twists = np.stack([effect.twist(frames, change) for _, _, effect in of_chain], axis=2)
        by_shared[..., [column for column, _, _ in of_chain]] = -Ad_c_v @ twists
    for column, _, joint in layout.of(JointReading):
        by_shared[..., column] = (by_own[..., :joints] @ joint.rate(data)[:, :, None])[..., 0]
    for column, _, clock in layout.of(Clock):
        if clock.of == "joints" and data.base_width > STAMP:
            by_shared[..., column] = by_base[..., STAMP] * clock.stations(data)[:, None]
    for column, _, floor in layout.of(FloorEffect):
        stance = floor.stance(data, state.base)
        by_shared[..., column] = (by_own[..., joints:] @ stance[..., None])[..., 0]
    return by_base, by_own, se3.adjoint(T_c_k), by_shared


def _stance_twists(stance: FloatArray) -> FloatArray:
    """(N, 6, 3) left twists of the base in its level frame by roll, pitch and height."""
    twists = np.zeros((len(stance), 6, 3))
    twists[:, :3, :2] = se3.left_jacobian_so3(stance * [1.0, 1.0, 0.0])[:, :, :2]
    twists[:, 3:, :2] = np.cross((stance * [0.0, 0.0, 1.0])[:, :, None], twists[:, :3, :2], axis=1)
    twists[:, 5, 2] = 1.0
    return twists


def linearize_views(data: Dataset, state: State, inliers: Inliers, noise: Noise, rates: FloatArray) -> Views:
    """Residuals and information of all stations' images; rates: (N, 6) see `view_rates`."""
    T_c_k = board_in_camera(data, state)
    parts = [
        images_of(data, state, T_c_k, inliers, noise, rates, block) for block in blocks_of(data.stations)
    ]
    information, gradient, cost = (np.concatenate(part) for part in zip(*parts, strict=True))
    direct = np.array([column for column, _, _ in data.layout.direct], dtype=np.int64)
    return Views(information, gradient, cost, *_pose_columns(data, state, T_c_k), data.log, direct)


def images_of(
    data: Dataset,
    state: State,
    T_c_k: FloatArray,
    inliers: Inliers,
    noise: Noise,
    rates: FloatArray,
    stations: slice | IntArray,
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Information, gradient and cost of some stations' images or poses, see `Views`; T_c_k: of all, (N, 4, 4)."""
    if data.posed.any():
        return _measured_poses(data, T_c_k, inliers, noise, stations)
    residual, J = corner_residuals(data, state, T_c_k[stations], stations, rates[stations])
    root_weight = np.where(inliers.used_corners[stations], 1 / noise.pixel_px, 0.0)
    W = data.whitening[stations] * root_weight[..., None, None]
    J, r = whitened(W, J, out=J), whitened(W, residual)
    count, Q, cameras, corners, _ = J.shape
    information, gradient = np.zeros((count, Q, Q)), np.zeros((count, Q))
    for camera in range(cameras):
        # Not the constants of other cameras.
        concerned = [True] * 6 + [effect.concerns(camera) for _, _, effect in data.layout.direct]
        columns = np.flatnonzero(concerned)
        At = J[:, columns, camera].reshape(count, len(columns), 2 * corners)
        information[:, columns[:, None], columns] += At @ At.mT
        gradient[:, columns] += (At @ r[:, camera].reshape(count, 2 * corners, 1))[..., 0]
    return information, gradient, np.sum(r**2, axis=(1, 2, 3))


def _measured_poses(
    data: Dataset, T_c_k: FloatArray, inliers: Inliers, noise: Noise, stations: slice | IntArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """The same of measured poses: their residual is the left twist from the measured to the predicted pose."""
    off = se3.log(T_c_k[stations] @ se3.inverse(data.T_c_k[stations]))
    by_delta = _by_left_twist(off)
    used = inliers.views[stations] / noise.pose_scale**2
    weight = data.pose_weight[stations] * used[:, None, None]
    pull = (weight @ off[..., None])[..., 0]
    information = by_delta.mT @ weight @ by_delta
    gradient = np.einsum("nab,na->nb", by_delta, pull)
    return information, gradient, np.sum(off * pull, axis=1)


def _by_left_twist(twist: FloatArray) -> FloatArray:
    """(N, 6, 6) derivative of log(exp(delta) exp(twist)) by delta, to second order in the twist."""
    ad = np.zeros((len(twist), 6, 6))
    ad[:, :3, :3] = ad[:, 3:, 3:] = se3.skew(twist[:, :3])
    ad[:, 3:, :3] = se3.skew(twist[:, 3:])
    return np.eye(6) - ad / 2 + ad @ ad / 12
