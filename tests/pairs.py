"""Calls of a stereo pair: the functions of several cameras, with the left and the right one as arguments."""

from dataclasses import replace

import numpy as np

from mobilecal_cli import stations, vision
from mobilecal_cli.model.observations import Corners, Observation
from mobilecal_cli.model.rig import SIDES, CameraRig
from mobilecal_cli.model.signals import PictureIndex
from mobilecal_cli.vision import pose as geometry


def with_views(o: Observation, left=None, right=None, **others) -> Observation:
    """An observation with other corners in the left or right image."""
    return replace(o, views=(left or o.views[0], right or o.views[1]), **others)


def pair_of(left, right, T_c_r, rectified=False) -> CameraRig:
    """A stereo pair whose images are parallel."""
    poses, R_rect = (np.eye(4), T_c_r), (np.eye(3), np.eye(3))
    return CameraRig(SIDES, (left, right), poses, rectified, R_rect, "left", calibrated=True)


def with_pair(cameras: CameraRig, left=None, right=None, T_c_r=None, **others) -> CameraRig:
    """A stereo pair with another left or right camera, or another pose of the right one."""
    each = (left or cameras.each[0], right or cameras.each[1])
    poses = cameras.T_c_each if T_c_r is None else (cameras.T_c_each[0], T_c_r)
    return replace(cameras, each=each, T_c_each=poses, **others)


def corners_of(pixels, noise) -> Corners:
    """Corners with the sigma of one coordinate, px, or with covariances (M, 2, 2), px^2."""
    return Corners(pixels, noise, 1) if np.isscalar(noise) else Corners(pixels, 1.0, 1, relative_cov=noise)


def triangulate(cameras, left, right, noise_left, noise_right):
    """See `vision.pose.triangulate`."""
    return geometry.triangulate(cameras, [corners_of(left, noise_left), corners_of(right, noise_right)])


def board_pose(cameras, points_k, left, right, noise_left, noise_right, start, free_scale=False):
    """See `vision.pose.board_pose`."""
    views = [corners_of(left, noise_left), corners_of(right, noise_right)]
    return geometry.board_pose(cameras, points_k, views, start, free_scale)


def measured_anew(cameras, o: Observation, points_k, left: Corners, right: Corners) -> Observation | None:
    """An observation with other corners, and what follows from them; None if they cannot be triangulated."""
    points = geometry.triangulate(cameras, [left, right])
    if isinstance(points, vision.Miss):
        return None
    pose = geometry.board_pose(cameras, points_k, [left, right], o.T_c_k)
    return replace(
        o,
        views=(left, right),
        points_c=points.points_c,
        points_cov=points.points_cov,
        T_c_k=pose.T_c_k,
        T_c_k_cov=pose.T_c_k_cov,
        reprojection_px=pose.rms_px,
    )


def measure(station, left, right, cameras, board):
    """See `vision.measure`."""
    return vision.measure(station, list(zip(left, right, strict=True)), cameras, board)


def pair_images(left_ns, right_ns, tolerance_s):
    """See `stations.shots_of`."""
    images = {name: PictureIndex(ns, ns, ns) for name, ns in (("left", left_ns), ("right", right_ns))}
    return stations.shots_of(images, tolerance_s)
