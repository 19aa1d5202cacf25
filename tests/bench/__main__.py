"""`make bench`: makes its own data, prints every table of performance, and writes docs/explanation/performance.md."""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

import cv2

from tests.bench import commands, corners, effect, established, growth, reading
from tests.bench.recordings import simulated, transcoded
from tests.bench.simulated import conditions

_PAGE = Path(__file__).resolve().parents[2] / "docs" / "explanation" / "performance.md"
_STATIONS = 67  # three seconds each, ten stereo pairs a second: 2,000 pairs
_INTRODUCTION = """# Performance

`make bench` measures what stands here and writes this page. Machines differ and are shared, so every figure that
matters is a ratio of two things measured side by side in one run, the median of at least five rounds.

"""


class _Data:
    """The recordings that several tables need, made when the first one asks, in a folder that may hold them already."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def _mono8(self) -> Path:
        path = self.folder / "moving.mcap"
        return path if path.exists() else simulated(path, _STATIONS)

    def _transcoded(self, name: str, kind: str, *, hide: bool) -> Path:
        path, part = self.folder / name, self.folder / f"{name}.part"
        if not path.exists():
            transcoded(self._mono8(), part, kind, hide).rename(path)
        return path

    def hidden(self, kind: str) -> Path:
        """The moving log, the board hidden for a third of the time."""
        return self._transcoded(f"hidden_{kind}.mcap", kind, hide=True)

    def open(self) -> Path:
        """The moving log as JPEGs, the board always in view."""
        return self._transcoded("open.mcap", "jpeg", hide=False)


def _sections(data: _Data) -> dict[str, tuple[str, Callable[[], str]]]:
    return {
        "reading": (
            "## Every frame of a moving log, on one core and on two\n\n"
            "2,000 stereo pairs of 640 x 480, every one looked at (`--stations all`); for a third of the time somebody stands "
            "before the board. Read + decode: all messages by the `mcap` package, pictures by OpenCV, on so many threads. Read "
            "+ see: joints, wheels and all pictures, up to the corners of every board, on so many processes, their start "
            "included.\n",
            lambda: reading.main({kind: data.hidden(kind) for kind in ("jpeg", "mono8", "png")}),
        ),
        "commands": (
            '## Whole commands\n\nBeside `python -c "import numpy, scipy.optimize, cv2, matplotlib.pyplot"`.\n',
            lambda: commands.main(data.hidden("jpeg"), data.folder),
        ),
        "corners": ("## Corners\n", corners.main),
        "effect": ("## What the corners do for the nine numbers\n", effect.main),
        "growth": (
            "## Cost against length\n\nA moving log of JPEGs that is played to and fro, ten stereo pairs a second.\n",
            lambda: growth.main(data.open(), data.folder),
        ),
        "solvers": (
            "## The solver beside Ceres and GTSAM\n\n"
            "The same likelihood, start and tolerances; costs and derivatives of both others are Python callbacks, which take "
            "most of their time. Without callbacks: what they took less what the callbacks took, as if cost and derivatives "
            "were free, beside the whole of mobilecal's time.\n",
            established.table,
        ),
    }


def main() -> None:
    """All sections, or those that are named; the page is written only when all were measured."""
    parser = argparse.ArgumentParser(prog="python -m tests.bench", description=main.__doc__)
    parser.add_argument("sections", nargs="*", help="reading, commands, corners, effect, growth, solvers")
    parser.add_argument(
        "--data", type=Path, help="folder to keep the recordings in, and to take them from again"
    )
    asked = parser.parse_args()
    with ExitStack() as stack:
        folder = asked.data or Path(stack.enter_context(tempfile.TemporaryDirectory()))
        folder.mkdir(parents=True, exist_ok=True)
        sections = _sections(_Data(folder))
        wanted = asked.sections or list(sections)
        text = f"{_INTRODUCTION}{conditions()}, OpenCV {cv2.__version__}\n"
        print(text, flush=True)
        for name in wanted:
            head, measure = sections[name]
            part = f"\n{head}\n{measure()}"
            print(part, flush=True)
            text += part
    if len(wanted) == len(sections):
        _PAGE.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
