"""All commands of the tutorial and the how-to pages, run in a shell: `make pages`."""

import json
import math
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from tests.conftest import REPOSITORY

DOCS = REPOSITORY / "docs"

pytestmark = pytest.mark.pages


PAGES = sorted(
    str(path.relative_to(DOCS))
    for path in [*DOCS.glob("tutorial/*.md"), *DOCS.glob("how-to/*.md")]
    if "```bash" in path.read_text(encoding="utf-8")
)


@pytest.fixture(scope="module")
def bench(sample_logs, tmp_path_factory):
    """A directory with the files that the pages use: recordings, a URDF, a fleet, and an earlier result."""
    from mobilecal_cli.simulate.robot import ROBOTS, urdf_text

    folder = tmp_path_factory.mktemp("bench")
    shutil.copy(sample_logs / "paper_robot.mcap", folder / "log.mcap")
    assert shell("mobilecal simulate another.mcap --seed 12 --quiet", folder).returncode == 0
    (folder / "sample_logs").symlink_to(sample_logs)
    (folder / "robot.urdf").write_text(urdf_text(ROBOTS["paper"]), encoding="utf-8")
    assert shell("mobilecal calibrate log.mcap --output result --quiet", folder).returncode == 0
    (folder / "recordings").mkdir()
    assert shell("mobilecal calibrate another.mcap --output other --quiet", folder).returncode == 0
    shutil.copy(folder / "result" / "extraction.npz", folder / "robot_1.npz")
    shutil.move(folder / "other" / "extraction.npz", folder / "robot_2.npz")
    shutil.rmtree(folder / "other")
    shutil.copy(folder / "log.mcap", folder / "recordings" / "robot_1.mcap")
    manifest = "robots: [{name: a, logs: [robot_1.npz]}, {name: b, logs: [robot_2.npz]}]"
    (folder / "fleet.yaml").write_text(manifest, encoding="utf-8")
    return folder


def shell(command, folder):
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    return subprocess.run(
        command, shell=True, cwd=folder, capture_output=True, text=True, env={**os.environ, "PATH": path}
    )


@pytest.mark.parametrize("page", PAGES)
def test_every_command_of_a_page_works(page, bench, tmp_path):
    folder = tmp_path / "work"
    shutil.copytree(bench, folder, symlinks=True)
    text = (DOCS / page).read_text(encoding="utf-8")
    if "--output result" in text:
        shutil.rmtree(folder / "result")  # the page creates it
    commands = [
        line
        for block in re.findall(r"```bash\n(.*?)```", text, flags=re.DOTALL)
        for line in block.replace("\\\n", " ").splitlines()
        if line.strip()
    ]
    assert commands
    for line in commands:
        command, _, remark = line.partition("  # exit code ")
        done = shell(command, folder)
        assert done.returncode == int(remark or 0), f"{command}\n{done.stdout}{done.stderr}"


def test_the_differences_that_the_tutorial_states(bench, tmp_path):
    """Between the methods: no larger than stated, and not much smaller."""
    text = (DOCS / "tutorial" / "first-calibration.md").read_text(encoding="utf-8")
    limits = r"([\d.]+) degrees per rotation axis, ([\d.]+) mm per translation axis and\s+([\d.]+) mm"
    said = re.search(f"at most {limits}", text)
    params = bench / "result" / "params.yaml"
    linear = tmp_path / "linear"
    recording = bench / "result" / "extraction.npz"
    done = shell(f"mobilecal calibrate {recording} --method linear --output {linear} -q", tmp_path)
    assert done.returncode == 0, done.stderr
    compared = shell(f"mobilecal compare {params} {linear / 'params.yaml'} --json", tmp_path)
    (difference,) = json.loads(compared.stdout)["against_first"]
    change = [abs(value) for value in difference["change"]]
    found = math.degrees(max(change[:3])), max(change[3:6]) * 1e3, change[8] * 1e3
    for stated, value in zip(map(float, said.groups()), found, strict=True):
        assert 0.8 * stated < value <= stated
