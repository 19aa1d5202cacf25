"""`make bench`: creates its data, prints all performance tables, and writes docs/validation/performance.md."""

import argparse
import re
import tempfile
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

from tests.bench import commands, corners, effect, established, growth, reading
from tests.bench.recordings import TEN_MINUTES, simulated
from tests.bench.study import conditions, paragraph

_PAGE = Path(__file__).resolve().parents[2] / "docs" / "validation" / "performance.md"


def _sections(folder: Path) -> dict[str, tuple[str, Callable[[], str]]]:
    return {
        "reading": (
            "## Every frame of a recording without stops, on one core and on two\n\n"
            + paragraph(
                "2,000 stereo pairs of 640 x 480, all of them searched (`--stations all`); a person occludes the board for a "
                "third of the time. Read + decode: all messages read with the `mcap` package, images decoded with OpenCV, "
                "one thread per core. Read + detect: joints, wheels and all images read, and the corners of each board "
                "detected, one process per core, start of the processes included."
            ),
            lambda: reading.main(
                {kind: simulated(folder, kind, occluded=True) for kind in ("jpeg", "mono8", "png")}
            ),
        ),
        "commands": (
            "## Complete commands\n\n"
            + paragraph('Compared with `python -c "import numpy, scipy.optimize, cv2"`.'),
            lambda: commands.main(simulated(folder, "jpeg", occluded=True), folder),
        ),
        "corners": ("## Corners\n\n", corners.main),
        "effect": ("## Effect of the corners on the nine parameters\n\n", effect.main),
        "growth": (
            "## Cost against length\n\n"
            + paragraph(
                "A recording without stops: JPEG images, ten stereo pairs per second. One minute is the beginning of the "
                "drive of ten; 60 minutes are this drive, forwards and backwards."
            ),
            lambda: growth.main(simulated(folder, "jpeg", occluded=False, stations=TEN_MINUTES), folder),
        ),
        "solvers": (
            "## The solver compared with Ceres and GTSAM\n\n"
            + paragraph(
                "The same likelihood, initial estimate and tolerances. Costs and derivatives in Ceres and GTSAM are Python "
                "callbacks, which take most of their time. Without callbacks: their time minus the time in callbacks, "
                "divided by the total time of mobilecal."
            ),
            established.solvers,
        ),
    }


def main() -> None:
    """Measure all sections or the named ones, and put them into the page; the others stay as they are."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench", description=main.__doc__)
    parser.add_argument("sections", nargs="*", help="reading, commands, corners, effect, growth, solvers")
    parser.add_argument("--data", type=Path, help="folder that keeps the recordings for the next run")
    asked = parser.parse_args()
    with ExitStack() as stack:
        folder = asked.data or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        folder.mkdir(parents=True, exist_ok=True)
        sections = _sections(folder)
        for name in asked.sections or list(sections):
            head, measure = sections[name]
            part = f"{head}{measure()}\n*{conditions()}*\n"
            print(part, flush=True)
            _PAGE.write_text(_with_section(_PAGE.read_text(encoding="utf-8"), part), encoding="utf-8")


def _with_section(page: str, section: str) -> str:
    """The page with a section in place of the one with the same heading."""
    heading = section.splitlines()[0]
    parts = re.split(r"^(?=## )", page, flags=re.MULTILINE)
    changed = [section if part.splitlines()[0] == heading else part for part in parts]
    return "\n\n".join(part.strip() for part in changed) + "\n"


if __name__ == "__main__":
    main()
