"""What the studies share: their arguments, many runs on all cores, and tables in Markdown."""

from __future__ import annotations

import json
import os
import platform
import resource
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np
import scipy

from mobilecal_cli import __version__
from mobilecal_cli.model import FloatArray

DEGREES_MM = np.concatenate([np.full(3, 180 / np.pi), np.full(6, 1e3)])
NINE_COLUMNS = ("r_x", "r_y", "r_z (deg)", "t_x", "t_y", "t_z", "rR", "rL", "b (mm)")
#: The same for ratios, which have no units.
NINE_RATIOS = tuple(name.partition(" ")[0] for name in NINE_COLUMNS)


def conditions() -> str:
    """Versions and machine, in one line."""
    versions = f"numpy {np.__version__}, scipy {scipy.__version__}"
    cores = f"{os.cpu_count()} cores, {platform.machine()}"
    when = f"{datetime.now(UTC):%Y-%m-%d}"
    return f"mobilecal {__version__}, Python {sys.version.split()[0]}, {versions}, {cores}, {when}"


@dataclass(frozen=True)
class Study:
    """Arguments of a study: the number of runs, then parts of the names of cases."""

    runs: int
    parts: tuple[str, ...] = ()

    @classmethod
    def begun(cls, runs: int) -> Study:
        """Those of the command line; `runs` by default. The conditions are printed first."""
        print(conditions())
        return cls(int(sys.argv[1]) if len(sys.argv) > 1 else runs, tuple(sys.argv[2:]))

    def chosen(self, names: Iterable[str]) -> list[str]:
        """The names that contain one of the parts; all without parts."""
        return [name for name in names if not self.parts or any(part in name for part in self.parts)]


def results_of(run: Callable[..., Any], *case: Any, seeds: Iterable[int], together: int = 5) -> list[Any]:
    """`run(*case, seed)` for each seed."""
    return list(map_runs(run, [(*case, seed) for seed in seeds], together))


def map_runs(run: Callable[..., Any], tasks: list[tuple[Any, ...]], together: int = 5) -> Iterator[Any]:
    """`run` on every task, on all cores, results in the tasks' order; a process gets so many at a time."""
    with ProcessPoolExecutor() as pool:
        yield from pool.map(run, *zip(*tasks, strict=True), chunksize=together)


#: As on a user's machine, where byte code is kept.
_ENVIRONMENT = {name: value for name, value in os.environ.items() if name != "PYTHONDONTWRITEBYTECODE"}


def spent(command: list[str]) -> tuple[float, float]:
    """Wall time and processor time of a command that may not pass, its child processes included, s."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    start = time.perf_counter()
    done = subprocess.run(command, capture_output=True, check=False, env=_ENVIRONMENT)
    wall = time.perf_counter() - start
    if done.returncode not in (0, 6):
        raise RuntimeError(done.stderr.decode())
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def measured(module: str, *arguments: object, **environment: str) -> Any:
    """What a module of this package prints last, as JSON: measured in a process of its own."""
    command = [sys.executable, "-m", f"tests.bench.{module}", *map(str, arguments)]
    variables = os.environ | environment
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True, env=variables)
    return json.loads(done.stdout.splitlines()[-1])


def kernel_mb(name: str) -> float:
    """Memory of this process as reported by the kernel, MB: VmRSS, or VmHWM for its peak."""
    (line,) = (text for text in Path("/proc/self/status").read_text().splitlines() if text.startswith(name))
    return int(line.split()[1]) / 1024


def by_length(study: Callable[[int, int], None]) -> None:
    """A study with N = 12 and with N = 40; runs as an argument, 1,000 by default."""
    runs = Study.begun(1000).runs
    for stations in (12, 40):
        study(stations, runs)


def head(*columns: str, title: str = "") -> None:
    """Print the head of a table, below a title."""
    print(f"\n{title}\n" if title else "")
    line(*columns)
    line(*["---"] * len(columns))


def line(*cells: object) -> None:
    """Print one line of a table, at once."""
    print("| " + " | ".join(map(str, cells)) + " |", flush=True)


def numbers(values: FloatArray, digits: int = 2) -> list[str]:
    """Cells of a table."""
    return [f"{value:.{digits}f}" for value in values]


def rms(values: FloatArray) -> FloatArray:
    """Root mean square over the runs, (n, k) → (k,); runs without a result have NaN."""
    return np.asarray(np.sqrt(np.nanmean(np.square(values), axis=0)))


def table(head: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A Markdown table."""
    lines = [head, ["---"] * len(head), *rows]
    return "".join("| " + " | ".join(line) + " |\n" for line in lines)


def paragraph(text: str) -> str:
    """A paragraph, wrapped at 100 columns, with an empty line after it."""
    return textwrap.fill(text, 100, break_long_words=False, break_on_hyphens=False) + "\n\n"
