"""Completion of commands, gates and settings in the shells that are installed."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

CASES = {
    "mobilecal che": {"check"},
    "mobilecal calibrate a.mcap --gate std.wheels.s": {"std.wheels.separation_m="},
    "mobilecal calibrate a.mcap --set noise.p": {"noise.pair_s=", "noise.pixel_px="},
    "mobilecal evaluate a.mcap --gate d": {"drift_deg_per_turn=", "drift_mm_per_m="},  # of `evaluate` alone
}
#: A command, a gate and a setting: the names themselves do not depend on the shell.
EACH = {line: CASES[line] for line in list(CASES)[:3]}


def script(shell):
    """What `--install-completion` installs."""
    command = "mobilecal --show-completion; true"  # the shell is the parent process of mobilecal
    done = subprocess.run([shell, "-c", command], capture_output=True, text=True, env=environment())
    return done.stdout


def environment(**more):
    path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    return {**os.environ, "PATH": path, **more}


def test_bash(tmp_path):
    (tmp_path / "completion.bash").write_text(script("bash"), encoding="utf-8")
    asked = [
        f"COMP_WORDS=({line}); COMP_CWORD={len(line.split()) - 1}; COMPREPLY=(); "
        "_mobilecal_completion mobilecal; printf '%s\\n' \"${COMPREPLY[@]}\" =="
        for line in CASES
    ]
    code = f"source {tmp_path / 'completion.bash'}\n" + "\n".join(asked)
    done = subprocess.run(["bash", "-c", code], capture_output=True, text=True, env=environment())
    answers = [set(part.split()) for part in done.stdout.split("==\n")[:-1]]
    assert answers == list(CASES.values()), done.stderr


@pytest.mark.skipif(shutil.which("fish") is None, reason="fish is not installed")
@pytest.mark.long
def test_fish(tmp_path):
    (tmp_path / "completion.fish").write_text(script("fish"), encoding="utf-8")
    asked = "; echo ==; ".join(f"complete -C '{line}'" for line in EACH)
    done = subprocess.run(
        ["fish", "-c", f"source {tmp_path / 'completion.fish'}; {asked}"],
        capture_output=True,
        text=True,
        env=environment(HOME=str(tmp_path)),
    )
    answers = [{row.split("\t")[0] for row in part.splitlines() if row} for part in done.stdout.split("==\n")]
    assert answers == list(EACH.values()), done.stderr


@pytest.mark.skipif(shutil.which("zsh") is None, reason="zsh is not installed")
def test_zsh(tmp_path):
    """The candidates that the completion function hands to zsh."""
    (tmp_path / "completion.zsh").write_text(script("zsh"), encoding="utf-8")
    lines = [f"words=({line}); CURRENT={len(line.split())}; _mobilecal_completion; echo ::" for line in EACH]
    code = (
        "compdef() { }; _files() { }; _arguments() { print -r -- $1 }\n"
        f"source {tmp_path / 'completion.zsh'}\n" + "\n".join(lines)
    )
    done = subprocess.run(["zsh", "-f", "-c", code], capture_output=True, text=True, env=environment())
    answers = done.stdout.split("::\n")[:-1]
    # Names are quoted; so are descriptions, after a colon.
    found = [set(re.findall(r'(?<!:)"([^"]+)"', answer)) for answer in answers]
    assert found == list(EACH.values()), done.stderr
