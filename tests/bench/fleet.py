"""Simulated robots, locally and on a Dask cluster that loses a worker: both give the same table.

Every sixth recording is truncated, so some robots fail.
"""

import csv
import signal
import tempfile
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path

from mobilecal_cli import calibrate as progress
from mobilecal_cli.calibrate import batch as fleet
from mobilecal_cli.calibrate.batch import RECORDS
from mobilecal_cli.simulate.record import simulate
from mobilecal_cli.simulate.scenario import Scenario
from tests.bench.study import Study
from tests.commands.dask_cluster import local_cluster

RUNS = 24  # robots
_CUT = 6  # every so many robots


def _record(log: Path, seed: int) -> None:
    simulate(Scenario(robot="paper", seed=seed), log, False, progress.silent)
    if seed % _CUT == 0:
        whole = log.read_bytes()
        log.write_bytes(whole[: len(whole) // 2])


def _records(out: Path) -> dict[str, int]:
    return {path.stem: path.stat().st_mtime_ns for path in (out / RECORDS).glob("*.json")}


def main(asked: Study) -> None:
    """Both runs, compared."""
    robots = asked.runs
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        logs = folder / "logs"
        logs.mkdir()
        with ProcessPoolExecutor(2) as pool:
            list(pool.map(_record, [logs / f"robot_{n:02}.mcap" for n in range(robots)], range(robots)))
        began, here = time.perf_counter(), partial(fleet.in_processes, count=2)
        fleet.batch(logs, folder / "here", run=here)
        here_s = time.perf_counter() - began
        began = time.perf_counter()
        fleet.batch(logs, folder / "here", run=here)
        again_s = time.perf_counter() - began
        kept: dict[str, int] = {}
        with local_cluster(folder, workers=2) as (address, workers):

            def progress(_: str, done: int, __: int | None) -> None:
                if done == robots // 2:
                    workers[0].send_signal(signal.SIGKILL)
                    workers[0].wait()
                    kept.update(_records(folder / "cluster"))

            began = time.perf_counter()
            there = partial(fleet.on_cluster, address=address)
            fleet.batch(logs, folder / "cluster", run=there, progress=progress)
            cluster_s = time.perf_counter() - began
        tables = [(folder / run / "summary.csv").read_text(encoding="utf-8") for run in ("here", "cluster")]
        verdicts = Counter(row["verdict"] for row in csv.DictReader(tables[0].splitlines()))
        redone = sum(_records(folder / "cluster")[robot] != time_ns for robot, time_ns in kept.items())
        print(f"\n{robots} robots: {', '.join(f'{n} {verdict}' for verdict, n in sorted(verdicts.items()))}")
        alike = tables[0] == tables[1]
        print(f"tables alike: {alike}; done when the worker was killed: {len(kept)}, done twice: {redone}")
        on_cluster = f"{cluster_s:.0f} on the cluster (one worker from half-way on)"
        print(f"s: {here_s:.0f} here, {again_s:.1f} here once more, {on_cluster}")
