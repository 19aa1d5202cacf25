"""Segments, processes and threads: the same corners in the same order for any number of processes."""

import sys
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from mobilecal_cli.calibrate import detect as detecting
from mobilecal_cli.calibrate import workers as processes
from mobilecal_cli.calibrate.extract import describe, extract
from mobilecal_cli.calibrate.inspect import inspect
from mobilecal_cli.errors import RecordingError
from mobilecal_cli.export.extraction import THUMBNAILS
from mobilecal_cli.model.observations import WheelTrack
from mobilecal_cli.model.rig import Board
from mobilecal_cli.model.signals import PictureIndex, Shot, Station, Track
from mobilecal_cli.readers import open_recording
from mobilecal_cli.rig.config import UNCONFIGURED, load_rig
from mobilecal_cli.rig.resolve import complete_rig
from mobilecal_cli.simulate.record import simulate
from mobilecal_cli.simulate.scenario import Scenario
from mobilecal_cli.stations import Plan
from tests.commands.edited import edited
from tests.pairs import with_pair
from tests.vision.scenes import pose, render, stereo_rig

EXTRACTING = sys.modules["mobilecal_cli.calibrate.extract"]  # the package's `extract` is the function in it


def station(index: int, pairs: int) -> Station:
    times = [1000 * index + i for i in range(pairs)]
    return Station(index, True, tuple(Shot((t, t)) for t in times), times[0], np.zeros(2), np.zeros(2))


def plan(stations: list[Station]) -> Plan:
    """A plan with these stations, in images that nobody reads."""
    times = np.array([pair.times_ns[0] for station in stations for pair in station.shots])
    index, track = PictureIndex(times, times, times), Track(np.arange(2), np.zeros(2))
    return Plan(tuple(stations), WheelTrack(track, track), (), {"left": index, "right": index}, ())


def test_segments_hold_all_stations_in_order():
    stations = [station(i, 1 + 90 * (i % 3)) for i in range(20)]
    segments = detecting.segments_of(plan(stations), True)
    assert [s.index for segment in segments for s in segment.stations] == list(range(20))
    pairs = [sum(len(s.shots) for s in segment.stations) for segment in segments]
    assert max(pairs) <= detecting.SEGMENT_SHOTS
    assert all(segment.shown == set(range(20)) for segment in segments)
    many = detecting.segments_of(plan([station(i, 1) for i in range(1000)]), True)
    assert len(many[0].shown) <= detecting.SNAPSHOTS
    segments = detecting.segments_of(plan([station(0, 1), station(1, 600), station(2, 1)]), True)
    assert [len(segment.stations) for segment in segments] == [1, 1, 1]


def test_depth_images_are_no_images_of_a_camera(tmp_path, few):
    """The hint was to record raw images, which these are; `check` ended with another code than `calibrate`."""
    simulate(Scenario(stations=4, pictures="mono8", pictures_per_rest=1), tmp_path / "log.mcap")
    depth = edited(
        tmp_path / "log.mcap",
        tmp_path / "depth.mcap",
        lambda topic, message: replace(message, encoding="32FC1") if "image" in topic else message,
    )
    with pytest.raises(
        RecordingError, match="unknown image encoding '32FC1': a depth or disparity"
    ) as caught:
        extract([depth], UNCONFIGURED)
    assert caught.value.hint == "set cameras in rig.yaml to the topics of the gray or color images"
    (of_cameras,) = (each for each in inspect([depth]).findings if each.about == "cameras")
    assert (of_cameras.exit_code, of_cameras.cure) == (caught.value.exit_code, caught.value.hint)


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("logs") / "moving.mcap"
    simulate(Scenario(motion="moving", stations=1, pictures="jpeg", seed=5), path)
    return path


def everything(log: Path, jobs: int):
    settings = {"stations": "all", "board.columns": 9, "board.rows": 6}
    return extract([log], load_rig(None, settings), jobs=jobs)


def same(a, b) -> bool:
    return len(a.observations) == len(b.observations) and all(
        np.array_equal(x.views[0].pixels, y.views[0].pixels)
        and np.array_equal(x.T_c_k, y.T_c_k)
        and np.array_equal(x.views[1].relative_cov, y.views[1].relative_cov)
        for x, y in zip(a.observations, b.observations, strict=True)
    )


@pytest.fixture(scope="module")
def alone(log):
    """What one process sees in a log that is split into several segments."""
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(detecting, "SEGMENT_SHOTS", 12)
        return everything(log, 1)


@pytest.fixture
def segmented(monkeypatch) -> None:
    """A short log is split into several segments."""
    monkeypatch.setattr(detecting, "SEGMENT_SHOTS", 12)


def test_processes_see_what_one_sees(log, alone, segmented):
    alone, shown = alone
    assert len(alone.observations) > 15
    assert not any(o.at_rest for o in alone.observations)
    assert alone.counts["pictures"] == 2 * alone.counts["stations"]
    together, shown_together = everything(log, 2)
    assert same(alone, together)
    pictures = [[(s.station, s.jpegs, s.thumbnail) for s in each] for each in (shown, shown_together)]
    assert pictures[0] == pictures[1]
    assert sum(bool(s.jpegs) for s in shown) > 10
    assert 15 < sum(bool(s.thumbnail) for s in shown) <= THUMBNAILS


def test_where_processes_cannot_be_started_this_one_looks_and_keeps_its_threads(
    log, alone, segmented, monkeypatch
):
    def refused(*_args, **_kwargs):
        raise OSError("no processes here")

    monkeypatch.setattr(processes, "ProcessPoolExecutor", refused)
    before = cv2.getNumThreads()
    cv2.setNumThreads(3)
    try:
        assert same(alone[0], everything(log, 2)[0])
        assert cv2.getNumThreads() == 3
    finally:
        cv2.setNumThreads(before)


def test_an_error_in_a_process_keeps_its_words(log, segmented, monkeypatch):
    resolve = EXTRACTING.complete_rig

    def other_size(*args):
        rig = resolve(*args)
        left = replace(rig.cameras.each[0], width=641)
        return replace(rig, cameras=with_pair(rig.cameras, left=left))

    monkeypatch.setattr(EXTRACTING, "complete_rig", other_size)
    with pytest.raises(RecordingError, match="the left images are 640 x 480") as raised:
        everything(log, 2)
    assert raised.value.hint


def test_another_board_at_the_first_stations_is_not_the_board(sample_logs, tmp_path):
    """Seen at the first three of twelve stops, it would win a vote of the first images."""
    other = Board(7, 5)
    image = render(
        stereo_rig().each[0], pose(0.0, 0.0, 1.1, (0.2, 0.0, 0.0), other, 0.04), other, 0.04, blur_px=0.7
    )
    left = dict.fromkeys(("left", "right"), 6)

    def edit(topic, message):
        side = next((side for side in left if topic == f"/stereo/{side}/image_raw/compressed"), None)
        if side is None or not left[side]:
            return message
        left[side] -= 1  # each image is new
        return replace(message, data=cv2.imencode(".png", cv2.subtract(image, float(left[side])))[1].ravel())

    log = edited(sample_logs / "paper_robot.mcap", tmp_path / "log.mcap", edit)
    with open_recording([log]) as recording:
        rig = complete_rig(describe(recording, UNCONFIGURED))
        plans, *_ = detecting.plan_recording(recording, rig)
        assert detecting.board_size(recording, rig, plans) == (9, 6)


@pytest.mark.parametrize(("scale", "said"), [(2, "images 2 times as large"), (0.5, "at the recorded size")])
def test_images_of_another_resolution_than_camera_info(scale, said):
    cameras = stereo_rig()
    camera = cameras.each[0]
    picture = np.zeros((round(camera.height / scale), round(camera.width / scale)), np.uint8)
    with pytest.raises(RecordingError, match="pixels, but their camera_info states") as refused:
        detecting.check_picture(picture, cameras.names[0], cameras)
    assert said in refused.value.hint
