"""Worker processes: results, errors, and cleanup after a crash."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from mobilecal_cli.calibrate.workers import FAILED, answer, processes

_LARGE = 10_000_000  # bytes; a pipe holds 65,536

_CALLER = """
import os, sys, time
from mobilecal_cli.calibrate.workers import answer, processes

if __name__ == "__main__":
    with processes(1) as submit:
        done = submit(os.getpid)
        print(answer(done), done.result().parent, flush=True)
        submit(bytes, {large})
        time.sleep(60)
"""


_STARTING = """
import os, signal, sys, time
from mobilecal_cli.files.interruption import unwind_on_signals
from mobilecal_cli.calibrate.workers import processes

if __name__ != "__main__":
    time.sleep(20)  # as if a worker process imported large modules
else:
    signal.signal(signal.SIGINT, signal.default_int_handler)  # a shell's background command ignores it
    unwind_on_signals()
    with processes(2):
        time.sleep(float(sys.argv[1]))
        os.killpg(0, signal.SIGINT)
        time.sleep(60)
"""


def test_tasks_are_done_in_other_processes_and_leave_no_files():
    with processes(2) as submit:
        results = [submit(bytes.upper, letter * _LARGE) for letter in (b"a", b"b")]
        folder = results[0].result().parent
        assert list(map(answer, results)) == [b"A" * _LARGE, b"B" * _LARGE]
        assert answer(submit(os.getpid)) != os.getpid()
        assert list(folder.iterdir()) == []
    assert not folder.exists()


def test_an_error_comes_back():
    with processes(1) as submit, pytest.raises(ValueError, match="invalid literal"):
        answer(submit(int, "one"))


def test_a_death_among_large_tasks_is_told():
    with processes(1) as submit:
        number = answer(submit(os.getpid))
        results = [submit(bytes.upper, b"a" * _LARGE) for _ in range(4)]
        os.kill(number, signal.SIGKILL)
        with pytest.raises(FAILED):
            answer(results[-1])


def _runs(number: str) -> bool:
    try:
        status = Path(f"/proc/{number}/status").read_text()
    except FileNotFoundError:
        return False
    return "\nState:\tZ" not in status  # a zombie has ended; whoever adopted it has not asked yet


@pytest.mark.skipif(not Path("/proc").is_dir(), reason="asks /proc")
def test_a_caller_that_is_killed_leaves_neither_process_nor_files(tmp_path):
    script = tmp_path / "caller.py"
    script.write_text(_CALLER.format(large=_LARGE))
    with subprocess.Popen([sys.executable, script], stdout=subprocess.PIPE, text=True) as caller:
        number, folder = caller.stdout.readline().split()
        assert _runs(number)
        time.sleep(0.5)
        caller.kill()
    deadline = time.monotonic() + 30
    while _runs(number) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not _runs(number)
    assert not Path(folder).exists()


@pytest.mark.parametrize("after_s", [0.0, 0.3, 1.0])
def test_an_interrupt_while_processes_start_leaves_no_traceback(tmp_path, after_s):
    script = tmp_path / "starting.py"
    script.write_text(_STARTING)
    ended = subprocess.run(
        [sys.executable, str(script), str(after_s)],
        env=os.environ | {"TMPDIR": str(tmp_path)},
        capture_output=True,
        text=True,
        timeout=50,
        start_new_session=True,
    )
    assert ended.returncode == 128 + signal.SIGINT
    assert ended.stderr == ""
    assert [path.name for path in tmp_path.iterdir()] == ["starting.py"]
