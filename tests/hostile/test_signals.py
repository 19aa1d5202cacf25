"""Commands that are ended by signals, at many moments: the old or the new output whole, and nothing else left."""

import contextlib
import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import pytest
import zstandard

from mobilecal_cli.files.scratch import abandoned, scratch_directory
from tests.command import python
from tests.hostile.refusals import extraction

SEMAPHORES = Path("/dev/shm")
KILL, TERM, HUP, INT = signal.SIGKILL, signal.SIGTERM, signal.SIGHUP, signal.SIGINT
NAMES = ["extraction.npz", "params.yaml", "report.html", "report.json"]


@pytest.fixture(autouse=True)
def no_signal_ignored():
    """The commands inherit it: under nohup or in the background of a shell, signals would be ignored."""
    usual = signal.default_int_handler, signal.SIG_DFL
    before = [signal.signal(number, how) for number, how in zip((INT, HUP), usual, strict=True)]
    yield
    for number, how in zip((INT, HUP), before, strict=True):
        signal.signal(number, how)


def started(arguments, cwd, **environment):
    """The command in a process group of its own, with an own directory for temporary files."""
    (cwd / "tmp").mkdir(exist_ok=True)
    return subprocess.Popen(
        [sys.executable, "-m", "mobilecal_cli", *map(str, arguments)],
        cwd=cwd,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        env={**os.environ, "TMPDIR": str(cwd / "tmp"), "OPENBLAS_NUM_THREADS": "1", **environment},
    )


def semaphores():
    return set(SEMAPHORES.iterdir()) if SEMAPHORES.is_dir() else set()


def ended(process, number, everyone):
    """Send the signal, wait for the end; exit code and standard error."""
    with contextlib.suppress(ProcessLookupError):  # it had finished: the exit code says so
        (os.killpg if everyone else os.kill)(process.pid, number)
    _, err = process.communicate(timeout=60)
    deadline = time.monotonic() + 15
    while time.monotonic() < deadline:  # worker processes notice the end of their parent
        try:
            os.killpg(process.pid, 0)
        except ProcessLookupError:
            break
        time.sleep(0.1)
    else:
        pytest.fail("processes are left")
    return process.returncode, err


def whole_or_nothing(folder, name="out"):
    """Whether the output exists; then it is complete, and nothing else is there."""
    assert sorted(path.name for path in folder.iterdir() if path.name != "tmp") in ([], [name])
    out = folder / name
    if out.exists():
        assert sorted(path.name for path in out.iterdir()) == NAMES
    return out.exists()


def cleaned(process, number, everyone, folder):
    """End a command and check that it cleaned up; whether it had finished."""
    before = semaphores()
    code, err = ended(process, number, everyone)
    assert "Traceback" not in err
    assert not list((folder / "tmp").iterdir())
    left, deadline = semaphores() - before, time.monotonic() + 30
    while left & semaphores() and time.monotonic() < deadline:  # those of other tests go away
        time.sleep(0.2)
    assert not left & semaphores()
    if code == 128 + number:
        assert err.splitlines()[-1].startswith("interrupted: ")
        return False
    assert code in (0, 6, -number)  # the last: it had finished, and Python was shutting down
    return True


@pytest.mark.parametrize(
    ("number", "everyone"),
    [
        (HUP, True),  # Ctrl-C: tests/commands/test_calibrate.py
        *(
            pytest.param(*case, marks=pytest.mark.long)
            for case in ((TERM, False), (TERM, True), (HUP, False), (INT, False), (INT, True))
        ),
    ],
)
def test_calibrate(sample_logs, tmp_path, number, everyone):
    process = started(["calibrate", sample_logs / "straight.mcap", "-o", "out"], tmp_path)
    time.sleep(1.5)
    finished = cleaned(process, number, everyone, tmp_path)
    assert whole_or_nothing(tmp_path) == finished


@pytest.mark.long
def test_nohup(sample_logs, tmp_path):
    """A hangup that the caller ignores stays ignored."""
    command = [sys.executable, "-m", "mobilecal_cli", "calibrate", sample_logs / "straight.mcap", "-o", "out"]
    process = subprocess.Popen(
        ["nohup", *command], cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )
    time.sleep(2)
    process.send_signal(HUP)
    assert process.wait(60) == 6
    assert whole_or_nothing(tmp_path)


@pytest.mark.parametrize("number", [TERM, pytest.param(HUP, marks=pytest.mark.long)])
def test_an_unpacked_recording(sample_logs, tmp_path, tmp_path_factory, number):
    packed = tmp_path_factory.mktemp("logs") / "log.mcap.zstd"
    packed.write_bytes(zstandard.compress((sample_logs / "paper_robot.mcap").read_bytes()))
    process = started(["inspect", packed], tmp_path)
    while not list(tmp_path.glob("tmp/*/log.mcap")) and process.poll() is None:
        time.sleep(0.01)
    assert not cleaned(process, number, False, tmp_path)


@pytest.mark.parametrize("number", [pytest.param(TERM, marks=pytest.mark.long), HUP])
def test_simulate(tmp_path, number):
    process = started(["simulate", "log.mcap", "--stations", 12], tmp_path)
    while not list(tmp_path.glob(".log.mcap.*.partial/*")) and process.poll() is None:
        time.sleep(0.05)
    assert not cleaned(process, number, False, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["tmp"]


@pytest.mark.parametrize(
    ("number", "everyone"),
    [
        (TERM, True),
        *(pytest.param(*case, marks=pytest.mark.long) for case in ((HUP, False), (TERM, False), (HUP, True))),
    ],
)
def test_batch(sample_logs, tmp_path, tmp_path_factory, number, everyone):
    logs = tmp_path_factory.mktemp("logs")
    for name in ("straight", "paper_robot"):
        packed = zstandard.compress((sample_logs / f"{name}.mcap").read_bytes())
        (logs / f"{name}.mcap").write_bytes(packed)
    process = started(["batch", logs, "-o", "out", "--jobs", 2], tmp_path)
    while not list(tmp_path.glob("tmp/*/[!0-9]*")) and process.poll() is None:
        time.sleep(0.01)
    time.sleep(0.2)  # the other process unpacks too, where the machine lets it
    assert not cleaned(process, number, everyone, tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["tmp"]


def test_an_interruption_after_the_output_is_in_place_says_so(tmp_path):
    code = (
        "import os, signal, sys\n"
        "from mobilecal_cli import __main__, export\n"
        "from mobilecal_cli.files import placing\n"
        "sync = placing._sync\n"
        "placing._sync = lambda folder: (sync(folder), os.kill(os.getpid(), signal.SIGINT))\n"
        "__main__.main()\n"
    )
    extraction(tmp_path)
    (tmp_path / "work").mkdir()
    arguments = ["calibrate", tmp_path / "e.npz", "--method", "linear", "-o", "out"]
    result = python("-c", code, *arguments, cwd=tmp_path / "work")
    assert result.returncode == 130
    assert result.stderr == f"interrupted: written: {tmp_path / 'work' / 'out'}\n"
    assert whole_or_nothing(tmp_path / "work")


def test_temporary_files_of_a_killed_run_are_removed_by_the_next(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    (tmp_path / "mobilecal-left").mkdir()
    (tmp_path / "mobilecal-left/log.mcap").write_text("unpacked")
    (tmp_path / "other").mkdir()
    with scratch_directory() as one, scratch_directory() as two:
        assert sorted(tmp_path.iterdir()) == sorted([one, two, tmp_path / "other"])
    assert list(tmp_path.iterdir()) == [tmp_path / "other"]


def test_a_temporary_directory_that_another_command_removes_before_the_lock(tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    real, made = tempfile.mkdtemp, []

    def mkdtemp(**named):
        made.append(Path(real(**named)))
        if len(made) < 3:  # another command looks for abandoned directories at this moment
            with abandoned(made[-1]) as free:
                assert free
                shutil.rmtree(made[-1])
        return str(made[-1])

    monkeypatch.setattr("tempfile.mkdtemp", mkdtemp)
    with scratch_directory() as path:
        assert path == made[-1]
        with abandoned(path) as free:
            assert not free
        (path / "file").write_bytes(b"")
    assert len(made) == 3
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("step", ["tempfile.mkdtemp", "os.open", "shutil.rmtree"])
def test_a_signal_while_a_temporary_directory_is_created_or_removed(tmp_path, step):
    """The signal comes just before or after a system call has done its work."""
    code = f"""
import os, shutil, signal, tempfile
from contextlib import ExitStack
from mobilecal_cli.files.interruption import unwind_on_signals
from mobilecal_cli.files.scratch import scratch_directory

unwind_on_signals()
call, seen = {step}, []

def interrupted(*given, **named):
    late = {step != "shutil.rmtree"}
    made = call(*given, **named) if late else None
    if not seen:
        seen.append(os.kill(os.getpid(), signal.SIGTERM))
    return made if late else call(*given, **named)

{step} = interrupted
with ExitStack() as stack:
    stack.enter_context(scratch_directory())
"""
    result = python("-c", code, TMPDIR=str(tmp_path))
    assert (result.returncode, result.stderr) == (128 + TERM, "")
    assert not list(tmp_path.iterdir())


def test_a_signal_as_the_clean_up_of_a_replacement_begins(tmp_path):
    """Before its first step: the replaced output was left beside the new one."""
    code = """
import os, signal
from pathlib import Path
import mobilecal_cli.files.placing as placing
from mobilecal_cli.files.interruption import unwind_on_signals

unwind_on_signals()
deferred, seen = placing.uninterrupted, []

def uninterrupted():
    if not seen and placed:
        seen.append(os.kill(os.getpid(), signal.SIGTERM))
    return deferred()

target, placed = Path("out"), []
target.write_text("old")
placing.uninterrupted = uninterrupted
with placing.partial_of(target, lambda path: ()) as partial:
    partial.write_text("new")
    placing.place(partial, target, lambda path: (), force=True)
    placed.append(target)
"""
    result = python("-c", code, cwd=tmp_path)
    assert (result.returncode, result.stderr) == (128 + TERM, "")
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("out", "new")]


@pytest.mark.parametrize(
    "end", ["with ending_on_signals(): task()", "task()"], ids=["worker", "main process"]
)
def test_a_signal_while_nothing_is_responsible_for_a_temporary_directory(tmp_path, end):
    """A recording was unpacked, and its caller does not have it yet."""
    code = f"""
from contextlib import ExitStack
from mobilecal_cli.files.interruption import Interrupted
from mobilecal_cli.calibrate.workers import ending_on_signals
from mobilecal_cli.files.scratch import scratch_directory

kept = []

def task():
    kept.append(ExitStack())
    kept[0].enter_context(scratch_directory())
    raise Interrupted(143)

{end}
"""
    result = python("-c", code, TMPDIR=str(tmp_path))
    assert (result.returncode, result.stderr) == (143, "")
    assert not list(tmp_path.iterdir())


def test_a_signal_that_an_import_swallows_or_turns_into_another_error(tmp_path):
    """An extension module that is being initialized ends with ImportError, or goes on."""
    ends = {
        "do_task(task)": "",
        "batch.run_job(job)": "",
        "__main__.main()": "interrupted: nothing was written\n",
    }
    thens = "raise ImportError('initialization failed')", "import colorsys; os._exit(0)", "pass"
    cases = [(end, then) for end in ends for then in thens]
    code = f"""
import os, pickle, signal, sys
from pathlib import Path
from mobilecal_cli import __main__, commands
from mobilecal_cli.calibrate import batch
from mobilecal_cli.calibrate.workers import do_task
from mobilecal_cli.files.interruption import unwind_on_signals

def importing(*given, **named):
    try:
        os.kill(os.getpid(), signal.SIGTERM)
    except SystemExit:
        pass
    exec(then)

class Importing:
    def __reduce__(self):
        return importing, ()

task = Path("task")
task.write_bytes(pickle.dumps(Importing()))
commands.app = batch.calibrate = importing
job = batch.FleetJob("robot", (Path("log.mcap"),), None, Path("."))
for number, (end, then) in enumerate({cases}):
    if os.fork() == 0:
        os.dup2(os.open(f"{{number}}.err", os.O_WRONLY | os.O_CREAT), 2)
        unwind_on_signals()
        exec(end)
        sys.exit("not interrupted")
    print(os.waitstatus_to_exitcode(os.wait()[1]), flush=True)
"""
    (tmp_path / "log.mcap").touch()
    result = python("-c", code, cwd=tmp_path)
    assert result.stderr == ""
    said = [(tmp_path / f"{number}.err").read_text() for number in range(len(cases))]
    assert said == [ends[end] for end, _ in cases]
    assert [int(line) for line in result.stdout.split()] == [128 + TERM] * len(cases)


def test_ctrl_c_during_the_first_imports_prints_no_traceback():
    code = """
import os, signal, sys

class Kill:
    def find_spec(self, name, *_):
        if name == "mobilecal_cli.files":
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, Kill())
from mobilecal_cli.__main__ import main

main()
"""
    result = python("-c", code)
    assert (result.returncode, result.stderr) == (-INT, "")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("number", "count", "of"),
    [(number, k, of) for number, of in ((KILL, 20), (TERM, 10), (HUP, 5)) for k in range(of)],
)
def test_at_any_moment_of_a_replacement(sample_logs, tmp_path, number, count, of):
    """An output is replaced; the moments are spread over the last half of the run."""
    logs = [sample_logs / "straight.mcap", "-o", "out", "--force"]
    process = started(["calibrate", *logs], tmp_path)
    began = time.monotonic()
    process.communicate()
    lasted = time.monotonic() - began
    old = (tmp_path / "out/params.yaml").stat().st_ino
    process = started(["calibrate", *logs], tmp_path)
    time.sleep(lasted * (0.5 + count / of / 2))
    code, err = ended(process, number, everyone=bool(count % 2))
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == NAMES
    if number != KILL:
        assert "Traceback" not in err
        assert code in (128 + number, -number, 6)  # -number: Python has ended but for its own cleaning up
        assert whole_or_nothing(tmp_path)
        assert not list((tmp_path / "tmp").iterdir())
        if code == 128 + number:
            changed = (tmp_path / "out/params.yaml").stat().st_ino != old
            said = "interrupted: written" if changed else "interrupted: nothing"
            assert err.splitlines()[-1].startswith(said)
    process = started(["calibrate", *logs], tmp_path)
    process.communicate()
    assert whole_or_nothing(tmp_path)
    assert not list((tmp_path / "tmp").iterdir())
