"""Messages come in order of log time, whatever order they were written in."""

from dataclasses import replace

import numpy as np
import pytest

from mobilecal_cli.readers import open_recording
from mobilecal_cli.readers.containers.blocks import BlockStorage
from mobilecal_cli.readers.containers.storage import Extent, goes_back, steps_back

from . import recordings as r


def late(share: float, most_s: float) -> np.ndarray:
    """Log times of 1,000 messages, s, some of which come late."""
    rng = np.random.default_rng(5)
    times = np.sort(rng.integers(0, 500, 1000)) * 0.01  # many are equal
    return np.where(rng.random(1000) < share, times - most_s * rng.random(1000), times)


@pytest.mark.parametrize("name", ["mcap-zstd", "mcap-unchunked", "mcap-no-summary", "bag", "rosbag2-sqlite3"])
@pytest.mark.parametrize(
    "times_s",
    [late(0, 0), late(0.02, 0.05), late(0.5, 3.0), late(0, 0)[::-1], np.append(late(0.1, 1), [-2.0])],
    ids=["in order", "a little late", "far apart", "backwards", "one that overlaps all"],
)
def test_messages_come_in_order(tmp_path, name, times_s):
    items = [
        r.Item("/n", r.START_NS + round(time_s * 1e9), r.number("UInt16", k))
        for k, time_s in enumerate(times_s)
    ]
    with open_recording([r.CONTAINERS[name](tmp_path / "log", items)]) as recording:
        found = [(m.log_time_ns, m.decode().data) for m in recording.messages(["/n"])]
        assert sorted(number for _, number in found) == list(range(len(items)))
        assert [log_ns for log_ns, _ in found] == sorted(item.log_ns for item in items)
        (part,) = recording.parts
        if not isinstance(part, BlockStorage):
            return
        assert len(part.blocks) > 5 or name == "mcap-unchunked"
        blocks = sorted(part.blocks, key=lambda block: (block.start_ns, block.offset))
        # Of messages with one log time those come first that are read first.
        stored = [(time_ns, bytes(data)) for b in blocks for _, time_ns, data in part.parse(part.load(b))]
        expected = sorted(stored, key=lambda message: message[0])
        assert [(m.log_time_ns, bytes(m.payload)) for m in recording.messages(["/n"])] == expected


WRITERS = {"mcap": r.write_mcap, "bag": r.write_bag, "db3": r.write_bag2}


def stepping(lengths_s=(20.0, 20.0), step_s=10.0, hz=(50, 5, 1)):
    """Messages of some topics; the clock of the recorder, and that of the stamps, steps back after each stretch."""
    items = []
    for k in range(round(sum(lengths_s) * max(hz))):
        true_s = k / max(hz)
        behind = round(step_s * 1e9) * int((true_s >= np.cumsum(lengths_s)[:-1]).sum())
        log_ns = r.START_NS + round(true_s * 1e9) - behind
        for rate in hz:
            if k % (max(hz) // rate) == 0:
                make = r.joint_state(["a"], [true_s], stamp_ns=log_ns)
                items.append(r.Item(f"/hz{rate}", log_ns + rate, make))
    return items


@pytest.mark.parametrize("write", WRITERS.values(), ids=WRITERS)
@pytest.mark.parametrize(
    ("lengths_s", "step_s"), [((20, 20), 10.0), ((5, 30), 10.0), ((12, 13, 14), 10.0), ((20, 20), 0.5)]
)
def test_log_times_go_on_where_the_recorder_s_clock_steps_back(tmp_path, write, lengths_s, step_s):
    items = stepping(lengths_s, step_s)
    with open_recording([write(tmp_path / "log", items)]) as recording:
        topics = [info.name for info in recording.topics]
        found = list(recording.messages(topics))
        values = [m.decode().position[0] for m in found]
        assert values == sorted(values)
        assert len(values) == len(items)
        log_s = (np.array([m.log_time_ns for m in found]) - r.START_NS) / 1e9
        assert np.abs(log_s - values).max() < 0.05
        steps = len(lengths_s) - 1
        (note, *more) = recording.damage
        assert f"the recorder's clock steps back by {step_s:.1f}" in note
        assert len(more) <= steps - 1
        for topic, times in recording.log_times().items():
            own = [m.log_time_ns for m in found if m.topic == topic]
            assert times.tolist() == own
            some = own[:: len(own) // 7]
            inside = (m.log_time_ns for m in recording.messages([topic], Extent(at_ns=np.array(some))))
            assert [log_ns for log_ns in inside if log_ns in some] == some
        assert recording.end_ns - recording.start_ns == pytest.approx(sum(lengths_s) * 1e9, abs=1e8)


@pytest.mark.parametrize("write", WRITERS.values(), ids=WRITERS)
@pytest.mark.parametrize("by_topic", [True, False])
def test_a_file_written_topic_by_topic_and_a_stray_log_time_have_no_steps(tmp_path, write, by_topic):
    items = stepping((30,))
    if by_topic:
        items.sort(key=lambda item: item.topic)
    else:
        items[400] = replace(items[400], log_ns=items[400].log_ns + 3600 * 10**9)
    with open_recording([write(tmp_path / "log", items)]) as recording:
        times = [m.log_time_ns for m in r.every(recording)]
        assert (times if by_topic else sorted(times)) == sorted(item.log_ns for item in items)
        assert recording.damage == ()


def test_log_times_of_damage_are_no_steps():
    channel = np.zeros(40, dtype=np.int64)
    extreme = np.array([2**63 - 1, -(2**63)] * 20)
    for log_ns in (extreme, np.repeat([2**62, 0], 20), np.zeros(0, dtype=np.int64)):
        assert not goes_back(channel[: len(log_ns)], log_ns)
    huge = np.concatenate([start + np.arange(20) for start in (2**61, 2**60, 2**61, 0)])
    assert goes_back(np.zeros(80, dtype=np.int64), huge)
    assert steps_back(np.zeros(80, dtype=np.int64), huge) == []


@pytest.mark.parametrize("lengths_s", [(20, 20), (12, 28), (5, 13, 22)])
@pytest.mark.parametrize("write", [r.write_mcap, r.write_bag])
def test_log_times_go_on_from_file_to_file(tmp_path, write, lengths_s):
    items, files = stepping(lengths_s), 4
    folder = tmp_path / "log"
    folder.mkdir()
    names = [f"log_{k}.{write.__name__}" for k in range(files)]
    for k, name in enumerate(names):
        write(folder / name, items[k * len(items) // files : (k + 1) * len(items) // files])
    listed = "\n".join(f"    - {name}" for name in names)
    (folder / "metadata.yaml").write_text(f"rosbag2_bagfile_information:\n  relative_file_paths:\n{listed}\n")
    with open_recording([folder]) as recording:
        found = r.every(recording)
        values = [m.decode().position[0] for m in found]
        assert values == sorted(values)
        assert len(values) == len(items)
        log_s = (np.array([m.log_time_ns for m in found]) - r.START_NS) / 1e9
        assert np.abs(log_s - values).max() < 0.1
        # Workers open the files without the directory.
        with open_recording([part.opened for part in recording.parts]) as again:
            times = [m.log_time_ns for m in r.every(again)]
        assert times == [m.log_time_ns for m in found]
