"""Readings that a driver repeats in motion are dropped; those of a joint at rest are not."""

from __future__ import annotations

import numpy as np
import pytest

from mobilecal_cli.model.signals import Track
from mobilecal_cli.readers.signals.series import Samples, with_rests, without_stale

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
        "joint pan: 38 of 600 readings repeat an old value, for up to 1.00 s during a motion; dropped"
    ]


@pytest.mark.parametrize("turns_back_s", [10.2, 10.8, 11.9])
def test_a_motion_that_turned_back_behind_repeated_readings_shows_them_too(turns_back_s):
    value = 20 - np.abs(_TIME_S - turns_back_s) * 1.0
    value[200:240] = value[200]
    keep, notes = _kept(value)
    assert np.flatnonzero(~keep).tolist() == [*range(201, 240)]
    assert len(notes) == 1


@pytest.mark.parametrize("encoder_step", [0.0, 0.005])
@pytest.mark.parametrize(
    "repeated", [lambda k: k % 3 > 0, lambda k: np.random.default_rng(k).uniform(size=600) < 0.3]
)
def test_readings_that_a_driver_repeats_here_and_there_are_dropped(encoder_step, repeated):
    """A publisher that is faster than the joint's controller: estimates in motion "did not converge" with every second one."""
    moving, stale = np.abs(_TIME_S - 15) < 8, repeated(np.arange(600))
    angle = np.interp(_TIME_S, [7, 15, 23], [0, 4, -4]) + 0.3 * np.sin(_TIME_S)
    read = encoder_step * np.round(angle / encoder_step) if encoder_step else angle
    stale[0] = False
    fresh = np.maximum.accumulate(np.where(stale, 0, np.arange(600)))
    keep, notes = _kept(read[fresh])
    assert np.mean(keep[moving & stale]) < 0.05
    assert keep[~stale].all()
    assert len(notes) == 1


@pytest.mark.parametrize("times", [2, 4])
def test_a_driver_that_repeats_each_reading_does_so_in_slow_motions_of_a_coarse_encoder(times):
    """Left as they were there, they were late by more than in fast ones: wheels were 2 % too large, with a PASS."""
    angle = np.interp(_TIME_S, [1, 8, 16, 24, 29], [0, 7, 7.5, 2, 2.1]) + 0.5 * np.sin(0.5 * _TIME_S)
    read = 0.02 * np.round(angle / 0.02)
    keep, _ = _kept(read[np.arange(600) // times * times])
    assert np.array_equal(np.flatnonzero(keep), np.arange(0, 600, times))


def _stops_and_goes():
    return np.interp(_TIME_S, [0, 2, 4, 7, 9, 12, 14, 30], [0, 0, 0.5, 0.5, -0.5, -0.5, 0.2, 0.2])


@pytest.mark.parametrize(
    "value",
    [
        _stops_and_goes(),
        0.02 * np.round(_stops_and_goes() / 0.02),  # a coarse encoder
        0.5 * np.floor(_TIME_S / 3),  # set from stop to stop by a simulator
        0.001 * np.round(0.01 * _TIME_S / 0.001),  # one step after every two readings
        np.cumsum(np.arange(600) % 8 < 2),  # two steps, and a rest
        np.zeros(600),
    ],
    ids=["rests", "coarse", "set", "slow", "short", "still"],
)
def test_a_joint_that_rests_or_has_coarse_steps_keeps_all_readings(value):
    keep, notes = _kept(value)
    assert keep.all()
    assert notes == []


def _samples(time_s, value):
    time_ns = np.round(time_s * 1e9).astype(np.int64)
    return Samples("/j", "joint pan on /j", time_ns, time_ns, np.reshape(value, (-1, 1)), positions=True)


def test_a_rest_before_messages_that_arrive_together_is_one():
    """The first readings after a stop of 1.5 s, which came 1 ms apart, showed "an old value during a motion"."""
    value, time_s = 20 * _stops_and_goes() + 0.1 * np.maximum(_TIME_S - 16, 0), _TIME_S.copy()
    time_s[[40, 140, 240]] = time_s[[41, 141, 241]] - 0.001
    track, notes = Track(np.round(time_s * 1e9).astype(np.int64), value), []
    assert without_stale("joint pan", track, notes) is track
    assert notes == []


@pytest.mark.parametrize("bunch_s", [0.2, 0.3])
def test_of_messages_that_arrive_together_the_last_counts(bunch_s):
    """Readings that were stamped as they came out of a queue: estimates in motion "did not converge"."""
    arrival_s = np.ceil((_TIME_S + 1e-6) / bunch_s) * bunch_s + 1e-6 * np.arange(600)
    time_ns, value = _samples(arrival_s, _TIME_S).ordered([])
    assert len(value) == pytest.approx(30 / bunch_s, abs=1)
    assert np.ptp(time_ns * 1e-9 - value[:, 0]) < 0.06


@pytest.mark.parametrize("rate_hz", [10, 50])
def test_readings_at_two_rates_do_not_arrive_together(rate_hz):
    time_s = np.concatenate([np.arange(0, 20, 0.1), np.arange(20, 30, 1 / rate_hz), np.arange(40, 45, 0.02)])
    assert len(_samples(time_s, time_s).ordered([])[0]) == len(time_s)


@pytest.mark.parametrize("rate_hz", [10, 20, 50])
def test_a_joint_that_is_published_in_motion_alone_rests_otherwise(rate_hz):
    """All images of stops had "no readings around them": a robot that stopped 14 times had too few stations."""
    time_s = np.arange(0, 30, 1 / rate_hz)
    value = np.interp(time_s, _TIME_S, _stops_and_goes())
    sent = np.append(True, np.diff(value) != 0)
    found = with_rests(Track(np.round(time_s[sent] * 1e9).astype(np.int64), value[sent]))
    within = found.time_ns[-1] * 1e-9 > time_s
    assert np.diff(found.time_ns).max() * 1e-9 < 2.5 / rate_hz
    assert found.at(np.round(time_s[within] * 1e9).astype(np.int64)) == pytest.approx(value[within], abs=1e-9)


@pytest.mark.parametrize("interval_s", [0.05, 0.6])
def test_a_pause_in_a_motion_and_slow_readings_are_no_rests(interval_s):
    time_s = np.delete(np.arange(0, 30, interval_s), np.arange(12, 25))
    track = Track(np.round(time_s * 1e9).astype(np.int64), np.sin(0.3 * time_s))
    assert np.array_equal(with_rests(track).time_ns, track.time_ns)
