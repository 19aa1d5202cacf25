"""Messages come in order of log time, whatever order they were written in."""

from __future__ import annotations

import numpy as np
import pytest

from mobilecal_cli.readers import open_recording
from mobilecal_cli.readers.containers.blocks import BlockStorage

from . import recordings as r


def late(share: float, most_s: float) -> np.ndarray:
    """Log times of 2,000 messages, s, some of which come late."""
    rng = np.random.default_rng(5)
    times = np.sort(rng.integers(0, 500, 2000)) * 0.01  # many are equal
    return np.where(rng.random(2000) < share, times - most_s * rng.random(2000), times)


@pytest.mark.parametrize("write", [r.write_mcap, r.write_bag])
@pytest.mark.parametrize(
    "times_s",
    [late(0, 0), late(0.02, 0.05), late(0.5, 3.0), late(0, 0)[::-1], np.append(late(0.1, 1), [-2.0])],
    ids=["in order", "a little late", "far apart", "backwards", "one that overlaps all"],
)
def test_messages_come_in_order(tmp_path, write, times_s):
    items = [
        r.Item("/n", "std_msgs/msg/UInt16", r.START_NS + round(time_s * 1e9), r.number("UInt16", k))
        for k, time_s in enumerate(times_s)
    ]
    with open_recording([write(tmp_path / "log", items)]) as recording:
        (part,) = recording.parts
        assert isinstance(part, BlockStorage)
        assert len(part.blocks) > 5
        found = [(m.log_time_ns, m.decode().data) for m in recording.messages(["/n"])]
        blocks = sorted(part.blocks, key=lambda block: (block.start_ns, block.offset))
        # Of messages with one log time those come first that are read first.
        stored = [(time_ns, bytes(data)) for b in blocks for _, time_ns, data in part.parse(part.load(b))]
        expected = sorted(stored, key=lambda message: message[0])
        assert [(m.log_time_ns, bytes(m.payload)) for m in recording.messages(["/n"])] == expected
    assert sorted(number for _, number in found) == list(range(len(items)))
