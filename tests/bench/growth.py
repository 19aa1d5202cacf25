"""Cost against length: the stages of `calibrate`, and its memory, on recordings of 1, 10 and 60 minutes."""

import itertools
import os
import time
from pathlib import Path
from statistics import median

from tests.bench.recordings import stretched
from tests.bench.study import kernel_mb, measured, paragraph, table

MINUTES = (1, 10, 60)
_LENGTHS = {"auto": MINUTES, "all": (1, 10)}
_STAGES = (
    "reading",
    "finding the board's size",
    "detecting the board",
    "solving",
    "writing the report",
)


def staged(log: str, out: str, stations: str) -> dict[str, float]:
    """Calibrate in this process: seconds of each stage, and the peak of resident memory, MB."""
    from mobilecal_cli.calibrate import steps
    from mobilecal_cli.rig.config import RigConfig

    began: list[tuple[str, float]] = []

    def progress(stage: str, done: int, total: int | None) -> None:
        if not began or began[-1][0] != stage:
            began.append((stage, time.perf_counter()))

    config, jobs = RigConfig.model_validate({"stations": stations}), os.cpu_count() or 1
    steps.calibrate([Path(log)], Path(out), config=config, force=True, progress=progress, jobs=jobs)
    began.append(("", time.perf_counter()))
    seconds = dict.fromkeys(_STAGES, 0.0)
    for (stage, start), (_, end) in itertools.pairwise(began):
        seconds[stage] += end - start  # an unknown stage is an error, not a column of zeros
    return seconds | {"mb": kernel_mb("VmHWM")}


def main(source: Path, folder: Path, rounds: int = 5) -> str:
    """Table 5; `source` is a recording without stops, as JPEGs. Each round runs all lengths in sequence."""
    logs = {minutes: stretched(source, folder / f"{minutes}min.mcap", minutes) for minutes in MINUTES}
    runs = [(stations, minutes) for stations, lengths in _LENGTHS.items() for minutes in lengths]
    found = [
        {run: measured(staged, logs[run[1]], folder / "out", run[0]) for run in runs} for _ in range(rounds)
    ]
    rows = []
    for run in runs:
        stations, minutes = run
        size = logs[minutes].stat().st_size / 1e9
        cells = [f"{median(of[run][stage] for of in found):.1f}" for stage in _STAGES]
        memory = f"{median(of[run]['mb'] for of in found):.0f}"
        rows.append([f"{minutes}", f"{size:.2f}", stations, *cells, memory])
    growth = []
    for stations, lengths in _LENGTHS.items():
        for short, long in itertools.pairwise(lengths):
            a, b, cells = (stations, short), (stations, long), []
            for stage in (*_STAGES, "mb"):
                shown = min(of[a][stage] for of in found) > 0.05
                cells.append(_grown([of[b][stage] / of[a][stage] for of in found]) if shown else "")
            growth.append([f"{short} to {long}: {long / short:.0f} times", stations, *cells])
    for log in logs.values():
        log.unlink()
    head = ["minutes", "GB", "stations", *(f"{stage} (s)" for stage in _STAGES), "peak (MB)"]
    return (
        f"Medians of {rounds} rounds.\n\n"
        + table(head, rows)
        + "\n"
        + paragraph(
            "Growth of each stage: median of the ratios of all rounds, with minimum and maximum. Stages that take less than "
            "0.05 s on the shorter recording are omitted."
        )
        + table(["length", "stations", *_STAGES, "memory"], growth)
    )


def _grown(ratios: list[float]) -> str:
    return f"{median(ratios):.1f} ({min(ratios):.1f} to {max(ratios):.1f})"
