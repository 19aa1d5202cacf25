"""Which measurements agree, whatever the others say: graduated non-convexity (Yang et al., 2020).

Truncated least squares count a measurement by its squared distance, but at most by a limit: one that is farther off has
no influence. Their sum has many minima. So each measurement has a weight, and the width in which weights fall from 1 to
0 begins so large that all count. It shrinks again and again, between steps of all unknowns.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.special import chdtri

from mobilecal_cli.errors import SolveError
from mobilecal_cli.likelihood.corners import FEWEST_CORNERS, corner_residuals, fitted_poses, whitened
from mobilecal_cli.likelihood.dataset import DEGREES, Inliers
from mobilecal_cli.likelihood.linearization import FREE_JOINT, solvable
from mobilecal_cli.likelihood.measurements import JOINTS
from mobilecal_cli.likelihood.posterior import Posterior
from mobilecal_cli.likelihood.state import State
from mobilecal_cli.model.arrays import BoolArray, FloatArray, IntArray
from mobilecal_cli.solvers.optimize import proposed

_CHANCE = 1e-4  # that a good measurement is beyond its limit
#: Largest squared distance of each kind: chi-squared. And the median of good measurements over it.
_LIMIT = {kind: float(chdtri(dof, _CHANCE)) for kind, dof in DEGREES.items()}
_USUAL = {kind: float(chdtri(dof, 0.5)) / _LIMIT[kind] for kind, dof in DEGREES.items()}
_FIRST_WIDTH = 2.0  # over the largest squared distance: all measurements count
_NEAR_WIDTH = 300.0  # over the limit, from a start that may be near: what is farther off pulls at nothing
_LAST_WIDTH = 0.05  # over the limit: hardly a measurement is between used and rejected
_NARROWER = 3.0  # width over the next one
_STEPS = 2  # of all unknowns at each width
_LITTLE = 1.0  # of the cost: a step that promises less waits for the next width
_ROUNDS = 5  # from a minimum that is not sure
_TRIALS, _LEAST_DAMPING = 12, 1e-4  # of one step, each with ten times the damping: the last with 1e7
#: Share of stations or legs that do not agree, or median distance over the usual one: then more starts are tried.
_MANY, _MUCH = 1 / 4, 4.0
_TINY = 1e-9  # weight and distance that stand for 0


def agreeing(starts: Iterable[Posterior], near: Iterable[Posterior]) -> tuple[State, Inliers]:
    """The state on which most measurements agree, and those that do: of the minima from some starts, the least.

    A station that takes several wrong readings to fit is one with wrong images.

    Args:
        starts: with the corners and images that may be used, and supposed noise levels. The limit of a kind is larger
            where most of its measurements are farther off than these explain.
        near: starts of which some may be near the minimum, tried until two starts lead to the least one, and it is
            sure. What is very far off there has no say.

    Raises:
        SolveError: no start leads to a minimum.
    """
    minima, further = list(_minima(starts, np.inf)), _minima(near, _NEAR_WIDTH)
    while not _settled(minima) and (minimum := next(further, None)) is not None:
        minima.append(minimum)
    if not minima:
        raise SolveError(
            "no set of measurements agrees on the parameters",
            "check the signs and units of joints and wheels in rig.yaml, and that the base turns and drives",
        )
    least = _least(minima)
    for _ in range(_ROUNDS):
        # What was far off at the start may be near by now.
        again = least if least.sure else next(_minima([least.lin], _NEAR_WIDTH), least)
        if again.cost > least.cost - _LITTLE:
            break
        least = again
    views = least.used["views"] & (np.sum(~least.used["readings"], axis=1) <= 1)
    readings = least.used["readings"] | ~views[:, None]
    inliers = replace(least.lin.inliers, views=views, legs=least.used["legs"], readings=readings)
    return least.lin.state, inliers


@dataclass(frozen=True, eq=False)
class _Minimum:
    """Where falling widths lead.

    Attributes:
        lin: the point.
        used: the measurements of each kind within their limits.
        usual: median distance of each kind over that of good measurements.
        cost: truncated.
    """

    lin: Posterior
    used: Mapping[str, BoolArray]
    usual: Mapping[str, float]
    cost: float

    @property
    def sure(self) -> bool:
        """Most stations and legs agree, about as well as the noise levels say."""
        agree = min(float(np.mean(used)) for used in (self.used["views"], self.used["legs"]) if used.size)
        return agree >= 1 - _MANY and max(self.usual.values()) < _MUCH

    def alike(self, other: _Minimum) -> bool:
        """Whether the same stations and legs agree at both."""
        return all(np.array_equal(self.used[kind], other.used[kind]) for kind in ("views", "legs"))


def _least(minima: Iterable[_Minimum]) -> _Minimum:
    """The least one, of those that are sure where there are any."""
    return min(minima, key=lambda minimum: (not minimum.sure, minimum.cost))


def _settled(minima: Sequence[_Minimum]) -> bool:
    """Whether the least one is sure, and more than one start leads to it."""
    return bool(minima) and _least(minima).sure and sum(_least(minima).alike(other) for other in minima) > 1


def _minima(starts: Iterable[Posterior], width: float) -> Iterator[_Minimum]:
    """Those to which the starts lead; a start that leads nowhere, or beyond all numbers, is left out."""
    for start in starts:
        try:
            with solvable():
                minimum = _minimum(start, width)
        except SolveError:
            continue
        if math.isfinite(minimum.cost):
            yield minimum


def _minimum(lin: Posterior, width: float) -> _Minimum:
    lin = lin.changed(state=lin.state.plus_shared(lin.priors.step_to_mean(lin.state)), apart=True)
    weights = {"readings": np.ones(lin.data.joints.shape)}
    damping = 0.0
    while width > _LAST_WIDTH:
        beyond = _beyond_limits(lin, weights["readings"])
        width = min(
            width / _NARROWER, _FIRST_WIDTH * max(float(of.max(initial=0.0)) for of in beyond.values())
        )
        usual = {kind: float(np.median(of)) / _USUAL[kind] if of.size else 1.0 for kind, of in beyond.items()}
        weights = {kind: _weight(of, width, max(usual[kind], 1.0)) for kind, of in beyond.items()}
        weights["views"] = weights["views"] * lin.inliers.views
        for _ in range(_STEPS):
            lin, damping, gain = _stepped(lin, weights, damping)
            if gain < _LITTLE:
                break
    used = {kind: weight > 0.5 for kind, weight in weights.items()}
    cost = _weighted(lin, {kind: of.astype(np.float64) for kind, of in used.items()}).cost
    cost += sum(_LIMIT[kind] * float(np.sum(~of)) for kind, of in used.items())
    return _Minimum(lin, used, usual, cost + _own_misfit(lin, np.flatnonzero(~used["views"])))


def _own_misfit(lin: Posterior, stations: IntArray) -> float:
    """Sum of squares of some stations' corners around the board that fits each best: no pose removes it."""
    data, state, every = lin.data, lin.state, lin.inliers.used_corners
    stations = stations[every[stations].sum(axis=(1, 2)) >= FEWEST_CORNERS]
    corners, rates = every[stations], lin.rates[:, stations]
    if not len(stations):
        return 0.0
    T_c_k = fitted_poses(state, data.T_c_k[stations], stations, corners, rates)
    off = whitened(
        data.whitening[stations], corner_residuals(state, T_c_k, stations, rates, by_constants=False)[0]
    )
    return float(np.sum(off[corners] ** 2)) / lin.noise.pixel_px**2


def _beyond_limits(lin: Posterior, of_readings: FloatArray) -> dict[str, FloatArray]:
    """Squared distance of each measurement over its limit; a station's allows for readings of little weight."""
    views, sigma = lin.views, _own_sigmas(lin, of_readings)
    J, G = views.by_own, views.rows[:, :6, :6]
    g = views.pull[:, :6] - (G @ (J @ lin.state.own[..., None]))[..., 0]  # without joint errors and sway
    off = (np.linalg.pinv(G, hermitian=True) @ g[..., None])[..., 0]
    spread = np.eye(6) + G @ ((J * sigma[:, None, :] ** 2) @ J.mT)
    of_views = np.einsum("na,na->n", off, np.linalg.solve(spread, g[..., None])[..., 0])
    of_legs = np.einsum("la,lab,lb->l", lin.legs.residual, lin.leg_weight, lin.legs.residual)
    of_readings = (lin.state.own[:, JOINTS] / lin.own_sigmas[:, JOINTS]) ** 2
    distance = {"views": of_views * lin.inliers.views, "legs": of_legs, "readings": of_readings}
    return {kind: of / _LIMIT[kind] for kind, of in distance.items()}


def _weight(beyond: FloatArray, width: float, limit: float) -> FloatArray:
    """Weights in [0, 1] of squared distances (eq. 14 of Yang et al. with mu = limit / width).

    Args:
        beyond: distances over the usual limit.
        width: by how much a distance exceeds the limit where the weight is 0.
        limit: over the usual one.
    """
    far = np.sqrt((limit + width) / np.maximum(beyond, _TINY))
    return np.asarray(np.clip(limit / width * (far - 1), 0.0, 1.0))


def _own_sigmas(lin: Posterior, of_readings: FloatArray) -> FloatArray:
    """(N, J + 3) sigma of each station's own errors, with weights (N, J) of the joint readings."""
    sigma = lin.own_sigmas.copy()
    sigma[:, JOINTS] = np.minimum(sigma[:, JOINTS] / np.sqrt(np.maximum(of_readings, _TINY)), FREE_JOINT)
    return sigma


def _weighted(lin: Posterior, weights: Mapping[str, FloatArray]) -> Posterior:
    """The same point with weights; that of a station is also that of its joint errors and its sway."""
    of_views, of_legs = (np.maximum(weights[kind], _TINY) for kind in ("views", "legs"))
    factor = 1 / np.sqrt(of_views)
    return lin.changed(
        ("legs",),
        {
            "views": lin.views.scaled(factor),
            "leg_weight": lin.leg_weight * of_legs[:, None, None],
            "own_sigmas": _own_sigmas(lin, weights["readings"]) * factor[:, None],
        },
    )


def _stepped(
    lin: Posterior, weights: Mapping[str, FloatArray], damping: float
) -> tuple[Posterior, float, float]:
    """The point after one step that lowers the weighted cost, the next damping, and the decrease that was promised.

    The point itself, and no decrease, where no step does.
    """
    start = _weighted(lin, weights)
    for _ in range(_TRIALS):
        try:
            step, gain = proposed(start, damping)
            trial = lin.after(step)
            # Far off, the cost may overflow: no improvement.
            with np.errstate(over="ignore", invalid="ignore"):
                better = _weighted(trial, weights).cost <= start.cost
            if better and trial.state.parameters.wheels.separation_m > 0:
                return trial, damping / 10 if damping > _LEAST_DAMPING else 0.0, gain
        except SolveError:
            pass
        damping = max(10 * damping, _LEAST_DAMPING)
    return lin, 0.0, 0.0
