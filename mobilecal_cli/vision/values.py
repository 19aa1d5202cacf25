"""What the stages inside vision hand to one another."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from mobilecal_cli.model import BoolArray, FloatArray
from mobilecal_cli.model.arrays import freeze, freeze_corners, freeze_covariances

Reason = Literal[
    "no board",
    "board partly hidden or cut off by the border",
    "squares too small",
    "blurred",
    "board continues beyond the grid",
    "board polarity does not alternate",
    "corners off the board's grid",
    "second board in view",
    "board of another size",
    "left and right do not fit together",
]
#: Where single precision is enough.
Single = NDArray[np.float32]
FLOOR_PX = 0.003  # what the corner model itself leaves on pictures without noise


@dataclass(frozen=True, slots=True)
class Look:
    """What pictures of one camera have in common, to begin the next fit with.

    Attributes:
        blur_px: sigma of the edges' blur, px.
        noise_grey: sigma of a pixel, grey levels; None where it is not known yet.
        contrast_grey: half of the step from dark to light; negative where the outer square next to corner 0 is dark.
        outer_whole: the board's outer squares are about as wide as the others.
    """

    blur_px: float = 0.9
    noise_grey: float | None = None
    contrast_grey: float = 0.0
    outer_whole: bool = True


@dataclass(frozen=True, slots=True, eq=False)
class Detection:
    """The board in one picture.

    Attributes:
        pixels: (M, 2) corner centres, px, in the order of `Board.grid`, numbered right-handed as seen from the
            board's front; square colours fix the origin as far as they can (see `grid.turns`), markers wholly.
        sigma_px: noise of one coordinate, px, from how far the corners scatter about a smooth grid.
        seen: (M,) the corners that were seen, all of them where nothing is said; the others' pixels are 0.
        cov: (M, 2, 2) what the fit of each corner claims, px^2; from `sigma_px` where nothing is said.
        look: what the next picture's fit may begin with; None where no corner model was fitted.
    """

    pixels: FloatArray
    sigma_px: float
    seen: BoolArray = field(default_factory=lambda: np.ones(0, dtype=np.bool_))
    cov: FloatArray = field(default_factory=lambda: np.zeros((0, 2, 2)))
    look: Look | None = None

    def __post_init__(self) -> None:
        freeze_corners(self, self.seen)
        freeze_covariances(self, "cov", self.cov, self.sigma_px**2)


@dataclass(frozen=True, slots=True)
class Miss:
    """Why a picture, or a pair of them, gives nothing.

    Attributes:
        reason: one of a few fixed phrases.
        detail: the numbers of this one.
    """

    reason: Reason
    detail: str


@dataclass(frozen=True, slots=True, eq=False)
class StereoPoints:
    """Corners seen by both cameras.

    Attributes:
        points_c: (M, 3) in the left camera's frame, m.
        points_cov: (M, 3, 3) their covariances, m^2.
        rms_px: root mean square of the reprojection residuals (four numbers a point), px; one of the four is
            the distance from the epipolar line, the other three are fitted.
    """

    points_c: FloatArray
    points_cov: FloatArray
    rms_px: float

    def __post_init__(self) -> None:
        freeze(self, points_c=("M", 3), points_cov=("M", 3, 3))


@dataclass(frozen=True, slots=True, eq=False)
class BoardPose:
    """Where the board is.

    Attributes:
        T_c_k: (4, 4) board coordinates to left camera coordinates, m.
        T_c_k_cov: (6, 6) its covariance, tangent order of `se3`, left perturbation T = exp(delta) T_c_k.
        scale: factor on the board's points that fits best; 1 where it was held.
        scale_sigma: its standard deviation; 0 where it was held.
        rms_px: root mean square of the reprojection residuals per coordinate, px.
    """

    T_c_k: FloatArray
    T_c_k_cov: FloatArray
    scale: float
    scale_sigma: float
    rms_px: float

    def __post_init__(self) -> None:
        freeze(self, T_c_k=(4, 4), T_c_k_cov=(6, 6))


def rms(residuals: FloatArray) -> float:
    """Root mean square of all elements."""
    return float(np.sqrt(np.mean(np.square(residuals))))
