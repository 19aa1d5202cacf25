"""Recordings whose clocks step, against the truth."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap.writer import Writer

from mobilecal_cli.calibrate.extract import extract
from mobilecal_cli.rig.config import load_rig
from mobilecal_cli.solvers import solve
from tests.truth import truth_of

S = 10**9
_STAMP = struct.Struct("<iI")


def stepped(source: Path, target: Path, step_s: float, topics: str) -> Path:
    """A recording whose header stamps on some topics step 20 s after its start."""
    with source.open("rb") as stream, target.open("wb") as sink:
        reader, writer = make_reader(stream), Writer(sink)
        writer.start("ros2")
        channels: dict[int, int] = {}
        first_ns = None
        for schema, channel, message in reader.iter_messages():
            assert schema is not None
            if channel.id not in channels:
                number = writer.register_schema(schema.name, schema.encoding, schema.data)
                channels[channel.id] = writer.register_channel(channel.topic, "cdr", number)
            first_ns = first_ns or message.log_time
            data = bytearray(message.data)
            if (
                message.log_time >= first_ns + 20 * S
                and topics in channel.topic
                and "String" not in schema.name
            ):
                seconds, nanoseconds = _STAMP.unpack_from(data, 4)
                stamp_ns = seconds * S + nanoseconds + round(step_s * S)
                _STAMP.pack_into(data, 4, stamp_ns // S, stamp_ns % S)
            writer.add_message(channels[channel.id], message.log_time, bytes(data), message.log_time)
        writer.finish()
    return target


@pytest.mark.parametrize(
    ("step_s", "topics"), [(-10, ""), (30, ""), (-10, "image"), (30, "joint"), (-10, "left/image")]
)
def test_a_step_changes_nothing_but_a_leg(sample_logs, tmp_path, step_s, topics):
    log = stepped(sample_logs / "paper_robot.mcap", tmp_path / "log.mcap", step_s, topics)
    extraction, _ = extract([log], load_rig(None))
    assert len(extraction.observations) == 12
    assert len(extraction.wheels) == 2
    assert [sum(o.log == log for o in extraction.observations) for log in (0, 1)] == [5, 7]
    assert any(f"by {abs(step_s):.3f} s, 2" in note and "separate logs" in note for note in extraction.notes)
    error = solve(extraction, "ml").parameters.minus(truth_of(sample_logs / "paper_robot.truth.yaml"))
    assert np.linalg.norm(error[3:6]) < 0.003
    assert np.all(np.abs(error[6:]) < [0.001, 0.001, 0.002])
