"""Copies of a sample log with something wrong in them, and a way to run the real command on them."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_typestore

STORE = get_typestore(Stores.ROS2_HUMBLE)
Edit = Callable[[str, Any], Any]


def edited(source: Path, target: Path, edit: Edit) -> Path:
    """Copy an MCAP, each decoded message through `edit(topic, message)`; None drops it."""
    with source.open("rb") as stream, target.open("wb") as out:
        writer = Writer(out, compression=CompressionType.NONE)
        writer.start(profile="ros2")
        channels: dict[int, int] = {}
        for schema, channel, message in make_reader(stream).iter_messages():
            assert schema is not None
            decoded = edit(channel.topic, STORE.deserialize_cdr(message.data, schema.name))
            if decoded is None:
                continue
            if channel.id not in channels:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(channel.topic, "cdr", number)
            data = bytes(STORE.serialize_cdr(decoded, schema.name))
            writer.add_message(channels[channel.id], message.log_time, data, message.publish_time)
        writer.finish()
    return target


@dataclass(frozen=True)
class Run:
    """What a command left behind."""

    code: int
    out: str
    err: str
    left: list[str]


def run(*arguments: object, cwd: Path) -> Run:
    """The real command in a process of its own, in a directory of its own."""
    before = set(cwd.rglob("*"))
    result = subprocess.run(
        [sys.executable, "-m", "mobilecal_cli", *map(str, arguments)],
        cwd=cwd,
        capture_output=True,
        text=True,
        timeout=120,
        stdin=subprocess.DEVNULL,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"},
        check=False,
    )
    left = sorted(str(path.relative_to(cwd)) for path in set(cwd.rglob("*")) - before)
    return Run(result.returncode, result.stdout, result.stderr, left)
