"""What the whole command says about input that cannot be used: the table docs/reference/refusals.md, and its test."""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from mobilecal_cli.export import extraction_to_npz
from mobilecal_cli.model import LogSource
from mobilecal_cli.simulate.ideal import Noise, ideal_extraction
from mobilecal_cli.simulate.robot import ROBOTS
from mobilecal_cli.simulate.route import plan_route
from tests.cli.edited import edited
from tests.conftest import REPOSITORY

LOGS = REPOSITORY / "sample_logs"
LOG = LOGS / "paper_robot.mcap"
IMAGES = ("/stereo/left/image_raw/compressed", "/stereo/right/image_raw/compressed")
NOISE = Noise(pixel_px=0.1, wheel_rad_per_sqrt_rad=0.002, joint_rad=2e-4)
Make = Callable[[Path], None]


def nothing(folder: Path) -> None:
    """A case that needs no file of its own."""


@dataclass(frozen=True)
class Case:
    """One input, and what must be said.

    Attributes:
        name: the input, as in the table.
        arguments: of the command.
        code: its exit code.
        says: part of the first line on standard error (of standard output for code 0).
        make: writes the files of the case into its directory.
        environment: variables.
    """

    name: str
    arguments: tuple[object, ...]
    code: int
    says: str
    make: Make = nothing
    environment: Mapping[str, str] = field(default_factory=dict)


def extraction(folder: Path) -> None:
    """extraction.npz of a simulated robot."""
    robot = ROBOTS["paper"]()
    ideal = ideal_extraction(robot, plan_route(robot), NOISE)
    made = replace(ideal, logs=(LogSource("log.mcap", "0" * 64),))
    (folder / "e.npz").write_bytes(extraction_to_npz(made))


def text(name: str, content: str) -> Make:
    """A text file."""
    return lambda folder: Path(folder, name).write_text(content) and None


def log(edit: Callable[[str, Any], Any]) -> Make:
    """A copy of the sample recording with an edit, as log.mcap."""
    return lambda folder: edited(LOG, folder / "log.mcap", edit) and None


def pictures(data: Callable[[], bytes]) -> Make:
    """The sample recording with other images."""
    content = data()
    image = np.frombuffer(content, np.uint8)
    return log(lambda topic, m: replace(m, data=image) if topic in IMAGES else m)


def urdf(old: str, new: str) -> Make:
    """The sample recording with another URDF."""

    def edit(topic: str, message: Any) -> Any:
        if topic != "/robot_description":
            return message
        assert old in message.data
        return replace(message, data=message.data.replace(old, new))

    return log(edit)


def positions(**values: float) -> Make:
    """The sample recording with a reading in place of those of some joints, in every second message."""
    count = [0]

    def edit(topic: str, message: Any) -> Any:
        if topic != "/joint_states":
            return message
        count[0] += 1
        position = message.position.copy()
        for name, value in values.items():
            if count[0] % 2:
                position[list(message.name).index(name)] = value
        return replace(message, position=position)

    return log(edit)


def fifo(folder: Path) -> None:
    """A named pipe."""
    os.mkfifo(folder / "fifo.mcap")


def tall_jpeg() -> bytes:
    """A JPEG of 1 x 65500 pixels."""
    return bytes(cv2.imencode(".jpg", np.zeros((65500, 1), np.uint8))[1])


SOLVE = ("calibrate", "e.npz", "-o", "out")
READ = ("calibrate", "log.mcap", "-o", "out")
RIG = ("calibrate", LOG, "--config", "rig.yaml", "-o", "out")
RADII = "{radius_left_m: %s, radius_right_m: 0.1, separation_m: 0.5}"

CASES = (
    Case("`--square-m inf`", ("calibrate", LOG, "--square-m", "inf"), 2, "board.square_m: must be from 0.0001 to 10 m"),
    Case(
        "`nominal.wheels` of 1e300 m", RIG, 2, "nominal.wheels.radius_left_m: must be from 0.001 to 10 m",
        text("rig.yaml", f"nominal: {{wheels: {RADII % '1e300'}}}"),
    ),
    Case(
        "`radius_left_m: true` in rig.yaml", RIG, 2, "radius_left_m: Input should be a valid number (got True)",
        text("rig.yaml", f"nominal: {{wheels: {RADII % 'true'}}}"),
    ),
    Case("`--fix radius_left=0`", (*SOLVE, "--fix", "radius_left=0"), 2, "0 m is not possible (range 0.001 to 10 m)", extraction),
    Case("`--fix radius_left=-0.2`", (*SOLVE, "--fix", "radius_left=-0.2"), 2, "-0.2 m is not possible", extraction),
    Case("`--fix t_x=1e300`", (*SOLVE, "--fix", "t_x=1e300"), 2, "1e+300 is not possible (range -100 to 100)", extraction),
    Case(
        "`--prior t_x=0.1±1e-300`", (*SOLVE, "--prior", "t_x=0.1±1e-300"), 2,
        "standard deviation: 1e-300 is not possible (range 1e-09 to 1000)", extraction,
    ),
    Case("`SOURCE_DATE_EPOCH` is a word", SOLVE, 2, "SOURCE_DATE_EPOCH", extraction, {"SOURCE_DATE_EPOCH": "today"}),
    Case("`SOURCE_DATE_EPOCH` is too large", SOLVE, 2, "SOURCE_DATE_EPOCH", extraction, {"SOURCE_DATE_EPOCH": "9" * 30}),
    Case("`SOURCE_DATE_EPOCH` is empty: the time is used", SOLVE, 0, "PASS", extraction, {"SOURCE_DATE_EPOCH": ""}),
    Case(
        "both wheels are the same joint", ("calibrate", LOG, "--set", "wheels.left.joint=wheel_right_joint", "-o", "out"), 2,
        "wheels.left and wheels.right are both read from wheel_right_joint",
    ),
    Case(
        "pan and tilt are the same joint", ("calibrate", LOG, "--set", "joints.pan=head_pan_joint", "--set", "joints.tilt=head_pan_joint"), 2,
        "joints.pan and joints.tilt are both 'head_pan_joint'",
    ),
    Case(
        "both cameras are one topic",
        ("calibrate", LOG, *(f"--set=cameras.{side}.image={IMAGES[0]}" for side in ("left", "right"))), 2,
        "cameras.left.image and cameras.right.image are both",
    ),
    Case("a joint reads 1e300 in every second message: dropped", READ, 0, "PASS", positions(head_pan_joint=1e300)),
    Case("a URDF with a wheel radius of 1e-300 m", READ, 2, "cylinder radius: 1e-300 m is not possible", urdf('radius="0.225"', 'radius="1e-300"')),
    Case("a URDF with a negative wheel radius", READ, 2, "cylinder radius: -0.1 m is not possible", urdf('radius="0.225"', 'radius="-0.1"')),
    Case("a URDF with an origin at 1e300 m", READ, 2, "origin xyz: 1e+300 m is not possible", urdf('xyz="0.04 0.0', 'xyz="1e300 0.0')),
    Case("JPEG images of 1 x 65500 pixels", READ, 4, "no checkerboard found", pictures(tall_jpeg)),
    Case("a named pipe as the recording", ("calibrate", "fifo.mcap"), 3, "fifo.mcap: not a regular file", fifo),
    Case("a device as the recording", ("calibrate", "/dev/null"), 3, "/dev/null: not a regular file"),
    Case("the output exists", (*SOLVE,), 7, "out: already exists", lambda folder: (extraction(folder), (folder / "out").mkdir(), None)[-1]),
    Case("the directory of the JUnit file does not exist", (*SOLVE, "--junit", "no/j.xml"), 7, "no is not a directory", extraction),
    Case("the JUnit file is inside the output", (*SOLVE, "--junit", "out/j.xml"), 7, "--junit out/j.xml: inside the output", extraction),
    Case("a name of 300 bytes as the output", (*SOLVE[:2], "-o", "x" * 300), 7, "File name too long", extraction),
)  # fmt: skip


def table() -> str:
    """The page docs/reference/refusals.md."""
    lines = [
        "# Refusals",
        "",
        "Generated from the tests by `make docs`: input that cannot be used, the exit code, and a part of the",
        "message. Each line is a test of the whole command (`tests/hostile/test_refusals.py`).",
        "",
        "| case | exit code | message contains |",
        "| --- | --- | --- |",
    ]
    lines += [f"| {case.name} | {case.code} | {case.says.replace('|', '/')} |" for case in CASES]
    return "\n".join(lines) + "\n"
