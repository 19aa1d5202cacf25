"""`mobilecal check`: one line for each criterion of a configuration and a recording."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

import numpy as np

from mobilecal_cli.model import SIDES, Inspection, Lack, MotionView, Parts, StereoRig, WheelSource, listed
from mobilecal_cli.model.text import visible, wrapped
from mobilecal_cli.report.values import json_text

#: Criteria without which no other can be checked.
_FIRST = ("rig.yaml", "recording")
State = Literal["ok", "limit", "problem", "unknown"]


@dataclass(frozen=True, slots=True)
class Line:
    """One criterion.

    Attributes:
        about: one of `Inspection.CRITERIA`.
        state: "ok"; "limit": a calibration is possible, with limits; "problem": it is not; "unknown": another problem
            prevents the check.
        what: what was found, or what is wrong.
        cure: what to do.
        exit_code: exit code of `calibrate` for this; 0 for "ok" and "unknown".
    """

    about: str
    state: State
    what: str
    cure: str = ""
    exit_code: int = 0


def checklist(found: Inspection) -> tuple[Line, ...]:
    """All criteria, in order; one with several problems has several lines.

    A configuration that is invalid, or a recording that cannot be read, is the only line.
    """
    opened = [_line(lack, "problem") for lack in found.missing if lack.about in _FIRST]
    if opened:
        return tuple(opened)
    lines: list[Line] = []
    for about in found.CRITERIA:
        bad = [_line(lack, "problem") for lack in found.missing if lack.about == about]
        bad += [_line(lack, "limit") for lack in found.weak if lack.about == about]
        lines += bad or [_good(about, found)]
    return tuple(line for line in lines if line.what)


def _line(lack: Lack, state: State) -> Line:
    return Line(lack.about, state, lack.what, lack.cure, lack.exit_code)


def _good(about: str, found: Inspection) -> Line:
    """A criterion without a problem: what was found, or unknown; without a text if it does not apply."""
    if about in ("recording", "priors", "gates"):
        return Line(about, "ok", "")
    known = {"rig.yaml": "valid", **_known(found.parts), **_measured(found)}.get(about)
    return (
        Line(about, "unknown", "not checked, see the problems" if found.missing else "could not be measured")
        if known is None
        else Line(about, "ok", known)
    )


def _known(parts: Parts) -> dict[str, str]:
    said = {}
    if parts.images is not None:
        said["cameras"] = " and ".join(dict.fromkeys(parts.images[side] for side in SIDES))
    if parts.cameras is not None:
        said["camera infos"] = _geometry(parts.cameras)
    if parts.wheels is not None:
        said["wheels"] = ", ".join(f"{side} {_wheel(parts.wheels[side])}" for side in SIDES)
    if parts.chain is not None:
        chain = parts.chain
        said["head chain"] = f"{chain.base_frame} to {chain.head_frame}, from the {parts.chain_from}"
        if parts.joints is not None:
            said["joints"] = f"{listed(chain.joints)} on {listed(parts.joints)}"
    return said


def _geometry(cameras: StereoRig) -> str:
    sides = [
        f"{side} {camera.width} x {camera.height} {camera.distortion}"
        for side, camera in zip(SIDES, (cameras.left, cameras.right), strict=True)
    ]
    kind = "rectified" if cameras.rectified else "raw"
    return f"{', '.join(sides)}; {kind} images; baseline {np.linalg.norm(cameras.T_c_r[:3, 3]) * 1e3:.1f} mm"


def _wheel(source: WheelSource) -> str:
    where = source.joint or source.field
    return f"{where} on {source.topic}" if where else f"odometry on {source.topic}"


def _measured(found: Inspection) -> dict[str, str]:
    said = {}
    if found.covered is not None:
        said["time"] = "{} of {} left images are within the time of right images, joints and wheels".format(
            *found.covered
        )
    if found.motion is not None:
        motion = found.motion
        stops = (
            "stops not counted, as only a part of the recording was read"
            if motion.rests is None
            else f"{motion.rests} stops with images; the motion determines all nine parameters"
        )
        said["motion"] = f"{stops}; {', '.join(_ranges(motion))}"
    board = found.board
    if board is not None and board.size is not None:
        said["board"] = (
            f"{board.size[0]} x {board.size[1]} inner corners, whole in {board.seen} of {board.pictures} images"
        )
        if board.square_m is not None:
            stated = "not stated" if board.stated_m is None else f"{board.stated_m * 1e3:.2f} mm stated"
            said["square size"] = f"{board.square_m * 1e3:.2f} mm measured with the stereo pair, {stated}"
    return said


def _ranges(motion: MotionView) -> Iterator[str]:
    """What joints and wheels do over the recording."""
    for name, span in motion.joints.items():
        yield f"{name} {span.low:.0f} to {span.high:.0f} {span.unit}"
    yield from (f"{side} wheel {motion.wheels_deg[side]:.0f} deg" for side in SIDES)
    if motion.driven_m is not None:
        yield f"driven {motion.driven_m:.1f} m with the nominal wheels"


def checklist_text(found: Inspection) -> str:
    """The criteria for the terminal; control characters from the recording are escaped."""
    lines = checklist(found)
    width = max(len(line.about) for line in lines)
    text = []
    for line in lines:
        start = f"{line.state:<7}  {line.about:<{width}}  "
        indent = " " * len(start)
        text += wrapped(line.what, start, indent)
        text += wrapped(f"hint: {line.cure}", indent, indent) if line.cure else []
    text += [f"note     {visible(note)}" for note in found.notes]
    problems = sum(line.state == "problem" for line in lines)
    limits = sum(line.state == "limit" for line in lines)
    counts = [f"{problems} problem{'s' * (problems != 1)}"] if problems else []
    counts += [f"{limits} limit{'s' * (limits != 1)}"] if limits else []
    end = f" (exit code {found.exit_code})" if problems else ""
    return "\n".join([*text, f"{', '.join(counts) or 'No problems'}{end}."]) + "\n"


def checklist_json(found: Inspection) -> str:
    """The criteria for programs; docs/reference/cli.md lists the keys."""
    data = {"lines": checklist(found), "notes": found.notes, "exit_code": found.exit_code}
    return json_text(data, sort_keys=False)
