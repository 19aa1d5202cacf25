"""A calibration put into a URDF: a few numbers change, every other byte stays."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from xml.parsers.expat import ParserCreate

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.export.xml_text import attribute
from mobilecal_cli.kinematics.urdf import Urdf, UrdfJoint, parse_urdf
from mobilecal_cli.model import CalibratedRobot, FloatArray, Side

_SIDES: tuple[Side, Side] = ("left", "right")
_WHEELS = [
    ["robot", "link", kind, "geometry", shape]
    for kind in ("visual", "collision")
    for shape in ("cylinder", "sphere")
]


@dataclass(frozen=True, slots=True)
class _Tag:
    """A start tag: its attributes may be changed, or an element put behind it."""

    start: int
    end: int


@dataclass(slots=True)
class _Places:
    """Where in the file the numbers stand.

    Attributes:
        joints: joint name → its own tag and its <origin>'s, where it has one.
        wheels: link name → tags of its cylinders and spheres.
        end: where the robot's end tag begins, bytes.
    """

    joints: dict[str, tuple[_Tag, _Tag | None]] = field(default_factory=dict)
    wheels: dict[str, list[_Tag]] = field(default_factory=dict)
    end: int = 0


@dataclass(frozen=True, slots=True)
class PatchedUrdf:
    """The new file.

    Attributes:
        content: its bytes.
        changes: what was changed, whole sentences.
    """

    content: bytes
    changes: tuple[str, ...]


def patched_urdf(content: bytes, robot: CalibratedRobot, wheel_joints: Mapping[Side, str]) -> PatchedUrdf:
    """Put the head-eye transform and the wheels into a URDF.

    The first joint on the way from the head's link to the camera's takes up the head-eye transform; joints behind it
    stay. Where the camera has no link, one is added at the end of the file. The wheels' joints move along their axle
    about its middle, and the wheels' cylinders and spheres (visual and collision) get the calibrated radii.

    Args:
        content: the URDF, UTF-8.
        robot: the calibration.
        wheel_joints: names of the wheels' joints; a side that is left out keeps its numbers.

    Raises:
        ConfigError: no URDF, or no fixed joint leads from the head to the camera, or no such wheel joint.
    """
    try:
        urdf = parse_urdf(content.decode("utf-8"))
    except UnicodeDecodeError as error:
        raise ConfigError(f"the URDF is not UTF-8: {error}", "save it as UTF-8") from error
    places = _places(content)
    edits: list[tuple[int, int, bytes]] = []
    changes: list[str] = []
    if robot.child_frame in urdf.links:
        mount, T_head_mount = _mount(urdf, robot)
        edits.append(_moved(content, places, mount.name, T_head_mount))
        changes.append(
            f"joint {mount.name!r}: its origin puts {robot.child_frame!r} on {robot.parent_frame!r} as calibrated"
        )
    else:
        edits.append(_added(places.end, urdf, robot))
        changes.append(
            f"link {robot.child_frame!r} was not there: added, with a fixed joint on {robot.parent_frame!r}; nothing "
            "else may publish that transform"
        )
    if len(wheel_joints) == len(_SIDES):
        for name, T in _wheel_origins(urdf, robot, wheel_joints):
            edits.append(_moved(content, places, name, T, ("xyz",)))
        changes.append(
            f"joints {wheel_joints['left']!r} and {wheel_joints['right']!r}: {robot.wheels.separation_m:.6g} m apart"
        )
    for side, name in wheel_joints.items():
        link = _joint(urdf, name).child
        radius_m = robot.wheels.radius_left_m if side == "left" else robot.wheels.radius_right_m
        tags = places.wheels.get(link, [])
        edits += [(*_span(tag), _with(content, tag, {"radius": f"{radius_m:.12g}"})) for tag in tags]
        told = (
            f"{len(tags)} radii are {radius_m:.6g} m" if tags else "no cylinder or sphere, no radius is set"
        )
        changes.append(f"link {link!r}: {told}")
    for start, end, new in sorted(edits, reverse=True):
        content = content[:start] + new + content[end:]
    return PatchedUrdf(content, tuple(changes))


def _span(tag: _Tag) -> tuple[int, int]:
    return tag.start, tag.end


def _mount(urdf: Urdf, robot: CalibratedRobot) -> tuple[UrdfJoint, FloatArray]:
    """The joint that takes up the head-eye transform, and its new origin."""
    path = urdf.path(robot.parent_frame, robot.child_frame)
    moving = [joint.name for joint in path if joint.kind != "fixed"]
    if moving or not path:
        raise ConfigError(
            f"URDF: {robot.child_frame!r} is not fixed to {robot.parent_frame!r}: joint "
            f"{moving[0] if moving else 'none'!r} lies between",
            "give the URDF of the robot that was calibrated",
        )
    T_mount_camera = np.eye(4)
    for joint in path[1:]:
        T_mount_camera = T_mount_camera @ joint.T_parent_child
    return path[0], robot.T_parent_child @ se3.inverse(T_mount_camera)


def _added(end: int, urdf: Urdf, robot: CalibratedRobot) -> tuple[int, int, bytes]:
    """The edit that adds the camera's link and joint before the end of the robot."""
    if robot.parent_frame not in urdf.links:
        raise ConfigError(
            f"URDF: neither {robot.child_frame!r} nor {robot.parent_frame!r} is one of its links",
            f"its links: {', '.join(urdf.links) or 'none'}",
        )
    lines = (
        f"<link name={attribute(robot.child_frame)}/>",
        f'<joint name={attribute(f"{robot.child_frame}_joint")} type="fixed">',
        f"  <parent link={attribute(robot.parent_frame)}/><child link={attribute(robot.child_frame)}/>",
        f"  {_origin(robot.T_parent_child)}",
        "</joint>",
    )
    return end, end, "".join(f"  {line}\n" for line in lines).encode()


def _wheel_origins(
    urdf: Urdf, robot: CalibratedRobot, wheel_joints: Mapping[Side, str]
) -> Iterable[tuple[str, FloatArray]]:
    """New origins of both wheel joints: on the old axle, about its old middle."""
    T = {}
    for side, name in wheel_joints.items():
        above = urdf.path(urdf.root, _joint(urdf, name).child)
        T_root_parent = np.eye(4)
        for joint in above[:-1]:
            T_root_parent = T_root_parent @ joint.T_parent_child
        T[side] = (T_root_parent, above[-1].T_parent_child)
    centre = {side: (parent @ own)[:3, 3] for side, (parent, own) in T.items()}
    axle = centre["left"] - centre["right"]
    middle = (centre["left"] + centre["right"]) / 2
    for side, sign in (("left", 0.5), ("right", -0.5)):
        place = middle + sign * robot.wheels.separation_m * axle / np.linalg.norm(axle)
        parent, own = T[side]
        moved = own.copy()
        moved[:3, 3] = se3.act(se3.inverse(parent), place[None])[0]
        yield wheel_joints[side], moved


def _joint(urdf: Urdf, name: str) -> UrdfJoint:
    if name not in urdf.joints:
        raise ConfigError(f"URDF: no joint {name!r}", f"its joints: {', '.join(urdf.joints)}")
    return urdf.joints[name]


def _moved(
    content: bytes, places: _Places, joint: str, T: FloatArray, names: Sequence[str] = ("xyz", "rpy")
) -> tuple[int, int, bytes]:
    """The edit that gives a joint an origin, or changes some attributes of the one that it has."""
    own, origin = places.joints[joint]
    if origin is not None:
        return (
            origin.start,
            origin.end,
            _with(content, origin, {name: _attributes(T)[name] for name in names}),
        )
    return own.end, own.end, _origin(T).encode()


def _attributes(T: FloatArray) -> dict[str, str]:
    xyz, rpy = np.round(T[:3, 3], 12), np.round(se3.to_rpy(T[:3, :3]), 12)
    return {
        name: " ".join(f"{value + 0.0:.12g}" for value in values)
        for name, values in (("xyz", xyz), ("rpy", rpy))
    }


def _origin(T: FloatArray) -> str:
    return f"<origin {' '.join(f'{name}={attribute(value)}' for name, value in _attributes(T).items())}/>"


def _with(content: bytes, tag: _Tag, values: Mapping[str, str]) -> bytes:
    """A tag with some attributes' values replaced, or added before its end."""
    text = content[tag.start : tag.end]
    for name, value in values.items():
        pattern = re.compile(rb"(\s" + name.encode() + rb"\s*=\s*)(\"[^\"]*\"|'[^']*')")
        found = pattern.search(text)
        if found is not None:
            quote = found.group(2)[:1]
            text = text[: found.start(2)] + quote + value.encode() + quote + text[found.end(2) :]
        else:
            end = len(text) - (2 if text.endswith(b"/>") else 1)
            text = text[:end].rstrip() + f' {name}="{value}"'.encode() + text[end:]
    return text


def _places(content: bytes) -> _Places:
    """Find the tags that may be changed. The file has been parsed before, so it is well-formed and has no DTD."""
    places = _Places()
    stack: list[tuple[str, str]] = []
    parser = ParserCreate()

    def start(name: str, attributes: dict[str, str]) -> None:
        at = parser.CurrentByteIndex
        tag = _Tag(at, _end_of_tag(content, at))
        inside = [element for element, _ in stack]
        own = attributes.get("name", "")
        if inside == ["robot"] and name == "joint":
            places.joints[own] = (tag, None)
        elif inside == ["robot", "joint"] and name == "origin":
            joint = stack[-1][1]
            places.joints[joint] = (places.joints[joint][0], tag)
        elif [*inside, name] in _WHEELS:
            places.wheels.setdefault(stack[1][1], []).append(tag)
        stack.append((name, own))

    def end(_: str) -> None:
        stack.pop()
        places.end = parser.CurrentByteIndex  # the robot's own comes last

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.Parse(content, True)
    return places


def _end_of_tag(content: bytes, at: int) -> int:
    """Behind the ">" that ends a start tag; one inside an attribute's value ends nothing."""
    quote = b""
    while True:
        at += 1
        character = content[at : at + 1]
        if quote:
            quote = b"" if character == quote else quote
        elif character in (b'"', b"'"):
            quote = character
        elif character == b">":
            return at + 1
