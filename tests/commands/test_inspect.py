"""`mobilecal inspect`: what a recording holds, at a glance."""

import json
import re
from dataclasses import replace

import cv2
import numpy as np
import pytest

from mobilecal_cli.calibrate import inspect
from mobilecal_cli.report.inspection import inspection_text
from mobilecal_cli.simulate.robot import ROBOTS, urdf_text
from tests.command import run, succeeded
from tests.commands.edited import edited
from tests.golden import assert_golden
from tests.readers import recordings as r


@pytest.mark.parametrize("name", ["paper_robot.mcap", "paper_robot.bag", "paper_robot_rosbag2"])
def test_sample_log(sample_logs, name):
    found = inspect.inspect([sample_logs / name])
    topics = {topic.name: topic for topic in found.topics}
    joints = topics["/joint_states"]
    assert (joints.messages, joints.steps_back) == (2142, 0)
    assert joints.rate_hz == pytest.approx(50, abs=0.01)
    assert joints.longest_gap_s == pytest.approx(0.02, abs=1e-6)
    assert topics["/robot_description"].rate_hz is None
    assert found.motion is not None
    assert found.motion.rests == 12
    assert found.motion.driven_m == pytest.approx(4.72, rel=0.01)  # as a calibration reports; it was 4.1
    assert found.motion.share_read == 1
    assert (found.board.pictures, found.board.seen, found.board.size) == (12, 12, (9, 6))
    assert (found.missing, found.weak, found.notes) == ((), (), ())
    assert found.rig.setting_sources["head chain base_link to head_link"] == "URDF on /robot_description"


def test_command_for_people_and_for_programs(sample_logs, tmp_path):
    log = sample_logs / "tick_robot.mcap"
    text = run("inspect", log, cwd=tmp_path)
    assert text.code == 3, text.err
    assert text.out.endswith("This recording cannot be calibrated as it is (exit code 3).\n")
    assert_golden(text.out, "inspect")
    config = sample_logs / "tick_robot.rig.yaml"
    made = succeeded("inspect", log, "--config", config, "--json", cwd=tmp_path)
    data = json.loads(made.out)
    assert data["missing"] == []
    assert data["exit_code"] == 0
    square_m = data["board"].pop("square_m")
    assert square_m == pytest.approx(0.07, rel=0.002)
    assert data["board"] == {"pictures": 12, "seen": 12, "columns": 9, "rows": 6, "square_stated_m": None}
    assert data["head"]["tilt"] == "tilt_joint"
    assert data["motion"]["share_read"] == 1
    assert list(tmp_path.iterdir()) == []


def test_everything_that_is_missing_is_named_at_once(tmp_path):
    items = [
        r.Item("/joint_states", r.START_NS, r.joint_state(["head_tilt"], [0.1])),
        r.Item("/left/image_raw", r.START_NS, r.image(r.picture(0), "mono8")),
    ]
    found = inspect.inspect([r.write_mcap(tmp_path / "log.mcap", items)])
    said = [lack.what for lack in found.missing]
    assert [text.split(":")[0] for text in said[:2]] == [
        "no camera info for the camera images on /left/image_raw",
        "no joint is named as a left or right wheel",
    ]
    assert any("the head chain is unknown" in text for text in said)
    assert all(lack.cure for lack in found.missing)


def test_a_camera_without_camera_info_is_the_only_thing_that_is_missing(tmp_path):
    """Which link carries it follows from its frame: that is no error of its own."""

    def described(store):
        return store.types["std_msgs/msg/String"](urdf_text(ROBOTS["rgbd"]))

    items = [
        r.Item("/robot_description", r.START_NS, described),
        r.Item(
            "/joint_states",
            r.START_NS,
            r.joint_state(["wheel_left_joint", "wheel_right_joint"], [0.1, 0.2]),
        ),
        r.Item("/camera/image_raw", r.START_NS, r.image(r.picture(0), "mono8")),
    ]
    found = inspect.inspect([r.write_mcap(tmp_path / "log.mcap", items)])
    (lack,) = [lack for lack in found.missing if "checkerboard" not in lack.what]
    assert lack.what.startswith("no camera info for the camera images on /camera/image_raw")
    assert "record its camera_info" in lack.cure


def test_a_long_recording_is_read_in_part(sample_logs, monkeypatch, few):
    monkeypatch.setattr("mobilecal_cli.calibrate.inspect.MOTION_BYTES", 2**20)
    found = inspect.inspect([sample_logs / "paper_robot.mcap"])
    assert 0 < found.motion.share_read < 1
    assert found.motion.rests is None
    assert "only a part of the recording was read" in " ".join(inspection_text(found).split())
    assert found.missing == ()


def test_too_few_rests_to_pass_are_told(sample_logs, tmp_path, few):
    whole = (sample_logs / "paper_robot.mcap").read_bytes()
    cut = tmp_path / "cut.mcap"
    cut.write_bytes(whole[: len(whole) * 6 // 10])
    found = inspect.inspect([cut])
    assert 0 < found.motion.rests < 8
    assert "possible stations; a calibration needs 4, and 8 to pass" in found.weak[0].what
    assert found.exit_code == 0


@pytest.mark.parametrize(
    ("name", "code"), [("head_fixed.mcap", 5), ("tick_robot.mcap", 3), ("nothing.mcap", 3), ("board.mcap", 4)]
)
def test_exit_code_of_calibrate(sample_logs, tmp_path, name, code, few):
    """`inspect` prints all it found, and ends as `calibrate` does."""
    log = sample_logs / name
    if name == "nothing.mcap":
        log = r.write_mcap(tmp_path / name, [])
    if name == "board.mcap":
        log = edited(sample_logs / "paper_robot.mcap", tmp_path / name, black_images)
    done = run("inspect", log, "--json", "--quiet", cwd=tmp_path)
    assert done.code == code, done.err
    data = json.loads(done.out)
    assert data["exit_code"] == code
    assert {lack["exit_code"] for lack in data["missing"]} == {code}
    assert name != "board.mcap" or "a board with markers, set board.kind" in data["missing"][0]["cure"]
    refused = run("calibrate", log, "--output", "out", "--quiet", cwd=tmp_path)
    assert (refused.code, refused.left) == (code, [])
    if name == "head_fixed.mcap":  # its URDF does not draw the camera
        said = (
            r"error: .*does not show the camera's height \(t_y\).*hint: .*tilt the head up.*--fix t_y=VALUE"
        )
        assert re.match(said, refused.err, re.DOTALL)


@pytest.mark.parametrize(
    ("percent", "code", "rests"), [(10, 4, 1), pytest.param(50, 0, 6, marks=pytest.mark.long)]
)
def test_a_truncated_database_is_judged_by_the_rest(sample_logs, tmp_path, percent, code, rests):
    """Its times were unknown, so nothing but the topics was checked, and it seemed good for a calibration."""
    (whole,) = (sample_logs / "paper_robot_rosbag2").glob("*.db3")
    log = tmp_path / "cut.db3"
    log.write_bytes(whole.read_bytes()[: whole.stat().st_size * percent // 100])
    found = inspect.inspect([log])
    assert (found.exit_code, found.motion.rests, found.motion.share_read) == (code, rests, 1.0)
    assert f"{rests} possible stations" in (*found.missing, *found.weak)[0].what
    assert found.board is not None
    assert found.covered is not None


def black_images(topic, message):
    """A recording of a dark room."""
    if topic.endswith("compressed"):
        black = cv2.imencode(".png", np.zeros((480, 640), np.uint8))[1].ravel()
        return replace(message, format="png", data=black)
    return message


def test_names_cannot_steer_the_terminal(sample_logs, few):
    found = inspect.inspect([sample_logs / "head_fixed.mcap"])
    evil = replace(found.topics[0], name="/evil\x1b[2J\u202e")
    text = inspection_text(replace(found, topics=(evil,), notes=("a note\r\x07 on it",)))
    assert "\x1b" not in text
    assert "\r" not in text
    assert "/evil\\x1b[2J\\u202e" in text
