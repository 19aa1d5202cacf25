"""Maximum-likelihood estimate from all measurements: which of them are outliers, and the fit of the others."""

from __future__ import annotations

import logging
from collections.abc import Iterator, Mapping
from contextlib import suppress
from dataclasses import replace

import numpy as np

from mobilecal_cli.errors import SolveError
from mobilecal_cli.likelihood.constants import PATTERNS, kind_of
from mobilecal_cli.likelihood.dataset import DEGREES, Inliers
from mobilecal_cli.likelihood.posterior import Posterior
from mobilecal_cli.model.arrays import IntArray
from mobilecal_cli.model.calibration import Parameters
from mobilecal_cli.solvers import outliers
from mobilecal_cli.solvers.fit import LikelihoodFit
from mobilecal_cli.solvers.inference import Inference
from mobilecal_cli.solvers.initial import start_state
from mobilecal_cli.solvers.robust import agreeing

_LOG = logging.getLogger(__name__)
#: Tried, of a first fit: of recordings that fit, ten are usual; from nominal values and with outliers, 50.
FIRST_STEPS = 60
_MOST_DECISIONS = 60
_CORNER_ROUNDS = 4
#: Scale of priors beyond which the outliers are decided again.
_CLEARLY_WIDER = 1.5


def robust_fit(inference: Inference, start: Parameters | None = None) -> LikelihoodFit:
    """Scales of the priors and outliers, decided one under the other, and a fine fit at the end.

    Usually there are no outliers: then all measurements decide at once.
    Else, the outliers come first, under the stated priors: a gross error of a measurement must not look like a wrong
    description.

    Raises:
        SolveError: not converged, or an unobservable parameter without a nominal value.
    """
    supposed = _supposed(inference, start or inference.initial(), {})
    first, as_stated = _first_fit(inference, supposed), replace(inference, scales_stay=True)
    fit = _of_all(inference, first) if first.inliers.same(supposed.inliers) else None
    return fit or _with_scales(inference, as_stated, _without_outliers(as_stated, first))


def _of_all(inference: Inference, first: LikelihoodFit) -> LikelihoodFit | None:
    """The fit of all measurements with the scales of the priors; None where one is an outlier."""
    try:
        fit = _corners_decided(inference, inference.estimate_noise(first))
        if not fit.inliers.views.all() or any(_suspects(inference, fit)):
            return None
        return inference.estimate_noise(fit, fine=True)
    except (SolveError, np.linalg.LinAlgError):
        return None


def _with_scales(inference: Inference, as_stated: Inference, fit: LikelihoodFit) -> LikelihoodFit:
    """The fit with the scales of the priors, from one under the stated priors.

    Where scales are clearly above 1, the outliers are decided again under these scales: from the beginning, if there
    were any. Meanwhile the scales stay.
    """
    # Anew from the supposed levels: a wrong description may have made them large.
    levels = inference.first_noise(np.array([fit.noise.pixel_px]))
    fit = inference.estimate_noise(inference.fit(fit.lin.state, fit.inliers, levels))
    wider = fit.noise.wider
    if max(wider.values(), default=1.0) > _CLEARLY_WIDER:
        if fit.inliers.same(Inliers.all_of(inference.data)):
            fit = _decided(as_stated, fit)
        else:
            supposed = _supposed(as_stated, fit.lin.state.parameters, wider)
            fit = _without_outliers(as_stated, _first_fit(as_stated, supposed))
    noisy = outliers.too_many(fit.data, fit.inliers)
    if noisy:
        _LOG.info("more than a third of the %s are outliers: taken as noise", " and ".join(noisy))
        all_of = Inliers.all_of(fit.data)
        inliers = replace(fit.inliers, **{kind: getattr(all_of, kind) for kind in noisy})
        fit = _refitted(inference, fit, inliers)
    return replace(inference.estimate_noise(fit, fine=True), noisy=noisy)


def _swapped(inference: Inference, fit: LikelihoodFit) -> LikelihoodFit | None:
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
                if outliers.beyond(trial, "views")[station] > 1:
                    continue
                trial = inference.refit(trial, replace(without, views=views))
            except SolveError:
                continue
            if outliers.worst(trial) < 1.0:
                return inference.estimate_noise(trial)
    return None


def once_decided(inference: Inference, fit: LikelihoodFit) -> LikelihoodFit | None:
    """A fit with measurements restored or rejected; None where all are consistent."""
    for inliers in _restored(fit):
        # Images that only wrong wheels place may agree to first order alone, and lead nowhere.
        with suppress(SolveError):
            return _refitted(inference, fit, inliers)
    for kind, wrong in _suspects(inference, fit):
        try:
            trial = _refitted(inference, fit, outliers.changed(fit.inliers, kind, wrong, to=False))
            beyond = outliers.beyond(trial, kind)
        except SolveError:
            continue  # the other measurements alone do not determine all parameters
        if any(beyond[at] > 1 for at in wrong):
            return trial
    return None


def _restored(fit: LikelihoodFit) -> Iterator[Inliers]:
    """Inliers with outliers of one kind that agree with all others, or with images whose reading is wrong alone."""
    for kind in DEGREES:
        used = getattr(fit.inliers, kind)
        agree = ~used & (outliers.beyond(fit, kind) < 1)
        if kind == "views":
            agree &= outliers.usable(fit)
        if agree.any():
            yield replace(fit.inliers, **{kind: used | agree})
    freed = outliers.with_reading_freed(fit)
    if freed is not None:
        yield freed


def _suspects(inference: Inference, fit: LikelihoodFit) -> Iterator[tuple[str, list[tuple[int, ...]]]]:
    """Kind and indices of inliers that are outliers against all others, to first order; the most striking first."""
    for _, kind, places in outliers.candidates(fit):
        without = outliers.changed(fit.inliers, kind, places, to=False)
        if without.views.sum() < outliers.FEWEST_VIEWS:
            continue
        try:
            beyond = outliers.beyond(inference.refit_near(fit, without), kind)
        except SolveError:
            continue  # the other measurements alone do not determine all parameters
        wrong = [at for at in places if beyond[at] > 1]
        if wrong:
            yield kind, wrong


def _refitted(inference: Inference, fit: LikelihoodFit, inliers: Inliers) -> LikelihoodFit:
    """A fit of other inliers, from where an earlier one ended, with noise levels of its own."""
    return inference.estimate_noise(inference.fit(fit.lin.state, inliers, fit.noise))


def _supposed(
    inference: Inference, initial: Parameters, wider: Mapping[str, float], legs: IntArray | None = None
) -> Posterior:
    """A first point, with supposed noise levels and without corners and boards that do not fit the board's shape.

    Base poses follow from one another by some legs, all by default. Between the others, images place them.
    """
    everything = Inliers.all_of(inference.data)
    driven = np.ones_like(everything.legs)
    if legs is not None:
        driven = np.isin(np.arange(len(driven)), legs)
    state = start_state(inference.data, initial, replace(everything, legs=driven))
    corners, boards, own_px = outliers.gross_corners(state)
    noise = replace(inference.first_noise(own_px), wider=wider)
    inliers = replace(everything, corners=corners, views=boards)
    return Posterior.at(state, inliers, noise, inference.priors(state))


def _first_fit(inference: Inference, supposed: Posterior) -> LikelihoodFit:
    """A fit of all measurements, or of those that agree if all together are implausible.

    Raises:
        SolveError: neither has a fit.
    """
    fit: LikelihoodFit | None = None
    why: SolveError | None = None
    try:
        fit = inference.fit(supposed.state, supposed.inliers, supposed.noise, FIRST_STEPS)
        if outliers.plausible(fit):
            return fit
    except SolveError as error:
        why = error
    legs = np.arange(len(inference.data.legs))
    # A start that is far off leads nowhere. A gross error of one leg is in one half of the legs only.
    # What lenses do beside their models decides on no gross error: as noise, steps are several times faster.
    rows = (row for row in inference.data.layout.constants if row.kind not in PATTERNS)
    plain = replace(inference, data=inference.data.with_constants(tuple(rows)))
    starts = _linear_starts(plain, supposed.noise.wider, legs) if fit is None else iter((fit.lin, supposed))
    near = _linear_starts(plain, supposed.noise.wider, legs[::2], legs[1::2])
    try:
        state, inliers = agreeing(
            *((_patterns_as_noise(plain, lin) for lin in those) for those in (starts, near))
        )
        return inference.fit(replace(state, data=inference.data), inliers, supposed.noise)
    except SolveError as error:
        if fit is None:
            raise why or error from error
        return fit


def _patterns_as_noise(inference: Inference, lin: Posterior) -> Posterior:
    """The same point without the patterns of lenses and corners, which the inference does not have."""
    state = replace(lin.state, data=inference.data)
    widest = max(camera.width for camera in state.data.cameras.each)
    px = np.hypot(lin.noise.pixel_px, kind_of("lens_waves").sigma * widest)
    noise = lin.noise.with_levels({"pixel_px": float(px)})
    return Posterior.at(state, lin.inliers, noise, inference.priors(state))


def _linear_starts(inference: Inference, wider: Mapping[str, float], *legs: IntArray) -> Iterator[Posterior]:
    """First points with linear parameters from sets of legs, and with these scales of the priors."""
    for some in filter(len, legs):
        try:
            yield _supposed(inference, inference.initial(some), wider, some)
        except (SolveError, np.linalg.LinAlgError):
            continue


def _without_outliers(inference: Inference, first: LikelihoodFit) -> LikelihoodFit:
    """Noise levels and outliers, from a first fit."""
    return _decided(inference, _corners_decided(inference, inference.estimate_noise(first)))


def _decided(inference: Inference, fit: LikelihoodFit) -> LikelihoodFit:
    """The fit after all decisions on outliers that follow from it."""
    before: list[Inliers] = [fit.inliers]
    for _ in range(_MOST_DECISIONS):
        again = once_decided(inference, fit) or _swapped(inference, fit)
        if again is None or any(again.inliers.same(other) for other in before):
            break
        before.append(again.inliers)
        fit = again
    return fit


def _corners_decided(inference: Inference, fit: LikelihoodFit) -> LikelihoodFit:
    """The fit with gross corners decided in the estimated cameras and board: the stated ones may be wrong.

    In wrong cameras, corners that are right are rejected, and a misfit of all conceals gross ones. An image or board
    that does not fit as a whole is left to the tests of stations.
    """
    for _ in range(_CORNER_ROUNDS):
        corners, boards, _ = outliers.gross_corners(fit.lin.state)
        used = fit.inliers.corners
        corners &= used.any(axis=2, keepdims=True)
        decided = np.where(boards[:, None, None], corners, used | corners)
        if np.array_equal(decided, used):
            break
        fit = _refitted(inference, fit, replace(fit.inliers, corners=decided))
    return fit
