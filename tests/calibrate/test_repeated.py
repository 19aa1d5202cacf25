"""The same measurements twice are found by content; other recordings of the same robot are not mistaken for it."""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest

from mobilecal_cli.calibrate.extract import extract, refuse_equal_files, refuse_equal_recordings
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.model.observations import Extraction, LogSource, WheelTrack
from mobilecal_cli.model.signals import Track
from mobilecal_cli.rig.config import load_rig
from mobilecal_cli.simulate.robot import PAPER_ROBOT
from mobilecal_cli.simulate.route import plan_route
from tests.commands.edited import edited
from tests.extractions import Noise, extraction_of, joined

ROBOT = PAPER_ROBOT


def recorded(route_seed=0, noise_seed=0, noise=Noise(0.2, 0.003, np.radians(1.2), np.radians(0.05))):  # noqa: B008
    return extraction_of(ROBOT, plan_route(ROBOT, seed=route_seed), noise, noise_seed)


def cut(track: Track, first: int | None = None, last: int | None = None) -> Track:
    return Track(track.time_ns[first:last], track.value[first:last] - track.value[first or 0])


def cut_wheels(extraction: Extraction, first: int | None = None, last: int | None = None) -> Extraction:
    (track,) = extraction.wheels
    wheels = WheelTrack(*(cut(w, first, last) for w in (track.right, track.left)))
    return replace(extraction, wheels=(wheels,))


def refused(extraction: Extraction) -> str:
    with pytest.raises(ConfigError) as caught:
        refuse_equal_recordings(extraction, ["a.mcap", "b.bag"])
    return caught.value.message


def test_equal_readings():
    one = recorded()
    assert refused(joined(one, one)).endswith("wheel and joint readings")
    # Parts of the recording, whose wheels count from their own start; the second pair overlaps by a third.
    third = len(one.wheels[0].time_ns) // 3
    for a, b in ((one, cut_wheels(one, 400)), (cut_wheels(one, None, 2 * third), cut_wheels(one, third))):
        said = "a.mcap and b.bag are the same recording: they contain the same wheel and joint readings"
        assert refused(joined(a, b)) == said


def test_simulations_that_begin_with_the_same_image_are_not_the_same(sample_logs):
    """Two of the samples were "the same recording"."""
    extraction, _ = extract([sample_logs / "paper_robot.mcap", sample_logs / "straight.mcap"], SETTINGS)
    assert extraction.legs == 11 + 9


def test_equal_images_and_files():
    one = recorded()
    late = Track(one.wheels[0].right.time_ns + 1000, one.wheels[0].right.value)
    other = replace(one, wheels=(WheelTrack(late, late),))
    assert refused(joined(one, other)).endswith("images")
    refuse_equal_files([LogSource("a", "1"), LogSource("b", "2")])
    with pytest.raises(ConfigError, match=r"^a and c have the same content$"):
        refuse_equal_files([LogSource("a", "1"), LogSource("b", "2"), LogSource("c", "1")])


@pytest.mark.parametrize(
    ("seeds", "noise"),
    [((1, 0), {}), ((0, 1), {}), ((1, 0), {"noise": None})],
    ids=["another drive", "other noise", "another drive without noise"],
)
def test_other_recordings_at_the_same_times(seeds, noise):
    """Simulated recordings all begin at the same time."""
    one, other = recorded(**noise), recorded(*seeds, **noise)
    refuse_equal_recordings(joined(one, other), ["a.mcap", "b.mcap"])


def repeated(after):
    """An edit that lets each camera repeat the image before, where `after(side, number)`."""
    last, count = {}, Counter()

    def edit(topic, message):
        side = next((side for side in ("left", "right") if topic.startswith(f"/stereo/{side}/image")), "")
        if side:
            count[side] += 1
            if after(side, count[side]):
                message.data = last[side]
            last[side] = message.data
        return message

    return edit


SETTINGS = load_rig(None, {"board.columns": 9, "board.rows": 6})


def test_an_image_that_is_sent_twice_counts_once(sample_logs, tmp_path):
    """The sample has two stereo pairs a stop."""
    log = edited(sample_logs / "paper_robot.mcap", tmp_path / "log.mcap", repeated(lambda _, n: n % 2 == 0))
    found, _ = extract([log], SETTINGS)
    assert len(found.observations) == 12
    assert {view.pictures for o in found.observations for view in o.views} == {1}
    assert found.counts["pictures"] == 24
    assert found.notes == tuple(
        f"/stereo/{side}/image_raw/compressed: 12 of 24 images are identical to the image before them; each picture "
        "is used once, and only until the robot moves"
        for side in ("left", "right")
    )


def test_a_camera_that_freezes(sample_logs, tmp_path):
    freeze = repeated(lambda side, number: side == "right" and number > 14)
    found, _ = extract([edited(sample_logs / "paper_robot.mcap", tmp_path / "log.mcap", freeze)], SETTINGS)
    assert [o.station for o in found.observations] == list(range(7))
    assert {r.reason for r in found.rejections} == {"images do not change while the robot moves"}
    unused = "10 stereo pairs between 26 and 42 s after the first image are not used: the right images stay"
    assert any(unused in note for note in found.notes)


def test_a_later_recording_without_a_urdf_has_that_of_the_first(sample_logs, tmp_path):
    """It was refused: the head chain is unknown."""
    log = edited(
        sample_logs / "head_fixed.mcap",
        tmp_path / "log.mcap",
        lambda topic, message: None if topic == "/robot_description" else message,
    )
    extraction, _ = extract([sample_logs / "straight.mcap", log], load_rig(None))
    assert {o.log for o in extraction.observations} == {0, 1}
    assert any("contains no URDF; that of an earlier one is used" in note for note in extraction.notes)
