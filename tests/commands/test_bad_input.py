"""Every bad input on the real command: its exit code, its message, and nothing left behind."""

import pytest

from tests.command import run


def refused(result, code, message, hint=""):
    assert result.code == code, result.err
    assert result.err.startswith("error: ")
    assert message in result.err
    assert "hint: " in result.err
    assert hint in result.err
    assert "Traceback" not in result.err
    assert result.left == []


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
