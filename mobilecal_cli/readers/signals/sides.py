"""Rotation of each side of several wheels: the mean of those that turn alike."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import numpy as np

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model.arrays import BoolArray, FloatArray, IntArray
from mobilecal_cli.model.rig import SIDES, Side
from mobilecal_cli.model.signals import Track

#: Wheels are compared over windows of this length in which one of them turns by this much.
_WINDOW_S, _TURNS_RAD = 1.0, 0.2
#: Two wheels differ in a window by more than this, and by more than this share of the larger rotation ...
_DIFFER_RAD, _DIFFER_SHARE = 0.15, 0.1
#: ... and disagree if they do so in more than this share of the windows, or differ by this share over all of them. If
#: most wheels of a side disagree, one that slips or starts again once counts as one that agrees: the windows in which
#: two wheels differ are left out of their rotation.
_WINDOWS_SHARE, _TOTAL_SHARE = 0.1, 0.05
#: Wheels that agree and differ by this share over all windows are noted.
_NOTED_SHARE = 0.03
#: A wheel that turns by less than this share of the others' rotation stands still.
_STILL_SHARE = 0.01
#: Share of the windows in which the opposite side turns too: that side says that the robot moves.
_OPPOSITE_SHARE = 0.5


def _compared(turned_rad: FloatArray) -> tuple[BoolArray, BoolArray, BoolArray]:
    """Windows in which two wheels of a side differ, (K, K, W); which agree over all windows, over the others, (K, K).

    Args:
        turned_rad: (W, K) rotation of the wheels in each window with motion.
    """
    turned = turned_rad.T
    size = np.abs(turned)
    limit = np.maximum(_DIFFER_RAD, _DIFFER_SHARE * np.maximum(size[:, None], size))
    differ = np.abs(turned[:, None] - turned) > limit
    seldom = differ.sum(axis=2) <= _WINDOWS_SHARE * len(turned_rad)

    def alike(which: BoolArray) -> BoolArray:
        path = (which * size).sum(axis=2)  # of the second wheel of each pair
        same = np.minimum(path, path.T) >= (1 - _TOTAL_SHARE) * np.maximum(path, path.T)
        return np.asarray(seldom & same, dtype=np.bool_)

    return differ, alike(np.ones_like(differ)), alike(~differ)


def _stands(size: FloatArray, differ: BoolArray, opposite: BoolArray) -> bool:
    """Whether a wheel stands still in most windows in which it differs from another, and the robot moves there.

    Args:
        size: (2, W) absolute rotation of the wheel and of the other one.
        differ, opposite: (W,) windows in which they differ, and in which the opposite side turns.
    """
    own, other = size[:, differ]
    still = own <= _STILL_SHARE * other
    return bool(still.mean() > 1 - _WINDOWS_SHARE and opposite[differ].mean() > _OPPOSITE_SHARE)


def sides_of(wheels: Mapping[Side, Sequence[tuple[str, Track]]], notes: list[str]) -> dict[Side, Track]:
    """One track for each side; notes name the wheels that are left out.

    Args:
        wheels: the wheels of each side, with a name for messages.
        notes: receives what is left out.

    Raises:
        RecordingError: the wheels of a side disagree, and the data does not show which of them is wrong.
    """
    if all(len(each) == 1 for each in wheels.values()):
        return {side: each[0][1] for side, each in wheels.items()}
    times_ns = _windows(wheels)
    turned = {
        side: np.stack([np.diff(track.at(times_ns)) for _, track in each], axis=1)
        for side, each in wheels.items()
    }
    tracks: dict[Side, Track] = {}
    for side, opposite in zip(SIDES, reversed(SIDES), strict=True):
        moves = np.abs(turned[side]).max(axis=1) > _TURNS_RAD
        also = np.abs(turned[opposite][moves]).max(axis=1, initial=0.0) > _TURNS_RAD
        kept = _kept(side, [name for name, _ in wheels[side]], turned[side][moves], also, notes)
        tracks[side] = _mean([wheels[side][k][1] for k in kept])
    return tracks


def _windows(wheels: Mapping[Side, Sequence[tuple[str, Track]]]) -> IntArray:
    """Ends of the windows, within the time of all wheels."""
    tracks = [track for each in wheels.values() for _, track in each]
    first, last = max(t.time_ns[0] for t in tracks), min(t.time_ns[-1] for t in tracks)
    if last <= first:
        raise RecordingError(
            "the wheels were not recorded at the same time", "record all wheels during the whole recording"
        )
    return np.linspace(first, last, max(2, round((last - first) * 1e-9 / _WINDOW_S) + 1)).astype(np.int64)


def _kept(
    side: Side, names: Sequence[str], turned_rad: FloatArray, opposite: BoolArray, notes: list[str]
) -> tuple[int, ...]:
    """Indices of the wheels that turn alike: more than half of those that do not stand still, or all of them.

    Args:
        turned_rad: (W, K) rotation of the wheels in each window with motion.
        opposite: (W,) whether the opposite side turns too.
        notes: receives what is left out.
    """
    every, size = range(len(names)), np.abs(turned_rad)
    differ, agree, mostly = _compared(turned_rad)
    stand = {
        a
        for a, b in itertools.permutations(every, 2)
        if not agree[a, b] and differ[a, b].any() and _stands(size.T[[a, b]], differ[a, b], opposite)
    }
    moving = [k for k in every if k not in stand]
    majorities = [
        group
        for count in range(len(moving), len(moving) // 2, -1)
        for group in itertools.combinations(moving, count)
    ]
    kept = next(
        (group for alike in (agree, mostly) for group in majorities if alike[np.ix_(group, group)].all()), ()
    )
    total, windows = size.sum(axis=0), len(turned_rad)
    if not kept:
        disagree = (pair for pair in itertools.combinations(moving or every, 2) if not mostly[pair])
        a, b = next(disagree, (0, 0))
        x, y = turned_rad[:, [a, b]].T
        opposite_ways = float(x @ y) < -0.5 * float(np.linalg.norm(x) * np.linalg.norm(y))
        what = "turn in opposite directions" if opposite_ways else "do not turn alike"
        cure = "find out which is wrong"
        if opposite_ways:
            cure = f"set wheels.{side}.signs, with -1 for a wheel that counts backward"
        raise RecordingError(
            f"{names[a]} and {names[b]} {what}: they differ by more than 10 % in {int(differ[a, b].sum())} of "
            f"{windows} seconds with motion, and turn by {total[a]:.1f} and {total[b]:.1f} rad; the data does not "
            "show which of them is wrong",
            f"{cure}, or name the wheels to read in wheels.{side}.joints or wheels.{side}.fields; the wheels "
            "of mecanum and other omnidirectional robots differ always: they are not supported",
        )
    notes += (
        f"{names[a]} and {names[b]} differ by more than 10 % in {int(differ[a, b].sum())} of {windows} seconds with "
        "motion (a slip, or a driver that started again?); their mean is used there, too"
        for a, b in itertools.combinations(kept, 2)
        if not agree[a, b]
    )
    least, most = min(kept, key=lambda k: total[k]), max(kept, key=lambda k: total[k])
    if agree[least, most] and total[least] < (1 - _NOTED_SHARE) * total[most]:
        notes.append(
            f"{names[least]} turns by {total[least]:.1f} rad and {names[most]} by {total[most]:.1f} rad, "
            f"{100 * (total[most] / total[least] - 1):.1f} % more (other tires, or another resolution?); their mean is "
            "used"
        )
    usual = float(np.median(total[list(kept)]))
    for k in every:
        if k not in kept:
            why = "stands still in" if k in stand else "differs by more than 10 % in"
            notes.append(
                f"{names[k]}: left out, it {why} {int(differ[k, kept[0]].sum())} of {windows} seconds with motion; "
                f"it turns by {total[k]:.1f} rad, the other {side} wheels by {usual:.1f} rad"
            )
    return kept


def _mean(tracks: Sequence[Track]) -> Track:
    """Mean rotation of some wheels, at the times of the one with most readings while all were recorded."""
    if len(tracks) == 1:
        return tracks[0]
    first, last = max(t.time_ns[0] for t in tracks), min(t.time_ns[-1] for t in tracks)
    times_ns = max((t.time_ns for t in tracks), key=len)
    times_ns = times_ns[(times_ns >= first) & (times_ns <= last)]
    return Track(times_ns, np.mean([track.at(times_ns) for track in tracks], axis=0))
