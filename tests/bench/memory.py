"""Peak memory and time of the commands against the length of a simulated recording."""

import tempfile
import time
from pathlib import Path

from mobilecal_cli.simulate.record import simulate
from mobilecal_cli.simulate.scenario import Scenario
from tests.bench.study import Study, head, kernel_mb, line, measured
from tests.command import run

#: Stops and stereo pairs per stop, with mono8 images of 640 x 480: about 0.1, 1 and 5 GB.
SIZES = ((6, 28), (20, 82), (40, 204))


def spent(*arguments: str) -> tuple[float, float]:
    """In a process of its own: run `mobilecal`; its peak resident memory, MB, and its time, s."""
    start = time.perf_counter()
    done = run(*arguments)
    if done.code not in (0, 6):
        raise RuntimeError(done.err)
    return kernel_mb("VmHWM"), time.perf_counter() - start


def row(container: str, stations: int, pairs: int, folder: Path) -> None:
    """Print one line of the table: a recording is made, measured and removed."""
    suffix = {"mcap": ".mcap", "mcap-lz4": ".mcap", "bag": ".bag"}.get(container, "")
    log = folder / f"log{suffix}"
    scenario = Scenario(stations=stations, pictures_per_rest=pairs, pictures="mono8", container=container)  # type: ignore[arg-type]
    simulate(scenario, log, force=True)
    size = sum(p.stat().st_size for p in ([log] if log.is_file() else log.iterdir())) / 1e9
    calibrate = measured(spent, "calibrate", log, "--output", folder / "out", "--force", "--quiet")
    inspect = measured(spent, "inspect", log, "--quiet")
    used = (f"{value:.0f}" for value in (*calibrate, *inspect))
    line(container, f"{size:.2f}", 2 * stations * pairs, *used)


def main(_: Study) -> None:
    """All sizes as MCAP, one as the other containers."""
    head("container", "GB", "images", "calibrate: MB", "s", "inspect: MB", "s")
    cases = [("mcap", *size) for size in SIZES]
    cases += [(container, *SIZES[1]) for container in ("mcap-lz4", "rosbag2", "bag")]
    with tempfile.TemporaryDirectory() as folder:
        for case in cases:
            row(*case, Path(folder))
