"""The command on its arguments, in this process: importing it anew for every run would cost a second each."""

import io
import os
import subprocess
import sys
import traceback
from collections.abc import Mapping
from contextlib import chdir, redirect_stderr, redirect_stdout
from dataclasses import dataclass
from pathlib import Path
from unittest.mock import patch

from mobilecal_cli.commands import main


@dataclass(frozen=True)
class Run:
    """What a command printed and left behind."""

    code: int
    out: str
    err: str
    left: list[str]


def python(
    *arguments: object, cwd: Path | None = None, **environment: str
) -> subprocess.CompletedProcess[str]:
    """Python in a process of its own, for what a command does to its process: `-m MODULE ...` or `-c CODE ...`."""
    return subprocess.run(
        [sys.executable, *map(str, arguments)],
        cwd=cwd,
        env={**os.environ, **environment},
        capture_output=True,
        text=True,
        timeout=120,
    )


def run(*arguments: object, cwd: Path | None = None, environment: Mapping[str, str] | None = None) -> Run:
    """Run the command in a directory; its standard input is empty, and no stream is a terminal.

    tests/commands/test_start.py and tests/hostile/test_signals.py run it in processes of its own.
    """
    folder = Path() if cwd is None else cwd
    before = set() if cwd is None else set(folder.rglob("*"))
    out, err = (io.TextIOWrapper(io.BytesIO(), encoding="utf-8", write_through=True) for _ in range(2))
    code = 0
    with (
        chdir(folder),
        redirect_stdout(out),
        redirect_stderr(err),
        patch.object(sys, "argv", ["mobilecal", *map(str, arguments)]),
        patch.object(sys, "stdin", io.StringIO()),
        patch.dict(os.environ, environment or {}),
    ):
        try:
            main()
        except SystemExit as leaving:
            code = leaving.code if isinstance(leaving.code, int) else int(leaving.code is not None)
        except Exception:
            traceback.print_exc()
            code = 1
    texts = [stream.buffer.getvalue().decode() for stream in (out, err)]
    left = sorted(str(path.relative_to(folder)) for path in set(folder.rglob("*")) - before) if cwd else []
    return Run(code, *texts, left)


def succeeded(*arguments: object, cwd: Path | None = None) -> Run:
    """`run`, with exit code 0."""
    done = run(*arguments, cwd=cwd)
    assert done.code == 0, done.out + done.err
    return done
