"""Calls of a stereo pair: the functions of several cameras, with the left and the right one as arguments."""

from __future__ import annotations

from dataclasses import replace

from mobilecal_cli import stations, vision
from mobilecal_cli.model import CameraRig, Observation, PictureIndex


def with_views(o: Observation, left=None, right=None, **others) -> Observation:
    """An observation with other corners in the left or right image."""
    return replace(o, views=(left or o.views[0], right or o.views[1]), **others)


def with_pair(cameras: CameraRig, left=None, right=None, T_c_r=None, **others) -> CameraRig:
    """A stereo pair with another left or right camera, or another pose of the right one."""
    each = (left or cameras.each[0], right or cameras.each[1])
    poses = cameras.T_c_each if T_c_r is None else (cameras.T_c_each[0], T_c_r)
    return replace(cameras, each=each, T_c_each=poses, **others)


def triangulate(cameras, left, right, noise_left, noise_right):
    """See `vision.triangulate`."""
    return vision.triangulate(cameras, [left, right], [noise_left, noise_right])


def board_pose(cameras, points_k, left, right, noise_left, noise_right, start, free_scale=False):
    """See `vision.board_pose`."""
    return vision.board_pose(cameras, points_k, [left, right], [noise_left, noise_right], start, free_scale)


def measure(log, station, left, right, cameras, board):
    """See `vision.measure`."""
    return vision.measure(log, station, list(zip(left, right, strict=True)), cameras, board)


def pair_images(left_ns, right_ns, tolerance_s):
    """See `stations.shots_of`."""
    images = {name: PictureIndex(ns, ns, ns) for name, ns in (("left", left_ns), ("right", right_ns))}
    return stations.shots_of(images, tolerance_s)
