"""Measurements with the estimated constants applied, and station-to-station corner errors in m and in pixels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.camera import project, project_with_jacobian
from mobilecal_cli.kinematics import integrate
from mobilecal_cli.likelihood.dataset import Dataset, dataset_of
from mobilecal_cli.likelihood.effects import TIMES, CameraEffect
from mobilecal_cli.likelihood.measurements import MotionPairs
from mobilecal_cli.likelihood.nuisance import PATTERNS, clocks_of, table
from mobilecal_cli.likelihood.state import State, cameras_at, clock_s, head_at, points_at
from mobilecal_cli.likelihood.views import board_poses, corner_residuals, view_rates
from mobilecal_cli.model import BoolArray, Extraction, FloatArray, Parameters, Residuals
from mobilecal_cli.solvers.transfer import base_motion, camera_motion

_LEAST_DEPTH_M = 0.01  # of a point that a camera does not show
_TRIANGULATION_STEPS = 8  # quadratic convergence: a displacement of ten pixels leaves 1e-6 px after three
_STILL_M = 1e-9


def at_state(
    extraction: Extraction,
    data: Dataset,
    state: State,
    noise_px: float | None = None,
    patterns: bool = False,
    corners: BoolArray | None = None,
) -> tuple[Extraction, MotionPairs]:
    """Measurements and pairs with a state's constants applied: cameras, time offsets, head chain and joints.

    Args:
        extraction, data: the measurements.
        state: gives the constants.
        noise_px: of the corners, px; as stated if None.
        patterns: whether those of the lenses are applied, too.
        corners: (N, C, M) those that the board poses rest on, see `board_poses`; all that were detected by default.
    """
    stated, cameras = extraction, cameras_at(data, state)
    extraction = replace(_as_modeled(stated, data, state, patterns), rig=replace(stated.rig, cameras=cameras))
    factor = 1.0 if noise_px is None else noise_px / data.claimed_px
    T_c_k = board_poses(data, state, data.seen if corners is None else corners)
    points_c = se3.act(T_c_k, points_at(data, state))
    on_boards = zip(extraction.observations, points_c, strict=True)
    seen = tuple(replace(o, points_c=points) for o, points in on_boards)
    extraction = triangulated_again(replace(extraction, observations=seen), factor)
    as_read = replace(state, own=np.zeros_like(state.own))
    return extraction, replace(
        data.pairs,
        points_c=np.stack([o.points_c for o in extraction.observations]),
        T_c_k=T_c_k,
        T_v_h=head_at(data, as_read),
        steps=data.steps(clock_s(data, state, "wheels")),
    )


def _as_modeled(extraction: Extraction, data: Dataset, state: State, patterns: bool) -> Extraction:
    """The same with each corner where `cameras_at` has it at the image's stamp.

    It was detected where the board was when its row was exposed, see `CameraChange`, and moved by the patterns of the
    lens, which are left in the pixels unless they are asked for.
    """
    rows = data.layout.constants
    of_lenses = [row for row in rows if isinstance(row.effect, CameraEffect) and row.kind in PATTERNS]
    of_times = [row for row in rows if isinstance(row.effect, CameraEffect) and row.effect.of in TIMES]
    undone = [row for row in (*of_lenses * patterns, *of_times) if state.value(row.name)]
    if not undone:
        return extraction
    rates = view_rates(data, state)
    shown, modeled = (
        corner_residuals(data.with_constants(kept), state, data.T_c_k, rates=rates, by_constants=False)[0]
        for kept in (
            [row for row in rows if row not in of_lenses or row in undone],
            [row for row in rows if row not in of_lenses and row not in of_times],
        )
    )
    moved = np.where(data.seen[..., None], shown - modeled, 0.0)
    observations = tuple(
        replace(
            o,
            views=tuple(
                replace(view, pixels=view.pixels - by) for view, by in zip(o.views, of_views, strict=True)
            ),
        )
        for o, of_views in zip(extraction.observations, moved, strict=True)
    )
    return replace(extraction, observations=observations)


def at_constants(
    extraction: Extraction, parameters: Parameters, constants: Mapping[str, float]
) -> tuple[Extraction, MotionPairs]:
    """The same with constants of an earlier calibration.

    Args:
        extraction: the measurements.
        parameters: the nine parameters.
        constants: name → difference from the stated value.
    """
    rig = extraction.rig
    every = *table(rig.cameras, rig.chain), *clocks_of(range(1, len(extraction.wheels)))
    rows = [row for row in every if constants.get(row.name)]
    data = dataset_of(extraction, rows)
    if not rows:
        return extraction, data.pairs
    boards = np.broadcast_to(np.eye(4), (data.logs, 4, 4))
    state = State.without_errors(data, parameters, boards, np.zeros((data.stations, 3)))
    known = {row.name: constants[row.name] for row in rows}
    return at_state(extraction, data, replace(state, constants=known))


def dead_reckoned(pairs: MotionPairs, parameters: Parameters) -> FloatArray:
    """T_w_v of every station, w being the base at its log's first observation: (N, 4, 4)."""
    T_w_v = np.broadcast_to(np.eye(4), pairs.T_v_h.shape).copy()
    T_vi_vj = base_motion(integrate(pairs.steps, parameters.wheels))
    for (i, j), T in zip(pairs.legs, T_vi_vj, strict=True):
        T_w_v[j] = T_w_v[i] @ T
    return T_w_v


def residuals_of(
    extraction: Extraction,
    pairs: MotionPairs,
    parameters: Parameters,
    inliers: BoolArray | None = None,
    rejected: BoolArray | None = None,
) -> Residuals:
    """Predict every station's corners in the station before (eq. 18) and compare, in m and in px.

    Args:
        extraction, pairs: the observations and the legs between them.
        parameters: the prediction's.
        inliers: (L,) legs to compare; all by default.
        rejected: (N, C, M) corners that do not count; none by default.
    """
    kept = np.arange(len(pairs.legs)) if inliers is None else np.flatnonzero(inliers)
    i, j = pairs.legs[kept].T
    cameras, observations = extraction.rig.cameras, extraction.observations
    predicted_c = se3.act(camera_motion(pairs, parameters)[kept], pairs.points_c[j])
    measured = np.stack([[view.seen for view in o.views] for o in observations], axis=1)
    pixels = np.stack([[view.pixels for view in o.views] for o in observations], axis=1)
    predicted = np.zeros((len(cameras.each), *predicted_c.shape[:2], 2))
    if measured.any():
        for k, (camera, T_c_camera) in enumerate(zip(cameras.each, cameras.T_c_each, strict=True)):
            points = se3.act(se3.inverse(T_c_camera), predicted_c) if k else predicted_c
            ahead = measured[k, i] | (points[..., 2] > _LEAST_DEPTH_M)
            predicted[k] = project(camera, np.where(ahead[..., None], points, [0.0, 0.0, 1.0]))
    squares = (predicted - pixels[:, i]) ** 2
    left_out = np.zeros_like(measured) if rejected is None else np.moveaxis(rejected, 1, 0)
    gross: BoolArray = np.asarray(left_out.any(axis=0))
    counted = (measured[:, i] & ~left_out[:, i] & ~gross[j])[..., None]
    apart = np.sum((predicted_c - pairs.points_c[i]) ** 2, axis=-1)
    variance = np.stack([np.trace(o.points_cov, axis1=-2, axis2=-1).mean() for o in observations])
    good = ~(gross[i] | gross[j])
    T_w_v = dead_reckoned(pairs, parameters)
    return Residuals(
        legs=pairs.legs[kept],
        leg_point_rms_m=np.sqrt(np.sum(apart, axis=-1, where=good) / np.maximum(good.sum(axis=-1), 1)),
        leg_corner_noise_m=np.sqrt(variance[i] + variance[j]),
        predicted_px=predicted,
        leg_reprojection_px=np.sqrt(
            np.sum(squares, axis=(0, 2, 3), where=counted) / np.maximum(counted.sum(axis=(0, 2, 3)), 1)
        ),
        T_w_v=T_w_v,
        T_w_k=T_w_v @ pairs.T_v_h @ parameters.T_h_c @ pairs.T_c_k,
    )


def triangulated_again(extraction: Extraction, factor: float = 1.0) -> Extraction:
    """The same with corners triangulated anew and their covariances, of cameras that are not those of the recording.

    Gauss-Newton steps from the points as they are, none of which changes a depth by more than half of it; corners that
    not even two cameras see stay.

    Args:
        extraction: with these cameras.
        factor: noise of the corners over the stated one.
    """
    observations, cameras = extraction.observations, extraction.rig.cameras
    points = np.stack([o.points_c for o in observations])
    detected = np.stack([[view.seen for view in o.views] for o in observations], axis=1)
    pixels = np.stack([[view.pixels for view in o.views] for o in observations], axis=1)
    covariance = np.stack([o.points_cov for o in observations])
    several = detected.sum(axis=0) > 1
    for _ in range(_TRIANGULATION_STEPS if several.any() else 0):
        errors, by_point = [], []
        for k, (camera, T_c_camera) in enumerate(zip(cameras.each, cameras.T_c_each, strict=True)):
            T_camera_c = se3.inverse(T_c_camera)
            usable = (detected[k] & several)[..., None]
            own = se3.act(T_camera_c, points) if k else points
            at, J = project_with_jacobian(camera, np.where(usable, own, [0.0, 0.0, 1.0]))
            errors.append(np.where(usable, pixels[k] - at, 0.0))
            by_point.append(np.where(usable[..., None], J @ T_camera_c[:3, :3] if k else J, 0.0))
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
        of_pixels = np.stack([[view.cov_px2 for view in o.views] for o in observations])  # (N, C, M, 2, 2)
        each = (by_pixel[..., 2 * k : 2 * k + 2] for k in range(len(cameras.each)))
        parts = (G @ of_pixels[:, k] @ G.mT for k, G in enumerate(each))
        covariance = np.where(several[..., None, None], sum(parts), covariance)
    seen = zip(observations, points, factor**2 * covariance, strict=True)
    return replace(extraction, observations=tuple(replace(o, points_c=p, points_cov=c) for o, p, c in seen))
