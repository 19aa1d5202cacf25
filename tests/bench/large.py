"""Processor time of `inspect` on large descriptions: topics of joint states, and links of a URDF."""

import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from tests.bench.study import Study, head, line, spent
from tests.commands.edited import edited
from tests.conftest import REPOSITORY
from tests.records import Record, records_of, written

LOG = REPOSITORY / "sample_logs" / "paper_robot.mcap"
_MESSAGES = 20  # of each additional topic
TOPICS = (500, 1000, 2000, 4000, 8000)
LINKS = (20_000, 100_000)


def with_topics(count: int, path: Path) -> None:
    """The sample recording with so many more topics of joint states."""
    names = [f"/robot{k}/joint_states" for k in range(count)]

    def more() -> Iterator[Record]:
        copied = 0
        for record in records_of(LOG):
            yield record
            if record.topic == "/joint_states" and copied < _MESSAGES:
                copied += 1
                yield from (replace(record, topic=name) for name in names)

    written(path, more())


def with_links(count: int, path: Path) -> None:
    """The sample recording with so many more links in its URDF, one behind the other."""

    def edit(topic: str, message: Any) -> Any:
        if topic != "/robot_description":
            return message
        more = [
            f'<link name="x{k}"/><joint name="j{k}" type="fixed"><parent link="{f"x{k - 1}" if k else "base_link"}"/>'
            f'<child link="x{k}"/><origin xyz="0 0 0.001"/></joint>'
            for k in range(count)
        ]
        return replace(message, data=message.data.replace("</robot>", "".join(more) + "</robot>"))

    edited(LOG, path, edit)


def _inspected_s(path: Path) -> float:
    """Processor time of `inspect`, s."""
    return spent([sys.executable, "-m", "mobilecal_cli", "inspect", str(path)])[1]


def main(_: Study) -> None:
    """Print the table: times beyond those of the sample recording alone."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.mcap"
        alone = min(_inspected_s(LOG) for _ in range(3))
        head("sample recording with", "inspect (s)", f"beyond {alone:.1f} s without, per item (ms)")
        make: Callable[[int, Path], None]
        for what, counts, make in (("topics", TOPICS, with_topics), ("links", LINKS, with_links)):
            for count in counts:
                make(count, path)
                more = min(_inspected_s(path) for _ in range(3)) - alone
                line(f"{count:,} {what}", f"{alone + more:.1f}", f"{1e3 * more / count:.2f}")
