"""Several recordings of one robot: camera infos that differ, and errors in one of them."""

from dataclasses import replace
from types import SimpleNamespace

import cv2
import numpy as np
import pytest

from mobilecal_cli.calibrate.extract import _other_cameras, extract
from mobilecal_cli.errors import ObservationError, RecordingError
from mobilecal_cli.model import CAMERA_INFO_CHANGES
from mobilecal_cli.rig.config import load_rig
from mobilecal_cli.simulate.robot import ROBOTS
from tests.commands.edited import edited
from tests.pairs import with_pair

CAMERAS = ROBOTS["paper"]().rig_cameras


def seen(name, cameras):
    return SimpleNamespace(name=name, rig=SimpleNamespace(cameras=cameras))


def changed(**fields):
    return with_pair(CAMERAS, right=replace(CAMERAS.each[1], **fields))


@pytest.mark.parametrize(
    "other",
    [
        changed(K=CAMERAS.each[1].K * np.array([[1.001], [1.001], [1]])),
        changed(D=CAMERAS.each[1].D + 0.01),
        changed(D=np.zeros(8), distortion="rational_polynomial"),
        with_pair(CAMERAS, T_c_r=CAMERAS.T_c_each[1] + 1e-4),
    ],
)
def test_other_cameras_are_told(other):
    (note,) = _other_cameras(seen("a.mcap", CAMERAS), seen("b.mcap", other))
    assert note.startswith(f"b.mcap: {CAMERA_INFO_CHANGES} from that of a.mcap")


def test_rounding_is_not_told():
    other = changed(K=CAMERAS.each[1].K * (1 + 1e-9), D=CAMERAS.each[1].D + 1e-9)
    assert _other_cameras(seen("a.mcap", CAMERAS), seen("b.mcap", other)) == ()


def test_the_recording_with_the_error_is_named(sample_logs):
    logs = [sample_logs / "tick_robot.mcap", sample_logs / "imperfect_robot.mcap"]
    said = r"imperfect_robot\.mcap: wheels\.left: the topic /wheel_ticks/left contains no messages"
    with pytest.raises(RecordingError, match=said):
        extract(logs, load_rig(sample_logs / "tick_robot.rig.yaml", {}))


def test_a_note_on_one_of_several_recordings_names_it(sample_logs, tmp_path):
    """The head stands still in one, published once, and moves in the other."""
    sent = []

    def once(topic, message):
        if topic != "/joint_states":
            return message
        sent.append(topic)
        kept = [i for i, name in enumerate(message.name) if len(sent) == 1 or "wheel" in name]
        return replace(
            message, name=[message.name[i] for i in kept], position=message.position[np.array(kept)]
        )

    log = edited(sample_logs / "head_fixed.mcap", tmp_path / "still.mcap", once)
    extraction, _ = extract([sample_logs / "paper_robot.mcap", log], load_rig(None))
    said = "joint head_tilt_joint on /joint_states: one reading only; the joint counts as standing still"
    assert f"{log}: {said}" in extraction.notes
    assert not any("nothing of this recording" in note for note in extraction.notes)


def test_a_recording_of_which_nothing_is_used_is_named(sample_logs, tmp_path):
    """The first one alone decides, and would say nothing of the second."""

    _, wall = cv2.imencode(".jpg", np.full((480, 640), 90, dtype=np.uint8))

    def covered(topic, message):
        return replace(message, data=wall.ravel()) if "image" in topic else message

    log = edited(sample_logs / "head_fixed.mcap", tmp_path / "covered.mcap", covered)
    extraction, _ = extract([sample_logs / "paper_robot.mcap", log], load_rig(None))
    assert {o.log for o in extraction.observations} == {0}
    assert [note for note in extraction.notes if note.startswith(f"{log}: nothing of this recording is used")]


def test_damage_is_noted(sample_logs, tmp_path):
    whole = (sample_logs / "paper_robot.mcap").read_bytes()
    (tmp_path / "cut.mcap").write_bytes(whole[: len(whole) * 85 // 100])
    extraction, _ = extract([tmp_path / "cut.mcap"], load_rig(None))
    assert any("the file ends inside a chunk" in note for note in extraction.notes)


@pytest.mark.long
def test_another_board_than_the_stated_one_is_named(sample_logs):
    stated = load_rig(None, {"board.columns": 8, "board.rows": 6})
    with pytest.raises(ObservationError, match="8 x 6 inner corners, but the images show 9 x 6") as caught:
        extract([sample_logs / "straight.mcap"], stated)
    assert "--board 9x6" in caught.value.hint
