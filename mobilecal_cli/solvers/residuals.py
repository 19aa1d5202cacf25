"""Measurements with the estimated constants applied, and station-to-station corner errors in m and in pixels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.camera import project, project_with_jacobian
from mobilecal_cli.kinematics import integrate
from mobilecal_cli.likelihood.dataset import Dataset, MotionPairs, dataset_of
from mobilecal_cli.likelihood.nuisance import camera_change, table
from mobilecal_cli.likelihood.state import State, cameras_at, head_at, points_at, wheel_clock_s
from mobilecal_cli.likelihood.views import view_rates
from mobilecal_cli.model import (
    BoolArray,
    Camera,
    Extraction,
    FloatArray,
    Parameters,
    Residuals,
    Side,
    StereoRig,
)
from mobilecal_cli.solvers.transfer import base_motion, camera_motion

_TRIANGULATION_STEPS = 8  # quadratic convergence: a displacement of ten pixels leaves 1e-6 px after three


def at_state(extraction: Extraction, data: Dataset, state: State) -> tuple[Extraction, MotionPairs]:
    """The cameras and the pairs with a state's constants applied: cameras, time offsets, head chain and joints."""
    cameras, extraction = cameras_at(data, state), _at_stamps(extraction, data, state)
    as_read = replace(state, joint_errors=np.zeros_like(state.joint_errors))
    return replace(extraction, rig=replace(extraction.rig, cameras=cameras)), replace(
        data.pairs,
        points_c=triangulated_again(extraction, cameras),
        T_v_h=head_at(data, as_read),
        steps=data.steps(wheel_clock_s(data, state)),
    )


def _at_stamps(extraction: Extraction, data: Dataset, state: State) -> Extraction:
    """The same with each corner where it was at its image's stamp, see `ImageClock`."""
    change = camera_change(data.layout.constants, state.constants)
    if not (change.right_late_s or change.readout_s):
        return extraction
    cameras, rates = change.apply(data.cameras), view_rates(data, state)[:, None]
    points = se3.act(data.T_c_k, points_at(data, state))
    velocity = np.cross(rates[..., :3], points) + rates[..., 3:]
    moved = []
    sides: tuple[tuple[Side, Camera], ...] = (("left", cameras.left), ("right", cameras.right))
    for k, (side, camera) in enumerate(sides):
        rows = (data.pixels[:, k, :, 1] + 0.5) / camera.height - 0.5
        late = points + change.late_s(side, rows)[..., None] * velocity
        if side == "right":
            points, late = (se3.act(se3.inverse(cameras.T_c_r), at) for at in (points, late))
        moved.append(project(camera, late) - project(camera, points))
    observations = tuple(
        replace(
            o,
            left=replace(o.left, pixels=o.left.pixels - left),
            right=replace(o.right, pixels=o.right.pixels - right),
        )
        for o, left, right in zip(extraction.observations, *moved, strict=True)
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
    rows = [row for row in table(rig.cameras, rig.chain) if constants.get(row.name)]
    data = dataset_of(extraction, rows)
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
    extraction: Extraction, pairs: MotionPairs, parameters: Parameters, inliers: BoolArray | None = None
) -> Residuals:
    """Predict every station's corners in the station before (eq. 18) and compare, in m and in px.

    Args:
        extraction, pairs: the observations and the legs between them.
        parameters: the prediction's.
        inliers: (L,) legs to compare; all by default.
    """
    sides: tuple[Side, Side] = ("left", "right")
    kept = np.arange(len(pairs.legs)) if inliers is None else np.flatnonzero(inliers)
    i, j = pairs.legs[kept].T
    cameras = extraction.rig.cameras
    predicted_c = se3.act(camera_motion(pairs, parameters)[kept], pairs.points_c[j])
    predicted_r = se3.act(se3.inverse(cameras.T_c_r), predicted_c)
    measured = np.stack([[getattr(o, side).seen for o in extraction.observations] for side in sides])
    predicted = {side: np.zeros((*predicted_c.shape[:2], 2)) for side in sides}
    if measured.any():
        predicted = {"left": project(cameras.left, predicted_c), "right": project(cameras.right, predicted_r)}
    seen = {
        "left": np.stack([o.left.pixels for o in extraction.observations])[i],
        "right": np.stack([o.right.pixels for o in extraction.observations])[i],
    }
    squares = np.stack([(predicted[side] - seen[side]) ** 2 for side in sides])
    counted = measured[:, i, :, None]
    T_w_v = dead_reckoned(pairs, parameters)
    return Residuals(
        legs=pairs.legs[kept],
        leg_point_rms_m=np.sqrt(np.mean(np.sum((predicted_c - pairs.points_c[i]) ** 2, axis=-1), axis=-1)),
        predicted_left_px=predicted["left"],
        predicted_right_px=predicted["right"],
        leg_reprojection_px=np.sqrt(
            np.sum(squares, axis=(0, 2, 3), where=counted) / np.maximum(counted.sum(axis=(0, 2, 3)), 1)
        ),
        T_w_v=T_w_v,
        T_w_k=T_w_v @ pairs.T_v_h @ parameters.T_h_c @ pairs.T_c_k,
    )


def triangulated_again(extraction: Extraction, cameras: StereoRig) -> FloatArray:
    """Corners triangulated with other cameras than stated, (N, M, 3), m, in the left camera.

    Gauss-Newton steps from the points of the stated cameras, none of which changes a depth by more than half of it;
    corners that only one camera sees stay as they are.
    """
    seen = extraction.observations
    points = np.stack([o.points_c for o in seen])
    left, right = (np.stack([getattr(o, side).pixels for o in seen]) for side in ("left", "right"))
    both = np.stack([o.left.seen & o.right.seen for o in seen])
    if not both.any():
        return points
    T_r_c = se3.inverse(cameras.T_c_r)
    for _ in range(_TRIANGULATION_STEPS):
        at, J = zip(
            project_with_jacobian(cameras.left, points),
            project_with_jacobian(cameras.right, se3.act(T_r_c, points)),
            strict=True,
        )
        error = np.concatenate([left - at[0], right - at[1]], axis=-1)
        by_point = np.concatenate([J[0], J[1] @ T_r_c[:3, :3]], axis=-2)
        transposed = np.swapaxes(by_point, -1, -2)
        step = np.linalg.solve(transposed @ by_point, transposed @ error[..., None])[..., 0]
        depth = points[..., 2:]
        step *= np.minimum(1.0, depth / 2 / np.maximum(np.abs(step[..., 2:]), 1e-12))
        points = np.where(both[..., None], points + step, points)
    return points
