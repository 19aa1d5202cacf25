"""Noise of corners from their scatter about what the camera model predicts for a flat board."""

from __future__ import annotations

import numpy as np

from mobilecal_cli.camera import project, undistorted
from mobilecal_cli.model import Camera, FloatArray
from mobilecal_cli.vision.grid_map import fit_grid, homography_px, noise_px


def roughness_px(camera: Camera, grid: FloatArray) -> float:
    """Noise of one corner coordinate, px, from the residuals of a smooth map.

    The map is a homography through the camera's model, and a polynomial for the errors of that model. A few corners
    determine too low a polynomial for the distortion of a lens itself, which would look like noise.

    Args:
        camera: the camera of the image.
        grid: (rows, columns, 2) px.
    """
    flat, inside = undistorted(camera, grid)
    if not inside.all():
        return fit_grid(grid).sigma_px
    rays = np.concatenate([homography_px(flat), np.ones((*grid.shape[:2], 1))], axis=-1)
    return noise_px(grid - project(camera, rays))
