"""Worker processes for tasks in the background."""

from __future__ import annotations

import atexit
import itertools
import multiprocessing
import os
import pickle
import shutil
import signal
import time
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import ExitStack, contextmanager, suppress
from multiprocessing import resource_tracker
from pathlib import Path
from threading import Thread
from typing import Any

from mobilecal_cli.errors import ResourceError
from mobilecal_cli.files.interruption import Interrupted, naming_interruptions, unwind_on_signals
from mobilecal_cli.files.scratch import remove_all, scratch_directory

#: Errors when processes cannot be started or one died; the caller then does the work itself.
FAILED = (BrokenProcessPool, OSError)
#: Settings of libraries that would start several threads in each process.
_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
#: Time that a task has for its clean-up after the parent was killed, s.
_GRACE_S = 10.0

#: What a worker process opened and closes at its end.
resources = ExitStack()
#: Submits a task with its arguments; `answer` waits for the result.
Submit = Callable[..., Future[Path]]


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Limit the numerical libraries of processes started inside the block to one thread."""
    before = {name: os.environ[name] for name in _THREADS if name in os.environ}
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    try:
        yield
    finally:
        for name in _THREADS:
            os.environ.pop(name, None)
        os.environ.update(before)


@contextmanager
def _blocked(number: signal.Signals) -> Iterator[None]:
    """Block a signal in processes started inside the block; here, it is delivered at the end of the block."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {number})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


@contextmanager
def ending_on_signals() -> Iterator[None]:
    """In a worker process: a signal inside the block ends the process after the block has unwound."""
    try:
        with naming_interruptions():
            yield
    except Interrupted as leaving:  # the pool would send it to the caller as the task's result
        resources.close()
        remove_all()
        os._exit(int(leaving.code or 1))


def _leave_with_the_caller(files: Path) -> None:
    caller = multiprocessing.parent_process()
    if caller is not None:
        caller.join()
        shutil.rmtree(files, ignore_errors=True)
        os.kill(os.getpid(), signal.SIGTERM)  # the task unwinds in the main thread
        time.sleep(_GRACE_S)
        os._exit(1)


def _stand_by(files: Path) -> None:
    """Initialize a worker process: it ends when its parent ends for any reason, and cleans up on a signal.

    `files` of the parent are removed if it was killed.
    """
    unwind_on_signals()
    atexit.register(resources.close)
    Thread(target=_leave_with_the_caller, args=(files,), daemon=True).start()
    with ending_on_signals():
        signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})


@contextmanager
def _pool(count: int, files: Path) -> Iterator[ProcessPoolExecutor]:
    """A pool of `count` worker processes; a signal in this process ends them at once."""
    # A hangup reaches all processes of the terminal: the one that removes leaked semaphores must outlive them.
    with _blocked(signal.SIGHUP):
        resource_tracker.ensure_running()
    # Spawned, not forked: a fork would copy locked mutexes of other threads.
    pool = ProcessPoolExecutor(count, multiprocessing.get_context("spawn"), _stand_by, (files,))
    try:
        # Ctrl-C reaches processes that still import modules, where Python would print a traceback.
        with _blocked(signal.SIGINT):
            for _ in range(count):  # the pool starts a process with each of the first tasks
                pool.submit(int)
        yield pool
    except Interrupted:
        for child in multiprocessing.active_children():
            child.terminate()
        raise
    finally:
        pool.shutdown(cancel_futures=True)


@contextmanager
def processes(count: int) -> Iterator[Submit | None]:
    """What submits tasks to `count` worker processes inside the block; None if these cannot be started.

    Submitting raises one of `FAILED` if a process died.

    Tasks and results are passed in files: if a process died while it sent a long message through a pipe, the
    other end would wait forever.
    """
    with ExitStack() as stack:
        pool, numbers = None, itertools.count()
        with suppress(*FAILED, NotImplementedError, ResourceError), _one_thread_each():
            files = stack.enter_context(scratch_directory())
            pool = stack.enter_context(_pool(count, files))

        def submit(task: Callable[..., Any], *given: Any) -> Future[Path]:  # noqa: ANN401
            assert pool is not None
            path = files / str(next(numbers))
            path.write_bytes(pickle.dumps((task, given), pickle.HIGHEST_PROTOCOL))
            return pool.submit(do_task, path)

        yield submit if pool is not None else None


def do_task(path: Path) -> Path:
    """Do the task in a file, in a worker process, and replace it by the result.

    It is unpickled here, and not by the pool: a signal while that imports modules must end the process, too.
    """
    with ending_on_signals():
        task, given = pickle.loads(path.read_bytes())
        path.write_bytes(pickle.dumps(task(*given), pickle.HIGHEST_PROTOCOL))
    return path


def answer(future: Future[Path]) -> Any:  # noqa: ANN401
    """The result of a submitted task, to be called once.

    Raises:
        BrokenProcessPool: a process died.
        Exception: the task's error.
    """
    path = future.result()
    returned = pickle.loads(path.read_bytes())
    path.unlink()
    return returned
