"""Rotation of each side of several wheels: their mean, if they turn alike."""

from __future__ import annotations

import itertools
from collections.abc import Mapping, Sequence

import numpy as np

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model import FloatArray, Side, Track

#: Wheels are compared over windows of this length in which one of them turns by this much.
_WINDOW_S, _TURNS_RAD = 1.0, 0.2
#: Two wheels differ in a window by more than this, and by more than this share of the larger rotation ...
_DIFFER_RAD, _DIFFER_SHARE = 0.15, 0.1
#: ... and disagree if they do so in more than this share of the windows, or differ by this share over all of them.
_WINDOWS_SHARE, _TOTAL_SHARE = 0.1, 0.05


def side_of_wheels(side: Side, wheels: Mapping[str, Track]) -> Track:
    """Mean rotation of the wheels of a side, at the times of the one with most readings while all were recorded.

    Args:
        wheels: name for messages → track.

    Raises:
        RecordingError: the wheels were not recorded at the same time, or two of them do not turn alike.
    """
    tracks = tuple(wheels.values())
    if len(tracks) == 1:
        return tracks[0]
    first, last = max(t.time_ns[0] for t in tracks), min(t.time_ns[-1] for t in tracks)
    if last <= first:
        raise RecordingError(
            "the wheels were not recorded at the same time", "record all wheels during the whole recording"
        )
    ends_ns = np.linspace(first, last, max(2, round((last - first) * 1e-9 / _WINDOW_S) + 1)).astype(np.int64)
    turned_rad = np.diff([track.at(ends_ns) for track in tracks])
    moves = np.abs(turned_rad).max(axis=0) > _TURNS_RAD
    _check_alike(side, tuple(wheels), turned_rad[:, moves])
    times_ns = max((t.time_ns for t in tracks), key=len)
    times_ns = times_ns[(times_ns >= first) & (times_ns <= last)]
    return Track(times_ns, np.mean([track.at(times_ns) for track in tracks], axis=0))


def _check_alike(side: Side, names: Sequence[str], turned_rad: FloatArray) -> None:
    """Refuse wheels of which two do not turn alike; `turned_rad` is (K, W), by wheel and window with motion."""
    windows = turned_rad.shape[1]
    for (a, x), (b, y) in itertools.combinations(zip(names, turned_rad, strict=True), 2):
        larger = np.maximum(np.abs(x), np.abs(y))
        differ = int(np.sum(np.abs(x - y) > np.maximum(_DIFFER_RAD, _DIFFER_SHARE * larger)))
        total = np.abs(x).sum(), np.abs(y).sum()
        if min(total) >= (1 - _TOTAL_SHARE) * max(total) and differ <= _WINDOWS_SHARE * windows:
            continue
        what, cure = "do not turn alike", "find out which is wrong"
        if float(x @ y) < -0.5 * float(np.linalg.norm(x) * np.linalg.norm(y)):
            what = "turn in opposite directions"
            cure = f"set wheels.{side}.signs, with -1 for a wheel that counts backward"
        raise RecordingError(
            f"{a} and {b} {what}: they differ by more than 10 % in {differ} of {windows} seconds with motion, and turn "
            f"by {total[0]:.1f} and {total[1]:.1f} rad; the data does not show which of them is wrong",
            f"{cure}, or name the wheels to read in wheels.{side}.joints or wheels.{side}.fields; the wheels "
            "of mecanum and other omnidirectional robots differ always: they are not supported",
        )
