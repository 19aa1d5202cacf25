"""Outputs when the process is killed, when names try to steer, and when the output is a link."""

import os
import re
import resource
import shutil
import subprocess
import sys
from itertools import groupby

import pytest

from mobilecal_cli.errors import OutputError
from mobilecal_cli.export.outputs import append_text, write_outputs
from tests.command import python, run
from tests.conftest import REPOSITORY


def test_killed_at_any_moment(tmp_path):
    """First what was there, and from one moment on all of the new output."""
    done = python("-m", "tests.hostile.kill_points", tmp_path / "w", cwd=REPOSITORY)
    assert done.returncode == 0, done.stderr
    *ways, end = done.stdout.split("\n\n")
    assert not end
    all_moments = [[line.split() for line in way.splitlines()] for way in ways]
    assert all(len(moments) >= 8 for moments in all_moments)
    assert [[state for state, _ in groupby(line[1] for line in moments)] for moments in all_moments] == [
        ["none", "new"],
        ["old", "new"],  # at no moment is there neither
        ["old", "none", "new"],  # the old one then lies beside it, whole
    ]
    assert all(line[2:] == ["aside"] for line in all_moments[2] if line[1] == "none")


PARAMS, LOG, URDF = "params.yaml", "log.mcap", "robot.urdf"


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        (("init", LOG, "--output", LOG), LOG),
        (("init", LOG, "--urdf", URDF, "--output", "./robot.urdf"), URDF),
        (("init", "bag", "--output", "bag/metadata.yaml"), "bag/metadata.yaml"),
        (("calibrate", LOG, "--junit", LOG), LOG),
        (("calibrate", LOG, "--last", PARAMS, "--junit", PARAMS), PARAMS),
        (("calibrate", LOG, "--summary", LOG), LOG),
        (("calibrate", LOG, "--last", PARAMS, "--summary", PARAMS), PARAMS),
        (("calibrate", LOG, "--config", "rig.yaml", "--summary", "rig.yaml"), "rig.yaml"),
        (("calibrate", "bag", "--summary", "bag/metadata.yaml"), "bag/metadata.yaml"),
        (("evaluate", LOG, PARAMS, "--junit", PARAMS), PARAMS),
        (("compare", PARAMS, PARAMS, "--plot", PARAMS), PARAMS),
        (("export", PARAMS, "--to", "ros2_control", "--output", PARAMS), PARAMS),
        (("export", PARAMS, "--to", "urdf", "--urdf", URDF, "--output", URDF), URDF),
        (("export", PARAMS, "--to", "foxglove", "--log", LOG, "--output", LOG), LOG),
    ],
)
def test_no_input_is_replaced(sample_logs, tmp_path, arguments, name):
    shutil.copy(REPOSITORY / "tests/export/golden/params.yaml", tmp_path / PARAMS)
    shutil.copy(sample_logs / "straight.mcap", tmp_path / LOG)
    shutil.copytree(sample_logs / "paper_robot_rosbag2", tmp_path / "bag")
    (tmp_path / URDF).write_text("<robot name='r'/>")
    (tmp_path / "rig.yaml").touch()
    before = (tmp_path / name).read_bytes()
    result = run(*arguments, "--force", cwd=tmp_path)
    assert result.code == 7, result.err
    says = {PARAMS: "a file of a calibration", LOG: "this command reads |: a recording"}.get(
        name, "this command reads "
    )
    assert re.search(says, result.err)
    assert (tmp_path / name).read_bytes() == before
    assert result.left == []


@pytest.mark.parametrize("name", [".", "..", "/"])
def test_a_directory_is_no_output_of_two_files(tmp_path, name):
    """The name of the second file was made first: a ValueError for a path without a name."""
    shutil.copy(REPOSITORY / "tests/export/golden/params.yaml", tmp_path / PARAMS)
    result = run("export", PARAMS, "--to", "foxglove", "--output", name, cwd=tmp_path)
    assert (result.code, result.left) == (7, [])
    assert "exists and is not a regular file" in result.err


@pytest.fixture
def small_files():
    """No file may grow beyond 4096 bytes, as on a disk that is full."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, before[1]))
    yield
    resource.setrlimit(resource.RLIMIT_FSIZE, before)


def test_a_file_that_cannot_be_appended_to_stays_as_it_is(tmp_path, small_files):
    """A part of the new text was left at its end."""
    path = tmp_path / "summary.md"
    path.write_bytes(b"x" * 4000)
    with pytest.raises(OutputError, match="cannot be written"):
        append_text(path, "y" * 200)
    assert path.read_bytes() == b"x" * 4000
    append_text(path, "y" * 96)
    assert path.read_bytes() == b"x" * 4000 + b"y" * 96


def test_of_two_files_that_belong_together_none_is_written_if_one_cannot_be(tmp_path, small_files):
    """The scene was new, its layout an older one."""
    first, second = tmp_path / "scene.mcap", tmp_path / "scene.layout.json"
    for path in (first, second):
        path.write_bytes(b"old")
    with pytest.raises(OutputError, match=r"layout\.json: cannot be written"):
        write_outputs({first: b"new", second: b"y" * 5000}, force=True)
    assert [path.read_bytes() for path in sorted(tmp_path.iterdir())] == [b"old", b"old"]


def test_a_pipe_as_the_urdf_to_patch(tmp_path):
    shutil.copy(REPOSITORY / "tests/export/golden/params.yaml", tmp_path / PARAMS)
    os.mkfifo(tmp_path / URDF)
    result = run("export", PARAMS, "--to", "urdf", "--urdf", URDF, cwd=tmp_path)
    assert (result.code, result.out) == (2, "")
    assert "robot.urdf: cannot be read: not a regular file" in result.err


@pytest.mark.parametrize(
    ("command", "name"),
    [
        (("init", "--output"), "file"),
        (("init", "--output"), "dangling"),
        (("simulate",), "file"),
        (("simulate",), "dangling"),
    ],
)
def test_links_as_outputs(sample_logs, tmp_path, command, name):
    """What a link points to stays as it is, with --force as well."""
    (tmp_path / "precious.txt").write_text("precious")
    (tmp_path / "file").symlink_to("precious.txt")
    (tmp_path / "dangling").symlink_to("nowhere")
    arguments = [] if command[0] == "simulate" else [sample_logs / "straight.mcap"]
    result = run(command[0], *arguments, *command[1:], name, "--force", cwd=tmp_path)
    assert result.code == 7, result.err
    assert (tmp_path / name).is_symlink()
    assert (tmp_path / "precious.txt").read_text() == "precious"
    assert not (tmp_path / "nowhere").exists()
    names = ["dangling", "file", "precious.txt"]
    assert sorted(path.name for path in tmp_path.iterdir()) == names


def test_a_working_directory_that_is_removed(tmp_path):
    gone = tmp_path / "gone"
    gone.mkdir()
    command = f"rmdir ../gone; exec {sys.executable} -m mobilecal_cli calibrate log.mcap"
    done = subprocess.run(["sh", "-c", command], cwd=gone, capture_output=True, text=True)
    assert (done.returncode, "Traceback" in done.stderr) == (7, False)
    assert "the working directory does not exist any more" in done.stderr
