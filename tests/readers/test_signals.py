"""Joints, wheels and stamps: what is read, dropped, noted and refused."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model.rig import Sources, WheelSource
from mobilecal_cli.model.signals import CLOCKS_DIFFER
from mobilecal_cli.readers import clocks_that_differ, open_recording
from mobilecal_cli.readers.signals.series import in_order
from mobilecal_cli.readers.signals.wheels import FieldWheel

from . import recordings as r

S = 10**9


def at(k: float) -> int:
    return r.START_NS + round(k * S)


def images(count: int = 3, every_s: float = 1, stamp=at) -> list[r.Item]:
    return [
        r.Item(topic, at(time_s), r.image(r.picture(k), "mono8", stamp(time_s)))
        for k, time_s in enumerate(every_s * np.arange(count))
        for topic in ("/l", "/r")
    ]


def joints(samples, topic="/j") -> list[r.Item]:
    """(log s, stamp ns, names, positions[, velocities]) each."""
    return [
        r.Item(topic, at(log), r.joint_state(names, position, *rate, stamp_ns=stamp))
        for log, stamp, names, position, *rate in samples
    ]


SOURCES = Sources(
    image={"left": "/l", "right": "/r"},
    info={"left": "", "right": ""},
    joints={"pan": "/j"},
    wheels={"left": WheelSource("/j", joint="wl"), "right": WheelSource("/j", joint="wr")},
)
NAMES = ["pan", "wl", "wr"]


def with_left(topic="/j", **of_wheel):
    """The sources with another left wheel."""
    return replace(SOURCES, wheels={**SOURCES.wheels, "left": WheelSource(topic, **of_wheel)})


def signals_of(tmp_path, items, sources=SOURCES):
    path = r.write_mcap(tmp_path / "log.mcap", items)
    with open_recording([path]) as recording:
        return r.one_log(recording, sources)


def joints_read(tmp_path, rows, sources=SOURCES):
    """Signals of joint states beside a few images."""
    return signals_of(tmp_path, [*images(), *joints(rows)], sources)


def wheel_at(times_s, angles):
    """Joint states of a left wheel."""
    return [(s, at(s), NAMES, [0, angle, 0]) for s, angle in zip(times_s, angles, strict=True)]


def steady(count=10):
    return [(0.1 * k, at(0.1 * k), NAMES, [k, 2.0 * k, 3.0 * k]) for k in range(count)]


def test_velocities_are_integrated_where_positions_are_absent(tmp_path):
    t = np.linspace(0, 1, 11)
    rows = [(s, at(s), NAMES, [0.0], [0, 2 * s, 4 - s]) for s in t]
    signals = joints_read(tmp_path, rows)
    np.testing.assert_allclose(signals.wheels["left"].value, t**2, atol=1e-12)
    np.testing.assert_allclose(signals.wheels["right"].value, 4 * t - t**2 / 2, atol=1e-12)
    assert any("wl on /j: no positions; velocities are integrated" in note for note in signals.notes)
    rows = [(0.1 * k, at(0.1 * k), NAMES, [0.0]) for k in range(5)]
    with pytest.raises(RecordingError, match="neither positions nor velocities"):
        joints_read(tmp_path, rows)


def test_zero_stamps_fall_back_to_log_time_and_another_clock_is_noted(tmp_path):
    rows = [(0.1 * k, 0, NAMES, [k, k, k]) for k in range(5)]
    signals = joints_read(tmp_path, rows)
    np.testing.assert_array_equal(signals.joints["pan"].time_ns, [at(0.1 * k) for k in range(5)])
    assert "/j: all 5 header stamps are zero; the log time is used" in signals.notes
    rows = [(0.1 * k, at(0.1 * k) - 100 * S, NAMES, [k, k, k]) for k in range(5)]
    signals = joints_read(tmp_path, rows)
    differ = (
        f"{CLOCKS_DIFFER}: the stamps of /j are 100.000 s before the log time, those of /l 0.000 s before it"
    )
    assert differ in signals.notes
    rows = [(0.1 * k, at(0.1 * k) + 5 * S, NAMES, [k, k, k]) for k in range(5)]
    differ = (
        f"{CLOCKS_DIFFER}: the stamps of /l are 0.000 s before the log time, those of /j 5.000 s after it"
    )
    assert differ in joints_read(tmp_path, rows).notes


@pytest.mark.parametrize(("ahead_s", "count"), [(0.2, 0), (0.5, 1), (-0.5, 1)])
def test_stamps_half_a_second_apart_are_noted(tmp_path, ahead_s, count):
    items = [*images(stamp=lambda s: at(s + ahead_s)), *joints(steady())]
    with open_recording([r.write_mcap(tmp_path / "log.mcap", items)]) as recording:
        assert len(clocks_that_differ(recording, ("/l", "/r", "/j"))) == count


def test_clock_that_steps_back_is_reported_with_numbers(tmp_path):
    stamps = [0, 1, 2, 3, 1.5, 2.5, 3.5, 4.5]
    rows = [(0.1 * k, at(s), NAMES, [s, s, s]) for k, s in enumerate(stamps)]
    signals = joints_read(tmp_path, rows)
    track = signals.joints["pan"]
    assert len(track.time_ns) == 6
    np.testing.assert_allclose((track.time_ns - r.START_NS) / S, track.value)
    dropped = "2 of 8 samples are out of order and dropped"
    assert f"/j: the clock steps back by up to 1.500 s; {dropped}" in signals.notes


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("most_s", [0.15, 1.0])
def test_late_messages_are_put_in_order(tmp_path, most_s, seed):
    """One message in four comes late; the log times are out of order, the stamps are right."""
    rng = np.random.default_rng(seed)
    delay_s = np.where(rng.random(60) < 0.25, rng.uniform(0, most_s, 60), 0) + rng.uniform(0, 2e-3, 60)
    rows = sorted((0.1 * k + delay, at(0.1 * k), NAMES, [k, k, k]) for k, delay in enumerate(delay_s))
    signals = joints_read(tmp_path, rows)
    np.testing.assert_array_equal(signals.joints["pan"].value, np.arange(60))
    assert any("samples are recorded after later ones, by up to 0." in note for note in signals.notes)


@pytest.mark.parametrize(("every", "wave", "share"), [(5, 3.0, 16), (1, 0.0, 99)])
def test_two_publishers_of_one_joint_are_named(tmp_path, every, wave, share):
    """The robot seemed to have no height. One of them must never move, and be the slower one."""
    real = [(0.02 * k, at(0.02 * k), NAMES, [0.0, 0.1, 0.3 + 0.001 * k]) for k in range(100)]
    wrong = [
        (0.02 * k + 0.01, at(0.02 * k + 0.01), NAMES, [0.0, wave * np.sin(k), 0.0])
        for k in range(0, 100, every)
    ]
    message = f"joint wl on /j: the readings alternate between two values, such as .* in {share} % of "
    with pytest.raises(RecordingError, match=message) as caught:
        joints_read(tmp_path, sorted(real + wrong))
    assert "joint_state_publisher" in caught.value.hint


def test_a_clock_that_steps_back_with_the_log_times_is_no_second_publisher(tmp_path):
    t = 0.02 * np.arange(2000)
    logged = np.where(t < 20, t, t - 5)
    rows = [(s, at(s), NAMES, [0.1, 2 * v, 2 * v]) for v, s in zip(t, logged, strict=True)]
    said = r"all within 5\.0 s from 15\.0 s on: the clock of the topic steps back"
    with pytest.raises(RecordingError, match=said):
        joints_read(tmp_path, sorted(rows))


@pytest.mark.parametrize("share", [0.01, 0.05, 0.3])
def test_few_messages_of_a_second_publisher_are_dropped(tmp_path, share):
    """They looked like motion: the verdict was NOT ENOUGH. The tilt is near zero, but its messages are known."""
    rng = np.random.default_rng(0)
    names, t = ["pan", "tilt", "wl", "wr"], 0.02 * np.arange(2000)
    right = np.stack([np.sin(0.2 * t), 0.02 * np.cos(t), 5 + 3 * t, 5 + 2 * t], axis=1)
    rows = [(s, at(s), names, list(value)) for s, value in zip(t, right, strict=True)]
    sent = 2 + np.flatnonzero(rng.random(1900) < share)
    wrong = [(0.02 * k + 0.005, at(0.02 * k + 0.005), names, [0.0] * 4) for k in sent]
    signals = joints_read(
        tmp_path, sorted(rows + wrong), replace(SOURCES, joints={"pan": "/j", "tilt": "/j"})
    )
    for track, expected in zip((*signals.joints.values(), *signals.wheels.values()), right.T, strict=True):
        assert len(track.value) > 0.99 * len(expected)  # right ones between two wrong ones are dropped, too
        np.testing.assert_allclose(np.interp(track.time_ns, [at(s) for s in t], expected), track.value)
    (note,) = (note for note in signals.notes if "jump" in note)
    assert int(note.split()[2]) == pytest.approx(len(sent), rel=0.1)
    assert "if a second publisher shares the topic, stop it (often joint_state_publisher" in note


def test_what_joints_and_wheels_do_is_no_second_publisher(tmp_path):
    """Readings of 10 Hz: a fast head, a fast wheel wrapped to a turn that stops at the wrap with noise, and a reset."""
    rng = np.random.default_rng(0)
    t = 0.1 * np.arange(400)
    angle = np.where(t < 20, 9.0 * t, 9.0 * 20) + 2 * np.pi * np.ceil(9.0 * 20 / 2 / np.pi) - 9.0 * 20
    wrapped = (angle + 1e-4 * rng.normal(size=400)) % (2 * np.pi)
    reset = 4.0 * t - 80 * (t > 20)
    rows = [
        (s, at(s), NAMES, list(value))
        for s, value in zip(t, np.stack([np.sin(3 * t), wrapped, reset], axis=1).tolist(), strict=True)
    ]
    signals = joints_read(tmp_path, rows)
    assert not any("jump to another value" in note for note in signals.notes)
    assert {len(track.value) for track in (*signals.joints.values(), *signals.wheels.values())} == {400}
    turned = signals.wheels["left"].value
    np.testing.assert_allclose(turned - turned[0], angle - angle[0], atol=1e-3)


def test_duplicate_stamps_keep_the_first(tmp_path):
    rows = [(0.1 * k, at(0.1 * (k // 2)), NAMES, [k, k, k]) for k in range(10)]
    signals = signals_of(tmp_path, [*images(), *joints(rows), *images()])
    np.testing.assert_array_equal(signals.joints["pan"].value, [0, 2, 4, 6, 8])
    assert "/j: 5 of 10 stamps occur twice; the first is kept" in signals.notes
    assert "/l: 3 of 6 stamps occur twice; the first is kept" in signals.notes


def test_gap_in_which_wheels_turned_is_reported(tmp_path):
    times = np.concatenate([0.02 * np.arange(50), 0.98 + 2.56 + 0.02 * np.arange(50)])
    signals = joints_read(tmp_path, wheel_at(times, 2 * times))
    worst = "the worst lasts 2.56 s from 0.98 s on, with 5.120 rad"
    assert f"left wheel: 1 gap during which the wheel turned; {worst}" in signals.notes
    assert not any(note.startswith("right wheel") for note in signals.notes)


def test_images_of_no_camera_are_listed_by_the_clock_of_the_others(tmp_path):
    other = [r.Item("/raw", at(k), r.image(r.picture(0), "mono8", at(k))) for k in (0.5, 1.5)]
    shown = images(stamp=lambda time_s: at(time_s) - 2 * S)
    signals = signals_of(tmp_path, sorted([*shown, *joints(steady()), *other], key=lambda item: item.log_ns))
    assert {topic: times.tolist() for topic, times in signals.other_images.items()} == {
        "/raw": [at(-1.5), at(-0.5)]
    }


def test_nan_readings_are_dropped_and_counted(tmp_path):
    rows = steady()
    rows[3] = (*rows[3][:3], [np.nan, 2e9, 9.0])
    signals = joints_read(tmp_path, rows)
    assert len(signals.joints["pan"].value) == len(signals.wheels["left"].value) == 9
    assert len(signals.wheels["right"].value) == 10
    possible = "(range -1e+09 to 1e+09); dropped"
    assert f"joint pan on /j: 1 of 10 readings are not possible, such as nan {possible}" in signals.notes
    assert f"joint wl on /j: 1 of 10 readings are not possible, such as 2e+09 {possible}" in signals.notes


def test_joint_states_with_fewer_positions_than_names_are_noted(tmp_path):
    rows = steady()
    rows[3:5] = [(*row[:3], row[3][:1]) for row in rows[3:5]]
    signals = joints_read(tmp_path, rows)
    assert len(signals.wheels["left"].value) == 8
    missing = {note for note in signals.notes if "no value" in note}
    assert missing == {f"joint {name} on /j: 2 of 10 messages have no value; ignored" for name in NAMES[1:]}


@pytest.mark.parametrize("bad", [0, 1])
def test_only_nan_is_refused(tmp_path, bad):
    rows = [(*row[:3], [np.nan if k == bad else x for k, x in enumerate(row[3])]) for row in steady()]
    with pytest.raises(
        RecordingError, match=f"joint {NAMES[bad]} on /j: all 10 readings are not possible, such as nan"
    ):
        joints_read(tmp_path, rows)


@pytest.mark.parametrize("pause_s", [0.05, 1.2, 3.0])
def test_wrapped_positions_are_unwrapped_and_noted_with_and_without_a_pause(tmp_path, pause_s):
    """The wheel turns on during the pause at the speed that it had before and has after it."""
    times = np.concatenate([0.05 * np.arange(60), 2.95 + pause_s + 0.05 * np.arange(60)])
    angle = 4.0 * times
    wrapped = (angle + np.pi) % (2 * np.pi) - np.pi
    signals = joints_read(tmp_path, wheel_at(times, wrapped))
    np.testing.assert_allclose(signals.wheels["left"].value, angle, atol=1e-9)
    assert any("wrapped to one turn; 4 jumps are undone" in note for note in signals.notes)


def turning(count=400, rate=4.0):
    """Stamps, s, and the angle of a wheel that turns, rests, and turns back."""
    times = 0.05 * np.arange(count)
    return times, rate * np.cumsum(np.clip(1.5 * np.cos(0.5 * times), -1, 1)) * 0.05


@pytest.mark.parametrize(
    "jumps",
    [
        {230: -300.0},  # a driver that starts again
        {100: 2**32 * 2 * np.pi / 4096},  # of a counter with 32 bits
        {100: -40.0, 250: 9000.0, 252: -9000.0},  # two wrong readings, too
    ],
)
def test_jumps_of_a_wheel_are_undone_and_noted(tmp_path, jumps):
    times, angle = turning()
    read = angle + sum(size * (np.arange(len(times)) >= at) for at, size in jumps.items())
    signals = joints_read(tmp_path, wheel_at(times, read))
    np.testing.assert_allclose(signals.wheels["left"].value, angle, atol=0.02)
    first = min(jumps)
    often = "once" if len(jumps) == 1 else f"{len(jumps)} times, first"
    said = f"the rotation jumps {often} by {read[first] - read[first - 1]:.4g} rad, {times[first - 1]:.1f} s after"
    assert any(said in note for note in signals.notes)


@pytest.mark.parametrize("counts", [False, True])
def test_a_driver_that_starts_again_in_a_pause(tmp_path, counts):
    """Slower than 20 times the wheel: it shows by its zero alone, which a counter need not have had at first."""
    times, angle = turning()
    kept = (times < 11.5) | (times > 13.5)
    times, angle = times[kept], angle[kept]
    ticks = np.round(1e4 * angle / (2 * np.pi))
    restarted = times > 12
    read = np.where(restarted, ticks - ticks[restarted][0], ticks + 12_345)
    if counts:
        numbers = [r.Item("/t", at(t), r.number("Int32", int(n))) for t, n in zip(times, read, strict=True)]
        source = with_left("/t", field="data", ticks_per_revolution=10_000)
        signals = signals_of(tmp_path, [*images(), *joints(wheel_at(times, 0 * times)), *numbers], source)
    else:
        signals = joints_read(tmp_path, wheel_at(times, read * 2 * np.pi / 1e4))
    turned = signals.wheels["left"].value
    np.testing.assert_allclose(turned - turned[0], angle - angle[0], atol=0.02)
    assert any("to zero in a pause of 2.1 s (a driver that started again?)" in n for n in signals.notes)


@pytest.mark.parametrize(("rate", "slip"), [(4.0, 6.0), (40_000.0, 0.0), (0.01, 0.0)])
def test_what_wheels_do_is_no_jump(tmp_path, rate, slip):
    """Also not a wheel that slips by less than a turn, readings in ticks, and one that hardly turns."""
    times, angle = turning(rate=rate)
    angle = angle + slip * (times > 5)
    signals = joints_read(tmp_path, wheel_at(times, angle))
    np.testing.assert_array_equal(signals.wheels["left"].value, angle)
    assert not any("jumps" in note for note in signals.notes)


@pytest.mark.parametrize("signed", [False, True])
def test_a_counter_in_joint_states_wraps_at_its_width(tmp_path, signed):
    ticks = np.arange(65_000, 67_000, 40)
    readings = (ticks + 2**15) % 2**16 - 2**15 if signed else ticks % 2**16
    rows = wheel_at(0.05 * np.arange(50), readings)
    sources = with_left(joint="wl", ticks_per_revolution=1000, bits=16)
    signals = joints_read(tmp_path, rows, sources)
    turned = signals.wheels["left"].value
    np.testing.assert_allclose(turned - turned[0], (ticks - ticks[0]) * 2 * np.pi / 1000, atol=1e-9)


def test_readings_beyond_the_width_of_a_counter_are_refused(tmp_path):
    width = {"ticks_per_revolution": 1000, "bits": 8}
    rows = wheel_at(0.1 * np.arange(5), 100.0 * np.arange(5))
    said = "joint wl on /j: a reading of 400 does not fit a counter of 8 bits"
    with pytest.raises(RecordingError, match=said):
        joints_read(tmp_path, rows, with_left(joint="wl", **width))
    ticks = [r.Item("/t", at(0.1 * k), r.number("UInt16", 90 * k)) for k in range(5)]
    with pytest.raises(RecordingError, match="a reading of 360 does not fit a counter of 8 bits"):
        signals_of(tmp_path, [*images(), *joints(steady()), *ticks], with_left("/t", field="data", **width))


@pytest.mark.parametrize(
    ("sources", "message"),
    [
        (
            replace(SOURCES, joints={"pan": "/nope"}),
            r"no topic /nope; topics present: /j \(sensor_msgs/msg/JointState\), /l",
        ),
        (
            replace(SOURCES, joints={"pan": "/l"}),
            "/l has the type sensor_msgs/msg/Image, expected sensor_msgs/msg/JointState",
        ),
        (
            replace(SOURCES, image={"left": "/j", "right": "/r"}),
            "/j has the type sensor_msgs/msg/JointState, expected sens",
        ),
        (with_left(joint="x"), "no joint x on /j; joints present: pan"),
        (with_left(field="ticks"), "no field ticks .*velocity"),
        (with_left(field="name"), "is a list, not a number"),
        (with_left(field="a..b"), "not a field path"),
    ],
)
def test_wrong_sources_are_refused(tmp_path, sources, message):
    items = [*images(), *joints(steady())]
    with pytest.raises(RecordingError, match=message) as caught:
        signals_of(tmp_path, items, sources)
    assert caught.value.hint
    with pytest.raises(RecordingError, match="no position of joint tilt on /j; joints present: pan, wl, wr"):
        signals_of(tmp_path, items, replace(SOURCES, joints={"tilt": "/j"}))


def test_side_without_images_is_refused(tmp_path):
    items = [item for item in images() if item.topic == "/l"]
    empty = r.Item("/r", at(0), r.image(r.picture(0), "mono8"))
    path = r.write_mcap(tmp_path / "log.mcap", [*items, *joints(steady()), empty])
    with open_recording([path]) as recording:
        part = recording.parts[0]
        messages = part.messages
        part.messages = lambda *how: (m for m in messages(*how) if m.topic != "/r")
        with pytest.raises(RecordingError, match="/r: no messages"):
            r.one_log(recording, SOURCES)


def turned(readings, source):
    """Rotation from readings of a counter, 10 ms apart."""
    wheel = FieldWheel("left", source, "data")
    for k, reading in enumerate(readings):
        wheel.take(SimpleNamespace(data=reading), k * 10**7, k * 10**7)
    wheel.checked([])
    return wheel.track(wheel.samples([]), []).value


@given(
    bits=st.sampled_from([8, 16, 32, 64]),
    signed=st.booleans(),
    start=st.integers(0, 2**64 - 1),
    steps=st.lists(st.integers(-100, 100), min_size=1, max_size=50),
    sign=st.sampled_from([1, -1]),
    floats=st.booleans(),
)
@example(bits=16, signed=False, start=59_500, steps=[7_000], sign=1, floats=True)
@settings(deadline=None)
def test_counters_of_any_width_wrap_round(bits, signed, start, steps, sign, floats):
    counts = start + np.concatenate([[0], np.cumsum(steps)]).astype(object)
    readings = [int(c) % 2**bits for c in counts]
    if signed:
        readings = [c - 2**bits if c >= 2 ** (bits - 1) else c for c in readings]
    if floats and bits < 64:  # a message may have them as float64
        readings = [float(c) for c in readings]
    angle = turned(readings, WheelSource("/t", field="data", ticks_per_revolution=360, bits=bits, sign=sign))
    expected = sign * np.radians((counts - start).astype(np.float64))
    np.testing.assert_allclose(angle, expected, atol=1e-12)


@pytest.mark.parametrize(
    ("span", "ticks", "start"),
    [(2**8, 1000, 200), (2**16, 1000, 65_000), (2**32, 4096, -500), (4096, 4096, 7)],
)
@pytest.mark.parametrize("signed", [False, True])
def test_counters_without_a_stated_width_wrap_where_they_are_seen_to(span, ticks, start, signed):
    counts = start + np.cumsum([0, 3, 9, *[20] * 40, *[-30] * 40, *[25] * 60])
    readings = (counts + span // 2) % span - span // 2 if signed else counts % span
    angle = turned(readings.tolist(), WheelSource("/t", field="data", ticks_per_revolution=ticks))
    np.testing.assert_allclose(angle, (counts - start) * 2 * np.pi / ticks, atol=1e-9)


@pytest.mark.parametrize("start", [0.0, 2.0, 4.0])
def test_angles_of_any_field_within_one_turn(start):
    angles = start + 0.3 * np.arange(60)
    angle = turned((angles % (2 * np.pi)).tolist(), WheelSource("/t", field="data"))
    np.testing.assert_allclose(angle, angles - start, atol=1e-9)


def test_counter_without_width_never_wraps_and_keeps_large_numbers_exact():
    readings = [2**62, 2**62 + 1, 2**62 + 70_000]
    angle = turned(readings, WheelSource("/t", field="data", ticks_per_revolution=100))
    np.testing.assert_allclose(angle, np.array([0, 1, 70_000]) * 2 * np.pi / 100, rtol=1e-14)


@given(st.lists(st.integers(0, 30), min_size=1, max_size=40))
def test_in_order_is_the_longest_increasing_choice(times):
    stamps = np.array(times, dtype=np.int64)
    kept = stamps[in_order(stamps)]
    assert np.all(np.diff(kept) > 0)
    firsts = list(dict.fromkeys(times))
    best = [1] * len(firsts)
    for i, late in enumerate(firsts):
        best[i] = max([1, *(best[j] + 1 for j in range(i) if firsts[j] < late)])
    assert len(kept) == max(best)


@pytest.mark.parametrize("topic", ["/j", "/head"])
def test_a_joint_that_is_published_once_stands_still(tmp_path, topic):
    """A latched message, sent long before the recording."""
    rows = [(*row[:2], NAMES[1:], row[3][1:]) for row in steady()]
    items = [*images(), *joints([(0, at(-60), NAMES[:1], [0.3])], topic), *joints(rows)]
    signals = signals_of(tmp_path, items, replace(SOURCES, joints={"pan": topic}))
    pan = signals.joints["pan"]
    np.testing.assert_array_equal(pan.value, [0.3, 0.3])
    assert pan.time_ns[0] <= min(index.time_ns[0] for index in signals.images.values())
    assert pan.time_ns[-1] >= max(index.time_ns[-1] for index in signals.images.values())
    assert f"joint pan on {topic}: one reading only; the joint counts as standing still" in signals.notes
    assert not any(CLOCKS_DIFFER in note for note in signals.notes)


def test_a_wheel_without_any_reading_is_left_out_of_its_side(tmp_path):
    names = [*NAMES, "rear"]
    rows = [(0.1 * k, at(0.1 * k), names, [k, 2.0 * k, 3.0 * k, np.nan]) for k in range(30)]
    sources = with_left(joint="wl", others=(WheelSource("/j", joint="rear"),))
    signals = joints_read(tmp_path, rows, sources)
    np.testing.assert_array_equal(signals.wheels["left"].value, 2.0 * np.arange(30))
    said = "joint rear on /j: all 30 readings are not possible, such as nan"
    assert f"{said} (range -1e+09 to 1e+09); left out" in signals.notes
    with pytest.raises(RecordingError, match=said):
        joints_read(tmp_path, rows, with_left(joint="rear"))


@pytest.mark.parametrize(
    "bad",
    [
        [(k, at(3), NAMES[:1], [0.1 * k]) for k in range(3)],
        [(0, at(0), NAMES[:1], [0.3]), (1, at(1), NAMES[:1], [np.nan])],
    ],
)
def test_a_joint_with_one_good_reading_of_several_does_not_count_as_still(tmp_path, bad):
    """All stamps are the same, or the others are not finite."""
    items = [*images(), *joints(bad, "/head"), *joints(steady())]
    signals = signals_of(tmp_path, items, replace(SOURCES, joints={"pan": "/head"}))
    assert len(signals.joints["pan"].value) == 1
    assert not any("standing still" in note for note in signals.notes)
