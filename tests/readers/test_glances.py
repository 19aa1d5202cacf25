"""What can be had of a recording without reading all of it."""

from dataclasses import replace

import numpy as np
import pytest

from mobilecal_cli.readers import Extent, open_recording, pictures_near, read_images
from mobilecal_cli.readers.containers.blocks import BlockStorage

from . import recordings as r

ITEMS = r.world()
TOPICS = {item.topic for item in ITEMS}


def blocks_of(recording):
    return [b for p in recording.parts if isinstance(p, BlockStorage) for b in p.blocks]


#: One of each way to find messages.
WAYS = [
    *(
        "bag",
        "rosbag2-sqlite3",
        "rosbag2-sqlite3-message",
        "rosbag2-mcap",
        "rosbag2-mcap-message",
        "mcap-zstd",
    ),
    *(
        "mcap-unchunked",
        "mcap-unchunked-no-summary",
        "mcap-no-summary",
        "mcap-no-index-at-all",
        "mcap-half-summary",
    ),
]


@pytest.fixture(params=WAYS)
def recording(request, in_container):
    with open_recording([in_container(request.param)]) as opened:
        yield opened


def test_pictures_near_moments_and_the_share_that_an_extent_leaves(recording):
    moments = [r.START_NS + k * r.STEP_NS for k in (0, 17, 25, 41, 999)]
    found = [(name, picture.tobytes()) for name, picture in pictures_near(recording, r.SOURCES, moments)]
    places = [("left", 0), ("right", 1)]
    assert found == [(name, r.picture(k + own).tobytes()) for name, own in places for k in (0, 20, 30, 50)]
    times = recording.log_times()
    assert set(times) == TOPICS
    for topic, found in times.items():
        assert found.tolist() == [item.log_ns for item in ITEMS if item.topic == topic]
    topics = ["/joint_states"]
    blocks = blocks_of(recording)
    assert recording.share(topics, Extent()) == recording.share(topics, Extent(2**30)) == 1
    if len(blocks) > 5 and all(block.is_chunk for block in blocks):
        assert 0 < recording.share(topics, Extent(20_000)) < 1


def test_a_part_is_read_where_blocks_are_large(recording):
    blocks = blocks_of(recording)
    if blocks and not all(block.is_chunk for block in blocks):
        pytest.skip("one stretch outside chunks holds all of this small file's messages of a topic")
    whole = r.one_log(recording, replace(r.SOURCES, image={}))
    part = r.one_log(recording, replace(r.SOURCES, image={}), Extent(20_000))
    assert part.images == {}
    known = dict(zip(whole.joints["pan"].time_ns.tolist(), whole.joints["pan"].value.tolist(), strict=True))
    got = dict(zip(part.joints["pan"].time_ns.tolist(), part.joints["pan"].value.tolist(), strict=True))
    assert got.items() <= known.items()
    assert recording.damage == ()
    if len(blocks) > 5:
        assert 0 < len(got) < len(known)
        assert max(got) - min(got) > 0.7 * (max(known) - min(known))
    else:
        assert got == known


def test_only_the_blocks_of_wanted_pictures_are_read_again(recording, monkeypatch):
    """Once the stamps are known, pictures are found where they were logged."""
    signals = r.one_log(recording, r.SOURCES)
    loaded = []
    for part in recording.parts:
        if isinstance(part, BlockStorage):
            load = part.load
            monkeypatch.setattr(part, "load", lambda block, load=load: (loaded.append(block), load(block))[1])
    wanted = {side: signals.images[side].rows(np.array([1, 4])) for side in ("left", "right")}
    found = {(side, ns): p for side, ns, p in read_images(recording, r.SOURCES, wanted)}
    assert set(found) == {(side, ns) for side, index in wanted.items() for ns in index.time_ns.tolist()}
    for k in (1, 4):
        left, right = (found[side, int(signals.images[side].time_ns[k])] for side in ("left", "right"))
        np.testing.assert_array_equal(left, r.picture(10 * k))
        np.testing.assert_array_equal(right, r.picture(10 * k + 1))
    blocks = blocks_of(recording)
    if len(blocks) > 5:
        assert len(loaded) <= 4
    assert recording.damage == ()


def test_pictures_are_found_although_the_index_lies_of_their_blocks(recording):
    signals = r.one_log(recording, r.SOURCES)
    for part in recording.parts:
        if isinstance(part, BlockStorage):
            part.blocks = [replace(block, end_ns=block.start_ns) for block in part.blocks]
    found = [(side, ns) for side, ns, _ in read_images(recording, r.SOURCES, signals.images)]
    expected = {side: index.time_ns.tolist() for side, index in signals.images.items()}
    assert sorted(found) == sorted((side, ns) for side, stamps in expected.items() for ns in stamps)


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
    times = [item.log_ns for item in ITEMS if item.topic == "/left/image_raw"]
    at_ns = np.array([times[0] - 1, times[1], times[2], times[4], times[5]])
    with open_recording([file]) as recording:
        assert logged(recording, Extent(at_ns=at_ns)) == [times[1], times[2], times[4], times[5]]
        assert recording.share(["/left/image_raw"], Extent(at_ns=at_ns)) == pytest.approx(4 / 6)
        assert recording.damage == ()
        assert logged(recording, Extent()) == times
