"""Commented draft of rig.yaml from a recording."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from typing import TypeVar

from mobilecal_cli.config import RigConfig
from mobilecal_cli.discovery.cameras import image_topics, info_topic, is_rectified
from mobilecal_cli.discovery.chain import frames
from mobilecal_cli.discovery.joints import pan_and_tilt
from mobilecal_cli.discovery.wheels import wheel_sources
from mobilecal_cli.errors import MobilecalError
from mobilecal_cli.kinematics.urdf import parse_urdf
from mobilecal_cli.likelihood.nuisance import KINDS
from mobilecal_cli.model import IMAGES, Prelude, Side, WheelSource

_SIDES: tuple[Side, Side] = ("left", "right")
T = TypeVar("T")


def _quoted(text: str) -> str:
    """YAML string that any loader reads back unchanged."""
    return json.dumps(text)


def _try(step: Callable[[], T]) -> tuple[T | None, list[str]]:
    """Result of a step, or a comment with the reason why there is none."""
    try:
        return step(), []
    except MobilecalError as error:
        said = f"{error.message}. {error.hint}" if error.hint else error.message
        return None, [f"# not determined: {' '.join(said.split())}"]


def _listing(title: str, names: Iterable[str]) -> list[str]:
    found = sorted(names)
    return [f"# {title}: {', '.join(_quoted(name) for name in found)}"] if found else [f"# {title}: none"]


def _cameras(prelude: Prelude) -> list[str]:
    images, why = _try(lambda: image_topics(RigConfig(), prelude))
    lines = _listing("image topics in the recording", (t.name for t in prelude.topics if t.type in IMAGES))
    lines += [*why, "cameras:"]
    for side in _SIDES:
        image = images[side] if images else f"/stereo/{side}/image_raw"
        info, missing = _try(lambda side=side, image=image: info_topic(side, image, RigConfig(), prelude))  # type: ignore[misc]
        lines += missing
        entry = f"{{image: {_quoted(image)}, info: {_quoted(info or f'/stereo/{side}/camera_info')}}}"
        lines.append(f"  {side}: {entry}" if images and info else f"  # {side}: {entry}")
    rectified = bool(images) and is_rectified(images["left"]) if images else False
    return [
        *lines,
        "  reference: left          # camera of the head-eye transform",
        f"  rectified: {'true' if rectified else 'false'}         # true if the images are rectified",
    ]


def _wheel_entry(source: WheelSource) -> str:
    where = f"joint: {_quoted(source.joint)}" if source.joint else f"field: {_quoted(source.field or 'data')}"
    return f"{{topic: {_quoted(source.topic)}, {where}, sign: {source.sign}}}"


def _wheels(prelude: Prelude) -> list[str]:
    wheels, why = _try(lambda: wheel_sources(RigConfig(), prelude))
    lines = [
        *why,
        "# for a tick counter: {topic: /ticks/left, field: data, ticks_per_revolution: 4096, bits: 16, sign: 1}",
    ]
    if wheels is None:
        return [
            *lines,
            "# wheels:",
            "#   left:  {topic: ..., joint: ...}",
            "#   right: {topic: ..., joint: ...}",
        ]
    return [*lines, "wheels:", *(f"  {side}: {_wheel_entry(wheels[side])}" for side in _SIDES)]


def _head(prelude: Prelude) -> list[str]:
    names = sorted({name for names in prelude.joint_names.values() for name in names})
    lines = _listing("joints in the recording", names)
    urdf_text = next((text for _, text in sorted(prelude.urdfs.items())), None)
    urdf, why = _try(lambda: parse_urdf(urdf_text)) if urdf_text is not None else (None, [])
    candidates = [name for name in urdf.joints if name in names] if urdf else names
    found, unsure = _try(lambda: pan_and_tilt(RigConfig(), prelude, candidates))
    pan, tilt = found or ("", "")
    lines += why + unsure
    if pan and tilt:
        lines.append(f"joints: {{pan: {_quoted(pan)}, tilt: {_quoted(tilt)}}}")
    else:
        lines.append("# joints: {topic: /joint_states, pan: head_pan_joint, tilt: head_tilt_joint}")
    ends, unknown = _try(lambda: frames(RigConfig(), urdf, tilt)) if urdf else (None, [])
    if ends is not None:
        return [
            *lines,
            "head:                      # the chain is in the recording's robot_description",
            f"  base_frame: {_quoted(ends[0])}",
            f"  head_frame: {_quoted(ends[1])}",
        ]
    return [
        *lines,
        *unknown,
        "# no usable robot_description in the recording: give head.urdf, or the chain here",
        "# head:",
        "#   base_frame: base_link",
        "#   head_frame: head_link",
        "#   chain:",
        "#     - {xyz_m: [0.05, 0, 0.9], rpy_rad: [0, 0, 0]}",
        "#     - {joint: head_pan_joint, axis: [0, 0, 1]}",
        "#     - {xyz_m: [0.02, 0, 0.06]}",
        "#     - {joint: head_tilt_joint, axis: [0, 1, 0]}",
    ]


def _priors() -> list[str]:
    """The section `priors` with all defaults, as comments."""
    entries = [(f"#   {kind.name}: {kind.sigma * kind.shown:.4g}", kind) for kind in KINDS]
    width = max(len(entry) for entry, _ in entries)
    return [
        "# how well the stated constants of the robot are known: one standard deviation of each, fixed (exact) or free",
        "# (ignored). all: fixed makes every constant exact; an entry for a single constant, such as focal_left,",
        "# overrides that of its kind.",
        "# priors:",
        *(f"{entry:{width}}  # {kind.shown_unit}: {kind.meaning}" for entry, kind in entries),
    ]


def draft_rig(prelude: Prelude, log_name: str) -> str:
    """Text of a rig.yaml with the keys found in the recording, and comments on the others.

    Args:
        `prelude`: topics and first messages of the recording.
        log_name: shown in the first line.
    """
    lines = [
        f"# rig.yaml for mobilecal, drafted from {_quoted(log_name)}.",
        "# Every key is optional if the recording contains the information.",
        "schema_version: 1",
        "",
        "# inner corners of the checkerboard; detected if omitted. square_m: side of a square, m;",
        "# measured with the stereo pair if omitted.",
        "# board: {columns: 9, rows: 6, square_m: 0.08}",
        "",
        *_cameras(prelude),
        "",
        *_wheels(prelude),
        "",
        *_head(prelude),
        "",
        "# nominal values, used only for what the recording does not determine, and to unwrap large turns",
        "# nominal:",
        "#   head_eye: {translation_m: [0, 0, 0], quaternion_xyzw: [0, 0, 0, 1]}",
        "#   wheels: {radius_left_m: 0.2, radius_right_m: 0.2, separation_m: 0.5}",
        "",
        "# known standard deviations; those omitted are estimated from the recording",
        "# noise: {pixel_px: 0.2, wheel_rad_per_sqrt_rad: 0.003, joint_rad: 0.001}",
        "",
        *_priors(),
    ]
    return "\n".join(lines) + "\n"
