"""Pictures by the index, and what it spares."""

from dataclasses import replace

import numpy as np
import pytest

from mobilecal_cli.readers import Extent, find_pictures, open_recording, read_stamps

from . import recordings as r

ITEMS = r.world()
IMAGES = r.SOURCES.image
LOGGED = {topic: [i.log_ns for i in ITEMS if i.topic == topic] for topic in IMAGES.values()}


@pytest.fixture(params=r.CONTAINERS)
def recording(request, tmp_path):
    with open_recording([r.CONTAINERS[request.param](tmp_path / "log", ITEMS)]) as opened:
        yield opened


def test_pictures_and_stamps_are_found_by_the_index(recording):
    pictures = find_pictures(recording, IMAGES)
    assert pictures is not None
    assert pictures.spread_ns == 0
    for topic, logged in LOGGED.items():
        assert pictures.index[topic].log_ns.tolist() == logged
        assert pictures.index[topic].stamp_ns.tolist() == [r.START_NS + 10 * k * r.STEP_NS for k in range(6)]
    wanted = {topic: np.array(logged)[[1, 4]] for topic, logged in LOGGED.items()}
    read = read_stamps(recording, wanted)
    assert read is not None
    stamps, notes = read
    expected = [r.START_NS + 10 * k * r.STEP_NS for k in (1, 4)]
    for topic, times in wanted.items():
        assert stamps[topic] == dict(zip(times.tolist(), expected, strict=True))
    assert notes == recording.damage == ()
    wanted = {topic: np.array([logged[0], logged[1] + 1]) for topic, logged in LOGGED.items()}
    assert read_stamps(recording, wanted) is None


def test_the_middle_lag_and_how_far_lags_differ(tmp_path):
    items = [
        replace(item, log_ns=item.log_ns + (5_000 if item.topic == "/left/image_raw" and k == 0 else 0))
        for k, item in enumerate(sorted(ITEMS, key=lambda item: item.topic != "/left/image_raw"))
    ]
    with open_recording([r.write_bag2(tmp_path / "log", items)]) as recording:
        pictures = find_pictures(recording, IMAGES)
    assert pictures is not None
    index = pictures.index["/left/image_raw"]
    assert set((index.log_ns - index.stamp_ns).tolist()) == {3_000_002}
    assert pictures.spread_ns == 5_000


def changed(topic, **changes):
    return [replace(item, **changes) if item.topic == topic else item for item in ITEMS]


BLACK = np.zeros((8, 8), np.uint8)


@pytest.mark.parametrize(
    "items",
    [
        [item for item in ITEMS if item.topic != "/left/image_raw"],
        changed("/left/image_raw", type="std_msgs/msg/UInt16", make=r.number("UInt16", 1)),
        changed("/left/image_raw", make=r.image(BLACK, "mono8", stamp_ns=0)),
        changed(
            "/right/image/compressed", make=lambda s: replace(r.compressed(BLACK, ".png")(s), format="h264")
        ),
    ],
    ids=["no such topic", "no pictures", "no stamps", "video"],
)
def test_all_stamps_are_needed(tmp_path, items):
    with open_recording([r.write_mcap(tmp_path / "log.mcap", items)]) as recording:
        assert find_pictures(recording, IMAGES) is None


def test_a_large_file_without_an_index(tmp_path, monkeypatch):
    monkeypatch.setattr("mobilecal_cli.readers.containers.blocks.UNINDEXED_BYTES", 10_000)
    path = r.CONTAINERS["mcap-no-index-at-all"](tmp_path / "log", ITEMS)
    with open_recording([path]) as recording:
        assert find_pictures(recording, IMAGES) is None
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
