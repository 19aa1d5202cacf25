"""Pixels of the board's corners at the stations of a drive, without noise."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from mobilecal_cli.model import Camera, FloatArray
from mobilecal_cli.simulate.actual import ActualRobot
from mobilecal_cli.simulate.drive import base_in_world
from mobilecal_cli.simulate.route import Route
from mobilecal_cli.simulate.stereo import pixels

_SHUTTER_ROUNDS = 4  # each shrinks the error by the rows that a corner moves during one image


@dataclass(frozen=True, slots=True, eq=False)
class Views:
    """The board in both cameras at N stations.

    Attributes:
        T_c_k: (N, 4, 4) board coordinates to left camera coordinates.
        pixels: of the left and right camera, (N, M, 2) each.
    """

    T_c_k: FloatArray
    pixels: tuple[FloatArray, FloatArray]


def camera_in_world(actual: ActualRobot, route: Route, times_s: FloatArray, floor: FloatArray) -> FloatArray:
    """T_w_c of the left camera at given times, (N, 4, 4); `floor` as from `floor_in_base`."""
    robot = replace(actual.stated, joints=actual.joints)
    heads = np.array([robot.head_pose(joints) for joints in route.joints(times_s)])
    return np.asarray(base_in_world(route.drive.poses(times_s)) @ floor @ actual.lean @ heads @ robot.T_h_c)


def views(actual: ActualRobot, route: Route, times_s: FloatArray, floor: FloatArray) -> Views:
    """The board's corners in the actual cameras.

    Args:
        actual, route: the ground truth.
        times_s: (N,) times of the images.
        floor: (N, 4, 4) see `floor_in_base`.
    """
    rig, corners_k = actual.rig_cameras, actual.shape(route.board).corners_k()
    half_s = actual.rolling_shutter_s / 2
    T_r_c: FloatArray = np.asarray(np.linalg.inv(rig.T_c_r), dtype=np.float64)
    poses: dict[float, FloatArray] = {}

    def exposed(camera: Camera, T_x_c: FloatArray | None, late_s: float) -> FloatArray:
        if late_s not in poses:
            T_w_c = camera_in_world(actual, route, times_s + late_s, floor)
            poses[late_s] = np.asarray(np.linalg.inv(T_w_c) @ route.T_w_k)
        T_x_k = poses[late_s] if T_x_c is None else np.array([T_x_c @ T for T in poses[late_s]])
        return np.array([pixels(camera, corners_k @ T[:3, :3].T + T[:3, 3]) for T in T_x_k])

    both = []
    for camera, T_x_c, late_s in (
        (rig.left, None, 0.0),
        (rig.right, T_r_c, actual.right_late_s),
    ):
        at = exposed(camera, T_x_c, late_s)
        if half_s:
            first, last = (exposed(camera, T_x_c, late_s + half) for half in (-half_s, half_s))
            at = _row_by_row(first, at, last, camera.height)
        both.append(at)
    return Views(poses[0.0], (both[0], both[1]))


def _row_by_row(first: FloatArray, middle: FloatArray, last: FloatArray, height: int) -> FloatArray:
    """Pixels of a rolling shutter from those at the times of the first, middle and last row: (..., 2) each."""
    at = middle
    for _ in range(_SHUTTER_ROUNDS):
        s = (2 * at[..., 1:] + 1) / height - 1
        at = middle + s * (last - first) / 2 + s**2 * (first + last - 2 * middle) / 2
    return at
