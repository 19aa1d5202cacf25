"""What the sum of squares says of the size of the world by itself: residuals that are lengths shrink with it."""

from __future__ import annotations

import numpy as np

from mobilecal_cli.likelihood.budget import of_errors
from mobilecal_cli.likelihood.measurements import ERRORS
from mobilecal_cli.likelihood.posterior import Posterior
from mobilecal_cli.model import FloatArray

#: The constant that stands for the size of the world in the images.
_SIZE = "square_scale"
_HEIGHTS = ("floor_m", "sway_m")


def expected_gradient(lin: Posterior) -> FloatArray:
    """(P,) gradient that half the sum of squares is expected to have at the true parameters.

    If the whole world shrinks, the images stay; what the wheels miss by and the heights of floor and sway
    shrink, and half their sum of squares falls, whatever the size of the world. The best values of the stations'
    unknowns make it least. In the likelihood of the other parameters alone, these integrated out, half the logarithm of
    the determinant of their information makes up for it (Laplace's approximation): its derivative is minus the number
    of these residuals, less what the unknowns take up. Without noise they are zero, and so is the gradient.

    With 2,000 stations, a square size that is stated to 0.1 % would come out 1.5 of these sigmas too small.
    """
    bias = np.zeros(lin.data.layout.size)
    if _SIZE in lin.data.layout.names:
        W, left = lin.leg_weight[:, :2], lin.leg_covariance - lin.marginals.legs
        squares = float(np.einsum("la,lab,lb->", lin.legs.residual[:, :2], W, lin.legs.residual))
        redundancy = float(np.einsum("lab,lba->", W, left[:, :, :2]))
        for each in of_errors(lin, lin.state.base[:, ERRORS]):
            for level in filter(_HEIGHTS.__contains__, each.parts):
                of_level, free = each.shown(level)
                squares, redundancy = squares + float(of_level.sum()), redundancy + float(free.sum())
        # Far from the optimum, rounding is all.
        redundancy = min(max(redundancy, 0.0), 2.0 * (len(left) + lin.data.stations))
        bias[lin.data.layout.names.index(_SIZE)] = min(squares, redundancy)
    return bias
