"""Commands on a file system that is full, or that may not be read: the message says so, and outputs stay as they are."""

import json
import os
import shlex
import shutil
import subprocess
import sys
from functools import partial

import pytest
import zstandard

from mobilecal_cli.calibrate import batch as fleet
from mobilecal_cli.calibrate.batch import FleetJob
from mobilecal_cli.errors import OutputError
from tests.conftest import REPOSITORY
from tests.hostile.refusals import extraction

#: A file system of some bytes, mounted for one command only.
_MOUNTED = "mount -t tmpfs -o size={size} none disk && {prepare} && {command}; code=$?; echo; ls -AR disk; exit $code"

#: What is written does not depend on the method; this one is fast.
SOLVE = ("calibrate", "e.npz", "--method", "linear", "--jobs", 1)


def on_a_small_disk(folder, size, prepare, *command):
    """Run a command; exit code, standard output and error, and what is on the disk after it."""
    (folder / "disk").mkdir(exist_ok=True)
    words = shlex.join([sys.executable, "-m", "mobilecal_cli", *map(str, command)])
    script = _MOUNTED.format(size=size, prepare=prepare, command=words)
    result = subprocess.run(
        ["unshare", "--map-root-user", "--mount", "sh", "-c", script],
        cwd=folder,
        capture_output=True,
        text=True,
        env={**os.environ, "TMPDIR": str(folder / "disk")},
    )
    if "unshare:" in result.stderr or "mount:" in result.stderr:
        pytest.skip("this system does not allow a file system of one's own")
    return result


@pytest.fixture
def solved(tmp_path):
    extraction(tmp_path)
    (tmp_path / "old").mkdir()
    (tmp_path / "old/params.yaml").write_text("# Robot calibration by mobilecal. Old.\n")
    return tmp_path


@pytest.mark.parametrize(
    "size", [*(pytest.param(size, marks=pytest.mark.long) for size in ("16k", "64k")), "128k"]
)
def test_a_disk_that_fills_while_the_output_is_written(solved, size):
    command = (*SOLVE, "-o", "disk/out", "--force")
    result = on_a_small_disk(solved, size, "cp -r old disk/out", *command)
    assert result.returncode == 7, result.stderr
    said = "error: disk/out: cannot be written: No space left on device\nhint: check free"
    assert result.stderr.startswith(said)
    assert result.stdout.split() == ["disk:", "out", "disk/out:", "params.yaml"]


@pytest.mark.parametrize("option", ["--summary", pytest.param("--junit", marks=pytest.mark.long)])
def test_a_full_disk_for_a_further_output(solved, option):
    """An empty summary was left, and nothing said that there are results."""
    fill = "dd if=/dev/zero of=disk/full bs=1k 2>/dev/null; true"
    result = on_a_small_disk(solved, "64k", fill, *SOLVE, "-o", "out", option, "disk/f")
    assert result.returncode == 7, result.stderr
    error, hint = result.stderr.splitlines()
    assert error == (
        "error: disk/f: cannot be written: No space left on device; the results are written to out"
    )
    assert hint.startswith("hint: check free space")
    assert result.stdout.split() == ["disk:", "full"]
    assert (solved / "out/params.yaml").exists()


@pytest.mark.long
def test_a_disk_that_fills_while_a_recording_is_simulated(tmp_path):
    result = on_a_small_disk(tmp_path, "512k", "true", "simulate", "disk/log.mcap", "--stations", 4)
    assert result.returncode == 7, result.stderr
    assert "No space left on device" in result.stderr
    assert result.stdout.split() == ["disk:"]


def test_a_full_directory_for_temporary_files(sample_logs, tmp_path):
    packed = zstandard.compress((sample_logs / "paper_robot.mcap").read_bytes())
    (tmp_path / "log.mcap").write_bytes(packed)
    result = on_a_small_disk(tmp_path, "512k", "true", "inspect", "log.mcap")
    assert result.returncode == 8, result.stderr
    said = "cannot be written: No space left on device\nhint: free space there, or set TMPDIR"
    assert said in result.stderr
    assert result.stdout.split() == ["disk:"]


@pytest.mark.long
def test_a_disk_that_fills_during_a_batch(sample_logs, tmp_path):
    (tmp_path / "robots").mkdir()
    shutil.copy(sample_logs / "straight.mcap", tmp_path / "robots")
    result = on_a_small_disk(tmp_path, "64k", "true", "batch", "robots", "-o", "disk/fleet", "--jobs", 1)
    assert result.returncode == 7, result.stderr
    error = result.stderr.splitlines()[0]
    assert error.startswith("error: 1 of 1 robots were not calibrated: straight: ")
    assert error.endswith("/disk/fleet/straight: cannot be written: No space left on device")
    assert "did not pass" not in result.stdout + result.stderr


def test_a_robot_that_could_not_be_written_is_calibrated_again(tmp_path, monkeypatch):
    extraction(tmp_path)
    job = FleetJob("straight", (tmp_path / "e.npz",), None, tmp_path)

    def full(*_: object, **__: object) -> None:
        raise OutputError("straight: cannot be written: No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(fleet, "calibrate", full)
        assert fleet.run_job(job).exit_code == 7
    monkeypatch.setattr(fleet, "calibrate", partial(fleet.calibrate, method="linear"))
    row = fleet.run_job(job)
    assert row.skipped == ""
    assert row.stations > 0


UNREADABLE = {
    ("calibrate", "log.mcap"): 3,
    ("check", "rig.yaml", "log.mcap"): 3,
    ("init", "log.mcap", "--output", "new.yaml"): 3,
    ("calibrate", "e.npz", "--config", "log.mcap"): 2,
    ("evaluate", "e.npz", "log.mcap"): 2,
    ("batch", "log.mcap", "--output", "out"): 2,
}


def test_files_that_may_not_be_read(solved):
    """All commands in one process that has given up the right to read everything."""
    (solved / "log.mcap").touch(mode=0)
    (solved / "rig.yaml").touch()
    code = (
        "import json; from tests.command import run; "
        f"print(json.dumps([(done.code, done.out, done.err) for done in (run(*given) for given in {[*UNREADABLE]})]))"
    )
    command = [sys.executable, "-c", code]
    if os.geteuid() == 0:  # the administrator may read everything
        if shutil.which("setpriv") is None:
            pytest.skip("needs setpriv")
        command = ["setpriv", "--bounding-set=-dac_override,-dac_read_search", *command]
    environment = {**os.environ, "PYTHONPATH": str(REPOSITORY)}
    result = subprocess.run(command, cwd=solved, capture_output=True, text=True, env=environment)
    assert result.returncode == 0, result.stderr
    for (arguments, expected), (code, out, err) in zip(
        UNREADABLE.items(), json.loads(result.stdout), strict=True
    ):
        assert code == expected, (arguments, err)
        assert "log.mcap: cannot be read: Permission denied" in out + err, arguments
        assert "hint: check " in out + err, arguments  # not: give another file
        assert "permissions" in out + err, arguments
        assert "Usage" not in err, arguments
