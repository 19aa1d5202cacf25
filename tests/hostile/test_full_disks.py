"""Commands on a file system that is full: the message says so, and the old output stays as it is."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys

import pytest
import zstandard

from tests.hostile.refusals import extraction

#: A file system of some bytes, mounted for one command only.
_MOUNTED = "mount -t tmpfs -o size={size} none disk && {prepare} && {command}; code=$?; echo; ls -AR disk; exit $code"


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


@pytest.mark.parametrize("size", ["16k", "64k", "128k"])
def test_a_disk_that_fills_while_the_output_is_written(solved, size):
    result = on_a_small_disk(
        solved, size, "cp -r old disk/out", "calibrate", "e.npz", "-o", "disk/out", "--force", "--jobs", 1
    )
    assert result.returncode == 7, result.stderr
    assert result.stderr.startswith(
        "error: disk/out: cannot be written: No space left on device\nhint: check free"
    )
    assert result.stdout.split() == ["disk:", "out", "disk/out:", "params.yaml"]


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
    assert (
        "cannot be written: No space left on device\nhint: free space there, or set TMPDIR" in result.stderr
    )
    assert result.stdout.split() == ["disk:"]
