"""Averages over the images of a station: common numbering, motion check, mean corners and their noise."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from mobilecal_cli.model import Board, BoolArray, Camera, Corners, FloatArray
from mobilecal_cli.vision.grid import turned, turns
from mobilecal_cli.vision.grid_map import roughness_px, scatter_px
from mobilecal_cli.vision.values import FLOOR_PX, Detection, rms


@dataclass(frozen=True, slots=True, eq=False)
class StationCorners:
    """One camera's corners in all images of a station.

    Attributes:
        pixels: (n, M, 2) px, in a common numbering.
        seen: (n, M) whether each corner was detected.
        cov: (n, M, 2, 2) covariance from each corner's fit, px^2.
    """

    pixels: FloatArray
    seen: BoolArray
    cov: FloatArray

    @classmethod
    def of(cls, detections: Sequence[Detection], board: Board) -> StationCorners:
        """Bring every image to the numbering nearest to that of the first."""
        pixels, cov = [], []
        for d in detections:
            options = [(turned(d.pixels, board, k), k) for k in turns(board)]
            nearest, turn = min(
                options, key=lambda option: float(np.sum((option[0] - detections[0].pixels) ** 2))
            )
            pixels.append(nearest)
            cov.append(turned(d.cov, board, turn))
        return cls(np.stack(pixels), np.stack([d.seen for d in detections]), np.stack(cov))

    def select(self, kept: BoolArray) -> StationCorners:
        """A subset of the images."""
        return StationCorners(self.pixels[kept], self.seen[kept], self.cov[kept])

    @property
    def drift_px(self) -> FloatArray:
        """(n,) distance of each image's corners from their median over all images, rms per coordinate, px."""
        if len(self.pixels) == 1:
            return np.zeros(1)
        measured = np.where(self.seen[..., None], self.pixels, np.nan)
        anywhere = self.seen.any(axis=0)
        off = measured[:, anywhere] - np.nanmedian(measured[:, anywhere], axis=0)
        return np.asarray(np.sqrt(np.nanmean(off**2, axis=(1, 2))))

    def average(self, board: Board, camera: Camera) -> Corners:
        """Mean of the corners that more than half of the images show, with the noise of the mean.

        The noise is the scatter over the images, pooled over the corners and divided by sqrt(n). Its lower
        limit is the roughness of the mean grid, because refinement errors common to all images do not average
        out. Noise in excess of the fits' covariances is added equally to all corners.
        """
        n, seen = len(self.pixels), 2 * self.seen.sum(axis=0) > len(self.pixels)
        weight = (self.seen & seen)[..., None]
        mean = np.sum(self.pixels * weight, axis=0) / np.maximum(weight.sum(axis=0), 1)
        if board.markers is None:
            roughness = roughness_px(camera, mean.reshape(board.rows, board.columns, 2))
        else:
            roughness = rms(scatter_px(board.grid()[seen, :2], mean[seen]))
        sigma_px = max(roughness, FLOOR_PX)
        if n > 1:
            freedom = max(2 * (int(weight.sum()) - int(seen.sum())), 1)
            scatter = np.sqrt(np.sum(weight * (self.pixels - mean) ** 2) / freedom)
            sigma_px = max(sigma_px, float(scatter / np.sqrt(n)))
        times = np.maximum(weight.sum(axis=0), 1)[..., None]
        claimed = np.sum(self.cov * weight[..., None], axis=0) / times**2
        usual = float(np.median(np.trace(claimed[seen], axis1=1, axis2=2))) / 2
        cov = claimed + max(sigma_px**2 - usual, 0.0) * np.eye(2)
        sigma_px = max(sigma_px, float(np.sqrt(usual)))
        return Corners(mean, sigma_px, n, seen, np.where(seen[:, None, None], cov / sigma_px**2, np.eye(2)))
