"""What the studies share: many runs on all cores, processes of their own, and tables in Markdown.

Run as a program, it calls a function in a process of its own, for `measured`.
"""

import json
import os
import platform
import resource
import subprocess
import sys
import textwrap
import time
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from mobilecal_cli import __version__
from mobilecal_cli.model.arrays import FloatArray

DEGREES_MM = np.concatenate([np.full(3, 180 / np.pi), np.full(6, 1e3)])
NINE_COLUMNS = ("r_x", "r_y", "r_z (deg)", "t_x", "t_y", "t_z", "rR", "rL", "b (mm)")
#: The same for ratios, which have no units.
NINE_RATIOS = tuple(name.partition(" ")[0] for name in NINE_COLUMNS)


def conditions() -> str:
    """Versions and machine, in one line."""
    packages = {"numpy": "numpy", "scipy": "scipy", "OpenCV": "opencv-python-headless"}
    versions = ", ".join(f"{name} {version(package)}" for name, package in packages.items())
    cores = f"{os.cpu_count()} cores, {platform.machine()}"
    when = f"{datetime.now(UTC):%Y-%m-%d}"
    return f"mobilecal {__version__}, Python {sys.version.split()[0]}, {versions}, {cores}, {when}"


@dataclass(frozen=True)
class Study:
    """What is asked of a study: the number of runs, and parts of the names of cases."""

    runs: int
    parts: tuple[str, ...] = ()

    def chosen(self, names: Iterable[str]) -> list[str]:
        """The names that contain one of the parts; all without parts."""
        return [name for name in names if not self.parts or any(part in name for part in self.parts)]


def results_of(run: Callable[..., Any], *case: Any, seeds: Iterable[int], together: int = 5) -> list[Any]:
    """`run(*case, seed)` for each seed, on all cores; a process gets so many seeds at a time."""
    with ProcessPoolExecutor() as pool:
        return list(pool.map(partial(run, *case), seeds, chunksize=together))


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


def measured(function: Callable[..., Any], *arguments: object, **environment: str) -> Any:
    """What a function returns in a process of its own, through JSON; it gets its arguments as strings."""
    command = [sys.executable, "-m", __name__, function.__module__, function.__name__, *map(str, arguments)]
    variables = os.environ | environment
    done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True, env=variables)
    return json.loads(done.stdout.splitlines()[-1])


def kernel_mb(name: str) -> float:
    """Memory of this process as reported by the kernel, MB: VmRSS, or VmHWM for its peak."""
    (line,) = (text for text in Path("/proc/self/status").read_text().splitlines() if text.startswith(name))
    return int(line.split()[1]) / 1024


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


if __name__ == "__main__":
    module, function, *given = sys.argv[1:]
    print(json.dumps(getattr(import_module(module), function)(*given)))
