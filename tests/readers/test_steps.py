"""Clock steps: where a recording is cut, and what the clocks are in its pieces."""

from dataclasses import replace

import numpy as np
import pytest

from mobilecal_cli.readers.signals.series import Samples, cut, end_notes, pause_notes, steps_of

S = 10**9
MS = 10**6
AT = 20.0


def samples(topic, hz=50, seconds=40.0, lag_ms=3.0, step_s=0.0, at_s=AT):
    """Readings whose value is the true time; their stamps step at some time."""
    rng = np.random.default_rng(len(topic))
    true_ns = np.round(np.arange(0, seconds, 1 / hz) * S).astype(np.int64)
    log_ns = true_ns + np.round((lag_ms + rng.random(len(true_ns))) * MS).astype(np.int64)
    stamp_ns = true_ns + round(step_s * S) * (true_ns >= at_s * S)
    return Samples(topic, topic, stamp_ns, log_ns, true_ns[:, None] / S)


@pytest.mark.parametrize("step_s", [-30, -10, -1.5, -0.5, 1.5, 30])
def test_all_clocks_step(step_s):
    series = [samples(topic, hz, step_s=step_s) for topic, hz in (("/j", 50), ("/l", 5), ("/r", 1))]
    (first, second), (note,) = cut(series)
    for before, after, whole in zip(first, second, series, strict=True):
        assert before.value.max() < AT <= after.value.min()
        assert len(before) + len(after) == len(whole)
        assert after.shift_ns == 0
    way = "back" if step_s < 0 else "forward"
    said = f"the clock of /j, /l, /r steps {way} by {abs(step_s):.3f} s, 20.0 s after the start"
    assert note.startswith(said)


@pytest.mark.parametrize("step_s", [-10, -0.3, 30])
@pytest.mark.parametrize("stepping", ["/joints", "/left /right", "/left"])
def test_a_step_of_some_clocks_is_undone_by_its_size(step_s, stepping):
    rates = {"/joints": 50, "/left": 5, "/right": 5}
    series = [samples(name, hz, step_s=step_s if name in stepping else 0) for name, hz in rates.items()]
    (_, second), _ = cut(series)
    for after in second:
        assert np.abs(after.time_ns / S - after.value[:, 0]).max() < 1e-3
    left, right = second[1:]
    if stepping == "/left /right":  # they stay as simultaneous as they are
        np.testing.assert_array_equal(left.time_ns, right.time_ns)


@pytest.mark.parametrize("step_s", [-5, 5])
@pytest.mark.parametrize("stepping", ["/joints", "/left /right"])
def test_a_step_of_the_log_times_of_some_topics_shows_in_their_ends(step_s, stepping):
    rates = {"/joints": 50, "/left": 5, "/right": 5}
    series = [samples(name, hz, step_s=step_s if name in stepping else 0) for name, hz in rates.items()]
    logged = []
    for one in series:
        log_ns = one.log_ns + one.stamp_ns - np.round(one.value[:, 0] * S).astype(np.int64)
        logged.append(replace(one, log_ns=log_ns).rows(np.argsort(log_ns, kind="stable"), 0))
    (before, after), (note,) = cut(logged)
    for part in (*before, *after):
        assert len(part) > 50
        assert np.abs(part.time_ns / S - part.value[:, 0]).max() < 0.25
    way = "back" if step_s < 0 else "forward"
    assert note.startswith(f"the clock of {stepping.replace(' ', ', ')} steps {way} by ")
    assert end_notes(logged) == end_notes(series) == []


def test_rare_images_that_end_late_are_noted():
    rare = samples("/left", 0.25)
    late_ns = np.where(rare.value[:, 0] > 20, 6 * S, 0)
    late = replace(rare, stamp_ns=rare.stamp_ns + late_ns, log_ns=rare.log_ns + late_ns)
    others = [samples("/j"), samples("/w")]
    (note,) = end_notes([late, *others])
    assert note.startswith(
        "/left: messages come until 2.0 s after the last ones of all other topics, and there is a"
    )
    assert len(cut([late, *others])[0]) == 1
    assert end_notes([rare, *others]) == []


def test_images_at_stops_have_pauses_of_their_own():
    times = np.concatenate([at + np.arange(3) / 5 for at in (1, 4, 7, 10, 19.6, 21, 24, 27, 30, 33, 36, 39)])
    stops = np.round(times * S).astype(np.int64)
    images = Samples("/left", "/left", stops, stops + 3 * MS, times[:, None])
    ending_early = [samples(topic, seconds=31.2) for topic in ("/j", "/w")]
    assert len(cut([images, *ending_early])[0]) == 1


def test_images_that_come_twice_as_often_and_end_early_show_no_step():
    images = samples("/left", 10, seconds=37.5)
    twice = images.rows(np.flatnonzero((images.value[:, 0] > 25) | (np.arange(len(images)) % 2 == 0)), 0)
    assert len(cut([twice, samples("/j"), samples("/w")])[0]) == 1


def test_clocks_of_two_computers_step_by_different_amounts():
    series = [samples("/joints", 50, step_s=-10), samples("/left", 5, step_s=3)]
    (_, second), _ = cut(series)
    for after in second:
        assert np.abs(after.time_ns / S - after.value[:, 0]).max() < 1e-3


def test_what_is_no_step():
    usual = samples("/j")
    stray = usual.stamp_ns.copy()
    stray[[400, 700, 701]] += np.array([50, -7, -9]) * S
    stalled = usual.log_ns.copy()  # a network that holds messages back for 4 s, then sends all
    held = (usual.value[:, 0] >= 10) & (usual.value[:, 0] < 14)
    stalled[held] = 14 * S + np.arange(held.sum())
    pause = np.where(usual.value[:, 0] > AT, 9 * S, 0)
    for stamp_ns, log_ns in (
        (usual.stamp_ns, usual.log_ns),
        (stray, usual.log_ns),
        (usual.stamp_ns, stalled),
        (usual.stamp_ns + pause, usual.log_ns + pause),  # a recorder that pauses
        (usual.stamp_ns // 20, usual.log_ns),  # a playback at a twentieth of the speed
        (usual.log_ns, usual.log_ns),  # no stamps
        (usual.stamp_ns[:9], usual.log_ns[:9]),
        (np.arange(100) * 5 * S, np.arange(100) * 10 * S),  # a slow playback of rare messages
    ):
        assert not len(steps_of(stamp_ns, log_ns))


def test_a_pause_of_all_topics_is_noted():
    def paused(topic, hz):
        one = samples(topic, hz)
        log_ns = one.log_ns + np.where(one.value[:, 0] > AT, 9 * S, 0)
        return Samples(topic, topic, one.stamp_ns, log_ns, one.value)

    (note,) = pause_notes([paused("/j", 50), paused("/left", 5)])
    assert note.startswith("1 pause of all topics; the longest lasts 9.02")
    assert "s, 20.0 s after the start" in note
    assert pause_notes([samples("/j", 50), paused("/left", 5)]) == []
    assert pause_notes([samples("/j", 50, seconds=0.0)]) == []
