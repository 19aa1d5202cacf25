"""Cost against length: the stages of `calibrate`, and its memory, on logs of 1, 10 and 60 minutes."""

from __future__ import annotations

import itertools
import json
import os
import subprocess
import sys
import time
from pathlib import Path

from tests.bench.recordings import stretched
from tests.bench.tables import table

MINUTES = (1, 10, 60)
ALL_MINUTES = (1, 10)
_STAGES = (
    "reading",
    "finding the board's size",
    "looking for the board",
    "measuring",
    "solving",
    "writing the report",
)


def staged(log: Path, out: Path, stations: str) -> dict[str, float]:
    """Calibrate in this process: seconds of each stage, and the peak of resident memory, MB."""
    from mobilecal_cli import pipeline

    began: list[tuple[str, float]] = []

    def progress(stage: str, done: int, total: int | None) -> None:
        if not began or began[-1][0] != stage:
            began.append((stage, time.perf_counter()))

    pipeline.calibrate(
        [log], out, flags={"stations": stations}, force=True, progress=progress, jobs=os.cpu_count() or 1
    )
    began.append(("", time.perf_counter()))
    seconds = dict.fromkeys(_STAGES, 0.0)
    for (stage, start), (_, end) in itertools.pairwise(began):
        seconds[stage] = seconds.get(stage, 0.0) + end - start
    status = Path("/proc/self/status").read_text()
    (peak,) = (line for line in status.splitlines() if line.startswith("VmHWM"))
    return seconds | {"mb": int(peak.split()[1]) / 1024}


def _row(log: Path, out: Path, minutes: float, stations: str) -> tuple[list[str], dict[str, float]]:
    command = [sys.executable, "-m", "tests.bench.growth", str(log), str(out), stations]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    found: dict[str, float] = json.loads(done.stdout.splitlines()[-1])
    size = log.stat().st_size / 1e9
    cells = [f"{found[stage]:.1f}" for stage in _STAGES]
    return [f"{minutes}", f"{size:.2f}", stations, *cells, f"{found['mb']:.0f}"], found


def main(source: Path, folder: Path) -> str:
    """Table 5; `source` is a moving log of JPEGs."""
    rows, found = [], {}
    for minutes in MINUTES:
        log = stretched(source, folder / f"{minutes}min.mcap", minutes)
        for stations in ("auto", "all") if minutes in ALL_MINUTES else ("auto",):
            row, found[stations, minutes] = _row(log, folder / "out", minutes, stations)
            rows.append(row)
        log.unlink()
    growth = []
    for stations, lengths in (("auto", MINUTES), ("all", ALL_MINUTES)):
        for short, long in itertools.pairwise(lengths):
            a, b = found[stations, short], found[stations, long]
            cells = [f"{b[stage] / a[stage]:.1f}" if a[stage] > 0.05 else "" for stage in _STAGES]
            growth.append(
                [f"{short} to {long}: {long / short:.0f} times", stations, *cells, f"{b['mb'] / a['mb']:.2f}"]
            )
    head = ["minutes", "GB", "stations", *(f"{stage} (s)" for stage in _STAGES), "peak (MB)"]
    return (
        table(head, rows)
        + "\nHow each stage grows; of stages that take less than 0.05 s on the shorter log nothing is said.\n\n"
        + table(["length", "stations", *_STAGES, "memory"], growth)
    )


if __name__ == "__main__":
    print(json.dumps(staged(Path(sys.argv[1]), Path(sys.argv[2]), sys.argv[3])))
