"""Processes beside this one that stand ready for tasks."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import contextmanager, suppress
from multiprocessing import get_context
from types import TracebackType
from typing import Any, Self

#: What a pool raises that cannot be started, or of which a process died: the work is done in this process then.
FAILED = (BrokenProcessPool, OSError)
#: Libraries that would start threads of their own in each of the processes.
_THREADS = ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS")


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


class Processes:
    """Some processes, from `start` to the end of a `with` block.

    Attributes:
        pool: takes their tasks; None where there are no processes.
    """

    def __init__(self) -> None:
        self.pool: ProcessPoolExecutor | None = None

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self.pool is not None:
            self.pool.shutdown(cancel_futures=True)

    def start(self, count: int, get_ready: Callable[..., None], *given: Any) -> None:  # noqa: ANN401
        """Start so many, each of which calls `get_ready` first; none where that is not possible."""
        with suppress(*FAILED, NotImplementedError), _one_thread_each():
            # Spawned, not forked: a fork would copy locks that other threads hold.
            self.pool = ProcessPoolExecutor(count, get_context("spawn"), get_ready, given)
            for _ in range(count):  # a process is started with each of the first tasks
                self.pool.submit(int)
