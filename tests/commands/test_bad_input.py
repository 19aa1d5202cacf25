"""Every bad input on the real command: its exit code, its message, and nothing left behind."""

import math
from dataclasses import replace

import numpy as np
import pytest

from tests.command import run, succeeded
from tests.commands.edited import edited

IMAGES = ("/stereo/left/image_raw/compressed", "/stereo/right/image_raw/compressed")


@pytest.fixture(scope="module")
def paper(sample_logs):
    return sample_logs / "paper_robot.mcap"


@pytest.fixture
def make(paper, tmp_path_factory):
    """A copy of the paper's log with an edit, outside the directory in which the command runs."""

    def _make(edit):
        return edited(paper, tmp_path_factory.mktemp("logs") / "bad.mcap", edit)

    return _make


def refused(result, code, message, hint=""):
    assert result.code == code, result.err
    assert result.err.startswith("error: ")
    assert message in result.err
    assert "hint: " in result.err
    assert hint in result.err
    assert "Traceback" not in result.err
    assert result.left == []


def at(message, seconds):
    """The message with its header stamp moved."""
    stamp = message.header.stamp
    total = stamp.sec * 10**9 + stamp.nanosec + round(seconds * 1e9)
    moved = replace(stamp, sec=total // 10**9, nanosec=total % 10**9)
    return replace(message, header=replace(message.header, stamp=moved))


@pytest.mark.long
def test_a_log_cut_off_near_its_end_is_used_and_told(paper, tmp_path, tmp_path_factory):
    cut = tmp_path_factory.mktemp("logs") / "cut.mcap"
    data = paper.read_bytes()
    cut.write_bytes(data[: int(0.85 * len(data))])
    result = run("calibrate", cut, "--output", "out", cwd=tmp_path)
    assert result.code in (0, 6), result.err
    assert "out/params.yaml" in result.left
    assert "messages" in (tmp_path / "out/report.json").read_text()
    report = (tmp_path / "out/report.html").read_text()
    assert "ends" in report or "cut" in report


def test_a_log_cut_off_early_is_too_little(paper, tmp_path, tmp_path_factory):
    cut = tmp_path_factory.mktemp("logs") / "cut.mcap"
    data = paper.read_bytes()
    cut.write_bytes(data[: int(0.15 * len(data))])
    result = run("calibrate", cut, cwd=tmp_path)
    assert result.code in (3, 4, 5)
    assert result.err.startswith("error: ")
    assert result.left == []


@pytest.mark.long
def test_no_board_anywhere(make, tmp_path):
    import cv2

    grey = np.random.default_rng(0).integers(90, 110, (480, 640)).astype(np.uint8)
    jpeg = cv2.imencode(".jpg", grey)[1].reshape(-1)
    log = make(lambda topic, m: replace(m, data=jpeg) if topic in IMAGES else m)
    refused(run("calibrate", log, cwd=tmp_path), 4, "no checkerboard found", "set board.kind in")
    sized = run("calibrate", log, "--board", "9x6", cwd=tmp_path)
    refused(
        sized,
        4,
        "images do not change while the robot moves",
        "Check the driver of the left and right camera",
    )


@pytest.mark.long
def test_the_wrong_board_size(paper, tmp_path):
    other = run("calibrate", paper, "--board", "8x6", cwd=tmp_path)
    refused(other, 4, "but the images show 9 x 6", "--board 9x6")


def on(topics, change):
    """An edit of the messages of some topics, found by the end of their names."""
    return lambda topic, message: change(message) if topic.endswith(topics) else message


def without(joint):
    """An edit of the joint states: one joint was not recorded."""

    def change(message):
        keep = [i for i, name in enumerate(message.name) if name != joint]
        return replace(message, name=[message.name[i] for i in keep], position=message.position[keep])

    return on("/joint_states", change)


def scaled(joint, factor):
    """An edit of the joint states: the readings of one joint are multiplied."""

    def change(message):
        factors = [factor if name == joint else 1.0 for name in message.name]
        return replace(message, position=message.position * factors)

    return on("/joint_states", change)


def swapped(message):
    other = {"wheel_left_joint": "wheel_right_joint", "wheel_right_joint": "wheel_left_joint"}
    return replace(message, name=[other.get(name, name) for name in message.name])


EDITS = {
    "left and right never together": (on(IMAGES[1], lambda m: at(m, 100)), 3, "no stereo pairs", ""),
    "joints at another time": (
        on("/joint_states", lambda m: at(m, -1000)), 3, "stereo pairs has readings", "clock",
    ),
    "a wheel was not recorded": (without("wheel_left_joint"), 3, "wheels.left", "head_pan_joint"),
    "nothing but NaN in a joint": (scaled("head_pan_joint", math.nan), 3, "head_pan_joint", ""),
    "swapped wheels": (
        on("/joint_states", swapped), 5, "the left and right wheels are swapped", "exchange",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", EDITS)
def test_what_the_recording_lacks_is_named(make, tmp_path, name):
    edit, code, message, hint = EDITS[name]
    refused(run("calibrate", make(edit), cwd=tmp_path), code, message, hint)


@pytest.mark.long
def test_a_few_nan_are_left_out_and_told(make, tmp_path):
    count = iter(range(10**9))

    def spoil(topic, message):
        if topic != "/joint_states" or next(count) % 50:
            return message
        return replace(message, position=np.full_like(message.position, math.nan))

    succeeded("calibrate", make(spoil), "--output", "out", cwd=tmp_path)
    assert "NaN or infinite" in (tmp_path / "out/report.json").read_text()


@pytest.mark.parametrize(
    ("log", "words", "cure"),
    [
        ("head_fixed.mcap", "the head's tilt spans only", "tilt the head up and down"),
        ("straight.mcap", "the base only drives straight", "turn the base"),
    ],
)
def test_motion_that_does_not_show_everything_to_the_papers_method(sample_logs, tmp_path, log, words, cure):
    refused(run("calibrate", sample_logs / log, "--method", "paper", cwd=tmp_path), 5, words, cure)


def test_a_hidden_number_without_a_nominal_value(sample_logs, tmp_path):
    """The camera's height cannot be seen, and the log's URDF does not draw the camera."""
    result = run("calibrate", sample_logs / "head_fixed.mcap", cwd=tmp_path)
    words = "the recording does not show the camera's height (t_y), and nominal.head_eye is not stated;"
    refused(result, 5, words, "tilt the head up and down")
    assert "--fix t_y=VALUE" in result.err


@pytest.mark.long
def test_a_wheel_that_counts_backwards(make, tmp_path):
    log = make(scaled("wheel_left_joint", -1.0))
    words = "the left wheel's encoder has the wrong sign"
    refused(run("calibrate", log, cwd=tmp_path), 5, words, "wheels.left.sign")
    succeeded("calibrate", log, "--set", "wheels.left.sign=-1", "--output", "out", cwd=tmp_path)


def test_bad_flags(paper, tmp_path):
    refused(run("calibrate", paper, "--board", "nine", cwd=tmp_path), 2, "--board nine")
    half = run("calibrate", paper, "--set", "board.columns=9", cwd=tmp_path)
    refused(half, 2, "give both columns and rows")
    assert run("calibrate", cwd=tmp_path).code == 2
    assert run("calibrate", paper, "--method", "magic", cwd=tmp_path).code == 2
