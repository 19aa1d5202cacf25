"""Approach direction of each joint at each station: backlash depends on it."""

from __future__ import annotations

import numpy as np

from mobilecal_cli.model import Extraction, FloatArray, IntArray, Track

_MOVED_RAD = 0.002  # less is noise of a reading, not a motion
# A joint in motion: its own direction counts, not how it got there.
_INTERVAL_NS, _MOVING_RADPS = 50_000_000, 0.03
_AROUND_NS = 150_000_000  # a joint that moves within this time of a station, but hardly there, turns back


def approach_direction(extraction: Extraction) -> FloatArray:
    """(N, J) the direction of each joint's last motion before each station, from -1 to 1.

    Where a joint turns back, its play is on neither side: there the direction changes in proportion to the rate.
    """
    seen = extraction.observations
    log, joints = np.array([o.log for o in seen]), np.stack([o.joints for o in seen])
    times_ns = np.array([o.time_ns for o in seen], dtype=np.int64)
    sides = np.zeros(joints.shape)
    for number, tracks in enumerate(extraction.joint_tracks):
        mine = np.flatnonzero(log == number)
        for j, track in enumerate(tracks):
            last = _last_motion(track, times_ns[mine], joints[mine, j])
            at = times_ns[mine]
            before, here, after = (track.at(at + by) for by in (-_INTERVAL_NS, 0, _INTERVAL_NS))
            ends = [np.abs(track.at(at + by) - here) for by in (-_AROUND_NS, _AROUND_NS)]
            rate = (here - before) / (_INTERVAL_NS * 1e-9)
            own = np.clip((after - before) / (2e-9 * _INTERVAL_NS) / _MOVING_RADPS, -1, 1)
            turns = np.minimum(*ends) > _MOVED_RAD
            sides[mine, j] = np.where((np.abs(rate) > _MOVING_RADPS) | turns, own, last)
    return sides


def _last_motion(track: Track, times_ns: IntArray, readings: FloatArray) -> FloatArray:
    """(n,) from which side a joint last came to its readings at some times: +1, -1, or 0 where it never moved."""
    stops = np.searchsorted(track.time_ns, times_ns)
    ends = np.unique(stops[stops > 0])
    side = np.zeros(len(stops))
    if not len(ends):
        return side
    # The track's least and greatest value between the stations: only one stretch is searched value by value.
    starts = np.concatenate([[0], ends[:-1]])
    least = np.minimum.reduceat(track.value[: ends[-1]], starts)
    greatest = np.maximum.reduceat(track.value[: ends[-1]], starts)
    counts = np.searchsorted(ends, stops, side="right")  # of the stretches before each station
    for i, (before, reading) in enumerate(zip(counts.tolist(), readings.tolist(), strict=True)):
        away, looked = np.zeros(0, dtype=np.bool_), 0
        while not away.any() and looked < before:  # mostly the stretch just before; else twice as far back
            looked = min(2 * looked + 1, before)
            near = slice(before - looked, before)
            away = np.maximum(greatest[near] - reading, reading - least[near]) > _MOVED_RAD
        if away.any():
            stretch = before - 1 - int(np.argmax(away[::-1]))
            values = track.value[starts[stretch] : ends[stretch]]
            last = values[np.abs(values - reading) > _MOVED_RAD][-1]
            side[i] = np.sign(reading - last)
    return side
