"""Choices of the command line: formats, paper sizes, simulations; this module imports nothing heavy."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from pkgutil import iter_modules
from typing import Literal

_FORMATS = [module.name for module in iter_modules([str(Path(__file__).parent / "export" / "formats")])]
#: A format of `mobilecal export`: each is a file in export/formats/.
Target = StrEnum("Target", _FORMATS)  # type: ignore[misc]

#: A page of `mobilecal board`: automatic (A4 to A0), a standard size, or as large as the board needs.
Paper = Literal[
    "auto", "a4", "a3", "a2", "a1", "a0", "letter", "tabloid", "ansi_c", "ansi_d", "ansi_e", "exact"
]


#: Robots of `mobilecal simulate`: name → what is special about it. `simulate.robot.ROBOTS` makes them.
ROBOTS: dict[str, str] = {
    "paper": "the robot of the paper",
    "tick": "pan-tilt head, tick counters",
    "fixed_camera": "stereo pair fixed to the base",
    "rgbd": "color camera of an RGB-D camera, fixed to the base",
    "skid_steer": "four wheel joints, which slip in turns",
    "odometry_only": "odometry, no wheels",
}


#: A robot of `mobilecal simulate`.
Robot = StrEnum("Robot", list(ROBOTS))  # type: ignore[misc]
#: Motions of a simulated robot.
Motion = Literal[
    "standard", "head_fixed", "pan_only", "straight", "spin", "base_fixed", "large_turns", "moving"
]
#: Formats of a simulated recording, of its images, and the board in them.
Container = Literal[
    "mcap", "mcap-lz4", "mcap-zstd", "mcap-ros1", "rosbag2", "rosbag2-mcap", "bag", "bag-lz4", "bag-bz2"
]
Pictures = Literal["jpeg", "png", "mono8"]
BoardKind = Literal["checkerboard", "charuco", "aprilgrid"]
