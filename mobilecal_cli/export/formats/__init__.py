"""Formats of `mobilecal export`, a file each: its name is that of the format, and it has one `Format`.

A new file is a new format: `mobilecal export --to`, its help, `export_to` and the table in docs/reference/cli.md
(`make docs`) read the files of this directory.
"""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path
from typing import ClassVar

from mobilecal_cli.export.scene import Scene
from mobilecal_cli.export.text import comment
from mobilecal_cli.model import NINE, CalibratedRobot, Extraction, Side
from mobilecal_cli.model.text import visible

CONVENTION = (
    "x_parent = R x_child + translation; optical frames: x right, y down, z forward. "
    "Lengths in m, angles in rad."
)


@dataclass(frozen=True, slots=True)
class Exported:
    """A calibration in another format.

    Attributes:
        content: the bytes of the file.
        notes: changes and notes, whole sentences.
        layout: text of a second file, the layout for Foxglove; "" for none.
    """

    content: bytes = field(repr=False)
    notes: tuple[str, ...] = ()
    layout: str = field(default="", repr=False)


@dataclass(frozen=True, slots=True, eq=False)
class Request:
    """What a format is made from.

    Attributes:
        robot: the calibration.
        params: its file, for messages.
        joints: names of the wheel joints, as far as they are known.
        measurements: reads the extraction next to the file.
        scene: makes the scene for viewers.
        urdf, camera, with_chain, rate_hz, distance_m, logs: see `calibrate.export.export`.
    """

    robot: CalibratedRobot
    params: Path
    joints: Mapping[Side, str]
    measurements: Callable[[], Extraction]
    scene: Callable[[], Scene]
    urdf: Path | None = None
    camera: str | None = None
    with_chain: bool = False
    rate_hz: float | None = None
    distance_m: float | None = None
    logs: tuple[Path, ...] = ()


class Format(ABC):
    """A format. The docstring of its class is its row in the table of formats: Markdown.

    Attributes:
        options: those of the command that only some formats use, and this one does.
        second_file: suffix of a second file, "" for none.
        states_verdict: whether its content has fields for the verdict; otherwise comments at its beginning state it.
        of_file: module → the format in it.
    """

    of_file: ClassVar[dict[str, type[Format]]] = {}

    options: ClassVar[frozenset[str]] = frozenset()
    second_file: ClassVar[str] = ""
    states_verdict: ClassVar[bool] = False

    def __init_subclass__(cls) -> None:
        Format.of_file[cls.__module__] = cls

    @abstractmethod
    def export(self, asked: Request) -> Exported:
        """The calibration in this format."""


def format_of(name: str) -> Format:
    """A format by its name, which is that of a file in this directory."""
    module = import_module(f"{__name__}.{name}")
    return Format.of_file[module.__name__]()


def frame_note(robot: CalibratedRobot) -> str:
    """Which optical frame the camera frame of a calibration is."""
    if not robot.rectified:
        return f"{robot.child_frame} is the optical frame of the raw images."
    return (
        f"{robot.child_frame} is the rectified optical frame: the calibration was made from rectified images. "
        "For raw images, use head_eye_raw of params.yaml."
    )


def verdict_note(robot: CalibratedRobot) -> tuple[str, ...]:
    """What a reader of an export has to know: a verdict other than PASS, its reasons, unobservable parameters."""
    lines: tuple[str, ...] = ()
    if not robot.verdict:
        lines = (
            "Verdict of the calibration: unknown. Its params.yaml states none, like those of earlier versions.",
        )
    elif robot.verdict != "PASS":
        lines = (f"Verdict of the calibration: {robot.verdict}.", *robot.reasons)
    hidden = ", ".join(name for name, hides in zip(NINE, robot.unobservable, strict=True) if hides)
    if hidden:
        lines += (f"Unobservable, so the calibration keeps the nominal value: {hidden}.",)
    return lines


def with_verdict(content: bytes, robot: CalibratedRobot) -> bytes:
    """A file in XML or YAML with `verdict_note` as comments at its beginning."""
    note = verdict_note(robot)
    if not note:
        return content
    start = re.match(rb"(?:\xef\xbb\xbf)?(?:<\?xml\s[^>]*\?>)?\s*(<?)", content)
    assert start is not None  # it matches the empty text too
    xml = start.group(1)
    lines = (f"<!-- {comment(line)} -->\n" if xml else f"# {visible(line)}\n" for line in note)
    at = start.start(1)
    return content[:at] + "".join(lines).encode() + content[at:]


class HeadEyeFormat(Format):
    """A text with the frames of the head-eye transform."""

    @abstractmethod
    def text(self, robot: CalibratedRobot) -> str:
        """The file. It says which frame the camera frame is."""

    def export(self, asked: Request) -> Exported:
        robot = asked.robot
        return Exported(self.text(robot).encode(), (frame_note(robot),) if robot.rectified else ())
