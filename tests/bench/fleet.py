"""Simulated robots in worker processes, and once more.

Every sixth recording is truncated, so some robots fail.
"""

from __future__ import annotations

import csv
import tempfile
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

from mobilecal_cli import calibrate as progress
from mobilecal_cli.calibrate import batch as fleet
from mobilecal_cli.simulate.record import simulate
from mobilecal_cli.simulate.scenario import Scenario
from tests.bench.study import Study

RUNS = 24  # robots
_CUT = 6  # every so many robots


def _record(log: Path, seed: int) -> None:
    simulate(Scenario(robot="paper", seed=seed), log, False, progress.silent)
    if seed % _CUT == 0:
        whole = log.read_bytes()
        log.write_bytes(whole[: len(whole) // 2])


def main(asked: Study) -> None:
    """Both runs."""
    robots = asked.runs
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        logs = folder / "logs"
        logs.mkdir()
        with ProcessPoolExecutor(2) as pool:
            list(pool.map(_record, [logs / f"robot_{n:02}.mcap" for n in range(robots)], range(robots)))
        began = time.perf_counter()
        fleet.batch(logs, folder / "here", run=partial(fleet.in_processes, count=2))
        here_s = time.perf_counter() - began
        began = time.perf_counter()
        fleet.batch(logs, folder / "here", run=partial(fleet.in_processes, count=2))
        again_s = time.perf_counter() - began
        table = (folder / "here" / "summary.csv").read_text(encoding="utf-8")
        verdicts = Counter(row["verdict"] for row in csv.DictReader(table.splitlines()))
        print(f"\n{robots} robots: {', '.join(f'{n} {verdict}' for verdict, n in sorted(verdicts.items()))}")
        print(f"s: {here_s:.0f}, and {again_s:.1f} once more")
