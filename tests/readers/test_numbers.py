"""Numbers in messages of any type, and how a counter starts again."""

import numpy as np
import pytest

from mobilecal_cli.model.signals import NumberField
from mobilecal_cli.readers import number_fields, open_recording
from mobilecal_cli.readers.signals.wheels import wraps

from . import recordings as r


def counter(span, step, count=400, start=None):
    return [int(v) for v in ((span // 2 if start is None else start) + step * np.arange(count)) % span]


@pytest.mark.parametrize(
    ("values", "expected"),
    [
        (counter(2**16, 300), (16, None)),
        (counter(2**16, -300), (16, None)),
        (counter(2**8, 5), (8, None)),
        (counter(2**8, 61), (8, None)),  # a fast wheel
        ([v - 2**15 for v in counter(2**16, 300)], (16, None)),  # signed
        (counter(2**32, 2**24), (32, None)),
        (counter(4096, 30), (None, 4096 - 30)),
        (counter(2**16, 3), (None, None)),
        (counter(2**16, 3) + counter(2**16, 3, start=0), (None, None)),  # a driver that starts again once
        (counter(2**16, 300) + counter(2**16, 300, 90, start=0), (16, None)),
        ([0] * 50, (None, None)),
        ([0, 0, 0, 500, 500, 500], (None, None)),
        ([0.5 * i for i in range(50)], (None, None)),
    ],
)
def test_how_a_counter_starts_again(values, expected):
    bits, jump = wraps(np.array(values, dtype=np.float64))
    assert bits == expected[0]
    assert jump == (None if expected[1] is None else pytest.approx(expected[1], abs=30))


def test_numbers_of_the_sample(sample_logs):
    with open_recording([sample_logs / "tick_robot.mcap"]) as recording:
        topics = [topic.name for topic in recording.topics]
        found = number_fields(recording, topics, lambda topic, path: "wheel_ticks" in topic)
        assert found == tuple(
            NumberField(f"/wheel_ticks/{side}", "data", True, 16, 16, None) for side in ("left", "right")
        )
        stamps = number_fields(recording, ["/stereo/left/camera_info"], lambda topic, path: True)
        assert {"height", "width", "binning_x", "roi.x_offset"} <= {field.path for field in stamps}
        assert not any("header" in field.path for field in stamps)


def test_numbers_that_never_change(tmp_path):
    messages = [("/t", r.START_NS + k, "mine", {"data": k, "resolution": 135}) for k in range(3)]
    with open_recording([r.write_json(tmp_path / "log.mcap", messages)]) as recording:
        found = number_fields(recording, ["/t"], lambda topic, path: True)
    assert {field.path: field.still for field in found} == {"data": False, "resolution": True}


def test_a_number_beyond_the_range_of_floats(tmp_path):
    path = r.write_json(tmp_path / "log.mcap", [("/t", r.START_NS, "mine", {"count": 10**400})])
    with open_recording([path]) as recording:
        found = number_fields(recording, ["/t"], lambda topic, path: True)
    assert found == (NumberField("/t", "count", True),)


def test_a_topic_that_cannot_be_read_has_none(shared_data):
    path = shared_data / "bags/rosbag2/rosbag2_tests/resources/mcap/wrong_rmw_test"
    with open_recording([path]) as recording:
        topics = [topic.name for topic in recording.topics]
        assert number_fields(recording, topics, lambda topic, path: True) == ()
        assert recording.damage
