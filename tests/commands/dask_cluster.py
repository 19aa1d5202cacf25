"""A Dask scheduler and its workers on loopback, each a process of its own."""

import json
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path


def _start(*arguments: object) -> subprocess.Popen:
    return subprocess.Popen(
        [sys.executable, "-m", *map(str, arguments)], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
    )


@contextmanager
def local_cluster(folder: Path, workers: int) -> Iterator[tuple[str, list[subprocess.Popen]]]:
    """The scheduler's address, and the workers' processes."""
    file = folder / "scheduler.json"
    scheduler = _start(
        "distributed.cli.dask_scheduler", "--host", "127.0.0.1", "--port", 0, "--no-dashboard",
        "--scheduler-file", file,
    )  # fmt: skip
    started: list[subprocess.Popen] = []
    try:
        deadline = time.monotonic() + 60
        # It exists before all of it is written, and ends with the last bracket.
        while not (file.exists() and file.read_text("utf-8").endswith("}")) and time.monotonic() < deadline:
            time.sleep(0.1)
        address = json.loads(file.read_text("utf-8"))["address"]
        here = (address, "--host", "127.0.0.1", "--no-nanny", "--no-dashboard")
        common = (*here, "--nworkers", 1, "--nthreads", 1)
        started += [
            _start("distributed.cli.dask_worker", *common, "--local-directory", folder / f"worker{number}")
            for number in range(workers)
        ]
        yield address, started
    finally:
        for process in (*started, scheduler):
            process.kill()
            process.wait()
