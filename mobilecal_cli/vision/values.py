"""Data passed between the stages of vision."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from mobilecal_cli.model.arrays import BoolArray, FloatArray, ReadOnly, set_corner_defaults
from mobilecal_cli.model.signals import Reason

#: For arrays where single precision is enough.
Single = NDArray[np.float32]
LARGE_PX = 1280  # image width from which detectors run at reduced size first, which is three times as fast
#: Fewer in an image, or in those of all cameras, do not determine the board's pose: it may be partly visible.
LEAST_CORNERS = 8
FLOOR_PX = 0.003  # error of the corner model on images without noise


@dataclass(frozen=True, slots=True)
class Appearance:
    """Properties of one camera's recent images, to start the next fit.

    Attributes:
        blur_px: sigma of the edges' blur, px.
        noise_grey: sigma of a pixel, gray levels; None if not known yet.
        contrast_grey: half of the step from dark to light, gray levels; negative if the outer square next to
            corner 0 is dark.
        outer_whole: whether the board's outer squares are about as wide as the others.
    """

    blur_px: float = 0.9
    noise_grey: float | None = None
    contrast_grey: float = 0.0
    outer_whole: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class Detection(ReadOnly):
    """The board in one image.

    Attributes:
        pixels: (M, 2) corner centers, px, in the order of `Board.grid`, numbered right-handed as seen from
            the board's front. Square colors determine the origin as far as possible (see `grid.turns`),
            markers fully.
        sigma_px: noise of one coordinate, px, from the scatter of the corners about a smooth grid.
        seen: (M,) whether each corner was detected, by default all; pixels of the others are 0.
        cov: (M, 2, 2) covariance from the fit of each corner, px^2; by default from `sigma_px`.
        appearance: start values for the fit in the next image; None if no corner model was fitted.
    """

    pixels: Annotated[FloatArray, "M", 2]
    sigma_px: float
    seen: Annotated[BoolArray, "M"] = field(default_factory=lambda: np.ones(0, dtype=np.bool_))
    cov: Annotated[FloatArray, "M", 2, 2] = field(default_factory=lambda: np.zeros((0, 2, 2)))
    appearance: Appearance | None = None

    def __post_init__(self) -> None:
        set_corner_defaults(self, "cov", self.sigma_px**2)
        ReadOnly.__post_init__(self)


@dataclass(frozen=True, slots=True)
class Miss:
    """Why an image, or a stereo pair, gives no corners.

    Attributes:
        reason, detail: of what kind it is, and the values of this case.
    """

    reason: Reason
    detail: str


def rms(residuals: FloatArray) -> float:
    """Root mean square of all elements."""
    return float(np.sqrt(np.mean(np.square(residuals))))
