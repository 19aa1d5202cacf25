"""What a look at a recording told, as text and as JSON."""

from __future__ import annotations

import json
import textwrap
from collections.abc import Iterable
from datetime import UTC, datetime
from typing import Any

import numpy as np

from mobilecal_cli.model import Camera, Inspection, Lack, MotionView, Rig, StereoRig
from mobilecal_cli.model.text import visible

_WIDTH = 96
#: What settled a role, in the words of `Rig.settled_by`, for people.
_WHY = {"log": "by name and type in the log", "flag": "by a flag", "file": "by the configuration"}


def inspection_json(found: Inspection) -> str:
    """All of it for programs; the keys are in docs/reference/cli.md."""
    rig = found.rig
    data: dict[str, Any] = {
        "recording": {
            "name": found.name,
            "containers": list(found.containers),
            "size_bytes": found.size_bytes,
            "start_ns": found.start_ns,
            "end_ns": found.end_ns,
            "duration_s": _duration_s(found),
        },
        "topics": [
            {
                "name": topic.name,
                "type": topic.type,
                "messages": topic.messages,
                "rate_hz": topic.rate_hz,
                "longest_gap_s": topic.longest_gap_s,
                "gap_at_s": topic.gap_at_s,
                "steps_back": topic.steps_back,
            }
            for topic in found.topics
        ],
        "roles": dict(rig.settled_by) if rig else None,
        "head": _head(rig) if rig else None,
        "cameras": _cameras(rig.cameras) if rig else None,
        "board": None
        if found.board is None
        else {
            "pictures": found.board.pictures,
            "seen": found.board.seen,
            "columns": found.board.size[0] if found.board.size else None,
            "rows": found.board.size[1] if found.board.size else None,
        },
        "motion": None if found.motion is None else _motion(found.motion),
        "missing": [{"what": lack.what, "cure": lack.cure} for lack in found.missing],
        "weak": [{"what": lack.what, "cure": lack.cure} for lack in found.weak],
        "notes": list(found.notes),
    }
    return json.dumps(data, indent=1, allow_nan=False) + "\n"


def _duration_s(found: Inspection) -> float | None:
    if found.start_ns is None or found.end_ns is None:
        return None
    return (found.end_ns - found.start_ns) * 1e-9


def _head(rig: Rig) -> dict[str, Any]:
    chain = rig.chain
    return {
        "base_frame": chain.base_frame,
        "head_frame": chain.head_frame,
        "joints": list(chain.joints),
        "pan": chain.pan or None,
        "tilt": chain.tilt or None,
    }


def _cameras(cameras: StereoRig) -> dict[str, Any]:
    def one(camera: Camera) -> dict[str, Any]:
        return {
            "frame": camera.frame_id,
            "width": camera.width,
            "height": camera.height,
            "focal_px": [float(camera.K[0, 0]), float(camera.K[1, 1])],
            "distortion": camera.distortion,
        }

    baseline_m = float(np.linalg.norm(cameras.T_c_r[:3, 3]))
    return {
        "left": one(cameras.left),
        "right": one(cameras.right),
        "baseline_m": baseline_m,
        "rectified": cameras.rectified,
    }


def _motion(motion: MotionView) -> dict[str, Any]:
    return {
        "joints": {
            name: {"low": span.low, "high": span.high, "unit": span.unit}
            for name, span in motion.joints.items()
        },
        "wheels_deg": dict(motion.wheels_deg),
        "driven_m": motion.driven_m,
        "turned_deg": motion.turned_deg,
        "rests": motion.rests,
        "share_read": motion.share,
    }


def inspection_text(found: Inspection) -> str:
    """The same for people: plain lines, nothing from the log can steer the terminal."""
    lines = [visible(found.name), f"  {_file_facts(found)}", "", *_topics(found)]
    if found.rig is not None:
        lines += ["", "What would be used", *_roles(found.rig)]
    if found.motion is not None:
        lines += ["", "Motion", *_motion_lines(found.motion)]
    if found.board is not None:
        lines += ["", "Board", f"  {_board(found)}"]
    lines += _lacks("Missing for a calibration", found.missing)
    lines += _lacks("What it cannot show", found.weak)
    if found.notes:
        lines += ["", "Odd", *(line for note in found.notes for line in _wrapped(note))]
    lines += ["", _conclusion(found)]
    return "\n".join(lines) + "\n"


def _wrapped(text: str) -> list[str]:
    return textwrap.wrap(visible(text), _WIDTH, initial_indent="  ", subsequent_indent="    ")


def _file_facts(found: Inspection) -> str:
    facts = [", ".join(found.containers), f"{found.size_bytes / 1e6:.1f} MB"]
    duration_s = _duration_s(found)
    if duration_s is not None and found.start_ns is not None:
        start = datetime.fromtimestamp(found.start_ns // 10**9, UTC)
        facts += [f"{duration_s:.1f} s", f"from {start:%Y-%m-%d %H:%M:%S} UTC"]
    return ", ".join(facts)


def _topics(found: Inspection) -> list[str]:
    rows = [("topic", "type", "messages", "rate", "longest gap", "")]
    for topic in found.topics:
        gap = (
            ""
            if topic.longest_gap_s is None
            else f"{topic.longest_gap_s:.3f} s at {topic.gap_at_s or 0:.1f} s"
        )
        back = f"{topic.steps_back} not in order of time" if topic.steps_back else ""
        rows.append(
            (
                visible(topic.name),
                visible(topic.type),
                "?" if topic.messages is None else str(topic.messages),
                "" if topic.rate_hz is None else f"{topic.rate_hz:.1f} Hz",
                gap,
                back,
            )
        )
    widths = [max(len(row[i]) for row in rows) for i in range(5)]
    lines = []
    for name, kind, messages, rate, gap, back in rows:
        left = f"  {name:<{widths[0]}}  {kind:<{widths[1]}}"
        right = f"  {messages:>{widths[2]}}  {rate:>{widths[3]}}  {gap:<{widths[4]}}  {back}"
        lines.append(f"{left}{right}".rstrip())
    return lines


def _roles(rig: Rig) -> Iterable[str]:
    cameras = rig.cameras
    for role, origin in rig.settled_by.items():
        yield from _wrapped(f"{role}: {_WHY.get(origin, origin)}")
    for side, camera in (("left", cameras.left), ("right", cameras.right)):
        size, focal = f"{camera.width} x {camera.height}", f"focal length {camera.K[0, 0]:.1f} px"
        yield f"  {side} camera: {size}, {focal}, {camera.distortion}"
    yield f"  stereo baseline: {np.linalg.norm(cameras.T_c_r[:3, 3]) * 1e3:.1f} mm"


def _motion_lines(motion: MotionView) -> Iterable[str]:
    for name, span in motion.joints.items():
        yield f"  {visible(name)}: {span.low:.1f} to {span.high:.1f} {span.unit}"
    turned = ", ".join(f"{side} {value:.0f} deg" for side, value in sorted(motion.wheels_deg.items()))
    yield f"  wheels turned: {turned}"
    if motion.driven_m is not None and motion.turned_deg is not None:
        yield (
            f"  driven {motion.driven_m:.2f} m, heading spans {motion.turned_deg:.0f} deg, by the nominal wheels"
        )
    if motion.rests is not None:
        yield f"  rests with pictures: {motion.rests}"
    if motion.share < 1:
        yield f"  (of {motion.share:.0%} of the recording, spread over it: the rest was not read)"


def _board(found: Inspection) -> str:
    board = found.board
    assert board is not None
    if board.size is None:
        return f"in none of {board.pictures} pictures spread over the log"
    columns, rows = board.size
    return f"{columns} x {rows} inner corners, whole in {board.seen} of {board.pictures} pictures spread over the log"


def _lacks(title: str, lacks: Iterable[Lack]) -> list[str]:
    lines = []
    for lack in lacks:
        lines += _wrapped(lack.what)
        if lack.cure:
            lines += textwrap.wrap(
                visible(f"cure: {lack.cure}"), _WIDTH, initial_indent="    ", subsequent_indent="      "
            )
    return ["", title, *lines] if lines else []


def _conclusion(found: Inspection) -> str:
    if found.missing:
        return "This recording cannot be calibrated as it is."
    if found.weak:
        return "A calibration of this recording will not show everything."
    return "Nothing is missing for a calibration."
