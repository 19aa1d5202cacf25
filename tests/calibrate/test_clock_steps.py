"""Recordings whose clocks step, against the truth."""

import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from mobilecal_cli.calibrate.extract import extract
from mobilecal_cli.rig.config import load_rig
from mobilecal_cli.solvers import solve
from tests.records import Record, records_of, written
from tests.truth import truth_of

S = 10**9
_STAMP = struct.Struct("<iI")


def stepped(source: Path, target: Path, step_s: float, topics: str) -> Path:
    """A recording whose header stamps on some topics step 20 s after its start."""
    records = list(records_of(source))
    changes_ns = records[0].time_ns + 20 * S

    def late(record: Record) -> Record:
        if record.time_ns < changes_ns or topics not in record.topic or "String" in record.type:
            return record
        data = bytearray(record.data)
        seconds, nanoseconds = _STAMP.unpack_from(data, 4)
        stamp_ns = seconds * S + nanoseconds + round(step_s * S)
        _STAMP.pack_into(data, 4, stamp_ns // S, stamp_ns % S)
        return replace(record, data=bytes(data))

    return written(target, map(late, records))


@pytest.mark.long  # what a step changes in the signals: tests/readers/test_steps.py
@pytest.mark.parametrize(
    ("step_s", "topics"), [(-10, "left/image"), (-10, ""), (30, ""), (30, "joint"), (-10, "image")]
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
