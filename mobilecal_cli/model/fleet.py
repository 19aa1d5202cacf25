"""Jobs and results of `batch`, which calibrates several robots."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any


@dataclass(frozen=True, slots=True)
class FleetJob:
    """One robot to calibrate.

    Attributes:
        name: name of the robot and of its output directory.
        logs: its recordings.
        config: its rig.yaml, or None.
        output: parent directory of the output directories.
        flags: dotted key → value; these override the file.
        gates: `NAME=LIMIT`.
        force: calibrate the robot again, and replace also a result that the batch did not write.
    """

    name: str
    logs: tuple[Path, ...]
    config: Path | None
    output: Path
    flags: Mapping[str, Any] = field(default_factory=dict)
    gates: tuple[str, ...] = ()
    force: bool = False


@dataclass(frozen=True, slots=True)
class FleetRow:
    """Result of one robot, or a directory entry that was skipped.

    Attributes:
        name: name of the robot, or of the entry.
        verdict: "PASS", "FAIL", "NOT ENOUGH", "ERROR" without a result, or "SKIPPED" for an entry.
        exit_code: exit code of `mobilecal calibrate`.
        reason: one sentence.
        stations: number of stations used.
        rotvec_rad: rotation vector of the reference camera in the head frame, (3,); empty without a result.
        lengths_m: its position, then radius_right, radius_left, separation, (6,); empty without a result.
        std: nine standard deviations, rad and m, None where unknown; empty for methods that give none.
        skipped: why the robot was not calibrated in this run; empty if it was.
        hint: what to do next, if it did not pass.
    """

    name: str
    verdict: str
    exit_code: int
    reason: str
    stations: int = 0
    rotvec_rad: tuple[float, ...] = ()
    lengths_m: tuple[float, ...] = ()
    std: tuple[float | None, ...] = ()
    skipped: str = ""
    hint: str = ""
