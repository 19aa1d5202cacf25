"""What the terminal shows while a command works: a bar on a terminal, nothing elsewhere."""

from __future__ import annotations

import logging
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager

from mobilecal_cli.pipeline import Progress, silent


@contextmanager
def _stages() -> Iterator[Progress]:
    """A line on standard error for every stage, with the time that it took, and what the code has to tell."""
    began = time.perf_counter()
    stage_began, current, last = began, "starting", ""

    def told(now: float) -> None:
        print(f"[{now - began:8.2f} s] {current}{last}: {now - stage_began:.2f} s", file=sys.stderr)

    def show(stage: str, done: int, total: int | None) -> None:
        nonlocal stage_began, current, last
        if stage != current:
            now = time.perf_counter()
            told(now)
            stage_began, current = now, stage
        last = "" if total is None else f" {done}/{total}"

    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter("           %(message)s"))
    log = logging.getLogger("mobilecal_cli")
    level = log.level
    log.addHandler(handler)
    log.setLevel(logging.INFO)
    try:
        yield show
    finally:
        told(time.perf_counter())
        log.removeHandler(handler)
        log.setLevel(level)


@contextmanager
def progress_bar(quiet: bool = False, verbose: bool = False) -> Iterator[Progress]:
    """A progress bar with counts and time left on standard error, if that is a terminal.

    Args:
        quiet: nothing at all.
        verbose: a line for every stage instead, also where there is no terminal.
    """
    if verbose:
        with _stages() as show_stage:
            yield show_stage
        return
    if quiet or not sys.stderr.isatty():
        yield silent
        return
    from rich.console import Console
    from rich.progress import BarColumn, SpinnerColumn, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(),
        TextColumn("{task.fields[counts]}"),
        TimeRemainingColumn(),
    )
    with Bar(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("starting", total=None, counts="")

        def show(stage: str, done: int, total: int | None) -> None:
            counts = "" if total is None else f"{done}/{total}"
            bar.update(task, description=stage, completed=done, total=total, counts=counts)

        yield show
