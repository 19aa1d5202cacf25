"""Measurements with the estimated constants applied, and station-to-station corner errors in m and in pixels.

And what these consist of, to first order: corners, joints, floor and wheels.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.camera import project, project_with_jacobian
from mobilecal_cli.kinematics import head_jacobian
from mobilecal_cli.likelihood.constants import PATTERNS, clocks_of, table
from mobilecal_cli.likelihood.corners import blocks_of, board_poses, corner_residuals, of_camera
from mobilecal_cli.likelihood.dataset import Dataset, dataset_of
from mobilecal_cli.likelihood.effects import TIMES, CameraEffect
from mobilecal_cli.likelihood.legs import leg_covariances
from mobilecal_cli.likelihood.measurements import STAMP, in_each_camera
from mobilecal_cli.likelihood.posterior import Posterior
from mobilecal_cli.likelihood.state import State
from mobilecal_cli.model.arrays import BoolArray, FloatArray
from mobilecal_cli.model.calibration import Parameters
from mobilecal_cli.model.observations import Extraction
from mobilecal_cli.model.rig import CameraRig, WheelGeometry
from mobilecal_cli.model.solution import ErrorPart, Noise, Residuals
from mobilecal_cli.solvers.transfer import camera_motion, dead_reckoned

_TRIANGULATION_STEPS = 8  # quadratic convergence: a displacement of ten pixels leaves 1e-6 px after three
_STILL_M = 1e-9


def at_state(
    state: State,
    noise: Noise | None = None,
    patterns: bool = False,
    corners: BoolArray | None = None,
    T_c_k: FloatArray | None = None,
) -> Dataset:
    """The measurements with a state's constants applied: cameras, time offsets, head chain, joints and board poses.

    Args:
        state: the measurements and the constants.
        noise: levels, of corners or measured poses; as stated if None.
        patterns: whether those of the lenses are applied, too.
        corners: (N, C, M) those that the board poses rest on, see `board_poses`; all that were detected by default.
        T_c_k: (N, 4, 4) these poses, if they are known.
    """
    data, pixels = state.data, _as_modeled(state, patterns)
    factor = 1.0 if noise is None else getattr(noise, data.images_level) / data.claimed_px
    if T_c_k is None:
        T_c_k = board_poses(state, data.seen if corners is None else corners)
    points_c, covariance = triangulated_again(state, pixels, se3.act(T_c_k, state.points_k))
    base = state.base.copy()
    base[:, STAMP:] = 0.0
    as_read = replace(state, base=base, own=np.zeros_like(state.own))
    return replace(
        data,
        cameras=state.cameras,
        chain=state.chain,
        pixels=pixels,
        T_c_k=T_c_k,
        points_c=points_c,
        points_cov=factor**2 * covariance,
        joints=as_read.joints,
        driven=data.steps(state.clock_s("wheels")),
    )


def _as_modeled(state: State, patterns: bool) -> FloatArray:
    """(N, C, M, 2) each corner where `State.cameras` have it at the image's stamp, px.

    It was detected where the board was when its row was exposed, see `CameraChange`, and moved by the patterns of the
    lens, which are left in the pixels unless they are asked for.
    """
    data, rows = state.data, state.data.layout.constants
    of_lenses = [row for row in rows if isinstance(row.effect, CameraEffect) and row.kind in PATTERNS]
    of_times = [row for row in rows if isinstance(row.effect, CameraEffect) and row.effect.of in TIMES]
    undone = [row for row in (*of_lenses * patterns, *of_times) if state.value(row.name)]
    if not undone:
        return data.pixels
    lenses, kept, times = ({row.name for row in some} for some in (of_lenses, undone, of_times))
    as_shown = [row for row in rows if row.name not in lenses - kept]
    as_modeled = [row for row in rows if row.name not in lenses | times]
    shown, modeled = (
        corner_residuals(each, data.T_c_k, rates=state.view_rates, by_constants=False)[0]
        for each in (replace(state, data=data.with_constants(some)) for some in (as_shown, as_modeled))
    )
    return np.asarray(data.pixels - np.where(data.seen[..., None], shown - modeled, 0.0))


def images_alike(lin: Posterior) -> State:
    """The state with each camera's corners where no image would have values of its own, see `Views.own_values`."""
    data, state, direct = lin.data, lin.state, [effect for _, _, effect in lin.data.layout.direct]
    if not lin.views.own:
        return state
    moved = np.zeros(data.pixels.shape)
    for own, values in lin.views.own_values(lin.noise).items():
        effect = direct[lin.views.traced[own] - 6]
        camera = next(k for k in range(len(data.cameras.each)) if effect.concerns(k))
        for block in blocks_of(data):
            _, J = of_camera(state, camera, state.T_c_k[block], block, lin.rates[:, block], [effect])
            moved[block, camera] += J[..., 6] * values[block, None, None]
    pixels = data.pixels - np.where(data.seen[..., None], moved, 0.0)
    return replace(state, data=replace(data, pixels=pixels))


def at_constants(extraction: Extraction, parameters: Parameters, constants: Mapping[str, float]) -> Dataset:
    """The same with parameters and constants (name → difference from the stated value) of an earlier calibration."""
    rig = extraction.rig
    every = *table(rig.cameras, rig.chain), *clocks_of(range(1, len(extraction.wheels)))
    rows = [row for row in every if constants.get(row.name)]
    data = dataset_of(extraction, rows)
    if not rows:
        return data
    boards = np.broadcast_to(np.eye(4), (data.logs, 4, 4))
    state = State.without_errors(data, parameters, boards, np.zeros((data.stations, 3)))
    return at_state(replace(state, constants={row.name: constants[row.name] for row in rows}))


def residuals_of(
    shown: Dataset,
    parameters: Parameters,
    inliers: BoolArray | None = None,
    rejected: BoolArray | None = None,
) -> Residuals:
    """Predict every station's corners in the station before (eq. 18) and compare, in m and in px.

    Args:
        shown, parameters: of the prediction.
        inliers: (L,) legs to compare; all by default.
        rejected: (N, C, M) corners that do not count; none by default.
    """
    pairs = shown.pairs
    kept = np.arange(len(pairs.legs)) if inliers is None else np.flatnonzero(inliers)
    i, j = pairs.legs[kept].T
    predicted_c = se3.act(camera_motion(pairs, parameters)[kept], pairs.points_c[j])
    measured = np.ascontiguousarray(np.moveaxis(shown.seen, 1, 0))
    pixels = np.ascontiguousarray(np.moveaxis(shown.pixels, 1, 0))
    predicted = np.zeros((len(shown.cameras.each), *predicted_c.shape[:2], 2))
    if measured.any():
        for k, (camera, _, points) in enumerate(in_each_camera(shown.cameras, predicted_c, measured[:, i])):
            predicted[k] = project(camera, points)
    squares = (predicted - pixels[:, i]) ** 2
    left_out = np.zeros_like(measured) if rejected is None else np.moveaxis(rejected, 1, 0)
    gross: BoolArray = np.asarray(left_out.any(axis=0))
    counted = (measured[:, i] & ~left_out[:, i] & ~gross[j])[..., None]
    apart = np.sum((predicted_c - pairs.points_c[i]) ** 2, axis=-1)
    variance = np.stack([np.trace(cov, axis1=-2, axis2=-1).mean() for cov in shown.points_cov])
    good = ~(gross[i] | gross[j])
    T_w_v = dead_reckoned(pairs, parameters.wheels)
    T_w_c = T_w_v @ pairs.T_v_h @ parameters.T_h_c
    return Residuals(
        legs=pairs.legs[kept],
        leg_point_rms_m=np.sqrt(np.sum(apart, axis=-1, where=good) / np.maximum(good.sum(axis=-1), 1)),
        leg_corner_noise_m=np.sqrt(variance[i] + variance[j]),
        predicted_px=predicted,
        leg_reprojection_px=np.sqrt(
            np.sum(squares, axis=(0, 2, 3), where=counted) / np.maximum(counted.sum(axis=(0, 2, 3)), 1)
        ),
        T_w_v=T_w_v,
        T_w_c=T_w_c,
        T_w_k=T_w_c @ pairs.T_c_k,
    )


def triangulated_again(state: State, pixels: FloatArray, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Corners (N, M, 3) triangulated anew with a state's cameras, m, and their covariances at the stated noise.

    Gauss-Newton steps from the points as they are, none of which changes a depth by more than half of it; corners that
    not even two cameras see stay.
    """
    data, covariance = state.data, state.data.points_cov
    detected = np.moveaxis(data.seen, 1, 0)
    several = detected.sum(axis=0) > 1
    for _ in range(_TRIANGULATION_STEPS if several.any() else 0):
        errors, by_point = [], []
        usable = detected & several
        for k, (camera, R, own) in enumerate(in_each_camera(state.cameras, points, usable)):
            at, J = project_with_jacobian(camera, own)
            errors.append(np.where(usable[k, ..., None], pixels[:, k] - at, 0.0))
            by_point.append(np.where(usable[k, ..., None, None], J @ R, 0.0))
        A = np.concatenate(by_point, axis=-2)
        A = np.where(several[..., None, None], A, np.eye(A.shape[-2], 3))
        transposed = A.mT
        by_pixel = np.linalg.solve(transposed @ A, transposed)  # (N, M, 3, 2 C)
        step = (by_pixel @ np.concatenate(errors, axis=-1)[..., None])[..., 0]
        depth = points[..., 2:]
        step *= np.minimum(1.0, depth / 2 / np.maximum(np.abs(step[..., 2:]), 1e-12))
        points = np.where(several[..., None], points + step, points)
        if np.abs(step[several]).max() < _STILL_M:
            break
    if several.any():
        each = (by_pixel[..., 2 * k : 2 * k + 2] for k in range(len(state.cameras.each)))
        parts = (G @ data.pixels_cov[:, k] @ G.mT for k, G in enumerate(each))
        covariance = np.where(several[..., None, None], sum(parts), covariance)
    return points, covariance


def leg_squares(lin: Posterior, shown: Dataset, residuals: Residuals) -> dict[str, FloatArray]:
    """Mean square error of each leg by each kind of noise, (2, L): px^2 and m^2.

    The kinds are "corners" (or "poses"), "joints", "floor", "wheels" and, in motion, "stamps"; joints and wheels
    with what is uncertain between two readings.

    Images and legs are those with the estimated constants, see `at_state`.
    """
    data, noise, X, (i, j) = lin.data, lin.noise, lin.state.parameters.T_h_c, residuals.legs.T
    T_v_c, points_c, points_cov = shown.pairs.T_v_h @ X, shown.pairs.points_c, shown.points_cov
    by_point = _by_point(shown.cameras, data, points_c)
    base = np.zeros((data.stations, 6, 3))  # twists of the base by roll, pitch and height of the floor
    turn, lift = math.hypot(noise.floor_rad, noise.sway_rad), math.hypot(noise.floor_m, noise.sway_m)
    base[:, [0, 1, 5], [0, 1, 2]] = np.hypot([turn, turn, lift], lin.state.constant_stance)
    twists = {
        "joints": se3.adjoint(se3.inverse(X))
        @ head_jacobian(data.chain, data.joints)
        * np.hypot(noise.joint_rad * np.array(data.chain.joint_units), data.joints_between)[:, None],
        "floor": se3.adjoint(se3.inverse(T_v_c)) @ base,
    }
    if data.moving.any():
        twists["stamps"] = noise.stamp_s * lin.state.view_rates[0][..., None]
    by_twist = se3.by_twist(points_c)
    own = {name: _mean_squares(by_twist @ twist[:, None], by_point) for name, twist in twists.items()}
    # Corners: detected at one station, triangulated at the other.
    T_w_v = residuals.T_w_v
    T_w_c = T_w_v @ T_v_c
    R = (se3.inverse(T_w_c[i]) @ T_w_c[j])[:, None, :3, :3]
    carried = R @ points_cov[j] @ R.mT
    in_image = by_point[i] @ carried @ by_point[i].mT
    corners_px = np.trace(in_image, axis1=-2, axis2=-1).mean(axis=1) + 2 * noise.pixel_px**2
    # Wheels: x, y and heading of the base at the end of the leg, seen from its start.
    end = (se3.inverse(T_w_v[i]) @ T_w_v[j])[:, None, :2, 3]
    lever = se3.act(T_v_c[i], points_c[i])[..., :2] - end
    by_pose = np.zeros((*lever.shape[:2], 3, 3))
    by_pose[..., 0, 0] = by_pose[..., 1, 1] = 1.0
    by_pose[..., 0, 2], by_pose[..., 1, 2] = -lever[..., 1], lever[..., 0]
    values, vectors = np.linalg.eigh(_wheel_covariance(data, lin.state.parameters.wheels, residuals, noise))
    root = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    motion = T_v_c[i][:, None, :3, :3].mT @ by_pose @ root[:, None]
    return {
        "poses" if data.posed else "corners": np.stack([corners_px, residuals.leg_corner_noise_m**2]),
        **{name: square[:, i] + square[:, j] for name, square in own.items()},
        "wheels": _mean_squares(motion, by_point[i]),
    }


def error_parts(squares: Mapping[str, FloatArray]) -> dict[str, ErrorPart]:
    """Kind of noise → its error over all legs, of `leg_squares`."""
    return {name: ErrorPart(*np.sqrt(np.mean(square, axis=1)).tolist()) for name, square in squares.items()}


def _by_point(cameras: CameraRig, data: Dataset, points_c: FloatArray) -> FloatArray:
    """(N, M, 2, 3) px/m, derivative of pixels by points in the first camera's frame, of a camera that has the board."""
    by_point = np.zeros((*points_c.shape[:2], 2, 3))
    showing = np.argmax(data.seen.sum(axis=2), axis=1)
    for k, (camera, R, points) in enumerate(in_each_camera(cameras, points_c, np.moveaxis(data.seen, 1, 0))):
        mine = showing == k
        by_point[mine] = project_with_jacobian(camera, points[mine])[1] @ R
    return by_point


def _mean_squares(motion: FloatArray, by_point: FloatArray) -> FloatArray:
    """(2, n) mean squares, px^2 and m^2, of motions of the corners, (n, M, 3, k), each with its sigma."""
    return np.stack([np.sum(each**2, axis=(2, 3)).mean(axis=1) for each in (by_point @ motion, motion)])


def _wheel_covariance(data: Dataset, wheels: WheelGeometry, residuals: Residuals, noise: Noise) -> FloatArray:
    """(L, 3, 3) covariance of odometry's (x, y, heading) on each leg of the residuals."""
    every = sum(leg_covariances(data.steps(), wheels, noise).values())
    covariance = np.asarray(every)[np.isin(data.legs[:, 1], residuals.legs[:, 1])]
    path_m = np.hypot(noise.encoder_rad * data.encoder_shares, data.wheels_between) * wheels.vector[:2]
    square = np.sum(path_m[residuals.legs] ** 2, axis=(1, 2))  # of the readings at both ends
    return np.asarray(covariance + square[:, None, None] * np.diag([1 / 4, 0.0, 1 / wheels.separation_m**2]))
