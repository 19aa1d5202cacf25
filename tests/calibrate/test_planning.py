"""Stations of a whole recording, planned from its files: whatever the container and the lags of the images."""

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from mobilecal_cli.calibrate.detect import plan_recording
from mobilecal_cli.model.rig import Sources, WheelSource
from mobilecal_cli.readers import open_recording, read_images

from ..readers import recordings as r

S = 10**9
MS = 10**6
IMAGES = {"left": "/l", "right": "/r"}
SOURCES = Sources(
    image=IMAGES,
    info={},
    joints={"pan": "/j"},
    wheels={side: WheelSource("/j", joint=f"wheel_{side}") for side in ("left", "right")},
)
RIG = SimpleNamespace(sources=SOURCES, chain=SimpleNamespace(joints=("pan",), prismatic=frozenset()))
LAG_NS = {"/l": 40 * MS, "/r": 43 * MS}


def rests(t):
    """Eight rests of 2 s with moves of 1 s between them."""
    number = np.minimum(t // 3, 7)
    share = np.clip(t - 3 * number - 2, 0, 1)
    return 0.5 * (number + share**2 * (3 - 2 * share))


def joint(t, motion):
    at = motion(t)
    stamp = r.START_NS + round(t * S)
    make = r.joint_state(["pan", "wheel_left", "wheel_right"], [at, 3 * at, 4 * at], stamp_ns=stamp)
    return r.Item("/j", stamp + 2 * MS, make)


def picture(topic, t, lag_ns):
    stamp = r.START_NS + round(t * S)
    pixels = np.full((48, 64), round(t * 10) % 256, np.uint8)
    return r.Item(topic, stamp + lag_ns, r.image(pixels, "mono8", stamp))


def log(motion=rests, lag=lambda topic, t: LAG_NS[topic], hz=10):
    joints = [joint(t, motion) for t in np.arange(0, 24, 0.02)]
    times_s = np.arange(0.1, 23.8, 1 / hz)
    return joints, [picture(topic, t, lag(topic, t)) for t in times_s for topic in ("/l", "/r")]


def two_files(folder, joints, pictures):
    """What two recorders write that run side by side."""
    return [r.write_mcap(folder / "joints.mcap", joints), r.write_bag(folder / "pictures.bag", pictures)]


def in_order(joints, pictures):
    return sorted([*joints, *pictures], key=lambda item: item.log_ns)


def sqlite(folder, joints, pictures):
    return [r.write_bag2(folder / "log", in_order(joints, pictures))]


def bag(folder, joints, pictures):
    return [r.write_bag(folder / "log.bag", in_order(joints, pictures))]


def planned(paths):
    """The plan and its notes; each image shows its own time, so that the chosen ones can be checked."""
    with open_recording(paths) as recording:
        (plan,), _, notes = plan_recording(recording, RIG)
        found = {
            (side, ns): image[0, 0] for side, ns, image in read_images(recording, RIG.sources, plan.images)
        }
        assert recording.damage == ()
    pairs = [pair.times_ns for station in plan.stations for pair in station.shots]
    keys = [(side, pair[k]) for pair in pairs for k, side in enumerate(IMAGES)]
    assert found == {(side, ns): round((ns - r.START_NS) / S * 10) % 256 for side, ns in keys}
    return plan, notes


@pytest.mark.parametrize("write", [two_files, sqlite, bag])
def test_the_plan_is_the_same_in_each_container(tmp_path, write):
    plan, notes = planned(write(tmp_path, *log(lag=jittery(15))))
    assert notes == ()
    assert len(plan.stations) == 8
    for k, station in enumerate(plan.stations):
        assert station.at_rest
        assert len(station.shots) == 10
        assert station.joints == pytest.approx([0.5 * k], abs=1e-12)
        for pair in station.shots:
            assert pair.times_ns[0] == pair.times_ns[1]
            assert (pair.times_ns[0] - r.START_NS) % (100 * MS) == 0


def jittery(most_ms):
    rng = np.random.default_rng(3)
    return lambda topic, _: LAG_NS[topic] + int(rng.uniform(-most_ms, most_ms) * MS)


def test_images_that_are_recorded_late_stand_at_their_stamps(tmp_path):
    """During the fourth rest the images are recorded a second late."""
    late = lambda topic, t: LAG_NS[topic] + (S if 9.0 < t < 11.2 else 0)  # noqa: E731
    plan, _ = planned(sqlite(tmp_path, *log(lag=late)))
    assert len(plan.stations) == 8
    for station in plan.stations:
        times_s = np.array([(pair.time_ns - r.START_NS) / S for pair in station.shots])
        assert np.all(np.abs(rests(times_s - 0.14) - rests(times_s + 0.14)) < 0.01)


def test_without_stamps_the_log_time_is_used(tmp_path):
    joints, pictures = log()
    unstamped = [
        replace(item, make=r.image(np.full((48, 64), k % 256, np.uint8), "mono8", 0))
        for k, item in enumerate(pictures)
    ]
    paths = sqlite(tmp_path, joints, unstamped)
    with open_recording(paths) as recording:
        (plan,), _, notes = plan_recording(recording, RIG)
    assert len(plan.stations) == 8
    assert "/l: all 237 header stamps are zero; the log time is used" in notes


@pytest.mark.parametrize("count", [3, 40], ids=["everywhere", "once"])
def test_repeated_images_are_used_once(tmp_path, count):
    """Each image is sent three times, or a camera stops for a while: what is chosen depends on all images."""
    joints, pictures = log(hz=30)
    left = [item for item in pictures if item.topic == "/l"]
    starts = range(0, len(left), count) if count == 3 else [300]
    for start in starts:
        for k, item in enumerate(left[start : start + count]):
            stamp = item.log_ns - LAG_NS["/l"]
            image = r.image(np.full((48, 64), start % 256, np.uint8), "mono8", stamp)
            left[start + k] = replace(item, make=image)
    paths = sqlite(tmp_path, joints, [*left, *(item for item in pictures if item.topic == "/r")])
    with open_recording(paths) as recording:
        (plan,), _, notes = plan_recording(recording, RIG)
    assert len(plan.stations) == 8
    assert any("images are identical to the image before them" in note for note in notes)
    used = [pair.times_ns[0] for station in plan.stations for pair in station.shots]
    own = {item.log_ns - LAG_NS["/l"]: k for k, item in enumerate(left)}
    if count == 3:
        numbers = [own[stamp] // 3 for stamp in used]
        assert len(set(numbers)) == len(numbers) > 8
    else:
        assert sum(own[stamp] in range(300, 340) for stamp in used) == 1
