"""Formats of `mobilecal export`, a file each: its name is that of the format, and its function `export` makes it.

The docstring of this function is a row in the table of formats (Markdown), and its parameters after the first are the
options that the format uses. A new file is a new format: `mobilecal export --to`, its help, `export_to` and the table
in docs/reference/cli.md (`make docs`) read the files of this directory.
"""

from __future__ import annotations

import inspect
import math
import re
from collections.abc import Callable
from dataclasses import dataclass, field
from importlib import import_module
from pathlib import Path

from mobilecal_cli import se3
from mobilecal_cli.export.scene import Scene
from mobilecal_cli.export.text import comment, rendered
from mobilecal_cli.likelihood.predict import off_as_stated
from mobilecal_cli.model.calibration import NINE, CalibratedRobot
from mobilecal_cli.model.observations import Extraction
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
        states_verdict: the content has fields for the verdict; otherwise comments at its beginning state it.
    """

    content: bytes = field(repr=False)
    notes: tuple[str, ...] = ()
    layout: str = field(default="", repr=False)
    states_verdict: bool = field(default=False, repr=False)


@dataclass(frozen=True, slots=True, eq=False)
class Source:
    """What formats are made from.

    Attributes:
        robot: the calibration.
        params: its file, for messages.
        measurements: reads the extraction next to the file.
        scene: makes the scene for viewers, with images of some recordings.
    """

    robot: CalibratedRobot
    params: Path
    measurements: Callable[[], Extraction]
    scene: Callable[[tuple[Path, ...]], Scene]


def format_of(name: str) -> Callable[..., Exported]:
    """A format by its name, which is that of a file in this directory."""
    made: Callable[..., Exported] = import_module(f"{__name__}.{name}").export
    return made


def options_of(name: str) -> list[str]:
    """Names of the options that a format uses."""
    return list(inspect.signature(format_of(name)).parameters)[1:]


def frame_note(robot: CalibratedRobot) -> str:
    """Which optical frame the camera frame of a calibration is."""
    if not robot.rectified:
        return f"{robot.child_frame} is the optical frame of the raw images."
    return (
        f"{robot.child_frame} is the rectified optical frame: the calibration was made from rectified images. "
        "For raw images, use head_eye_raw of params.yaml."
    )


def rectified_note(robot: CalibratedRobot) -> tuple[str, ...]:
    """The note of an export on its camera frame, where it is not that of the images as recorded."""
    return (frame_note(robot),) if robot.rectified else ()


def chain_note(robot: CalibratedRobot) -> tuple[str, ...]:
    """How far the camera is off where the head-eye transform is used without the corrections of the head chain."""
    if robot.chain is None or not robot.constants:
        return ()
    turn_rad, shift_m = off_as_stated(robot.chain, robot.constants, robot.T_parent_child)
    deg, mm = f"{math.degrees(turn_rad):.2g}", f"{1e3 * shift_m:.2g}"
    if deg == mm == "0":
        return ()
    return (
        f"The calibration also corrects the head chain; with it as stated, the camera is {deg} degrees and {mm} mm "
        "away from its estimated place. The format urdf writes the corrections into the URDF (with-chain).",
    )


def verdict_note(robot: CalibratedRobot) -> tuple[str, ...]:
    """What a reader of an export has to know: a verdict other than PASS, its reasons, unobservable parameters."""
    lines: tuple[str, ...] = ()
    if not robot.verdict:
        lines = ("Verdict of the calibration: unknown. Its params.yaml states none.",)
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


def of_head_eye(robot: CalibratedRobot, template: str, **values: str) -> Exported:
    """A text with the frames of the head-eye transform, from its template."""
    T, notes = robot.T_parent_child, (frame_note(robot), *chain_note(robot))
    text = rendered(
        template,
        robot=robot,
        about=" ".join((CONVENTION, *notes)),
        convention=CONVENTION,
        notes=notes,
        translation_m=T[:3, 3].tolist(),
        quaternion_xyzw=se3.quaternion_xyzw(T[:3, :3]).tolist(),
        rpy_rad=se3.to_rpy(T[:3, :3]).tolist(),
        factors=robot.factors,
        **values,
    )
    return Exported(text.encode(), (*chain_note(robot), *rectified_note(robot)))
