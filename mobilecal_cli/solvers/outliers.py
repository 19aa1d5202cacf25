"""Which measurements are outliers: gross corners by themselves, everything else by the statistics of a fit."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
from scipy.special import chdtri

from mobilecal_cli.likelihood.corners import (
    FEWEST_CORNERS,
    blocks_of,
    corner_residuals,
    fitted_poses,
    median_size,
    whitened,
)
from mobilecal_cli.likelihood.dataset import DEGREES, Dataset, Inliers
from mobilecal_cli.likelihood.residual_tests import limit
from mobilecal_cli.likelihood.state import State
from mobilecal_cli.model.arrays import BoolArray, FloatArray, IntArray
from mobilecal_cli.solvers.fit import LikelihoodFit
from mobilecal_cli.solvers.noise import guess_worth

_CORNER_SIGMAS = 5.5
_BAD_IMAGE = 0.4  # share of gross corners from which on the whole board is rejected
_BAD_BOARD = 6.0  # corner noise of one station against the usual
_MANY = 1e6
_STRIKING = 0.2  # chance that any good measurement of a kind becomes a candidate
FEWEST_VIEWS = 4
_STRETCH = 3  # longest run of legs that nothing confirms: beyond it, something moved
_TOO_MANY = 1 / 3  # outliers among the measurements of a kind: that kind's noise is larger than supposed
_NEARER = 0.01  # squared distance over the former one: what the first order leaves of a large change is less
# Measurements that are judged at once, one more for every `_LONG_RECORDING` stations, lie so many stations apart that
# none is mistaken for another.
_APART = 5
#: From so many stations on, decisions are made a few at a time: so that their cost does not grow with the recording.
_LONG_RECORDING = 100
_MUCH = 4.0  # a first fit with statistics beyond this many times their limit is implausible
#: Noise levels that decide where a measurement of each kind is expected, the one that counts most first.
_JUDGED_BY = {
    "views": ("pose_scale", "joint_rad", "wheel_rad_per_sqrt_rad"),
    "legs": ("pose_scale", "wheel_rad_per_sqrt_rad"),
    "readings": ("joint_rad",),
}


def gross_corners(state: State) -> tuple[BoolArray, BoolArray, FloatArray]:
    """Corners and whole boards that fit the board's own shape, each station by itself.

    Cameras whose poses are only described are judged each alone: these poses may be degrees off.

    Returns:
        (N, C, M) inlier corners, (N,) inlier boards, and (N,) each station's corner noise, px.
    """
    data = state.data
    if data.posed:
        return data.seen, np.ones(data.stations, dtype=np.bool_), np.zeros(data.stations)
    size = np.zeros(data.seen.shape)
    numbers = np.arange(data.seen.shape[1])
    for together in numbers[None] if data.cameras.calibrated else numbers[:, None]:
        detected = data.seen & np.isin(numbers, together)[:, None]
        shown = np.flatnonzero(detected.any(axis=(1, 2)))
        for block in blocks_of(data, len(shown)):
            mine = shown[block]
            T = fitted_poses(state, data.T_c_k[mine], mine, detected[mine], robust=True)
            residual, _ = corner_residuals(state, T, mine, by_constants=False)
            off = np.linalg.norm(whitened(data.whitening[mine], residual), axis=-1)
            size[mine] += detected[mine] * off
    # The median length of a two-dimensional normal vector is 1.1774 sigma.
    own = median_size(size, data.seen) / 1.1774
    common = max(float(np.median(own)), 1e-9)
    near = size <= _CORNER_SIGMAS * np.maximum(common, np.minimum(own, _BAD_BOARD * common))[:, None, None]
    inliers = near & data.seen
    enough = np.all(inliers.sum(axis=2) >= (1 - _BAD_IMAGE) * data.seen.sum(axis=2), axis=1)
    enough &= inliers.sum(axis=(1, 2)) >= FEWEST_CORNERS
    return inliers, enough & (own < _BAD_BOARD * common), own


def worst(fit: LikelihoodFit) -> float:
    """Largest statistic of an inlier over its limit, for known noise levels."""
    count = fit.data.stations
    return max(
        float(np.max(getattr(fit.tests, kind)[getattr(fit.inliers, kind)], initial=0))
        / limit(count, dof, _MANY)
        for kind, dof in DEGREES.items()
    )


def plausible(fit: LikelihoodFit) -> bool:
    """Whether a first fit of everything, with supposed noise, shows no gross outlier."""
    most = 1.0 if fit.given >= set(fit.components) else _MUCH
    return worst(fit) < most and bool(fit.inliers.views.all())


def usable(fit: LikelihoodFit) -> BoolArray:
    """(N,) stations most of whose corners fit the board's shape."""
    most = fit.inliers.corners.sum(axis=2) >= 0.5 * fit.data.seen.sum(axis=2)
    return np.asarray(most.all(axis=1), dtype=np.bool_)


def with_reading_freed(fit: LikelihoodFit) -> Inliers | None:
    """The inliers with the images of the outlier station that fits best, and one of its readings rejected instead."""
    least = np.where(
        ~fit.inliers.views & usable(fit), fit.tests.views_freed.min(axis=1, initial=np.inf), np.inf
    )
    best = int(np.argmin(least))
    if least[best] > limit(fit.data.stations, DEGREES["views"] - 1, known_by(fit, "views")):
        return None
    reading = best, int(np.argmin(fit.tests.views_freed[best]))
    return changed(changed(fit.inliers, "views", [(best,)], to=True), "readings", [reading], to=False)


def candidates(fit: LikelihoodFit) -> list[tuple[float, str, list[tuple[int, ...]]]]:
    """Inliers that stand out, of each kind the most striking: (by how much, kind, indices)."""
    tests = fit.tests
    striking_most = []
    for kind, dof in DEGREES.items():
        values = np.where(getattr(fit.inliers, kind), getattr(tests, kind), 0.0)
        if not values.size:
            continue
        usual = float(chdtri(dof, _STRIKING / values.size))
        striking = np.argwhere(values > usual)
        places = some_of(fit.data, kind, striking[np.argsort(-values[values > usual], kind="stable")])
        if places:
            striking_most.append((float(values[places[0]]) / usual, kind, places))
    return sorted(striking_most, reverse=True)


def some_of(data: Dataset, kind: str, places: IntArray) -> list[tuple[int, ...]]:
    """The first of some places of a kind, (n, indices), that are far from one another.

    One of each recording, of long ones a few.
    """
    log = data.log[data.legs[:, 0]] if kind == "legs" else data.log
    left = 1 + np.bincount(data.log) // _LONG_RECORDING
    some: dict[int, list[tuple[int, ...]]] = {}
    for at in places:
        mine = int(log[at[0]])
        beside = some.setdefault(mine, [])
        if left[mine] and all(abs(at[0] - other[0]) > _APART for other in beside):
            beside.append(tuple(int(k) for k in at))
            left[mine] -= 1
    return [at for beside in some.values() for at in beside]


def beyond(fit: LikelihoodFit, kind: str) -> FloatArray:
    """Statistic of each measurement over its limit, against what all others predict; 0 where it does not matter."""
    statistic = getattr(fit.tests, kind) / limit(fit.data.stations, DEGREES[kind], known_by(fit, kind))
    return np.where(getattr(fit.tests, f"small_{kind}"), 0.0, statistic)


def restored(was: Inliers, fit: LikelihoodFit, before: LikelihoodFit | None = None) -> IntArray:
    """(logs,) number of former outliers of each recording that this fit uses.

    Args:
        was: the former inliers.
        fit: the fit.
        before: another one that uses them: then only those count that are outliers no more, or far nearer.
    """
    data, inliers = fit.data, fit.inliers
    count = np.zeros(data.log.max() + 1, dtype=np.int64)
    for kind in DEGREES:
        back = getattr(inliers, kind) & ~getattr(was, kind)
        if before is not None and back.any():
            back &= beyond(fit, kind) < np.maximum(1.0, _NEARER * beyond(before, kind))
        first = np.nonzero(back)[0]
        count += np.bincount(data.log[data.legs[first, 0] if kind == "legs" else first], minlength=len(count))
    return count


def longest_stretch(fit: LikelihoodFit) -> IntArray | None:
    """Legs one after another whose wheels and images confirm each other nowhere; None if no stretch is long.

    Two used stations confirm the legs between them if all of these are used, and few stations between are rejected.
    Nothing beyond the first or the last station confirms a stretch that reaches it: that counts like one more leg.
    """
    data, views, used = fit.data, fit.inliers.views, fit.inliers.legs
    longest, size = None, _STRETCH
    of_leg = data.log[data.legs[:, 0]]
    for log in np.unique(of_leg).tolist():
        legs = np.flatnonzero(of_leg == log)
        stations = np.append(data.legs[legs, 0], data.legs[legs[-1], 1])
        confirmed = np.zeros(len(legs), dtype=np.bool_)
        for a, b in itertools.pairwise(np.flatnonzero(views[stations]).tolist()):
            confirmed[a:b] = bool(used[legs[a:b]].all()) and b - a <= _STRETCH
        for is_sure, run in itertools.groupby(range(len(legs)), key=confirmed.__getitem__):
            mine = np.array(list(run))
            at_end = mine[0] == 0 or mine[-1] == len(legs) - 1
            if not is_sure and len(mine) + at_end > size:
                longest, size = legs[mine], len(mine) + int(at_end)
    return longest


def moved_before(fit: LikelihoodFit, stretch: IntArray) -> int:
    """The station before which something moved, for legs that nothing confirms: after the first legs of a recording."""
    log, views, (i, j) = fit.data.log, fit.inliers.views, fit.data.legs[stretch].T
    begins = i[0] == 0 or log[i[0] - 1] != log[i[0]]
    return int(j[-1] if begins and views[j[-1]] else j[0])


def known_by(fit: LikelihoodFit, kind: str) -> float:
    """Number of residuals that the noise rests on that a kind is judged by: very many where a level is given."""
    levels = [level for level in _JUDGED_BY[kind] if level in fit.components]
    if not levels or levels[0] in fit.given:
        return _MANY
    redundancy = sum(fit.components[level].redundancy for level in levels)
    return redundancy + guess_worth(redundancy)


def too_many(data: Dataset, inliers: Inliers) -> tuple[str, ...]:
    """Kinds of measurements more than a third of which are outliers; at a station, images or readings are.

    Those one after another at an end of a recording count as none: noise is everywhere, a change is from there on.
    """
    stations = inliers.views & inliers.readings.all(axis=1)
    shares = {"readings": stations, "legs": inliers.legs, "views": stations}
    log = {"legs": data.log[data.legs[:, 0]]}
    scattered = {kind: used[~_at_an_end(used, log.get(kind, data.log))] for kind, used in shares.items()}
    return tuple(kind for kind, used in scattered.items() if np.sum(~used) > _TOO_MANY * used.size)


def _at_an_end(used: BoolArray, log: IntArray) -> BoolArray:
    """(n,) outliers before the first used measurement of their recording, or after the last: a stretch of them.

    Args:
        used: (n,) in order of time.
        log: (n,) recording of each.
    """
    outside = np.zeros_like(used)
    for mine in (np.flatnonzero(log == number) for number in np.unique(log)):
        inside = np.flatnonzero(used[mine])
        if len(inside):
            for stretch in (mine[: inside[0]], mine[inside[-1] + 1 :]):
                outside[stretch] = len(stretch) > _STRETCH
    return outside


def changed(inliers: Inliers, kind: str, places: list[tuple[int, ...]], to: bool) -> Inliers:
    """The inliers with some measurements of a kind restored or rejected."""
    values = getattr(inliers, kind).copy()
    for at in places:
        values[at] = to
    return replace(inliers, **{kind: values})
