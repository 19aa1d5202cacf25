"""Recordings that are given more than once: their data would count twice."""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np

from mobilecal_cli.errors import ConfigError
from mobilecal_cli.model import Extraction, LogSource, Observation, Track, WheelTrack

_SAME_SHARE = 0.9  # of the readings while both were recorded
_LEAST_OVERLAP = 0.05  # of the shorter recording
_SAME_VALUE = 1e-9  # rad, m or px
_HINT = "give each recording once, in one container: repeated data make the standard deviations too small"


def refuse_equal_files(logs: Sequence[LogSource]) -> None:
    """Refuse files of equal content, whatever their names.

    Raises:
        ConfigError: naming both files.
    """
    first: dict[str, str] = {}
    for log in logs:
        if log.sha256 in first:
            raise ConfigError(f"{first[log.sha256]} and {log.path} have the same content", _HINT)
        first[log.sha256] = log.path


def refuse_equal_recordings(extraction: Extraction, names: Sequence[str]) -> None:
    """Refuse recordings with the same readings or images, such as one recording in two containers.

    Args:
        extraction: of all recordings.
        names: of the recordings.

    Raises:
        ConfigError: naming both recordings.
    """
    joints = extraction.joint_tracks or ((),) * len(extraction.wheels)
    signals = list(zip(extraction.wheels, joints, strict=True))
    seen = [[o for o in extraction.observations if o.log == log] for log in range(len(signals))]
    for i, j in itertools.combinations(range(len(signals)), 2):
        if same_signals(signals[i], signals[j]):
            refuse_same(names[i], names[j], "wheel and joint readings")
        if _same_images(seen[i], seen[j]):
            refuse_same(names[i], names[j], "images")


def refuse_same(one: str, other: str, what: str) -> None:
    """Refuse two recordings.

    Raises:
        ConfigError: always.
    """
    raise ConfigError(f"{one} and {other} are the same recording: they contain the same {what}", _HINT)


def same_signals(one: tuple[WheelTrack, Sequence[Track]], other: tuple[WheelTrack, Sequence[Track]]) -> bool:
    """Whether all readings of both wheels and all joints are the same while both were recorded."""
    tracks, others = ([wheels.right, wheels.left, *joints] for wheels, joints in (one, other))
    return all(_same_readings(a, b) for a, b in zip(tracks, others, strict=False))


def _same_readings(one: Track, other: Track) -> bool:
    """Whether two tracks overlap and are the same there; unwrapped rotations may start elsewhere."""
    stamps, i, j = np.intersect1d(one.time_ns, other.time_ns, return_indices=True)
    shorter = min(len(one.time_ns), len(other.time_ns))
    if not len(stamps) or len(stamps) < _LEAST_OVERLAP * shorter:
        return False
    begin, end = max(one.time_ns[0], other.time_ns[0]), min(one.time_ns[-1], other.time_ns[-1])
    overlap = min(int(np.sum((track.time_ns >= begin) & (track.time_ns <= end))) for track in (one, other))
    apart = one.value[i] - other.value[j]
    same = np.abs(apart - np.median(apart)) < _SAME_VALUE
    return int(same.sum()) >= _SAME_SHARE * overlap


def _same_images(one: Sequence[Observation], other: Sequence[Observation]) -> bool:
    """Whether a station of one recording has the time and the corners of a station of the other."""
    at = {o.time_ns: o for o in one}
    return any(o.time_ns in at and _same_corners(at[o.time_ns], o) for o in other)


def _same_corners(one: Observation, other: Observation) -> bool:
    pairs = ((one.left, other.left), (one.right, other.right))
    return all(
        a.pixels.shape == b.pixels.shape and np.abs(a.pixels - b.pixels).max(initial=0.0) < _SAME_VALUE
        for a, b in pairs
    )
