"""Reading joints and wheels first, then only the chosen images, gives the same plan as one pass."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from unittest import mock

import numpy as np
import pytest
from mcap.writer import CompressionType

from mobilecal_cli.calibrate import plan as planning
from mobilecal_cli.calibrate.extract import extract
from mobilecal_cli.calibrate.plan import plan_recording
from mobilecal_cli.errors import RecordingError
from mobilecal_cli.model import Sources, WheelSource
from mobilecal_cli.readers import open_recording, read_images
from mobilecal_cli.readers.messages import Channel
from mobilecal_cli.rig.config import load_rig
from mobilecal_cli.solvers import solve
from tests.records import records_of, written

from ..readers import recordings as r

S = 10**9
MS = 10**6
IMAGES = {"left": "/l", "right": "/r"}
SOURCES = Sources(
    image=IMAGES,
    info={},
    joints=("/j",),
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
    return r.Item("/j", "sensor_msgs/msg/JointState", stamp + 2 * MS, make)


def picture(topic, t, lag_ns):
    stamp = r.START_NS + round(t * S)
    pixels = np.full((48, 64), round(t * 10) % 256, np.uint8)
    return r.Item(topic, "sensor_msgs/msg/Image", stamp + lag_ns, r.image(pixels, "mono8", stamp))


def log(motion=rests, lag=lambda topic, t: LAG_NS[topic], hz=10):
    joints = [joint(t, motion) for t in np.arange(0, 24, 0.02)]
    times_s = np.arange(0.1, 23.8, 1 / hz)
    return joints, [picture(topic, t, lag(topic, t)) for t in times_s for topic in ("/l", "/r")]


def in_stretches(folder, joints, pictures):
    """An MCAP file whose chunks hold joints or pictures, but for one in each stretch of 3 s."""
    items = []
    for stretch in range(8):
        inside = range(r.START_NS + 3 * stretch * S, r.START_NS + 3 * (stretch + 1) * S)
        late = 2**63 if stretch == 7 else inside.stop
        items += [item for some in (joints, pictures) for item in some if inside.start <= item.log_ns < late]
    items = list({id(item): item for item in items}.values())
    return [r.write_mcap(folder / "log.mcap", items, compression=CompressionType.NONE)]


def two_files(folder, joints, pictures):
    """What two recorders write that run side by side."""
    return [r.write_mcap(folder / "joints.mcap", joints), r.write_bag(folder / "pictures.bag", pictures)]


def in_order(joints, pictures):
    return sorted([*joints, *pictures], key=lambda item: item.log_ns)


def sqlite(folder, joints, pictures):
    return [r.write_bag2(folder / "log", in_order(joints, pictures))]


def bag(folder, joints, pictures):
    return [r.write_bag(folder / "log.bag", in_order(joints, pictures))]


def one_plan(recording):
    plans, _, notes = plan_recording(recording, RIG)
    return plans, notes


def planned(paths, joints_first, read=()):
    """The plan, the notes, and how many messages of each topic were decoded."""
    decoded = Counter()
    decode = Channel.decode

    def counted(self, data):
        decoded[self.topic] += 1
        return decode(self, data)

    with (
        mock.patch.object(planning, "WORTH_BYTES", 0 if joints_first else 2**62),
        mock.patch.object(Channel, "decode", counted),
        open_recording(paths) as recording,
    ):
        (plan,), notes = one_plan(recording)
        counts = dict(decoded)
        pairs = [pair.times_ns for station in plan.stations for pair in station.shots]
        wanted = {"left": {left for left, _ in pairs}, "right": {right for _, right in pairs}}
        assert {side: set(index.stamp_ns.tolist()) for side, index in plan.images.items()} == wanted
        found = {(side, ns): image[0, 0] for side, ns, image in read_images(recording, IMAGES, plan.images)}
        assert recording.damage == ()
    # Each image shows its own time, so that the chosen ones can be checked.
    keys = [(side, ns) for side, stamps in wanted.items() for ns in stamps]
    assert found == {(side, ns): round((ns - r.START_NS) / S * 10) % 256 for side, ns in keys}
    return plan, notes, counts


def same(found, expected):
    """Whether two plans are equal in everything."""
    assert len(found.stations) == len(expected.stations)
    for one, other in zip(found.stations, expected.stations, strict=True):
        assert replace(one, joints=[], joints_std=[]).shots == other.shots
        assert (one.index, one.at_rest, one.time_ns) == (other.index, other.at_rest, other.time_ns)
        np.testing.assert_array_equal(one.joints, other.joints)
        np.testing.assert_array_equal(one.joints_std, other.joints_std)
    np.testing.assert_array_equal(found.wheels.time_ns, expected.wheels.time_ns)
    np.testing.assert_array_equal(found.wheels.right_rad, expected.wheels.right_rad)
    assert found.rejections == expected.rejections
    return True


@pytest.mark.parametrize("write", [in_stretches, two_files, sqlite])
def test_the_plan_is_that_of_one_pass(tmp_path, write):
    paths = write(tmp_path, *log())
    plan, notes, decoded = planned(paths, joints_first=True)
    expected, expected_notes, all_decoded = planned(paths, joints_first=False)
    assert same(plan, expected)
    assert len(plan.stations) == 8
    assert all(station.at_rest and len(station.shots) == 10 for station in plan.stations)
    assert notes == expected_notes
    assert all_decoded["/l"] == all_decoded["/r"] == 237
    assert decoded["/l"] == decoded["/r"] == 80 + 17


def test_one_pass_is_enough(tmp_path):
    paths = bag(tmp_path, *log())
    _, _, decoded = planned(paths, joints_first=True)
    assert decoded["/l"] == 237
    paths = sqlite(tmp_path, *log())
    with mock.patch.object(planning, "find_pictures") as find, open_recording(paths) as recording:
        plan_recording(recording, RIG)
    find.assert_not_called()


@pytest.mark.parametrize("write", [in_stretches, sqlite])
def test_a_moving_log_with_a_constant_lag(tmp_path, write):
    paths = write(tmp_path, *log(lambda t: np.sin(t)))
    plan, notes, decoded = planned(paths, joints_first=True)
    expected, expected_notes, _ = planned(paths, joints_first=False)
    assert same(plan, expected)
    assert not any(station.at_rest for station in plan.stations)
    assert notes == expected_notes
    assert decoded["/l"] == len(plan.stations) + 17


def jittery(most_ms):
    rng = np.random.default_rng(3)
    return lambda topic, _: LAG_NS[topic] + int(rng.uniform(-most_ms, most_ms) * MS)


def test_stamps_are_the_pictures_own_where_the_lag_varies(tmp_path):
    joints, pictures = log(lag=jittery(15))
    paths = sqlite(tmp_path, joints, pictures)
    plan, _, decoded = planned(paths, joints_first=True)
    assert decoded["/l"] == 80 + 17
    assert len(plan.stations) == 8
    for k, station in enumerate(plan.stations):
        assert station.at_rest
        assert station.joints == pytest.approx([0.5 * k], abs=1e-12)
        for pair in station.shots:
            assert pair.times_ns[0] == pair.times_ns[1]
            assert (pair.times_ns[0] - r.START_NS) % (100 * MS) == 0


def test_a_moving_log_whose_lag_varies_needs_all_stamps(tmp_path):
    paths = sqlite(tmp_path, *log(lambda t: np.sin(t), lag=jittery(15)))
    plan, notes, decoded = planned(paths, joints_first=True)
    expected, expected_notes, _ = planned(paths, joints_first=False)
    assert same(plan, expected)
    assert notes == expected_notes
    assert decoded["/l"] >= 237


def test_a_lag_that_the_few_pictures_do_not_show(tmp_path):
    """During the fourth rest the images are a second late, which the sampled ones do not show."""
    few = {round(0.1 + k, 1) for k in np.linspace(0, 236, 9).astype(int) * 0.1}

    def lag(topic, t):
        return LAG_NS[topic] + (S if 9.0 < t < 11.2 and round(t, 1) not in few else 0)

    paths = sqlite(tmp_path, *log(lag=lag))
    plan, _, decoded = planned(paths, joints_first=True)
    expected, _, _ = planned(paths, joints_first=False)
    joints = [[station.joints.round(9).tolist() for station in each.stations] for each in (plan, expected)]
    assert joints[0] == joints[1]
    for station in plan.stations:
        times_s = np.array([(pair.time_ns - r.START_NS) / S for pair in station.shots])
        assert np.all(np.abs(rests(times_s - 0.14) - rests(times_s + 0.14)) < 0.01)
    assert decoded["/l"] < 237


def test_without_stamps_all_is_as_in_one_pass(tmp_path):
    joints, pictures = log()
    unstamped = [
        replace(item, make=r.image(np.full((48, 64), k % 256, np.uint8), "mono8", 0))
        for k, item in enumerate(pictures)
    ]
    paths = sqlite(tmp_path, joints, unstamped)
    with mock.patch.object(planning, "WORTH_BYTES", 0), open_recording(paths) as recording:
        (plan,), notes = one_plan(recording)
    assert len(plan.stations) == 8
    assert "/l: all 237 header stamps are zero; the log time is used" in notes


def test_clocks_that_differ_are_noted(tmp_path):
    paths = sqlite(tmp_path, *log(lag=lambda topic, _: 2 * S if topic == "/l" else 2 * S + 3 * MS))
    _, notes, decoded = planned(paths, joints_first=True)
    _, expected, _ = planned(paths, joints_first=False)
    assert decoded["/l"] == 97
    assert notes == expected
    assert any(note.startswith("clocks differ: the stamps of /r are 2.003 s") for note in notes)


def test_pictures_that_cannot_be_decoded_are_counted(tmp_path):
    joints, pictures = log()
    (file,) = r.write_bag2(tmp_path / "log", in_order(joints, pictures)).glob("*.db3")
    data = bytes(r.ROS2.serialize_cdr(r.number("UInt16", 1)(r.ROS2), "std_msgs/msg/UInt16"))
    log_ns = r.START_NS + 300 * MS + LAG_NS["/l"]
    of_topic = "(SELECT id FROM topics WHERE name = '/l')"
    where = f"timestamp = {log_ns} AND topic_id = {of_topic}"
    r.in_sqlite(file, f"UPDATE messages SET data = x'{data.hex()}' WHERE {where}")
    with mock.patch.object(planning, "WORTH_BYTES", 0), open_recording([file]) as recording:
        (plan,), notes = one_plan(recording)
    assert len(plan.stations[0].shots) == 9
    assert "/l: 1 of the 80 selected images do not match their type; ignored" in notes


def test_what_cannot_be_planned_is_told_as_in_one_pass(tmp_path):
    joints, _ = log()
    offsets = (("/l", 0.2), ("/r", 0.7))
    pictures = [picture(topic, k + offset_s, 0) for k in range(20) for topic, offset_s in offsets]
    paths = sqlite(tmp_path, joints, pictures)
    messages = []
    for worth in (0, 2**62):
        with (
            mock.patch.object(planning, "WORTH_BYTES", worth),
            open_recording(paths) as recording,
            pytest.raises(RecordingError) as caught,
        ):
            plan_recording(recording, RIG)
        messages.append((caught.value.message, caught.value.hint))
    assert messages[0] == messages[1]
    assert "no stereo pairs" in messages[0][0]


def apart(source: Path, folder: Path) -> list[Path]:
    """A recording once more, its pictures in a file of their own, logged 40 ms (left) and 43 ms later."""
    joints = [record for record in records_of(source) if "image_raw" not in record.topic]
    pictures = [
        replace(record, time_ns=record.time_ns + (40 if "left" in record.topic else 43) * MS)
        for record in records_of(source)
        if "image_raw" in record.topic
    ]
    return [written(folder / "joints.mcap", joints), written(folder / "pictures.mcap", pictures)]


@pytest.mark.long
def test_a_simulated_log_gives_the_same_numbers(sample_logs, tmp_path, monkeypatch):
    paths = apart(sample_logs / "paper_robot.mcap", tmp_path)
    config = load_rig(None, {})
    one_pass, _ = extract(paths, config)
    monkeypatch.setattr(planning, "WORTH_BYTES", 0)
    with mock.patch.object(planning, "read_stamps", wraps=planning.read_stamps) as read:
        joints_first, _ = extract(paths, config)
    read.assert_called_once()
    assert joints_first.notes == one_pass.notes
    assert joints_first.counts == one_pass.counts
    assert one_pass.counts["observations"] > 10
    found, expected = solve(joints_first, "ml"), solve(one_pass, "ml")
    np.testing.assert_array_equal(found.parameters.T_h_c, expected.parameters.T_h_c)
    assert found.parameters.wheels == expected.parameters.wheels


@pytest.mark.parametrize("count", [3, 40], ids=["everywhere", "once"])
def test_repeated_images_need_one_pass(tmp_path, count):
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
    with mock.patch.object(planning, "WORTH_BYTES", 0), open_recording(paths) as recording:
        (plan,), notes = one_plan(recording)
    assert len(plan.stations) == 8
    assert any("images are identical to the image before them" in note for note in notes)
    used = [pair.times_ns[0] for station in plan.stations for pair in station.shots]
    own = {item.log_ns - LAG_NS["/l"]: k for k, item in enumerate(left)}
    if count == 3:
        numbers = [own[stamp] // 3 for stamp in used]
        assert len(set(numbers)) == len(numbers) > 8
    else:
        assert sum(own[stamp] in range(300, 340) for stamp in used) == 1
