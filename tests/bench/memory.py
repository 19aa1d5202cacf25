"""Peak memory and time of the commands against the length of a simulated recording."""

import subprocess
import sys
import tempfile
import time
from pathlib import Path

from mobilecal_cli.simulate.record import simulate
from mobilecal_cli.simulate.scenario import Scenario
from tests.bench.study import Study, head, line

#: Stops and stereo pairs per stop, with mono8 images of 640 x 480: about 0.1, 1 and 5 GB.
SIZES = ((6, 28), (20, 82), (40, 204))


#: The command, and at its end what the kernel says of its memory (a child's `ru_maxrss` has its parent's in it).
_PROGRAM = """
import sys
from pathlib import Path
from mobilecal_cli.__main__ import main
try:
    main()
finally:
    (line,) = (l for l in Path("/proc/self/status").read_text().splitlines() if l.startswith("VmHWM"))
    print(line, file=sys.stderr)
"""


def spent(*arguments: str) -> tuple[float, float]:
    """Run `mobilecal` with arguments, in a process of its own: its peak resident memory, MB, and its time, s."""
    start = time.perf_counter()
    command = [sys.executable, "-c", _PROGRAM, *arguments, "--quiet"]
    done = subprocess.run(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True, check=False)
    if done.returncode not in (0, 6):
        raise RuntimeError(done.stderr)
    return int(done.stderr.split("VmHWM:")[1].split()[0]) / 1024, time.perf_counter() - start


def measured(container: str, stations: int, pairs: int, folder: Path) -> None:
    """Print one line of the table: a recording is made, measured and removed."""
    suffix = {"mcap": ".mcap", "mcap-lz4": ".mcap", "bag": ".bag"}.get(container, "")
    log = folder / f"log{suffix}"
    scenario = Scenario(stations=stations, pictures_per_rest=pairs, pictures="mono8", container=container)  # type: ignore[arg-type]
    simulate(scenario, log, force=True)
    size = sum(p.stat().st_size for p in ([log] if log.is_file() else log.iterdir())) / 1e9
    calibrate = spent("calibrate", str(log), "--output", str(folder / "out"), "--force")
    inspect = spent("inspect", str(log))
    used = (f"{value:.0f}" for value in (*calibrate, *inspect))
    line(container, f"{size:.2f}", 2 * stations * pairs, *used)


def main(_: Study) -> None:
    """All sizes as MCAP, one as the other containers."""
    head("container", "GB", "images", "calibrate: MB", "s", "inspect: MB", "s")
    cases = [("mcap", *size) for size in SIZES]
    cases += [(container, *SIZES[1]) for container in ("mcap-lz4", "rosbag2", "bag")]
    with tempfile.TemporaryDirectory() as folder:
        for case in cases:
            measured(*case, Path(folder))
