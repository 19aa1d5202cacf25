"""Camera infos that change in the middle of a recording."""

from dataclasses import replace

import numpy as np
import pytest

from mobilecal_cli import se3
from mobilecal_cli.model.signals import CAMERA_INFO_CHANGES
from mobilecal_cli.readers import open_recording
from mobilecal_cli.readers.containers.storage import EVERYTHING, Extent

from . import recordings as r

P = np.array([[480.0, 0, 310, -57.6], [0, 480, 235, 0], [0, 0, 1, 0]])
D = [-0.2, 0.1, 0, 0, 0]


def world(after=None, count=10, at=6, **before):
    """A recording whose left camera info is published `count` times, and changes at one of them."""
    usual = {"K": r.K_LEFT, "D": D, "P": P, **before}
    items = [item for item in r.world() if item.topic != "/left/camera_info"]
    for k in range(count):
        log_ns = r.START_NS + k * 100_000_000
        stated = {**usual, **(after or {})} if k >= at else usual
        make = r.info(**stated, stamp_ns=log_ns)
        items.append(r.Item("/left/camera_info", log_ns, make))
    return sorted(items, key=lambda item: item.log_ns)


def notes_of(tmp_path, items, container="mcap-zstd", extent=EVERYTHING):
    path = r.CONTAINERS[container](tmp_path / "log", items)
    with open_recording([path]) as recording:
        notes = r.one_log(recording, r.SOURCES, extent).notes
    return [note for note in notes if CAMERA_INFO_CHANGES in note]


@pytest.mark.parametrize("container", ["mcap-zstd", "mcap-ros1", "bag", "rosbag2-sqlite3"])
@pytest.mark.parametrize("extent", [EVERYTHING, Extent(10**9)], ids=["together", "alone"])
def test_a_change_is_told_with_its_time_and_size(tmp_path, container, extent):
    moved = r.K_LEFT + np.array([[0.0, 0, 2.5], [0, 0, 0], [0, 0, 0]])
    assert notes_of(tmp_path, world({"K": moved}), container, extent) == [
        "/left/camera_info: the camera calibration changes 0.6 s after the start: K by up to 2.5 px; 4 of 10 messages "
        "differ from the others, which are used; images recorded while it differs are left out"
    ]


@pytest.mark.parametrize(
    ("after", "said"),
    [
        ({"D": [-0.2, 0.12, 0, 0, 0]}, "D by up to 0.02;"),
        ({"P": P + 1e-2}, "P by up to 0.01 px;"),
        ({"R": se3.exp_so3(np.radians([0, 0.3, 0]))}, "R by 0.3 deg;"),
        ({"size": (480, 360)}, "image size 640 x 480 to 480 x 360;"),
        ({"D": [0.1] * 8, "model": "rational_polynomial"}, "model plumb_bob (5) to rational_polynomial (8);"),
        ({"size": (320, 240)}, "but the image size in camera_info is 320 x 240; 4 of 10 messages differ"),
    ],
)
def test_what_changes_is_named(tmp_path, after, said):
    (note,) = notes_of(tmp_path, world(after))
    assert said in note


@pytest.mark.parametrize(
    "after", [None, {"K": r.K_LEFT * (1 + 1e-9)}, {"P": P + 1e-10}, {"K": np.zeros((3, 3))}]
)
def test_rounding_stamps_and_an_invalid_message_are_no_change(tmp_path, after):
    assert notes_of(tmp_path, world(after)) == []


def test_one_wrong_message_is_counted(tmp_path):
    items = world({"D": [0, 0, 0, 0, 0]}, at=3)
    later = [item for item in items if item.topic == "/left/camera_info"][4:]
    usual = {item.log_ns: r.info(r.K_LEFT, D, P, stamp_ns=item.log_ns) for item in later}
    items = [replace(item, make=usual[item.log_ns]) if item in later else item for item in items]
    (note,) = notes_of(tmp_path, items)
    assert "0.3 s after the start" in note
    assert "1 of 10 messages differ" in note


def test_what_most_messages_say_is_used_and_other_images_are_left_out(tmp_path):
    """The first four camera infos state other focal lengths, and two of the six left images are recorded then."""
    path = r.write_mcap(tmp_path / "log", world({"K": r.K_LEFT}, K=1.1 * r.K_LEFT, at=4))
    with open_recording([path]) as recording:
        signals = r.one_log(recording, r.SOURCES)
    (topic,) = signals.infos
    assert topic == "/left/camera_info"
    np.testing.assert_allclose(signals.infos[topic].K, r.K_LEFT)
    first_ns = signals.images["left"].time_ns[0]
    assert first_ns == r.START_NS + 20 * r.STEP_NS
    assert len(signals.images["left"].time_ns) == 4
    assert [len(signals.recorded_ns[side]) for side in ("left", "right")] == [6, 6]
    assert len(signals.images["right"].time_ns) == 6
    (note,) = [note for note in signals.notes if CAMERA_INFO_CHANGES in note]
    assert "4 of 10 messages differ from the others" in note


def test_images_are_left_out_while_the_stated_calibration_is_that_of_no_camera(tmp_path):
    """It was passed over: the images were taken for those of the calibration before."""
    path = r.write_mcap(tmp_path / "log", world({"size": (320, 240)}, at=4))
    with open_recording([path]) as recording:
        signals = r.one_log(recording, r.SOURCES)
    assert len(signals.images["left"].time_ns) == 2
    assert len(signals.images["right"].time_ns) == 6
    (note,) = [note for note in signals.notes if CAMERA_INFO_CHANGES in note]
    assert "6 of 10 messages differ from the others" in note
