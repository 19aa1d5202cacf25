"""Readings that a driver repeats in motion are dropped; those of a joint at rest are not."""

from __future__ import annotations

import numpy as np
import pytest

from mobilecal_cli.model import Track
from mobilecal_cli.readers.signals.series import without_stale

_TIME_S = np.arange(0, 30, 0.05)


def _kept(value):
    """(n,) which readings are kept, and the notes."""
    track, notes = Track(np.round(_TIME_S * 1e9).astype(np.int64), value), []
    kept = without_stale("joint pan", track, notes)
    assert np.array_equal(kept.value, np.interp(kept.time_ns, track.time_ns, track.value))
    return np.isin(track.time_ns, kept.time_ns), notes


def test_repeated_readings_between_steps_of_a_motion_are_dropped():
    value = 0.5 * np.sin(0.4 * _TIME_S)
    for start in (100, 240):
        value[start : start + 20] = value[start]
    keep, notes = _kept(value)
    assert np.flatnonzero(~keep).tolist() == [*range(101, 120), *range(241, 260)]
    assert notes == [
        "joint pan: 38 of 600 readings repeat an old value during a motion, for up to 1.00 s; dropped"
    ]


def test_a_coarse_encoder_shows_them_too():
    """It changes in every second or third reading only."""
    value = 0.006 * np.round(0.05 * _TIME_S / 0.006)
    value[200:240] = value[200]
    keep, notes = _kept(value)
    dropped = np.flatnonzero(~keep)
    assert len(notes) == 1
    assert set(dropped) >= set(range(203, 238))
    assert set(dropped) <= set(range(195, 245))


def _stops_and_goes():
    return np.interp(_TIME_S, [0, 2, 4, 7, 9, 12, 14, 30], [0, 0, 0.5, 0.5, -0.5, -0.5, 0.2, 0.2])


@pytest.mark.parametrize(
    "value",
    [
        _stops_and_goes(),
        0.02 * np.round(_stops_and_goes() / 0.02),  # a coarse encoder
        0.5 * np.floor(_TIME_S / 3),  # set from stop to stop by a simulator
        0.001 * np.round(0.01 * _TIME_S / 0.001),  # one step after every two readings
        np.sin(0.4 * _TIME_S)[
            np.maximum(np.arange(600) - (np.arange(600) % 3), 0)
        ],  # each reading three times
        np.zeros(600),
    ],
    ids=["rests", "coarse", "set", "slow", "slower driver", "still"],
)
def test_a_joint_that_rests_or_has_coarse_steps_keeps_all_readings(value):
    keep, notes = _kept(value)
    assert keep.all()
    assert notes == []


@pytest.mark.parametrize("count", [1, 2, 3, 6, 7])
def test_short_tracks_stay_as_they_are(count):
    track = Track(np.arange(count), np.arange(count, dtype=float))
    assert without_stale("joint pan", track, []) is track
