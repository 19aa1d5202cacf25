"""Maximum-likelihood estimate from all measurements: which of them are outliers, and the fit of the others."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from mobilecal_cli.errors import SolveError
from mobilecal_cli.likelihood.noise import Inliers
from mobilecal_cli.likelihood.residual_tests import limit
from mobilecal_cli.model import Extraction, Noise, Parameters
from mobilecal_cli.solvers import outliers
from mobilecal_cli.solvers.consensus import consensus
from mobilecal_cli.solvers.constraints import Constraints
from mobilecal_cli.solvers.fit import Fit
from mobilecal_cli.solvers.inference import FINE, Inference
from mobilecal_cli.solvers.initial import initial_state

_LOG = logging.getLogger(__name__)
_MOST_DECISIONS = 60
_CORNER_ROUNDS = 4
#: Scale of priors beyond which the outliers are decided again.
_CLEARLY_WIDER = 1.5


def maximum_likelihood(
    extraction: Extraction, constraints: Constraints | None = None, start: Parameters | None = None
) -> Fit:
    """Solve for all parameters by maximum likelihood.

    Args:
        extraction: at least four observations.
        constraints: fixed parameters, priors, and constants to estimate.
        start: where to start; the linear solution by default.

    Raises:
        ConfigError: a constraint that this robot cannot have.
        SolveError: not converged, or an unobservable parameter without a nominal value.
    """
    return robust_fit(Inference.of(extraction, constraints or Constraints()), start)


def robust_fit(inference: Inference, start: Parameters | None = None) -> Fit:
    """Scales of the priors and outliers, decided one under the other, and a fine fit at the end.

    Usually there are no outliers, and no scale is clearly above 1: then all measurements decide at once. Else, the
    outliers come first, under the stated priors: a gross error of a measurement must not look like a wrong description.

    A part that moves in the middle of the recording may drive the scales so far that the fit has no end. Then it is
    the one under the stated priors: the jump explains the misfit, not the description.

    Raises:
        SolveError: see `maximum_likelihood`.
    """
    initial = start or inference.initial()
    noise, inliers = _supposed(inference, initial, {})
    first = _first_fit(inference, initial, noise, inliers)
    fit = _as_described(inference, first) if first.inliers.same(inliers) else None
    if fit is not None:
        return fit
    held = replace(inference, scales_stay=True)
    fit = _without_outliers(held, first)
    try:
        return _with_scales(inference, held, fit)
    except SolveError:
        if held.jump(fit) is None:
            raise
        return held.estimate_noise(fit, FINE)


def _as_described(inference: Inference, first: Fit) -> Fit | None:
    """The fit of all measurements with the scales of the priors; None where one is an outlier or a scale is wide."""
    try:
        fit = _corners_decided(inference, inference.estimate_noise(first))
        wide = max(fit.noise.wider.values(), default=1.0) > _CLEARLY_WIDER
        if wide or not fit.inliers.views.all() or any(_suspects(inference, fit)):
            return None
        return inference.estimate_noise(fit, FINE)
    except (SolveError, np.linalg.LinAlgError):
        return None


def _with_scales(inference: Inference, held: Inference, fit: Fit) -> Fit:
    """The fit with the scales of the priors, from one under the stated priors.

    Where scales are clearly above 1, the outliers are decided again under these scales: from the beginning, if there
    were any. Meanwhile the scales stay.
    """
    # Anew from the supposed levels: a wrong description may have made them large.
    supposed = inference.first_noise(np.array([fit.noise.pixel_px]))
    fit = inference.estimate_noise(inference.fit(fit.lin.state, fit.inliers, supposed))
    wider = fit.noise.wider
    if max(wider.values(), default=1.0) > _CLEARLY_WIDER:
        if fit.inliers.same(Inliers.all_of(inference.data)):
            fit = _decided(held, fit)
        else:
            parameters = fit.lin.state.parameters
            fit = _without_outliers(held, _first_fit(held, parameters, *_supposed(held, parameters, wider)))
    noisy = outliers.too_many(fit)
    fit = _with_all(inference, fit, noisy) if noisy else fit
    return replace(inference.estimate_noise(fit, FINE), noisy=noisy)


def _restored(inference: Inference, fit: Fit) -> Fit:
    """Restore measurements consistent with the inliers: legs first, as a bad station breaks both of its legs."""
    for _ in range(2 * len(inference.data.legs)):
        legs = None if fit.inliers.legs.all() else outliers.consistent_legs(fit)
        if legs is None:
            break
        fit = inference.refit(fit, replace(fit.inliers, legs=legs))
    for _ in range(inference.data.stations):
        again = outliers.restored_views(fit, outliers.CONSENSUS_REDUNDANCY)
        if again is None:
            break
        fit = inference.refit(fit, again)
    return inference.fit(fit.lin.state, fit.inliers, fit.noise)


def _swapped(inference: Inference, fit: Fit) -> Fit | None:
    """A fit with a station's images restored and a leg beside it rejected instead: a slip looks like both."""
    inliers, legs = fit.inliers, inference.data.legs
    for station in np.flatnonzero(~inliers.views & outliers.usable(fit)):
        beside = np.flatnonzero((legs == station).any(axis=1))
        neighbors = np.setdiff1d(legs[beside], [station])
        if len(beside) == 2 and inliers.legs[beside].all() and inliers.views[neighbors].all():
            continue  # two legs from used stations agree about this one: its images are wrong
        for slipped in beside:
            views, driven = inliers.views.copy(), inliers.legs.copy()
            views[station], driven[beside], driven[slipped] = True, True, False
            without = replace(inliers, legs=driven)
            try:
                trial = inference.refit(fit, without)
                off, _ = trial.tests.predicted_views
                if off[station] > limit(inference.data.stations, 6, outliers.CONSENSUS_REDUNDANCY):
                    continue
                trial = inference.refit(trial, replace(without, views=views))
            except SolveError:
                continue
            if outliers.worst(trial) < 1.0:
                return inference.estimate_noise(trial)
    return None


def once_decided(inference: Inference, fit: Fit) -> Fit | None:
    """A fit with measurements restored or rejected; None where all are consistent."""
    inliers = fit.inliers
    back = outliers.restored_views(fit, outliers.known_by(fit, "views"))
    if back is not None:
        return _refitted(inference, fit, back)
    for kind in ("legs", "readings"):
        out = ~getattr(inliers, kind)
        agreeing = (
            outliers.some_of(inference.data, kind, np.argwhere(out & (outliers.external(fit, kind) < 1)))
            if out.any()
            else []
        )
        if agreeing:
            return _refitted(inference, fit, outliers.changed(inliers, kind, agreeing, to=True))
    for kind, wrong in _suspects(inference, fit):
        try:
            trial = _refitted(inference, fit, outliers.changed(inliers, kind, wrong, to=False))
            beyond = outliers.external(trial, kind)
        except SolveError:
            continue  # the other measurements alone do not determine all parameters
        if any(beyond[at] > 1 for at in wrong):
            return trial
    return None


def _suspects(inference: Inference, fit: Fit) -> Iterator[tuple[str, list[tuple[int, ...]]]]:
    """Kind and indices of inliers that are outliers against all others, to first order; the most striking first."""
    for _, kind, places in outliers.candidates(fit):
        without = outliers.changed(fit.inliers, kind, places, to=False)
        if without.views.sum() < outliers.FEWEST_VIEWS:
            continue
        try:
            beyond = outliers.external(inference.refit_near(fit, without), kind)
        except SolveError:
            continue  # the other measurements alone do not determine all parameters
        wrong = [at for at in places if beyond[at] > 1]
        if wrong:
            yield kind, wrong


def _refitted(inference: Inference, fit: Fit, inliers: Inliers) -> Fit:
    """A fit of other inliers, from where an earlier one ended, with noise levels of its own."""
    return inference.estimate_noise(inference.fit(fit.lin.state, inliers, fit.noise))


def _supposed(inference: Inference, initial: Parameters, wider: Mapping[str, float]) -> tuple[Noise, Inliers]:
    """Noise levels and inliers to begin with, for some scales of the priors: no image or board that fits nothing."""
    everything = Inliers.all_of(inference.data)
    state = initial_state(inference.data, initial, everything)
    corners, boards, own_px = outliers.gross_corners(inference.data, state)
    noise = replace(inference.first_noise(own_px), wider=wider)
    return noise, replace(everything, corners=corners, views=boards)


def _without_outliers(inference: Inference, first: Fit) -> Fit:
    """Noise levels and outliers, from a first fit."""
    return _decided(inference, _corners_decided(inference, inference.estimate_noise(first)))


def _decided(inference: Inference, fit: Fit) -> Fit:
    """The fit after all decisions on outliers that follow from it."""
    before: list[Inliers] = [fit.inliers]
    for _ in range(_MOST_DECISIONS):
        again = once_decided(inference, fit) or _swapped(inference, fit)
        if again is None or any(again.inliers.same(other) for other in before):
            break
        before.append(again.inliers)
        fit = again
    return fit


def _corners_decided(inference: Inference, fit: Fit) -> Fit:
    """The fit with gross corners decided in the estimated cameras and board: the stated ones may be wrong.

    In wrong cameras, corners that are right are rejected, and a misfit of all conceals gross ones. An image or board
    that does not fit as a whole is left to the tests of stations.
    """
    for _ in range(_CORNER_ROUNDS):
        corners, boards, _ = outliers.gross_corners(fit.data, fit.lin.state)
        used = fit.inliers.corners
        corners &= used.any(axis=2, keepdims=True)
        decided = np.where(boards[:, None, None], corners, used | corners)
        if np.array_equal(decided, used):
            break
        fit = _refitted(inference, fit, replace(fit.inliers, corners=decided))
    return fit


def _with_all(inference: Inference, fit: Fit, noisy: tuple[str, ...]) -> Fit:
    """A fit of all measurements of some kinds: so many outliers are noise, larger than supposed."""
    all_of = Inliers.all_of(fit.data)
    inliers = replace(fit.inliers, **{kind: getattr(all_of, kind) for kind in noisy})
    _LOG.info("more than a third of the %s are outliers: taken as noise", " and ".join(noisy))
    return _refitted(inference, fit, inliers)


def _first_fit(inference: Inference, initial: Parameters, noise: Noise, inliers: Inliers) -> Fit:
    """A fit of all measurements, or of those on which most legs agree if all together are implausible."""
    failure: SolveError | None = None
    fit: Fit | None = None
    try:
        state = initial_state(inference.data, initial, Inliers.all_of(inference.data))
        fit = inference.fit(state, inliers, noise)
        if outliers.plausible(fit) or not len(inference.data.legs):  # no legs that could agree
            return fit
    except SolveError as error:
        failure = error
    try:
        return _by_consensus(inference, initial, noise, inliers)
    except SolveError as error:
        # Noise far above the supposed one, and no outliers: all measurements, with noise levels to match.
        _LOG.info("no consensus of legs: %s", error.message)
    if fit is None:
        assert failure is not None
        raise failure
    return fit


def _by_consensus(inference: Inference, initial: Parameters, noise: Noise, inliers: Inliers) -> Fit:
    """A fit of the legs that agree, with all measurements restored that are consistent with it."""
    data = inference.data
    agreed = consensus(data, initial, noise, lambda pairs: inference.initial_of(pairs, initial))
    inflated = {
        name: getattr(noise, name) * agreed.noise_factor
        for name in ("wheel_rad_per_sqrt_rad", "joint_rad")
        if name not in inference.given
    }
    noise = replace(noise, **inflated)
    legs = ~agreed.bad
    touched = np.zeros((data.stations, 2), dtype=np.int64)
    for (i, j), good in zip(data.legs, legs, strict=True):
        touched[[i, j], int(good)] += 1
    lonely = (touched[:, 0] > 0) & (touched[:, 1] == 0)
    inliers = replace(inliers, legs=legs, views=inliers.views & ~lonely)
    state = initial_state(data, agreed.parameters, inliers)
    return _restored(inference, inference.fit(state, inliers, noise))
