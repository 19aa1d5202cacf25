from dataclasses import replace

import numpy as np
import pytest

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model.rig import HeadChain, JointLink
from mobilecal_cli.model.signals import PictureIndex, Shot, Signals, Track
from mobilecal_cli.stations import KEYFRAMES, SHOTS_PER_REST, plan_stations, wheel_track
from tests.pairs import pair_images

START = 1_700_000_000_000_000_000
S = 1_000_000_000


def ns(seconds):
    return START + np.round(np.asarray(seconds, dtype=float) * S).astype(np.int64)


def staircase(times, rests=8, rest_s=2.0, move_s=1.0, height=0.5):
    """Rests of 2 s and smooth moves of 1 s in between."""
    period = rest_s + move_s
    number = np.minimum(np.floor(times / period), rests - 1)
    share = np.clip((times - number * period - rest_s) / move_s, 0, 1)
    return height * (number + share**2 * (3 - 2 * share))


def indexed(stamp_ns):
    return PictureIndex(stamp_ns, stamp_ns, stamp_ns)


def head(*joints):
    return HeadChain("base", "head", tuple(JointLink(name, [0, 0, 1]) for name in joints))


def planned(log, joints, **options):
    """The plan of a recording, and the notes."""
    (plan,), notes = plan_stations([log], head(*joints), **options)
    return plan, notes


def signals(pan, wheel, duration_s=24.0, image_hz=5.0, joint_hz=50.0, **changes):
    times = np.arange(0, duration_s, 1 / joint_hz)
    pictures = np.arange(0.1, duration_s - 0.1, 1 / image_hz)
    values = {
        "joints": {"pan": Track(ns(times), pan(times))},
        "wheels": {"left": Track(ns(times), wheel(times)), "right": Track(ns(times), 1.5 * wheel(times))},
        "images": {side: indexed(ns(pictures)) for side in ("left", "right")},
        "notes": (),
    } | changes
    recorded_ns = {name: index.time_ns for name, index in values["images"].items()}
    return Signals(**({"recorded_ns": recorded_ns} | values))


def test_every_rest_is_one_station():
    plan, notes = planned(signals(staircase, lambda t: 3 * staircase(t)), ("pan",))
    assert len(plan.stations) == 8
    assert all(station.at_rest for station in plan.stations)
    for i, station in enumerate(plan.stations):
        assert station.joints == pytest.approx([0.5 * i], abs=1e-12)
        assert 3.0 * i <= (station.time_ns - START) / S <= 3.0 * i + 2
        assert 5 <= len(station.shots) <= 10
        assert station.index == i
    assert notes == ()


def test_joint_noise_and_a_coarse_encoder_do_not_hide_rests():
    random = np.random.default_rng(1)
    step = np.radians(1.2)

    def noisy(t):
        return staircase(t) + random.normal(scale=np.radians(0.05), size=len(t))

    def coarse(t):
        # The wheel comes to rest on the edge of a step, and the count flickers by one.
        return np.round((3 * staircase(t)) / step + 0.5 + random.normal(scale=0.1, size=len(t))) * step

    plan, _ = planned(signals(noisy, coarse), ("pan",))
    assert len(plan.stations) == 8
    scatter = [station.joints_std[0] for station in plan.stations]
    assert np.degrees(np.mean(scatter)) == pytest.approx(0.05, rel=0.2)


def test_a_turning_head_is_no_rest():
    plan, notes = planned(signals(lambda t: np.abs((t / 3) % 2 - 1), lambda t: 0 * t), ("pan",))
    assert not any(station.at_rest for station in plan.stations)
    assert 20 < len(plan.stations) <= KEYFRAMES
    assert "images taken in motion are used" in notes[0]
    assert "rests" not in notes[0]


def test_keyframes_spread_over_the_motion():
    # Nine tenths of the log look one way; the keyframes must not.
    def mostly_one_way(t):
        return np.where(t < 20, 0.02 * np.sin(3 * t), (t - 20) * 0.5)

    plan, _ = planned(signals(mostly_one_way, lambda t: 0.2 * t, image_hz=20), ("pan",))
    pan = np.array([station.joints[0] for station in plan.stations if not station.at_rest])
    assert np.sum(pan > 0.1) >= 10


def test_unequal_clocks_of_the_cameras_pair_the_nearest_and_each_picture_once():
    left, right = ns([0, 1, 2, 3]), ns([0.02, 0.98, 1.01, 3.01])
    pairs = pair_images(left, right, 0.1)
    at = [tuple((time_ns - START) / S for time_ns in shot.times_ns) for shot in pairs]
    assert at == [(0, 0.02), (1, 1.01), (3, 3.01)]
    pairs = pair_images(ns([0, 0.03, 0.06]), ns([0.04]), 0.1)
    assert len(pairs) == 1
    assert pairs[0].times_ns[0] == ns(0.03)


def test_left_and_right_never_together():
    with pytest.raises(RecordingError, match=r"no stereo pairs: .* closest two are 0\.500 s apart"):
        pair_images(ns([0, 1]), ns([0.5, 1.5]), 0.1)


@pytest.mark.parametrize("halts", [7, 8])
def test_a_few_halts_in_a_long_drive_leave_its_images_in_use(halts):
    """Images in motion were not used beside six rests, and seven are fewer than a verdict needs."""

    def angle(t):
        return np.interp(t, *zip(*((3 * k + s, k) for k in range(halts) for s in (0, 1)), strict=True))

    plan, _ = planned(signals(angle, angle), ("pan",))
    assert sum(station.at_rest for station in plan.stations) == halts
    assert all(station.at_rest for station in plan.stations) == (halts == 8)


def test_pictures_without_readings_are_left_out():
    good = signals(staircase, lambda t: 3 * staircase(t))
    keep = np.abs((good.joints["pan"].time_ns - START) / S - 10.5) > 1.6  # gone over the fourth rest
    pan = Track(good.joints["pan"].time_ns[keep], good.joints["pan"].value[keep])
    plan, notes = planned(replace(good, joints={"pan": pan}), ("pan",))
    assert sum(station.at_rest for station in plan.stations) == 7
    assert {r.reason for r in plan.rejections} == {"no readings around the image"}
    assert {r.detail for r in plan.rejections} == {"pan"}
    (note,) = (note for note in notes if "stereo pairs" in note)
    assert note.startswith(f"{len(plan.rejections)} stereo pairs between ")
    assert "no readings around them (pan)" in note


def test_readings_that_end_before_the_pictures_begin():
    early = Track(ns([0.0, 1.0]) - 100 * S, [0.0, 0.0])
    good = signals(staircase, staircase)
    bad = replace(good, joints={"pan": early})
    with pytest.raises(RecordingError, match=r"none of .* stereo pairs has readings") as caught:
        planned(bad, ("pan",))
    assert caught.value.message.endswith("missing: pan")
    assert "use the same clock" in caught.value.hint
    bad = replace(good, joints={"pan": early, "tilt": early})
    with pytest.raises(RecordingError, match=r"missing: pan, tilt$"):
        planned(bad, ("pan", "tilt"))


def test_wheels_that_never_overlap():
    with pytest.raises(RecordingError, match="do not overlap"):
        wheel_track({"right": Track(ns([0, 1]), [0.0, 1.0]), "left": Track(ns([5, 6]), [0.0, 1.0])})


def test_wheels_at_different_rates_are_joined():
    right, left = Track(ns([0, 1, 2]), [0.0, 1.0, 2.0]), Track(ns([0.5, 1.5]), [5.0, 6.0])
    track = wheel_track({"right": right, "left": left})
    assert (track.time_ns - START) / S == pytest.approx([0.5, 1.0, 1.5])
    assert track.right_rad == pytest.approx([0.5, 1.0, 1.5])
    assert track.left_rad == pytest.approx([5.0, 5.5, 6.0])


def test_everything_is_every_pair_at_rest_and_in_motion():
    log = signals(lambda t: staircase(t, rests=8), lambda t: 3 * staircase(t), image_hz=20.0)
    plan, _ = planned(log, ("pan",), everything=True)
    pairs = [pair for station in plan.stations for pair in station.shots]
    assert len(pairs) == len(log.images["left"].time_ns)
    resting = [station for station in plan.stations if station.at_rest]
    assert len(resting) == 8
    assert max(len(station.shots) for station in resting) > SHOTS_PER_REST
    assert all(len(station.shots) == 1 for station in plan.stations if not station.at_rest)
    assert [s.times_ns[0] for s in pairs] == sorted(s.times_ns[0] for s in pairs)


def test_of_very_many_pairs_in_motion_some_are_used(monkeypatch):
    monkeypatch.setattr("mobilecal_cli.stations.MOST_IN_MOTION", 30)
    log = signals(lambda t: staircase(t, rests=8), lambda t: 3 * staircase(t), image_hz=20.0)
    plan, notes = planned(log, ("pan",), everything=True)
    times = np.array([station.shots[0].times_ns[0] for station in plan.stations if not station.at_rest])
    assert len(times) == 30
    assert times[-1] - times[0] > 0.8 * (log.images["left"].time_ns[-1] - START)
    assert sum(len(station.shots) for station in plan.stations if station.at_rest) > 8 * SHOTS_PER_REST
    assert any("of those in motion, 30, evenly spread, fit into memory" in note for note in notes)


def repeating(times, first):
    """Images at some times, each identical to the one at the time of the same row of `first`."""
    return PictureIndex(ns(times), ns(times), ns(times), since_ns=ns(first))


PICTURES = np.arange(0.1, 23.9, 0.1)


def with_images(left_first, right_first):
    images = {"left": repeating(PICTURES, left_first), "right": repeating(PICTURES, right_first)}
    return planned(signals(staircase, lambda t: 3 * staircase(t), images=images), ("pan",))


def test_a_camera_without_noise_gives_one_picture_a_rest():
    """The image at the stop is repeated to the end of the rest, from before the moment that counts as rest."""
    start = np.floor(PICTURES / 3) * 3
    first = np.where(PICTURES - start < 2, np.maximum(start, 0.1), PICTURES)
    plan, notes = with_images(first, first)
    assert [len(station.shots) for station in plan.stations] == [1] * 8
    assert all(station.at_rest for station in plan.stations)
    assert not notes


@pytest.mark.parametrize("shift", [0, 1, 2])
def test_a_driver_that_repeats_images(shift):
    """Each image is sent three times; the two cameras need not repeat together."""
    left, right = (PICTURES[np.maximum((np.arange(len(PICTURES)) + k) // 3 * 3 - k, 0)] for k in (0, shift))
    plan, notes = with_images(left, right)
    assert len(plan.stations) == 8
    for side, first in (("left", left), ("right", right)):
        shown = dict(zip(ns(PICTURES).tolist(), ns(first).tolist(), strict=True))
        used = [shown[p.times_ns[side == "right"]] for station in plan.stations for p in station.shots]
        assert len(set(used)) == len(used) >= 8 * 4
    assert not notes


def test_images_repeated_in_motion_are_not_used():
    """New ones at 10 Hz, each sent again 20 and 40 ms later."""
    times = (np.arange(0.1, 23.9, 0.1)[:, None] + [0, 0.02, 0.04]).ravel()
    images = {side: repeating(times, np.repeat(times[::3], 3)) for side in ("left", "right")}
    swing = signals(lambda t: np.sin(3 * t), lambda t: 0.5 * t, images=images)
    plan, _ = planned(swing, ("pan",), everything=True)
    used = [pair.times_ns[0] for station in plan.stations for pair in station.shots]
    assert used == ns(times[::3]).tolist()


@pytest.mark.parametrize("frozen", ["right", "left and right"])
def test_a_frozen_camera_is_named(frozen):
    stop = np.minimum(PICTURES, 19.0)
    plan, notes = with_images(stop if "left" in frozen else PICTURES, stop)
    assert sum(station.at_rest for station in plan.stations) == 7
    note, _ = notes
    said = f"the {frozen} images stay the same while the robot moves. Check the driver of the {frozen} camera"
    assert said in note
    assert "between 20 and 24 s after the first image" in note


def lost_after(seconds, begin=0.0):
    """Images of both cameras from a first second on, until a last one."""
    return {side: indexed(ns(np.arange(begin + 0.1, seconds, 0.2))) for side in ("left", "right")}


BOTH = lost_after(14.0)
ONE = {**BOTH, "right": indexed(ns(np.arange(0.1, 24, 0.2)))}
ALL = {side: ns(np.arange(0.1, 24, 0.2)) for side in ("left", "right")}
DURING_RESTS = np.concatenate([np.arange(3 * k + 0.5, 3 * k + 1.8, 0.2) for k in range(8)])


@pytest.mark.parametrize(("changes", "words"), [
    ({"images": BOTH}, "No images for 10 s, from 14 s after the first reading on, while the robot moves."),
    ({"images": lost_after(24.0, begin=9.0)}, "No images for 9 s, from 0 s after the first reading on"),
    ({"images": BOTH, "other_images": {"/raw": ns([13.9, 15, 23.9])}}, "moves. The images of this time are on /raw. Record"),
    ({"images": BOTH, "other_images": {"/depth": ns(PICTURES)}}, "the robot moves. Check the cameras"),
    ({"images": lost_after(23.0)}, None),
    ({"images": {"left": indexed(ns(DURING_RESTS))}}, None),
    ({"images": lost_after(26.0), "duration_s": 60.0}, None),  # it waits at the end
    ({"images": BOTH, "recorded_ns": ALL}, None),  # but not used
    ({"images": ONE, "recorded_ns": ALL}, None),
])  # fmt: skip
def test_cameras_that_stop_while_the_robot_moves_are_named(changes, words):
    _, every_note = planned(signals(staircase, lambda t: 3 * staircase(t), **changes), ("pan",))
    notes = [note for note in every_note if "images for" in note]
    assert bool(notes) == (words is not None)
    assert words is None or words in notes[0]


def test_cameras_that_are_not_triggered_together_count_alone_in_motion():
    taken = np.arange(0.1, 23.9, 0.2)
    images = {"left": indexed(ns(taken)), "right": indexed(ns(taken + 0.03))}
    log = signals(lambda t: 0.3 * np.sin(t), lambda t: 2 * t, images=images)
    plan, notes = planned(log, ("pan",), everything=True)
    assert len(plan.stations) == 2 * len(taken)
    assert all(len(shot.taken_ns) == 1 for station in plan.stations for shot in station.shots)
    assert any("the images of 119 stereo pairs are more than 5 ms apart" in note for note in notes)


def test_two_of_three_cameras_that_are_triggered_together_stay_together():
    a, b = Shot((5, 105, 6)), Shot((5, None, 6))
    assert a.split(10) == [Shot((5, None, 6)), Shot((None, 105, None))]
    assert b.split(10) == [b]


def slow(hz, **changes):
    """Rests of two seconds, in a recording with few joint and wheel readings."""
    return signals(staircase, lambda t: 3 * staircase(t), joint_hz=hz, **changes)


def test_joints_and_wheels_that_are_published_slowly_are_named_with_their_rates():
    used, notes = planned(slow(1.0), ("pan",))
    lost = {(rejection.reason, rejection.detail) for rejection in used.rejections}
    rates = "pan 1 per second, wheels 1 per second; at least 2 needed in motion"
    assert lost == {("too few readings per second", rates)}
    assert f"too few readings per second ({rates}). Publish joints and wheels at 20 Hz or more" in notes[0]
    assert notes[1].startswith("wheels: too few readings per second (1, at least 8 needed).")


def test_images_that_lie_between_slow_readings_in_motion_name_their_rate():
    moving = signals(lambda t: t, lambda t: t, joint_hz=1.0)
    with pytest.raises(RecordingError, match="pan 1 per second, wheels 1 per second; at least 2") as caught:
        plan_stations([moving], head("pan"))
    assert "20 Hz" in caught.value.hint


def test_a_joint_that_is_published_once_leaves_no_break_to_be_judged():
    """At the stamp of an image: "not enough values to unpack"."""
    log = signals(staircase, staircase)
    once = Track(log.joints["pan"].time_ns[:1], log.joints["pan"].value[:1])
    at = np.append(once.time_ns, log.images["left"].time_ns)
    shown = {side: indexed(at) for side in log.images}
    recorded = dict.fromkeys(log.images, at)
    _, notes = planned(replace(log, joints={"pan": once}, images=shown, recorded_ns=recorded), ["pan"])
    assert any("no readings around them" in note for note in notes)
