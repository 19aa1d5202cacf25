"""A fisheye lens with few unknowns: the equidistant projection."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mobilecal_cli.model import FloatArray

_FOCAL_LENGTHS = (0.2, 0.3, 0.45, 0.7)  # in units of the larger side of the image: 290 to 80 degrees across
_LARGEST_RAD = 3.0  # angle to the optical axis; the projection ends at pi
#: How far a lens may be from those tried: logarithm of the focal length, and center in units of the larger side.
_SPREAD = np.array([0.2, 0.1, 0.1])


@dataclass(frozen=True, slots=True, eq=False)
class Fisheye:
    """Distance from the principal point = focal length * angle to the optical axis.

    Attributes:
        center_px: (2,) principal point, px.
        focal_px: focal length, px.
    """

    center_px: FloatArray
    focal_px: float

    def moved(self, change: FloatArray, side_px: float) -> Fisheye:
        """The lens after a change (3,) of focal length and center, in units of what is likely."""
        by = _SPREAD * change
        return Fisheye(self.center_px + side_px * by[1:], self.focal_px * float(np.exp(by[0])))

    def reaches(self, pixels: FloatArray) -> bool:
        """Whether all pixels (M, 2) are images of directions."""
        return float(np.hypot(*(pixels - self.center_px).T).max()) < _LARGEST_RAD * self.focal_px

    def rays(self, pixels: FloatArray) -> FloatArray:
        """(M, 2) px → (M, 3) unit vectors."""
        x, y = ((pixels - self.center_px) / self.focal_px).T
        angle = np.hypot(x, y)
        sine = np.sinc(angle / np.pi)  # sin(angle) / angle
        return np.stack([sine * x, sine * y, np.cos(angle)], axis=-1)

    def project(self, points: FloatArray) -> FloatArray:
        """(..., 3) directions of any length → (..., 2) px."""
        across = np.hypot(points[..., 0], points[..., 1])
        angle = np.arctan2(across, points[..., 2])
        scale = self.focal_px * angle / np.maximum(across, 1e-12)
        return np.asarray(self.center_px + scale[..., None] * points[..., :2])


def fisheyes(height: int, width: int) -> tuple[Fisheye, ...]:
    """Lenses to start from in images of this size."""
    center_px = np.array([(width - 1) / 2, (height - 1) / 2])
    return tuple(Fisheye(center_px, max(width, height) * focal) for focal in _FOCAL_LENGTHS)
