"""What became of others' recordings: `python docs/generate/recordings.py DATA` makes recordings-read.md.

DATA is a directory with the published recordings; it is not part of the repository.
"""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

from mobilecal_cli.errors import RecordingError
from mobilecal_cli.readers import open_recording

TARGET = Path(__file__).resolve().parents[1] / "reference" / "recordings-read.md"
CONFORMANCE = {
    "NoData": 0,
    "OneAttachment": 0,
    "OneMetadata": 0,
    "OneMessage": 1,
    "OneSchemalessMessage": 1,
    "TenMessages": 10,
}
SUFFIXES = {".mcap", ".bag", ".db3", ".zstd", ".db3-wal", ".db3-shm"}
HEAD = """\
# Recordings of others that were read

Made by `docs/generate/recordings.py` from published recordings: MCAP's conformance files, bags of Foxglove, Cruise,
rosbag-rs, rosbag-analyzer-web, rosbag2, rosbags-rs and machinevision-toolbox, and joint states of Fetch Robotics' and
M. Ferguson's robots, which serve as joints and wheels (tests/readers/test_shared_data.py).
"""


def read(path: Path) -> tuple[int, tuple[str, ...]]:
    """Messages of all topics, and what was odd.

    Raises:
        RecordingError: the recording is refused.
    """
    with open_recording([path]) as recording:
        count = sum(1 for part in recording.parts for _ in part.raw({info.name for info in recording.topics}))
        return count, recording.damage


def conformance(folder: Path) -> Iterator[str]:
    """A line for each kind of conformance file."""
    yield "## MCAP conformance\n"
    yield "| kind | files | messages in each | read with this count, nothing odd |\n| --- | --- | --- | --- |"
    for kind, expected in CONFORMANCE.items():
        files = sorted((folder / kind).glob("*.mcap"))
        right = sum(read(path) == (expected, ()) for path in files)
        yield f"| {kind} | {len(files)} | {expected} | {right} |"


def others(folder: Path) -> Iterator[str]:
    """A line for each of the other recordings: a rosbag2 directory, or a file."""
    yield "\n## Others\n\n| recording | messages | what was said |\n| --- | --- | --- |"
    inside = [path.parent for path in folder.rglob("metadata.yaml")]
    files = [path for path in folder.rglob("*") if path.is_file() and path.suffix in SUFFIXES]
    paths = {next((home for home in inside if home in path.parents), path) for path in files}
    for path in sorted(paths):
        if "mcap_conformance" in path.parts:
            continue
        name = path.relative_to(folder).as_posix()
        try:
            count, damage = read(path)
        except RecordingError as error:
            yield f"| {name} | refused | {_said(error.message, folder)} |"
        else:
            yield f"| {name} | {count} | {_said('; '.join(damage), folder)} |"


def _said(text: str, folder: Path) -> str:
    return text.replace(f"{folder}/", "").replace("|", "\\|")


if __name__ == "__main__":
    bags = Path(sys.argv[1]) / "bags"
    lines = [HEAD, *conformance(bags / "mcap_conformance"), *others(bags)]
    TARGET.write_text("\n".join(lines) + "\n", encoding="utf-8")
