"""The usability walk, done anew: `python docs/generate/walk.py` writes docs/explanation/usability-walk.md.

Every command is run, from an empty virtual environment on; what it printed is what stands there (long output cut).
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path

REPOSITORY = Path(__file__).resolve().parents[2]
TARGET = REPOSITORY / "docs" / "explanation" / "usability-walk.md"
MOST_LINES = 34

STEPS: tuple[tuple[str, str], ...] = (
    (
        "A fresh virtual environment, and the tool in it.",
        "python3 -m venv venv && venv/bin/pip install --quiet .",
    ),
    ("What can it do?", "mobilecal --help"),
    (
        "A robot has been driven in front of a board for a minute; here it is simulated, so that the truth is known.",
        "mobilecal simulate monday.mcap --seed 11",
    ),
    ("Is the recording any good?", "mobilecal inspect monday.mcap | tail -n 24"),
    ("Calibrate it.", "mobilecal calibrate monday.mcap --output monday"),
    ("Would one more stop help?", "mobilecal suggest monday.mcap | head -n 4"),
    (
        "Try the result on a recording that it has not seen.",
        "mobilecal simulate tuesday.mcap --seed 12 --quiet && mobilecal evaluate tuesday.mcap monday/params.yaml",
    ),
    (
        "Calibrate that one, too: has the robot changed over night?",
        "mobilecal calibrate tuesday.mcap --output tuesday --quiet --last monday/params.yaml && "
        "mobilecal compare monday/params.yaml tuesday/params.yaml --max-sigma 5",
    ),
    ("Both together know more.", "mobilecal calibrate monday.mcap tuesday.mcap --output both"),
    (
        "Onto the robot: its URDF changes in these lines and no others.",
        "mobilecal export both/params.yaml --to urdf --urdf robot.urdf --output calibrated.urdf && "
        "diff robot.urdf calibrated.urdf",
    ),
    ("And its controller.", "mobilecal export both/params.yaml --to ros2_control"),
    (
        "What does it say to a recording that is cut off?",
        "head -c 600000 monday.mcap > cut.mcap; mobilecal calibrate cut.mcap",
    ),
    ("And to a typing error?", "mobilecal calibrate monday.mcap --set wheels.left.singn=-1"),
)
HEAD = """\
# A walk from installation to a changed robot

Made by `docs/generate/walk.py`: every command was run, and this is what it printed (⋯ where it is cut). What stood out
on the way, and was mended for it, is at the end.
"""
TAIL = """\
## What stood out

- A recording with five rests was called complete by `inspect`, and then failed for want of eight. `inspect` now counts
  the rests that a pass needs.
- On a telephone, a long name out of a log made the page wider than the screen. Words now break anywhere.
- A URDF without the camera's optical frame was refused by `export`. The link is now added, and it is said so.
- What the tool calls a leg is the way from one stop to the next; the terminal says "from stop to stop".
"""


def main() -> None:
    """Walk."""
    parts = [HEAD]
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for entry in ("mobilecal_cli", "pyproject.toml", "README.md", "LICENSE"):
            source = REPOSITORY / entry
            copy = shutil.copytree if source.is_dir() else shutil.copy
            copy(source, folder / entry)
        drawn = "from mobilecal_cli.simulate.robot import ROBOTS; from mobilecal_cli.simulate.urdf import urdf_text"
        text = subprocess.run(
            [sys.executable, "-c", f"{drawn}; print(urdf_text(ROBOTS['paper']()), end='')"],
            capture_output=True, text=True, check=True,
        ).stdout  # fmt: skip
        (folder / "robot.urdf").write_text(text, encoding="utf-8")
        path = f"{folder / 'venv' / 'bin'}{os.pathsep}{os.environ['PATH']}"
        for told, command in STEPS:
            done = subprocess.run(
                command, shell=True, cwd=folder, capture_output=True, text=True, check=False,
                env={**os.environ, "PATH": path, "PYTHONPATH": "", "COLUMNS": "100"},
            )  # fmt: skip
            lines = [
                line for line in (done.stdout + done.stderr).rstrip().splitlines() if "is ignored" not in line
            ]
            if len(lines) > MOST_LINES:
                lines = [*lines[: MOST_LINES - 8], "⋯", *lines[-7:]]
            shown = "\n".join(line.replace(name, "…").rstrip() for line in lines)
            parts.append(f"{told}\n\n```text\n$ {command}\n{shown}\n[exit code {done.returncode}]\n```\n")
            print(f"{done.returncode}: {command}")
    TARGET.write_text("\n".join([*parts, TAIL]), encoding="utf-8")


if __name__ == "__main__":
    main()
