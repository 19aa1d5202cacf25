"""Time of complete commands compared with the imports that any such tool needs."""

import sys
from pathlib import Path
from statistics import median

from tests.bench.study import spent, table

REPEATS = 7
_IMPORTS = "import numpy, scipy.optimize, cv2"
_SAMPLE = Path(__file__).resolve().parents[2] / "sample_logs" / "paper_robot.mcap"


def main(moving: Path, folder: Path, repeats: int = REPEATS) -> str:
    """Table 2: the sample recording, the recording without stops with default options, and `--help`."""
    tool = [sys.executable, "-m", "mobilecal_cli"]
    out = ["--output", str(folder / "out"), "--force", "--quiet"]
    commands = {
        "calibrate the sample recording of the paper's robot": [*tool, "calibrate", str(_SAMPLE), *out],
        "calibrate the recording without stops, stations selected": [*tool, "calibrate", str(moving), *out],
        "mobilecal --help": [*tool, "--help"],
    }
    runs: dict[str, list[tuple[float, float, float, float]]] = {name: [] for name in commands}
    spent(commands["mobilecal --help"])  # byte code is written once
    for _ in range(repeats):
        for name, command in commands.items():
            imports, own = spent([sys.executable, "-c", _IMPORTS]), spent(command)
            runs[name].append((*imports, *own))
    rows = []
    for name, some in runs.items():
        each = zip(*((r[0], r[2], r[2] / r[0], r[3] / r[1]) for r in some), strict=True)
        rows.append([name, *(f"{median(values):.2f}" for values in each)])
    head = ["command", "imports (s)", "command (s)", "ratio of wall time", "ratio of processor time"]
    return table(head, rows)
