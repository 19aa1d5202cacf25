"""Kill a process at every moment at which it touches the disk while it writes its outputs.

`python -m tests.hostile.kill_points DIRECTORY` prints one line a moment: what was done last, and what is there then. An
empty line ends each way: a new output, one that replaces another, and the same where the two cannot be exchanged.
"""

import os
import shutil
import sys
from pathlib import Path

from mobilecal_cli.export import outputs
from mobilecal_cli.export.params import FIRST_LINE
from mobilecal_cli.files import placing

OLD = {"params.yaml": FIRST_LINE.encode(), "report.html": b"old"}
NEW = {name: FIRST_LINE.encode() * 1000 for name in sorted(outputs.OUTPUT_NAMES)}
_TOUCHES = ("open", "os.", "shutil.", "ctypes.")


def _die_at(number: int) -> None:
    """Let the process end, as by SIGKILL, before its `number`-th touch of the disk."""
    left = [number]

    def hook(event: str, arguments: tuple[object, ...]) -> None:
        if event.startswith(_TOUCHES):
            left[0] -= 1
            if left[0] < 0:
                os.write(1, f"{event} ".encode())
                os._exit(9)

    sys.addaudithook(hook)


def state(target: Path) -> str:
    """none, old, new or broken."""
    if not target.exists():
        return "none"
    found = {path.name: path.read_bytes() for path in target.iterdir()}
    return "old" if found == OLD else "new" if found == NEW else "broken"


def try_all(folder: Path, existing: bool, exchange: bool) -> None:
    """All moments, one process each."""
    number, code = 0, 9
    while code:
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        target = folder / "out"
        if existing:
            target.mkdir()
            for name, content in OLD.items():
                (target / name).write_bytes(content)
        child = os.fork()
        if child == 0:
            if not exchange:
                placing._rename = lambda source, target, flag: False
            _die_at(number)
            outputs.write_outputs({target: NEW}, existing)
            os.write(1, b"done ")
            os._exit(0)
        _, status = os.waitpid(child, 0)
        code = os.waitstatus_to_exitcode(status)
        aside = [path for path in folder.glob(".*.old/replaced") if state(path) == "old"]
        os.write(1, f"{state(target)} {'aside' if aside else ''}\n".encode())
        number += 1


if __name__ == "__main__":
    for existing, exchange in ((False, True), (True, True), (True, False)):
        try_all(Path(sys.argv[1]), existing, exchange)
        os.write(1, b"\n")
