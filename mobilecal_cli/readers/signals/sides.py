"""Rotation of each side from several wheels: their mean, without those that do not turn as the others do."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model import SIDES, BoolArray, FloatArray, IntArray, Side, Track

#: Wheels are compared over windows of this length in which one of them turns by this much.
_WINDOW_S, _TURNS_RAD = 1.0, 0.2
#: Two wheels differ in a window by more than this, and by more than this share of the larger rotation ...
_DIFFER_RAD, _DIFFER_SHARE = 0.15, 0.1
#: ... and disagree if they do so in more than this share of the windows, or differ by this share over all of them.
_WINDOWS_SHARE, _TOTAL_SHARE = 0.1, 0.05
#: A wheel that turns by less than this share of the others' rotation stands still.
_STILL_SHARE = 0.01
#: Share of the windows in which the opposite side turns too: that side says that the robot moves.
_OPPOSITE_SHARE = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class _Windows:
    """Rotation of the wheels of one side in each window with motion.

    Attributes:
        turned_rad: (W, K).
        opposite: (W,) whether the opposite side turns too.
    """

    turned_rad: FloatArray
    opposite: BoolArray

    def differ(self, a: int, b: int) -> BoolArray:
        """(W,) windows in which two wheels differ."""
        x, y = self.turned_rad[:, a], self.turned_rad[:, b]
        limit = np.maximum(_DIFFER_RAD, _DIFFER_SHARE * np.maximum(np.abs(x), np.abs(y)))
        return np.asarray(np.abs(x - y) > limit)

    def agree(self, a: int, b: int) -> bool:
        """Whether two wheels turn alike over the recording."""
        if not len(self.turned_rad):
            return True
        path = np.abs(self.turned_rad[:, [a, b]]).sum(axis=0)
        alike = float(path.min()) >= (1 - _TOTAL_SHARE) * float(path.max())
        return alike and bool(self.differ(a, b).mean() <= _WINDOWS_SHARE)

    def stands(self, wheel: int) -> bool:
        """Whether a wheel stands still in most windows in which it differs from another, and the robot moves there."""
        for other in range(self.turned_rad.shape[1]):
            differ = self.differ(wheel, other)
            turned = np.abs(self.turned_rad[differ])
            if self.agree(wheel, other) or not len(turned):
                continue
            still = turned[:, wheel] <= _STILL_SHARE * turned[:, other]
            if still.mean() > 1 - _WINDOWS_SHARE and self.opposite[differ].mean() > _OPPOSITE_SHARE:
                return True
        return False


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
        kept = _kept(side, wheels[side], _Windows(turned[side][moves], also), notes)
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
    side: Side, wheels: Sequence[tuple[str, Track]], windows: _Windows, notes: list[str]
) -> tuple[int, ...]:
    """Indices of the wheels that turn alike: more than half of those that do not stand still, or all of them."""
    stand = [k for k in range(len(wheels)) if windows.stands(k)]
    moving = [k for k in range(len(wheels)) if k not in stand]
    groups = (group for size in range(len(moving), 0, -1) for group in itertools.combinations(moving, size))
    kept = next(
        (group for group in groups if all(windows.agree(a, b) for a, b in itertools.combinations(group, 2))),
        (),
    )
    if not kept or 2 * len(kept) <= len(moving):
        raise _disagreement(side, wheels, windows, moving or list(range(len(wheels))))
    total = np.abs(windows.turned_rad).sum(axis=0)
    usual = float(np.median(total[list(kept)]))
    for k, (name, _) in enumerate(wheels):
        if k not in kept:
            differ = windows.differ(k, kept[0])
            why = "stands still in" if k in stand else "differs by more than 10 % in"
            notes.append(
                f"{name}: left out, it {why} {int(differ.sum())} of {len(differ)} seconds with motion; it turns by "
                f"{total[k]:.1f} rad, the other {side} wheels by {usual:.1f} rad"
            )
    return kept


def _disagreement(
    side: Side, wheels: Sequence[tuple[str, Track]], windows: _Windows, moving: Sequence[int]
) -> RecordingError:
    a, b = next(
        (pair for pair in itertools.combinations(moving, 2) if not windows.agree(*pair)),
        (moving[0], moving[0]),
    )
    total = np.abs(windows.turned_rad).sum(axis=0)
    x, y = windows.turned_rad[:, [a, b]].T
    opposite = float(x @ y) < -0.5 * float(np.linalg.norm(x) * np.linalg.norm(y))
    differ = windows.differ(a, b)
    names = f"{wheels[a][0]} and {wheels[b][0]}"
    what = "turn in opposite directions" if opposite else "do not turn alike"
    cure = (
        f"set wheels.{side}.signs, with -1 for a wheel that counts backward"
        if opposite
        else "find out which is wrong"
    )
    return RecordingError(
        f"{names} {what}: they differ by more than 10 % in {int(differ.sum())} of {len(differ)} seconds with motion, "
        f"and turn by {total[a]:.1f} and {total[b]:.1f} rad; the data does not show which of them is wrong",
        f"{cure}, or name the wheels to read in wheels.{side}.joints or wheels.{side}.fields; the wheels "
        "of mecanum and other omnidirectional robots differ always: they are not supported",
    )


def _mean(tracks: Sequence[Track]) -> Track:
    """Mean rotation of some wheels, at the times of the one with most readings while all were recorded."""
    if len(tracks) == 1:
        return tracks[0]
    first, last = max(t.time_ns[0] for t in tracks), min(t.time_ns[-1] for t in tracks)
    times_ns = max((t.time_ns for t in tracks), key=len)
    times_ns = times_ns[(times_ns >= first) & (times_ns <= last)]
    return Track(times_ns, np.mean([track.at(times_ns) for track in tracks], axis=0))
