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
from functools import partial
from multiprocessing import resource_tracker
from pathlib import Path
from threading import Thread
from typing import Any, TypeVar

from mobilecal_cli.errors import ResourceError
from mobilecal_cli.files.interruption import Interrupted, naming_interruptions, unwind_on_signals
from mobilecal_cli.files.scratch import enter_scratch, remove_all

#: Errors when processes cannot be started or one died; the caller then does the work itself.
FAILED = (BrokenProcessPool, OSError)
#: Settings of libraries that would start several threads in each process.
_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")
#: Time that a task has for its clean-up after the parent was killed, s.
_GRACE_S = 10.0

#: What a worker process opened and closes at its end.
resources = ExitStack()

Result = TypeVar("Result")


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


def _leave_with_the_caller(files: Path | None) -> None:
    caller = multiprocessing.parent_process()
    if caller is not None:
        caller.join()
        if files is not None:
            shutil.rmtree(files, ignore_errors=True)
        os.kill(os.getpid(), signal.SIGTERM)  # the task unwinds in the main thread
        time.sleep(_GRACE_S)
        os._exit(1)


def stand_by(files: Path | None = None) -> None:
    """Initialize a worker process: it ends when its parent ends for any reason, and cleans up on a signal.

    `files` of the parent are removed if it was killed.
    """
    unwind_on_signals()
    atexit.register(resources.close)
    Thread(target=_leave_with_the_caller, args=(files,), daemon=True).start()
    work(signal.pthread_sigmask, signal.SIG_UNBLOCK, {signal.SIGINT})


@contextmanager
def _blocked(number: signal.Signals) -> Iterator[None]:
    """Block a signal in processes started inside the block; here, it is delivered at the end of the block."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {number})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def work(task: Callable[..., Result], *given: Any) -> Result:  # noqa: ANN401
    """Run a task in a worker process; a signal ends the process after the task has unwound."""
    try:
        with naming_interruptions():
            return task(*given)
    except Interrupted as leaving:  # the pool would send it to the caller as the task's result
        resources.close()
        remove_all()
        os._exit(int(leaving.code or 1))


def submitted(pool: ProcessPoolExecutor, task: Callable[..., Result], *given: Any) -> Future[Result]:  # noqa: ANN401
    """A task that a process of a pool imports, too, so that a signal at that moment does not end in an error."""
    return pool.submit(work, _unpacked, pickle.dumps((task, given)))


def _unpacked(packed: bytes) -> Any:  # noqa: ANN401
    task, given = pickle.loads(packed)
    return task(*given)


@contextmanager
def workers(count: int, files: Path | None = None) -> Iterator[ProcessPoolExecutor]:
    """A pool of `count` worker processes that `stand_by`; a signal in this process ends them at once.

    Raises:
        OSError, BrokenProcessPool: a process cannot be started.
    """
    # A hangup reaches all processes of the terminal: the one that removes leaked semaphores must outlive them.
    with _blocked(signal.SIGHUP):
        resource_tracker.ensure_running()
    # Spawned, not forked: a fork would copy locked mutexes of other threads.
    pool = ProcessPoolExecutor(count, multiprocessing.get_context("spawn"), stand_by, (files,))
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


def _do(question: Path, answer: Path) -> None:
    packed = question.read_bytes()
    question.unlink()
    answer.write_bytes(pickle.dumps(_unpacked(packed), pickle.HIGHEST_PROTOCOL))


#: Submits a task with its arguments; returns a function that waits for the result, to be called once.
Submit = Callable[..., Callable[[], Any]]


@contextmanager
def processes(count: int) -> Iterator[Submit | None]:
    """What submits tasks to `count` worker processes inside the block; None if these cannot be started.

    Submitting raises one of `FAILED` if a process died; waiting for a result does so, too, or raises the task's error.

    Tasks and results are passed in files: if a process died while it sent a long message through a pipe, the
    other end would wait forever.
    """
    submit = None
    with ExitStack() as stack:
        with suppress(*FAILED, NotImplementedError, ResourceError), _one_thread_each():
            files = enter_scratch(stack)
            pool = stack.enter_context(workers(count, files))
            submit = partial(_submitted_in_files, files, pool, itertools.count())
        yield submit


def _submitted_in_files(
    files: Path,
    pool: ProcessPoolExecutor,
    numbers: Iterator[int],
    task: Callable[..., Result],
    *given: Any,  # noqa: ANN401
) -> Callable[[], Result]:
    number = next(numbers)
    question, answer = (files / f"{number}.{what}" for what in ("task", "result"))
    question.write_bytes(pickle.dumps((task, given), pickle.HIGHEST_PROTOCOL))
    done = pool.submit(work, _do, question, answer)

    def result() -> Result:
        done.result()
        returned: Result = pickle.loads(answer.read_bytes())
        answer.unlink()
        return returned

    return result
