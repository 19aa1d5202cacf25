"""Processes beside this one that stand ready for tasks."""

from __future__ import annotations

import itertools
import multiprocessing
import os
import pickle
import shutil
import signal
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from pathlib import Path
from tempfile import TemporaryDirectory
from threading import Thread
from types import TracebackType
from typing import Any, Generic, Self, TypeVar

#: What comes of processes that cannot be started, or of which one died: the work is done in this process then.
FAILED = (BrokenProcessPool, OSError)
#: Libraries that would start threads of their own in each of the processes.
_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")

Result = TypeVar("Result")


@contextmanager
def _one_thread_each() -> Iterator[None]:
    """Processes that are started meanwhile do their sums on one thread."""
    before = {name: os.environ.get(name) for name in _THREADS}
    os.environ.update(dict.fromkeys(_THREADS, "1"))
    try:
        yield
    finally:
        for name, value in before.items():
            if value is None:
                os.environ.pop(name, None)
            else:
                os.environ[name] = value


def _leave_with_the_caller(files: Path | None) -> None:
    caller = multiprocessing.parent_process()
    if caller is not None:
        caller.join()
        if files is not None:
            shutil.rmtree(files, ignore_errors=True)
        os._exit(1)


def stand_by(files: Path | None = None, get_ready: Callable[..., object] = int, *given: Any) -> None:  # noqa: ANN401
    """What a process does first: see to it that it ends with the one that called it, however that ends; get ready.

    Ctrl-C ends it without a word: the command tells that it was interrupted.

    Args:
        files: a folder of the caller's, to be removed if the caller did not live to do so.
        get_ready: called last.
        given: what it is called with.
    """
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    Thread(target=_leave_with_the_caller, args=(files,), daemon=True).start()
    get_ready(*given)


def _do(question: Path, answer: Path) -> None:
    task, given = pickle.loads(question.read_bytes())
    question.unlink()
    answer.write_bytes(pickle.dumps(task(*given), pickle.HIGHEST_PROTOCOL))


class Task(Generic[Result]):
    """A task that a process was given."""

    def __init__(self, done: Future[None], answer: Path) -> None:
        self._done, self._answer = done, answer

    def result(self) -> Result:
        """What came of it, once: waits for it. Raises what the task raised, or one of `FAILED`."""
        self._done.result()
        result: Result = pickle.loads(self._answer.read_bytes())
        self._answer.unlink()
        return result


class Processes:
    """Some processes, from `start` to the end of a `with` block.

    Tasks and results pass through files: a process that dies in the middle of a pipe's long message leaves the other
    end waiting for the rest of it for ever.
    """

    def __init__(self) -> None:
        self._pool: ProcessPoolExecutor | None = None
        self._files: TemporaryDirectory[str] | None = None
        self._numbers = itertools.count()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._pool is not None:
            self._pool.shutdown(cancel_futures=True)
        if self._files is not None:
            self._files.cleanup()

    @property
    def started(self) -> bool:
        """Whether there are any."""
        return self._pool is not None

    def start(self, count: int, get_ready: Callable[..., object], *given: Any) -> None:  # noqa: ANN401
        """Start so many, each of which calls `get_ready` first; none where that is not possible."""
        with suppress(*FAILED, NotImplementedError), _one_thread_each():
            if self._files is None:
                self._files = TemporaryDirectory(prefix="mobilecal-", ignore_cleanup_errors=True)
            # Spawned, not forked: a fork would copy locks that other threads hold.
            spawn = multiprocessing.get_context("spawn")
            self._pool = ProcessPoolExecutor(
                count, spawn, stand_by, (Path(self._files.name), get_ready, *given)
            )
            for _ in range(count):  # a process is started with each of the first tasks
                self._pool.submit(int)

    def submit(self, task: Callable[..., Result], *given: Any) -> Task[Result]:  # noqa: ANN401
        """Have a task done by the next process that is free.

        Raises:
            OSError, BrokenProcessPool: see `FAILED`.
        """
        if self._pool is None or self._files is None:
            raise OSError("no processes were started")
        number = next(self._numbers)
        question, answer = (Path(self._files.name, f"{number}.{what}") for what in ("task", "result"))
        question.write_bytes(pickle.dumps((task, given), pickle.HIGHEST_PROTOCOL))
        return Task(self._pool.submit(_do, question, answer), answer)
