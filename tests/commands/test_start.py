"""What the command line loads before it knows what is asked for."""

import os
import shlex
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from tests.command import python
from tests.conftest import REPOSITORY

#: pydantic is not among them: typer itself loads it for the options of the group.
HEAVY = ("numpy", "scipy", "cv2", "rosbags", "mcap", "jinja2", "rich", "distributed")


@pytest.mark.parametrize(
    ("arguments", "heavy"),
    [(["calibrate", "--help"], HEAVY), (["--help"], (*HEAVY, "typer")), (["--version"], (*HEAVY, "typer"))],
)
def test_help_loads_nothing_heavy(arguments, heavy):
    code = (
        "import sys\n"
        f"sys.argv = ['mobilecal', *{arguments!r}]\n"
        "from mobilecal_cli.__main__ import main\n"
        "try:\n    main()\nexcept SystemExit as leaving:\n    assert not leaving.code\n"
        f"loaded = sorted(set({heavy!r}) & set(sys.modules))\n"
        "assert not loaded, loaded\n"
    )
    done = python("-c", code)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize(("argument", "columns"), [("--help", 79), ("--help", 200), ("--version", 80)])
def test_texts_are_the_same_without_the_command_line_library(argument, columns):
    library = "from mobilecal_cli.commands import main; main()"
    commands = ["-m", "mobilecal_cli"], ["-c", f"import sys; sys.argv[0] = 'mobilecal'; {library}"]
    quick, slow = (python(*command, argument, COLUMNS=str(columns)) for command in commands)
    assert quick.returncode == slow.returncode == 0
    assert quick.stdout == slow.stdout.replace("Usage: mobilecal", "Usage: python -m mobilecal_cli")


def test_every_command_teaches_with_an_example():
    from mobilecal_cli.commands import app

    for command in app.registered_commands:
        assert "Example: mobilecal" in command.callback.__doc__, command.callback.__name__


def test_every_parameter_has_a_help_text():
    from typer.main import get_command

    from mobilecal_cli.commands import app

    commands = get_command(app).commands
    assert [f"{name} {p.name}" for name, c in commands.items() for p in c.params if not p.help] == []
    assert all("Args:" not in command.help for command in commands.values())


def test_the_commands_need_no_docstrings():
    assert python("-OO", "-m", "mobilecal_cli", "compare", "--help").returncode == 0


@pytest.mark.parametrize("arguments", [["calibrate", "a"], ["board", "--corners", "8x5", "--square", "0.08"]])
def test_a_system_that_is_not_supported_is_named(arguments):
    """Windows lacks these names; nothing else can be said there before."""
    code = (
        "import os, signal, sys\n"
        "sys.modules['fcntl'] = None\n"
        "del signal.SIGHUP, signal.pthread_sigmask, os.O_DIRECTORY, os.O_NOFOLLOW\n"
        f"sys.argv = ['mobilecal', *{arguments!r}]\n"
        "from mobilecal_cli.__main__ import main\n"
        "main()\n"
    )
    done = python("-c", code)
    assert (done.returncode, done.stdout) == (2, "")
    assert done.stderr.startswith("error: mobilecal runs on Linux and macOS")
    assert "Windows Subsystem for Linux" in done.stderr


@pytest.mark.parametrize("unbuffered", ["", "1"])
@pytest.mark.parametrize(
    ("command", "redirection"),
    [("bogus", "2>&-"), ("calibrate", "2</dev/null"), ("calibrate", "2>/dev/full")],
)
def test_a_wrong_command_line_that_standard_error_cannot_show(command, redirection, unbuffered):
    """It ended as a bug does, as standard output that is full, or with Python's own code where it keeps what is written."""
    if redirection.endswith("full") and not Path("/dev/full").exists():
        pytest.skip("this system has no /dev/full")
    words = f"{shlex.quote(sys.executable)} -m mobilecal_cli {command} {redirection}"
    environment = {**os.environ, "PYTHONUNBUFFERED": unbuffered}
    done = subprocess.run(["sh", "-c", words], capture_output=True, text=True, env=environment)
    assert (done.returncode, done.stdout) == (2, "")


@pytest.mark.parametrize(
    ("command", "redirection"),
    [("board --help", ">&-"), ("board --help", ">/dev/full"), ("--version", ">&-")],
)
def test_output_that_cannot_be_written_is_an_error(command, redirection):
    """To a closed standard output, it was lost with exit code 0."""
    if redirection.endswith("full") and not Path("/dev/full").exists():
        pytest.skip("this system has no /dev/full")
    words = f"{shlex.quote(sys.executable)} -m mobilecal_cli {command} {redirection}"
    environment = {**os.environ, "PYTHONUNBUFFERED": ""}  # what is kept is written at the end
    done = subprocess.run(["sh", "-c", words], capture_output=True, text=True, env=environment)
    assert done.returncode == 7
    assert done.stderr.startswith("error: standard output cannot be written: ")


def test_the_package_states_the_same_systems():
    metadata = tomllib.loads((REPOSITORY / "pyproject.toml").read_text(encoding="utf-8"))
    systems = [c for c in metadata["project"]["classifiers"] if c.startswith("Operating System")]
    assert systems == ["Operating System :: MacOS", "Operating System :: POSIX :: Linux"]
    assert "Linux or macOS" in (REPOSITORY / "README.md").read_text(encoding="utf-8")
