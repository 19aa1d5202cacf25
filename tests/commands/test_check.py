"""`mobilecal check`: a configuration against a recording, one line for each criterion."""

import json
from dataclasses import replace

import numpy as np
import pytest

from mobilecal_cli.calibrate import inspect
from mobilecal_cli.report.inspection import checklist, checklist_text
from tests.command import run, succeeded
from tests.commands.edited import edited
from tests.golden import assert_golden

EVERY = ("cameras", "camera infos", "wheels", "head chain", "joints", "time", "motion", "board")


@pytest.fixture(scope="module")
def rig(tmp_path_factory):
    path = tmp_path_factory.mktemp("rig") / "rig.yaml"
    path.write_text("schema_version: 1\n", encoding="utf-8")
    return path


def states(found):
    return {line.about: line.state for line in checklist(found)}


def test_a_board_without_the_stated_markers(sample_logs, tmp_path):
    """ "No problems.", and calibrate found no board."""
    (tmp_path / "rig.yaml").write_text(
        (sample_logs / "tick_robot.rig.yaml").read_text()
        + "board: {kind: charuco, dictionary: DICT_5X5_100, marker_share: 0.7, columns: 8, rows: 5}\n"
    )
    done = run("check", "rig.yaml", sample_logs / "tick_robot.mcap", cwd=tmp_path)
    assert done.code == 4
    assert "shows the markers of the stated charuco board, but a" in " ".join(done.out.split())


def test_a_rig_that_fits(sample_logs, tmp_path):
    rig, log = sample_logs / "tick_robot.rig.yaml", sample_logs / "tick_robot.mcap"
    done = succeeded("check", rig, log, cwd=tmp_path)
    assert done.out.endswith("No problems.\n")
    assert_golden(done.out, "check")
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
    "motion": ({"wheels.left": {"topic": "/joint_states", "field": "nope"}}, 3, "no field nope ('nope' is"),
    "board": ({"board": {"columns": 8, "rows": 6}}, 4, "8 x 6 inner corners, but the images show 9 x 6"),
    "square size": ({"board.square_m": 0.15}, 4, "the squares are 0.08 m wide at the median"),
}


@pytest.mark.parametrize("about", WRONG)
def test_each_problem_has_its_line_and_exit_code(sample_logs, rig, about, few):
    flags, code, words = WRONG[about]
    found = inspect.check(rig, [sample_logs / "head_fixed.mcap"], flags)
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
    found = inspect.check(bad, [log])
    (line,) = checklist(found)
    assert (line.about, line.state, line.exit_code) == ("rig.yaml", "problem", 2)
    assert "not filled in yet: wheels.left.ticks_per_revolution" in line.what
    (line,) = checklist(inspect.check(rig, [bad]))
    assert (line.about, line.state, line.exit_code) == ("recording", "problem", 3)
    done = run("check", bad, log, cwd=tmp_path)
    assert (done.code, done.err) == (2, "")
    assert done.out.endswith("1 problem (exit code 2).\n")


def test_limits_are_no_problems(sample_logs, rig, few):
    found = inspect.check(rig, [sample_logs / "straight.mcap"])
    assert found.exit_code == 0
    (lack,) = found.weak
    assert lack.about == "motion"
    assert "the base only drives straight" in lack.what
    assert "turn the base" in lack.cure
    assert checklist_text(found).endswith("1 limit.\n")
    assert found.motion.turned_deg < 3
    # The truth drives 2.7 m in all; wheels with noise go a little further.
    assert 2 < found.motion.driven_m < 4


def test_images_of_another_size_and_other_times(sample_logs, rig, tmp_path, few):
    def smaller(topic, message):
        return replace(message, width=320) if topic == "/stereo/left/camera_info" else message

    found = inspect.check(rig, [edited(sample_logs / "head_fixed.mcap", tmp_path / "a.mcap", smaller)])
    (line,) = [line for line in checklist(found) if line.about == "camera infos"]
    assert "the left images are 640 x 480 pixels, but their camera_info states 320 x 480" in line.what

    count = 0

    def short(topic, message):
        nonlocal count
        count += topic == "/joint_states"
        return None if topic == "/joint_states" and count > 900 else message

    found = inspect.check(rig, [edited(sample_logs / "straight.mcap", tmp_path / "b.mcap", short)])
    (line,) = [line for line in checklist(found) if line.about == "time"]
    assert line.state == "limit"
    inside, total = found.covered
    assert (total, 4 < inside < 18) == (20, True)
    assert f"{inside} of 20 left images" in line.what


def test_several_recordings_are_checked_one_after_another(sample_logs, rig, tmp_path, few):
    """They were read as one, although their times overlap: half of the readings were dropped as repeated."""
    logs = [sample_logs / "straight.mcap", sample_logs / "head_fixed.mcap"]
    done = run("check", rig, *logs, cwd=tmp_path)
    assert [line for line in done.out.splitlines() if line.endswith(".mcap")] == list(map(str, logs))
    assert done.out.count("ok       cameras  ") == 2
    assert "occur twice" not in done.out
    made = run("check", rig, *logs, "--json", "--quiet", cwd=tmp_path)
    assert [each["exit_code"] for each in json.loads(made.out)] == [0, 5]
    assert made.code == 5
    missing = run("check", rig, logs[0], tmp_path / "none.mcap", cwd=tmp_path)
    assert missing.code == 3
    assert "none.mcap" in missing.out


@pytest.mark.long
def test_a_camera_that_stops_is_named(sample_logs, rig, tmp_path):
    """A cable pulled in the middle: nothing said why one camera shows the board at fewer stations."""
    count = 0

    def pulled(topic, message):
        nonlocal count
        right = topic == "/stereo/right/image_raw/compressed"
        count += right
        return None if right and count > 10 else message

    log = edited(sample_logs / "paper_robot.mcap", tmp_path / "pulled.mcap", pulled)
    succeeded("calibrate", log, "-o", tmp_path / "out", cwd=tmp_path)
    notes = json.loads((tmp_path / "out/report.json").read_text())["notes"]
    (note,) = [note for note in notes if "No right images" in note]
    assert "while there are 14 left images. Check the cable and the driver of the right camera." in note
    (line,) = [line for line in checklist(inspect.check(rig, [log])) if line.about == "time"]
    assert line.state == "limit"
    assert "of 24 left images were recorded while right images, joints and wheels were" in line.what


CHAIN = {
    "head.base_frame": "base_link",
    "head.head_frame": "head_link",
    "head.chain": [
        {"joint": "head_pan_joint", "axis": [0, 0, 1]},
        {"joint": "head_pan_joint", "axis": [0, 0, 1]},
        {"joint": "torso_pitch_joint", "axis": [0, 1, 0]},
    ],
}
LENGTHS = {"baseline_length": "free", "joint_position": "free"}
TURNS = {"joint_axis": "free", "joint_zero": "free"}
FOUND = {
    "a joint twice": (CHAIN, "head chain", "limit", "joint 'head_pan_joint' is in head.chain 2 times"),
    "a missing tilt": (
        CHAIN,
        "head chain",
        "limit",
        "'head_tilt_joint': recorded, but not in the head chain",
    ),
    "free priors": ({"priors": {"all": "free"}}, "priors", "limit", "r_x, r_y, r_z: unobservable"),
    "free axes": ({"priors": TURNS}, "priors", "limit", "axes and zero positions of the head joints are all"),
    "free lengths": (
        {"priors": LENGTHS},
        "priors",
        "limit",
        "radius_right, radius_left, separation: unobser",
    ),
    "square size": ({"board.square_m": 0.082}, "square size", "limit", "80.0"),
}


@pytest.mark.parametrize("name", FOUND)
def test_what_needs_no_solution_is_found(sample_logs, rig, few, name):
    """These passed, and ended the calibration with exit code 5 or 6. None of these stops `calibrate`."""
    flags, about, state, words = FOUND[name]
    found = inspect.check(rig, [sample_logs / "paper_robot.mcap"], flags)
    lines = [line for line in checklist(found) if line.about == about and words in line.what]
    assert [(line.state, bool(line.cure)) for line in lines] == [(state, True)]
    assert found.exit_code == 0


@pytest.mark.parametrize(
    "flags",
    [
        {"priors": {**LENGTHS, "pan_position_x": 1.0}},
        {"priors": LENGTHS, "board.square_m": 0.08},
        {"priors": {**TURNS, "joint_zero": 1.0}},
    ],
)
def test_some_free_priors_are_no_limits(sample_logs, rig, few, flags):
    found = inspect.check(rig, [sample_logs / "paper_robot.mcap"], flags)
    assert (found.missing, found.weak) == ((), ())


def test_a_square_that_calibrate_may_accept_is_no_problem(sample_logs, rig):
    """Exit code 4 at a limit of 19.5 %, where that of `calibrate`, from all stations, is 21.7 %."""
    found = inspect.check(rig, [sample_logs / "paper_robot.mcap"], {"board.square_m": 0.0667})
    (line,) = [line for line in checklist(found) if line.about == "square size"]
    assert (line.state, found.exit_code) == ("limit", 0)
    assert line.what.endswith("on the board's distance at its stations, not known yet")


def changed_states(source, target, change):
    def edit(topic, message):
        if topic != "/joint_states":
            return message
        names, values = list(message.name), np.array(message.position)
        change(names, values)
        return replace(message, position=values)

    return edited(source, target, edit)


def test_readings_in_degrees_have_impossible_ranges(sample_logs, rig, tmp_path, few):
    def in_degrees(names, values):
        values[names.index("head_tilt_joint")] *= 180 / np.pi

    log = changed_states(sample_logs / "paper_robot.mcap", tmp_path / "degrees.mcap", in_degrees)
    lines = [line for line in checklist(inspect.check(rig, [log])) if line.about == "joints"]
    assert [line.state for line in lines] == ["limit"]
    assert "(limit 360); the readings look like degrees, and radians are expected" in lines[0].what


@pytest.mark.parametrize("whole", [True, False])
def test_wheels_with_identical_readings(sample_logs, rig, tmp_path, whole, monkeypatch, few):
    """Also where only a part of the recording is read, and the stops are not known."""

    def same(names, values):
        values[names.index("wheel_left_joint")] = values[names.index("wheel_right_joint")]

    if not whole:
        monkeypatch.setattr(inspect, "MOTION_BYTES", 2**17)
    log = changed_states(sample_logs / "paper_robot.mcap", tmp_path / "same.mcap", same)
    found = inspect.check(rig, [log])
    assert (found.motion.rests is not None) == whole
    assert found.exit_code == 0
    (line,) = [line for line in checklist(found) if line.about == "motion"]
    assert line.state == "limit"
    assert "left and the right wheel have identical readings between all stations" in line.what


@pytest.fixture(scope="module")
def robot(sample_logs):
    return inspect.inspect([sample_logs / "straight.mcap"]).rig


@pytest.mark.parametrize(("late_s", "counted"), [(0.002, 40), (-0.002, 40), (0.09, 40), (1.15, 38)])
def test_images_at_the_ends_are_counted(robot, late_s, counted):
    """A left image logged just before the first right image or the first reading made it N - 1 of N."""
    left = np.arange(40) * 10**9
    others = {robot.sources.image["right"], *robot.sources.motion}
    times = {robot.sources.image["left"]: left, **dict.fromkeys(others, left + round(late_s * 1e9))}
    covered = inspect._covered(robot, times, [])
    assert covered == (counted, 40)


def test_motion_that_only_the_part_that_is_read_lacks_is_a_limit(sample_logs, rig, monkeypatch, few):
    """Nothing was said about the motion of a recording of which a part is read."""
    whole = inspect.check(rig, [sample_logs / "head_fixed.mcap"])
    assert (states(whole)["motion"], whole.exit_code) == ("problem", 5)
    monkeypatch.setattr(inspect, "MOTION_BYTES", 2**17)
    part = inspect.check(rig, [sample_logs / "head_fixed.mcap"])
    assert part.motion.share_read < 1
    assert (states(part)["motion"], part.exit_code) == ("limit", 0)


@pytest.mark.long
def test_the_height_of_a_camera_that_no_joint_tilts(sample_logs, tmp_path):
    """It ends with the exit code of `calibrate`, unless the nominal value is stated."""
    rig, log = tmp_path / "rig.yaml", sample_logs / "head_fixed.mcap"
    rig.write_text("head: {chain: []}", encoding="utf-8")
    done = run("check", rig, log, cwd=tmp_path)
    assert (done.code, run("calibrate", log, "--config", rig, cwd=tmp_path).code) == (5, 5)
    assert "no joint tilts the camera, so the recording does not show its height" in " ".join(
        done.out.split()
    )
    stated = "nominal: {head_eye: {translation_m: [0, 0, 1], quaternion_xyzw: [-0.5, 0.5, -0.5, 0.5]}}"
    rig.write_text(f"head: {{chain: []}}\n{stated}", encoding="utf-8")
    assert run("check", rig, log, cwd=tmp_path).code == 0
