"""Tracks: the curve through the readings of a wheel or joint."""

import numpy as np
import pytest

from mobilecal_cli.model.signals import Track

#: Ten readings per second, and times between them.
READ_NS = np.arange(0, 10_000_000_001, 100_000_000)
BETWEEN_NS = np.arange(300_000_000, 9_700_000_000, 17_000_000)


def swung(times_ns):
    """A wheel that turns back at a steady acceleration, rad."""
    return 0.5 * (times_ns * 1e-9 - 5) ** 2


def test_slow_readings_of_a_wheel_that_turns_back_lose_nothing():
    """Lines between them cut off 1.2 mrad there: radii came out too large by 0.2 %, and at 5 Hz recordings failed."""
    track = Track(READ_NS, swung(READ_NS))
    assert track.at(BETWEEN_NS) == pytest.approx(swung(BETWEEN_NS), abs=1e-12)
    assert track.mean(BETWEEN_NS, 40_000_000) == pytest.approx(swung(BETWEEN_NS) + 0.02**2 / 6, abs=1e-9)


def test_a_steady_motion_and_a_rest_stay_straight():
    value = np.maximum(READ_NS * 1e-9 - 5, 0)
    off = np.abs(Track(READ_NS, value).at(BETWEEN_NS) - np.maximum(BETWEEN_NS * 1e-9 - 5, 0))
    before = (BETWEEN_NS > 5_000_000_000) & (BETWEEN_NS < 5_100_000_000)
    assert off[~before].max() < 1e-12
    assert off[before].max() < 0.1 / 6


def test_readings_that_arrive_together_are_no_jump():
    """Without a bound, the curve swings by many times the way between such pairs."""
    time_ns = np.sort(np.concatenate([READ_NS, READ_NS + 1000]))
    value = 0.02 * np.arange(len(time_ns))
    off = Track(time_ns, value).at(BETWEEN_NS) - np.interp(BETWEEN_NS, time_ns, value)
    assert np.abs(off).max() < 0.01


def test_beyond_its_readings_a_track_rests():
    for count in (1, 2, 5):
        track = Track(READ_NS[:count], np.arange(float(count)))
        outside = np.array([-7_000_000_000, 7_000_000_000])
        assert track.at(outside).tolist() == [0.0, count - 1.0]
        assert track.mean(outside, 10**9) == pytest.approx([0.0, count - 1.0])
        falling = Track(READ_NS[:count], -np.arange(float(count)))
        assert falling.at(READ_NS[:count]).tolist() == falling.value.tolist()
        assert falling.at(READ_NS[: count - 1] + 50_000_000) == pytest.approx(-0.5 - np.arange(count - 1.0))
    assert track.mean(READ_NS[4:5], 200_000_000) == pytest.approx([4.0 - 0.25])
    assert track.at(READ_NS[:0]).shape == (0,)
