"""Recordings whose motion does not show everything, on the whole command."""

import pytest

from tests.command import run

HEIGHT = "the recording does not show the camera's height (t_y), and nominal.head_eye is not stated;"


@pytest.mark.parametrize(
    ("log", "method", "words"),
    [
        ("head_fixed.mcap", "paper", ("the head's tilt spans only", "tilt the head up and down")),
        ("straight.mcap", "paper", ("the base only drives straight", "turn the base")),
        # The log's URDF does not draw the camera.
        ("head_fixed.mcap", "ml", (HEIGHT, "tilt the head up and down", "--fix t_y=VALUE")),
    ],
)
def test_motion_that_does_not_show_everything(sample_logs, tmp_path, log, method, words):
    done = run("calibrate", sample_logs / log, "--method", method, cwd=tmp_path)
    assert (done.code, done.left) == (5, [])
    assert done.err.startswith("error: ")
    assert "hint: " in done.err
    assert [word for word in words if word not in done.err] == []
