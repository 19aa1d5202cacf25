"""What the sum of squares says of the size of the world by itself: residuals that are lengths shrink with it."""

from __future__ import annotations

import numpy as np

from mobilecal_cli.likelihood.posterior import Posterior
from mobilecal_cli.likelihood.processes import LEVELS
from mobilecal_cli.model import BoolArray, FloatArray

#: The constant that stands for the size of the world in the images.
_SIZE = "square_scale"
_HEIGHT = LEVELS.index("floor_m")


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
        bias[lin.data.layout.names.index(_SIZE)] = min(_squares(lin), _redundancy(lin))
    return bias


def _squares(lin: Posterior) -> float:
    missed, W = lin.legs.residual, lin.leg_weight
    height = lin.processes.whitened(lin.state.base)[:, _HEIGHT]
    sway = lin.state.own[:, -1] / lin.own_sigmas[:, -1]
    of_legs = np.einsum("la,lab,lb->", missed[:, :2], W[:, :2], missed)
    return float(of_legs + np.sum(height**2) + np.sum(sway[_swaying(lin)] ** 2))


def _redundancy(lin: Posterior) -> float:
    marginal, processes = lin.marginals, lin.processes
    left = lin.leg_covariance - marginal.legs
    height = marginal.innovations(processes.rho)[:, _HEIGHT, _HEIGHT] / processes.variance[:, _HEIGHT]
    sway = marginal.own[:, -1, -1] / lin.own_sigmas[:, -1] ** 2
    of_legs = np.einsum("lab,lba->", lin.leg_weight[:, :2], left[:, :, :2])
    left_over = float(of_legs + np.sum(1 - height) + np.sum(1 - sway[_swaying(lin)]))
    return min(max(left_over, 0.0), 2.0 * (len(left) + len(height)))  # far from the optimum, rounding is all


def _swaying(lin: Posterior) -> BoolArray:
    return lin.inliers.views & lin.data.drives
