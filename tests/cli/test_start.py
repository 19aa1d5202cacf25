"""What the command line loads before it knows what is asked for."""

from __future__ import annotations

import subprocess
import sys

import pytest

#: pydantic is not among them: typer itself loads it where an option has a range.
HEAVY = (
    "numpy",
    "scipy",
    "cv2",
    "rosbags",
    "mcap",
    "jinja2",
    "rich",
    "distributed",
)


@pytest.mark.parametrize("arguments", [["--help"], ["calibrate", "--help"], ["--version"]])
def test_help_loads_nothing_heavy(arguments):
    code = (
        "import sys\n"
        f"sys.argv = ['mobilecal', *{arguments!r}]\n"
        "from mobilecal_cli.__main__ import main\n"
        "try:\n    main()\nexcept SystemExit as leaving:\n    assert not leaving.code\n"
        f"loaded = sorted(set({HEAVY!r}) & set(sys.modules))\n"
        "assert not loaded, loaded\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_every_command_teaches_with_an_example():
    from mobilecal_cli.cli import app

    for command in app.registered_commands:
        assert "Example: mobilecal" in command.callback.__doc__, command.callback.__name__
