"""`mobilecal check`: a configuration against a recording, one line for each criterion."""

from __future__ import annotations

import json
from dataclasses import replace

import pytest

from mobilecal_cli.pipeline import inspecting
from mobilecal_cli.report.checklist import checklist, checklist_text
from tests.cli.edited import edited
from tests.command import run
from tests.golden import assert_golden

EVERY = ("rig.yaml", "cameras", "camera infos", "wheels", "head chain", "joints", "time", "motion", "board")


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    path = tmp_path_factory.mktemp("rig") / "rig.yaml"
    path.write_text("schema_version: 1\n", encoding="utf-8")
    return path


def states(found):
    return {line.about: line.state for line in checklist(found)}


def test_a_rig_that_fits(sample_logs, tmp_path):
    rig, log = sample_logs / "tick_robot.rig.yaml", sample_logs / "tick_robot.mcap"
    done = run("check", rig, log, cwd=tmp_path)
    assert done.code == 0, done.err
    assert done.out.endswith("No problems.\n")
    assert_golden(done.out, "check")
    assert (
        "ok       wheels        left data on /wheel_ticks/left, right data on /wheel_ticks/right" in done.out
    )
    assert "70.00 mm measured with the stereo pair, not stated" in done.out
    assert "24 of 24 left images" in done.out
    assert done.left == []
    made = run("check", rig, log, "--json", "--quiet", cwd=tmp_path)
    data = json.loads(made.out)
    assert data["exit_code"] == made.code == 0
    assert {line["state"] for line in data["lines"]} == {"ok"}
    assert [line["about"] for line in data["lines"]] == [*EVERY, "square size"]


WRONG = {
    "cameras": ({"cameras.left.image": "/joint_states"}, 3, "/joint_states contains no images"),
    "camera infos": ({"cameras.left.info": "/joint_states"}, 3, "contains no camera info"),
    "wheels": ({"wheels.left.joint": "nope"}, 3, "no joint 'nope'"),
    "head chain": ({"head.head_frame": "nope"}, 2, "no link 'nope'"),
    "joints": ({"joints.topic": "/nope"}, 3, "/nope contains no joint states"),
    "priors": ({"priors": {"neck": 1}}, 2, "no such constant"),
    "gates": ({"gates": {"neck": 1}}, 2, "unknown figure"),
    "motion": (
        {"wheels.left": {"topic": "/joint_states", "field": "nope"}},
        3,
        "no field nope ('nope' is missing)",
    ),
    "board": ({"board": {"columns": 8, "rows": 6}}, 4, "8 x 6 inner corners, but the images show 9 x 6"),
    "square size": ({"board.square_m": 0.1}, 4, "squares measure 80.0 mm, 100.0 mm are stated"),
}


@pytest.mark.parametrize("about", WRONG)
def test_each_problem_has_its_line_and_exit_code(sample_logs, rig, about, monkeypatch):
    monkeypatch.setattr("mobilecal_cli.pipeline.sampling.PICTURE_MOMENTS", 1)
    flags, code, words = WRONG[about]
    found = inspecting.check(rig, [sample_logs / "head_fixed.mcap"], flags)
    (line,) = [line for line in checklist(found) if line.about == about and line.state == "problem"]
    assert (words in line.what, line.exit_code, bool(line.cure)) == (True, code, True)
    assert found.exit_code in {code, 5}  # this recording also lacks a nominal value
    said = states(found)
    others = {name for name in EVERY if name not in (about, "time", "motion", "board")}
    follow = {"cameras": {"camera infos"}, "head chain": {"joints"}}.get(about, set())
    assert all(said[name] == "ok" for name in others - follow), said


def test_invalid_files_are_problems_too(sample_logs, rig, tmp_path):
    log = sample_logs / "straight.mcap"
    bad = tmp_path / "bad.yaml"
    bad.write_text("wheels: {left: {ticks_per_revolution: TODO}}\n", encoding="utf-8")
    found = inspecting.check(bad, [log])
    (line,) = checklist(found)
    assert (line.about, line.state, line.exit_code) == ("rig.yaml", "problem", 2)
    assert "not filled in yet: wheels.left.ticks_per_revolution" in line.what
    (line,) = checklist(inspecting.check(rig, [bad]))
    assert (line.about, line.state, line.exit_code) == ("recording", "problem", 3)
    done = run("check", bad, log, cwd=tmp_path)
    assert (done.code, done.err) == (2, "")
    assert done.out.endswith("1 problem (exit code 2).\n")


def test_limits_are_no_problems(sample_logs, rig):
    found = inspecting.check(rig, [sample_logs / "straight.mcap"])
    assert found.exit_code == 0
    assert states(found)["motion"] == "limit"
    assert checklist_text(found).endswith("1 limit.\n")


def test_images_of_another_size_and_other_times(sample_logs, rig, tmp_path):
    def smaller(topic, message):
        return replace(message, width=320) if topic == "/stereo/left/camera_info" else message

    found = inspecting.check(rig, [edited(sample_logs / "head_fixed.mcap", tmp_path / "a.mcap", smaller)])
    (line,) = [line for line in checklist(found) if line.about == "camera infos"]
    assert "the left images are 640 x 480 pixels, but their camera_info states 320 x 480" in line.what

    count = 0

    def short(topic, message):
        nonlocal count
        count += topic == "/joint_states"
        return None if topic == "/joint_states" and count > 900 else message

    found = inspecting.check(rig, [edited(sample_logs / "straight.mcap", tmp_path / "b.mcap", short)])
    (line,) = [line for line in checklist(found) if line.about == "time"]
    assert line.state == "limit"
    inside, total = found.covered
    assert (total, 4 < inside < 18) == (20, True)
    assert f"{inside} of 20 left images" in line.what


def test_several_recordings_are_checked_one_after_another(sample_logs, rig, tmp_path):
    """They were read as one, although their times overlap: half of the readings were dropped as repeated."""
    logs = [sample_logs / "straight.mcap", sample_logs / "head_fixed.mcap"]
    done = run("check", rig, *logs, cwd=tmp_path)
    assert [line for line in done.out.splitlines() if line.endswith(".mcap")] == list(map(str, logs))
    assert done.out.count("rig.yaml      valid") == 2
    assert "occur twice" not in done.out
    made = run("check", rig, *logs, "--json", "--quiet", cwd=tmp_path)
    assert [each["exit_code"] for each in json.loads(made.out)] == [0, 5]
    assert made.code == 5
    missing = run("check", rig, logs[0], tmp_path / "none.mcap", cwd=tmp_path)
    assert missing.code == 3
    assert "none.mcap" in missing.out


def test_a_camera_that_stops_is_named(sample_logs, rig, tmp_path):
    """A cable pulled in the middle: too few stations were found, and nothing said why."""
    count = 0

    def pulled(topic, message):
        nonlocal count
        right = topic == "/stereo/right/image_raw/compressed"
        count += right
        return None if right and count > 10 else message

    log = edited(sample_logs / "paper_robot.mcap", tmp_path / "pulled.mcap", pulled)
    done = run("calibrate", log, "-o", tmp_path / "out", cwd=tmp_path)
    assert done.code == 6
    notes = json.loads((tmp_path / "out/report.json").read_text())["notes"]
    (note,) = [note for note in notes if "No right images" in note]
    assert "while there are 14 left images. Check the cable and the driver of the right camera." in note
    (line,) = [line for line in checklist(inspecting.check(rig, [log])) if line.about == "time"]
    assert line.state == "limit"
    assert "of 24 left images were recorded while right images, joints and wheels were" in line.what
