"""What the station-to-station corner error consists of, to first order: corners, joints, floor and wheels."""

from __future__ import annotations

import math

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.camera import project_with_jacobian
from mobilecal_cli.kinematics import head_jacobian
from mobilecal_cli.likelihood.dataset import Dataset
from mobilecal_cli.likelihood.legs import leg_covariances
from mobilecal_cli.likelihood.measurements import MotionPairs
from mobilecal_cli.likelihood.posterior import Posterior
from mobilecal_cli.likelihood.state import constant_stance
from mobilecal_cli.model import CameraRig, ErrorPart, Extraction, FloatArray, Noise, Parameters, Residuals


def error_parts(
    lin: Posterior, extraction: Extraction, pairs: MotionPairs, residuals: Residuals
) -> dict[str, ErrorPart]:
    """Kind of noise ("corners", "joints", "floor", "wheels") → its error; empty without legs.

    Args:
        lin: the estimate.
        extraction, pairs: with the estimated constants, see `residuals.at_state`.
        residuals: of the estimate.
    """
    data, noise, parameters = lin.data, lin.noise, lin.state.parameters
    if not len(residuals.legs):
        return {}
    X, (i, j) = parameters.T_h_c, residuals.legs.T
    T_v_c, points_c = pairs.T_v_h @ X, pairs.points_c
    points_cov = np.stack([o.points_cov for o in extraction.observations])
    by_point = _by_point(extraction.rig.cameras, data, points_c)
    base = np.zeros((data.stations, 6, 3))  # twists of the base by roll, pitch and height of the floor
    turn, lift = math.hypot(noise.floor_rad, noise.sway_rad), math.hypot(noise.floor_m, noise.sway_m)
    base[:, [0, 1, 5], [0, 1, 2]] = np.hypot([turn, turn, lift], constant_stance(data, lin.state))
    twists = {
        "joints": se3.adjoint(se3.inverse(X))
        @ head_jacobian(data.chain, data.joints)
        * (noise.joint_rad * np.array(data.chain.joint_units)),
        "floor": se3.adjoint(se3.inverse(T_v_c)) @ base,
    }
    by_twist = np.concatenate(
        [-se3.skew(points_c), np.broadcast_to(np.eye(3), (*points_c.shape, 3))], axis=-1
    )
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
    values, vectors = np.linalg.eigh(_wheel_covariance(data, parameters, residuals, noise))
    root = vectors * np.sqrt(np.maximum(values, 0.0))[:, None, :]
    motion = T_v_c[i][:, None, :3, :3].mT @ by_pose @ root[:, None]
    squares = {
        "corners": np.stack([corners_px, residuals.leg_corner_noise_m**2]),
        **{name: square[:, i] + square[:, j] for name, square in own.items()},
        "wheels": _mean_squares(motion, by_point[i]),
    }
    return {name: ErrorPart(*np.sqrt(np.mean(square, axis=1)).tolist()) for name, square in squares.items()}


def _by_point(cameras: CameraRig, data: Dataset, points_c: FloatArray) -> FloatArray:
    """(N, M, 2, 3) px/m, derivative of pixels by points in the first camera's frame, of a camera that has the board."""
    by_point = np.zeros((*points_c.shape[:2], 2, 3))
    showing = np.argmax(data.seen.sum(axis=2), axis=1)
    for k, (camera, T_c_camera) in enumerate(zip(cameras.each, cameras.T_c_each, strict=True)):
        T_camera_c, mine = se3.inverse(T_c_camera), showing == k
        by_point[mine] = (
            project_with_jacobian(camera, se3.act(T_camera_c, points_c[mine]))[1] @ T_camera_c[:3, :3]
        )
    return by_point


def _mean_squares(motion: FloatArray, by_point: FloatArray) -> FloatArray:
    """(2, n) mean squares, px^2 and m^2, of motions of the corners, (n, M, 3, k), each with its sigma."""
    return np.stack([np.sum(each**2, axis=(2, 3)).mean(axis=1) for each in (by_point @ motion, motion)])


def _wheel_covariance(
    data: Dataset, parameters: Parameters, residuals: Residuals, noise: Noise
) -> FloatArray:
    """(L, 3, 3) covariance of odometry's (x, y, heading) on each leg of the residuals."""
    wheels = parameters.wheels
    every = sum(leg_covariances(data.steps(), wheels, noise).values())
    covariance = np.asarray(every)[np.isin(data.legs[:, 1], residuals.legs[:, 1])]
    if noise.encoder_rad:
        steps = data.encoder_step_rad
        path_m = noise.encoder_rad * steps / max(steps.max(), 1e-12) * wheels.vector[:2]
        square = 2 * float(np.sum(path_m**2))  # a reading at both ends
        covariance = covariance + np.diag([square / 4, 0.0, square / wheels.separation_m**2])
    return covariance
