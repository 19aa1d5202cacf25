"""Log times by the index, and what it spares."""

import numpy as np
import pytest

from mobilecal_cli.readers import Extent, open_recording

from . import recordings as r

ITEMS = r.world()
IMAGES = r.SOURCES.image
LOGGED = {topic: [i.log_ns for i in ITEMS if i.topic == topic] for topic in IMAGES.values()}


def test_a_large_file_without_an_index(tmp_path, monkeypatch):
    monkeypatch.setattr("mobilecal_cli.readers.containers.blocks.UNINDEXED_BYTES", 10_000)
    path = r.CONTAINERS["mcap-no-index-at-all"](tmp_path / "log", ITEMS)
    with open_recording([path]) as recording:
        assert recording.log_times() == {}


def logged(recording, extent):
    return [m.log_time_ns for m in recording.messages(["/left/image_raw"], extent)]


@pytest.mark.parametrize("indexed", [True, False])
def test_sqlite_reads_the_log_times_asked_for(tmp_path, indexed):
    (file,) = r.write_bag2(tmp_path / "log", ITEMS).glob("*.db3")
    if not indexed:
        r.in_sqlite(file, "DROP INDEX timestamp_idx")
    times = LOGGED["/left/image_raw"]
    at_ns = np.array([times[0] - 1, times[1], times[2], times[4], times[5]])
    with open_recording([file]) as recording:
        assert logged(recording, Extent(at_ns=at_ns)) == [times[1], times[2], times[4], times[5]]
        assert recording.share(["/left/image_raw"], Extent(at_ns=at_ns)) == pytest.approx(4 / 6)
        assert recording.damage == ()
        assert logged(recording, Extent()) == times


def test_bytes_of_topics_in_sqlite(tmp_path):
    (file,) = r.write_bag2(tmp_path / "log", ITEMS).glob("*.db3")
    with open_recording([file]) as recording:
        for topic in (*IMAGES.values(), "/ticks"):
            payloads = [len(m.payload) for m in recording.messages([topic])]
            assert recording.bytes_of([topic]) == sum(payloads) > 0
        assert recording.bytes_of(IMAGES.values()) == sum(recording.bytes_of([t]) for t in IMAGES.values())
        assert recording.bytes_of(["/none"]) == 0
