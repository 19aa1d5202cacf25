"""`mobilecal init`: the draft of a rig.yaml, and what is listed on the terminal."""

import itertools
from dataclasses import replace

import cv2
import numpy as np
import pytest

from mobilecal_cli.calibrate import inspect
from mobilecal_cli.commands.init import draft
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.simulate.robot import ROBOTS, urdf_text
from tests.command import run
from tests.commands.edited import edited
from tests.golden import assert_golden


def keys(draft):
    return {one.key: one.value for one in draft.filled}


def test_what_is_left_is_listed_and_then_checked(sample_logs, tmp_path):
    """The tick robot: everything but the resolution of its encoders is known."""
    log = sample_logs / "tick_robot.mcap"
    done = run("init", log, cwd=tmp_path)
    assert (done.code, done.left) == (0, ["rig.yaml"])
    assert "wheels.left   " in done.out
    assert "topic: /wheel_ticks/left, field: data, bits: 16, sign: 1" in done.out
    needed = done.out.split("TODO: needed for a calibration\n")[1].split("\n\n")[0]
    assert needed.startswith("  wheels.left.ticks_per_revolution, wheels.right.ticks_per_revolution: ")
    optional = done.out.split("TODO: optional\n")[1].split("\n\n")[0]
    assert "Suggestion: 70 mm (70.0" in " ".join(optional.split())
    assert done.out.endswith(f"Written: rig.yaml\nNext: mobilecal check rig.yaml {log}\n")
    assert run("init", log, cwd=tmp_path).code == 7
    checked = run("check", "rig.yaml", log, cwd=tmp_path)
    assert checked.code == 2
    assert "not filled in yet: wheels.left.ticks_per_revolution" in " ".join(checked.out.split())
    rig = tmp_path / "rig.yaml"
    rig.write_text(rig.read_text(encoding="utf-8").replace("revolution: TODO", "revolution: 4096"))
    assert run("check", "rig.yaml", log, "--quiet", cwd=tmp_path).code == 0


def test_standard_output_holds_the_file_alone(sample_logs, tmp_path):
    done = run("init", sample_logs / "straight.mcap", "--output", "-", cwd=tmp_path)
    assert (done.code, done.left) == (0, [])
    assert done.out.startswith("# rig.yaml for mobilecal")
    assert done.err.startswith("Filled in\n")
    assert_golden(done.err, "init")


def test_recordings_of_two_robots_are_refused(sample_logs, few):
    """The draft was that of a robot with the topics of both."""
    logs = [sample_logs / "paper_robot.mcap", sample_logs / "tick_robot.mcap"]
    with pytest.raises(ConfigError, match=r"tick_robot\.mcap need different configurations: wheels\.left is"):
        draft(logs)
    one = [sample_logs / "paper_robot.mcap", sample_logs / "straight.mcap"]
    assert (draft(one).notes, draft(one).text.splitlines()[1:]) == ((), draft(one[:1]).text.splitlines()[1:])


def test_a_board_that_the_image_cuts_off_is_no_other_board(sample_logs, tmp_path):
    left = itertools.count()

    def cut_off(topic, message):
        """The first half of the left images, moved by 220 pixels: most show a board of 7 x 6 or less."""
        if topic != "/stereo/left/image_raw/compressed" or next(left) >= 12:
            return message
        image = cv2.imdecode(np.asarray(message.data), cv2.IMREAD_GRAYSCALE)
        image = np.pad(image, ((0, 0), (0, 220)), mode="edge")[:, 220:]
        return replace(message, data=cv2.imencode(".jpg", image)[1].reshape(-1))

    made = draft([edited(sample_logs / "paper_robot.mcap", tmp_path / "log.mcap", cut_off)])
    assert (keys(made)["board.columns"], keys(made)["board.rows"]) == ("9", "6")


def test_a_urdf_file_is_written_relative_to_the_rig(sample_logs, tmp_path, few):
    def without_urdf(topic, message):
        return None if topic == "/robot_description" else message

    log = edited(sample_logs / "head_fixed.mcap", tmp_path / "log.mcap", without_urdf)
    assert {one.key for one in draft([log]).todo if one.needed} == {"head"}
    urdf, rig = tmp_path / "robot.urdf", tmp_path / "rigs" / "rig.yaml"
    urdf.write_text(urdf_text(ROBOTS["paper"]), encoding="utf-8")
    rig.parent.mkdir()
    made = draft([log], urdf, rig.parent)
    rig.write_text(made.text, encoding="utf-8")
    assert keys(made)["head.urdf"] == "../robot.urdf"
    assert not any(one.needed for one in made.todo)
    found = inspect.check(rig, [log])
    assert found.survey.head.origin == "head.urdf of the configuration"
    assert {lack.about for lack in found.missing} == {"motion"}  # the head never moves


def test_a_dark_room_has_no_board(sample_logs, tmp_path, few):
    from tests.commands.test_inspect import black_images

    log = edited(sample_logs / "head_fixed.mcap", tmp_path / "log.mcap", black_images)
    made = draft([log])
    assert [one.key for one in made.todo if one.needed] == ["board"]
    assert not any(one.key.startswith("board") for one in made.filled)
