"""Many robots, calibrated one by one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any


@dataclass(frozen=True, slots=True)
class FleetJob:
    """One robot to calibrate.

    Attributes:
        name: of the robot, and of the directory of its outputs.
        logs: its recordings.
        config: its rig.yaml, or None.
        output: the directory that holds those of all robots.
        flags: dotted key → value, over the file.
        gates: `NAME=LIMIT`.
    """

    name: str
    logs: tuple[Path, ...]
    config: Path | None
    output: Path
    flags: Mapping[str, Any] = field(default_factory=dict)
    gates: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class FleetRow:
    """What came of one robot.

    Attributes:
        name: of the robot.
        verdict: "PASS", "FAIL", "NOT ENOUGH", or "ERROR" where there is no answer.
        exit_code: as `mobilecal calibrate` would have left.
        reason: one sentence.
        stations: that were used.
        rotvec_rad, lengths_m: three numbers of the reference camera's rotation on the head (a rotation vector), and
            six lengths: its place, then radius_right, radius_left, separation; empty where there is no answer.
        std: nine, rad and m, None where a number is not known; empty where none is.
    """

    name: str
    verdict: str
    exit_code: int
    reason: str
    stations: int = 0
    rotvec_rad: tuple[float, ...] = ()
    lengths_m: tuple[float, ...] = ()
    std: tuple[float | None, ...] = ()
