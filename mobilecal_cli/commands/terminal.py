"""Terminal output: progress while a command runs, and the verdict at its end."""

from __future__ import annotations

import logging
import os
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

from mobilecal_cli.calibrate import Progress, silent
from mobilecal_cli.model.text import visible

if TYPE_CHECKING:
    from mobilecal_cli.report.verdict import Verdict

_BOLD = {"PASS": "\x1b[1;32m", "FAIL": "\x1b[1;31m", "NOT ENOUGH": "\x1b[1;33m"}  # green, red, yellow
_BOLD["GATE FAILED"] = _BOLD["FAIL"]
_PLAIN = "\x1b[0m"


def verdict_text(verdict: Verdict, to_stderr: bool = False) -> str:
    """The verdict as wrapped lines; the level is colored on a terminal, unless NO_COLOR is set."""
    stream, level, lines = sys.stderr if to_stderr else sys.stdout, verdict.level, verdict.lines
    if stream.isatty() and not os.environ.get("NO_COLOR"):
        lines[0] = f"{_BOLD[level]}{level}{_PLAIN}{lines[0][len(level) :]}"
    return "\n".join(lines)


def open_page(page: Path) -> str:
    """Open a page in the user's browser, without waiting for its end; or do nothing, without a display.

    Returns:
        A sentence that says where the page is.
    """
    shown = visible(str(page.resolve()))
    if not _has_display():
        return f"No display to open the report on: {shown}"
    # A browser in the terminal, or one that stays open, must not hold up this command.
    process = subprocess.Popen(
        [sys.executable, "-I", "-m", "webbrowser", "-t", page.resolve().as_uri()],
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,
    )
    threading.Thread(target=process.wait, daemon=True).start()
    return f"Opening the report in a browser: {shown}"


def _has_display() -> bool:
    """Whether a browser can show a window: $BROWSER also stands for one that shows it elsewhere."""
    if os.environ.get("BROWSER"):
        return True
    if sys.platform == "darwin":
        return not os.environ.get("SSH_CONNECTION")
    return bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


@contextmanager
def _stages() -> Iterator[Progress]:
    """Print each stage with its duration, and the log messages of the code, on standard error."""
    began = time.perf_counter()
    stage_began, current, last = began, "starting", ""

    def report(now: float) -> None:
        print(f"[{now - began:8.2f} s] {current}{last}: {now - stage_began:.2f} s", file=sys.stderr)

    def show(stage: str, done: int, total: int | None) -> None:
        nonlocal stage_began, current, last
        if stage != current:
            now = time.perf_counter()
            report(now)
            stage_began, current = now, stage
        last = "" if total is None and not done else f" {_count(done, total)}"

    handler = logging.StreamHandler(sys.stderr)
    handler.setFormatter(logging.Formatter("           %(message)s"))
    log = logging.getLogger("mobilecal_cli")
    level = log.level
    log.addHandler(handler)
    log.setLevel(logging.INFO)
    try:
        yield show
    finally:
        report(time.perf_counter())
        log.removeHandler(handler)
        log.setLevel(level)


def _count(done: int, total: int | None) -> str:
    """Progress as text: "3/12", or "37 steps" where the total is unknown; "" before the first step."""
    if total is not None:
        return f"{done}/{total}"
    return f"{done} steps" if done else ""


@contextmanager
def progress_bar(quiet: bool = False, verbose: bool = False) -> Iterator[Progress]:
    """Progress on standard error, if that is a terminal.

    A stage with a known total has a bar and the time left; any other stage has a moving bar and its steps.

    Args:
        quiet: show nothing.
        verbose: print a line per stage instead, also where standard error is no terminal.
    """
    if verbose:
        with _stages() as show_stage:
            yield show_stage
        return
    if quiet or not sys.stderr.isatty():
        yield silent
        return
    from rich.console import Console
    from rich.progress import BarColumn, TextColumn, TimeElapsedColumn, TimeRemainingColumn
    from rich.progress import Progress as Bar

    told = TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[counts]}")
    times = TimeElapsedColumn(), TimeRemainingColumn()
    with Bar(*told, *times, console=Console(stderr=True), transient=True) as bar:
        current, task = "starting", bar.add_task("starting", total=None, counts="")

        def show(stage: str, done: int, total: int | None) -> None:
            nonlocal current, task
            if stage != current:  # a task keeps its total and its clock, so each stage has its own
                bar.remove_task(task)
                current, task = stage, bar.add_task(stage, total=total, counts="")
            bar.update(task, completed=done, total=total, counts=_count(done, total))

        yield show
