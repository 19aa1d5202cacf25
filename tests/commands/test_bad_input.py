"""Every bad input on the real command: its exit code, its message, and nothing left behind."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests.command import run
from tests.commands.edited import edited

IMAGES = ("/stereo/left/image_raw/compressed", "/stereo/right/image_raw/compressed")


@pytest.fixture(scope="module")
def paper(sample_logs):
    return sample_logs / "paper_robot.mcap"


def refused(result, code, message, hint=""):
    assert result.code == code, result.err
    assert result.err.startswith("error: ")
    assert message in result.err
    assert "hint: " in result.err
    assert hint in result.err
    assert "Traceback" not in result.err
    assert result.left == []


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
def test_no_board_anywhere(paper, tmp_path, tmp_path_factory):
    grey = np.random.default_rng(0).integers(90, 110, (480, 640)).astype(np.uint8)
    jpeg = cv2.imencode(".jpg", grey)[1].reshape(-1)

    def blank(topic, message):
        return replace(message, data=jpeg) if topic in IMAGES else message

    log = edited(paper, tmp_path_factory.mktemp("logs") / "bad.mcap", blank)
    refused(run("calibrate", log, cwd=tmp_path), 4, "no checkerboard found", "set board.kind in")
    sized = run("calibrate", log, "--board", "9x6", cwd=tmp_path)
    frozen = "images do not change while the robot moves"
    refused(sized, 4, frozen, "Check the driver of the left and right camera")


@pytest.mark.long
def test_the_wrong_board_size(paper, tmp_path):
    other = run("calibrate", paper, "--board", "8x6", cwd=tmp_path)
    refused(other, 4, "but the images show 9 x 6", "--board 9x6")


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
