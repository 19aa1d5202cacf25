"""The head's kinematic chain from a URDF. Only joints and cylinder radii are read."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from xml.etree.ElementTree import Element

import numpy as np
from defusedxml.common import DefusedXmlException
from defusedxml.ElementTree import ParseError, fromstring

from mobilecal_cli import ranges, se3
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.rig import FixedLink, JointLink
from mobilecal_cli.model.text import listed

_AXIS_DEFAULT = "1 0 0"  # default of the URDF specification


@dataclass(frozen=True, slots=True, eq=False)
class UrdfJoint:
    """One joint of a URDF.

    Attributes:
        name, kind, parent, child: as in the file; kind is "revolute", "continuous", "fixed", ...
        T_parent_child: (4, 4) at the joint's zero, m.
        axis: (3,) unit vector in the joint's frame.
        mimic: (joint, multiplier, offset) or None.
    """

    name: str
    kind: str
    parent: str
    child: str
    T_parent_child: FloatArray
    axis: FloatArray
    mimic: tuple[str, float, float] | None


@dataclass(frozen=True, slots=True, eq=False)
class Urdf:
    """A robot's joints and its wheels' radii.

    Attributes:
        name: the robot's name.
        joints: joint name → joint, in the file's order.
        cylinder_radius_m: link name → radius of its largest cylinder (collision before visual), if it has one.
    """

    name: str
    joints: Mapping[str, UrdfJoint]
    cylinder_radius_m: Mapping[str, float]

    @property
    def links(self) -> tuple[str, ...]:
        """Names of all links that joints connect."""
        return tuple(
            dict.fromkeys(name for joint in self.joints.values() for name in (joint.parent, joint.child))
        )

    @property
    def root(self) -> str:
        """The link without a parent."""
        children = {joint.child for joint in self.joints.values()}
        return next((link for link in self.links if link not in children), "")

    def path(self, base: str, tip: str) -> tuple[UrdfJoint, ...]:
        """Joints on the path from one link down to another.

        Raises:
            ConfigError: a link is not in the URDF, or no path of joints connects the two.
        """
        links = self.links
        for link in (base, tip):
            if link not in links:
                raise ConfigError(
                    f"URDF of {self.name!r}: no link {link!r}", f"links present: {listed(links)}"
                )
        above = {joint.child: joint for joint in self.joints.values()}
        path: list[UrdfJoint] = []
        link = tip
        while link != base:
            if link not in above or len(path) > len(above):
                raise ConfigError(
                    f"URDF of {self.name!r}: no path of joints from {base!r} to {tip!r}",
                    "set head.base_frame and head.head_frame to the two ends of the chain",
                )
            path.append(_checked(above[link]))
            link = above[link].parent
        return tuple(reversed(path))

    def pose(self, base: str, tip: str) -> FloatArray:
        """Pose of a link in the coordinates of one above it, with all joints at zero, (4, 4) m; raises as `path`."""
        T = np.eye(4)
        for joint in self.path(base, tip):
            T = T @ joint.T_parent_child
        return T

    def carrier(self, link: str) -> tuple[str, FloatArray]:
        """The highest link that carries a link by fixed joints alone, and the pose of the link on it, (4, 4)."""
        above, T = {joint.child: joint for joint in self.joints.values()}, np.eye(4)
        for _ in above:  # transforms may go in a circle
            if link not in above or above[link].kind != "fixed":
                break
            T, link = above[link].T_parent_child @ T, above[link].parent
        return link, T


def _checked(joint: UrdfJoint) -> UrdfJoint:
    """The joint itself, if a real robot can have it.

    Raises:
        ConfigError: a value is out of range.
    """
    where = f"URDF: joint {joint.name!r}"
    for value in joint.T_parent_child[:3, 3]:
        ranges.POSITION.check(f"{where}, origin xyz", float(value))
    for value in joint.mimic[1:] if joint.mimic else ():
        ranges.DIFFERENCE.check(f"{where}, mimic", value)
    return joint


def _numbers(
    owner: Element, child: str, attribute: str, default: str, where: str, count: int = 3
) -> FloatArray:
    """(count,) numbers of an attribute of a child element, as long as both exist, otherwise the default.

    Raises:
        ConfigError: other text, or another count.
    """
    element = owner.find(child)
    text = default if element is None else element.get(attribute, default)
    try:
        values = np.array([float(word) for word in text.split()])
    except ValueError:
        values = np.zeros(0)
    if values.shape != (count,) or not np.all(np.isfinite(values)):
        xacro = ": expand xacro files first" if "$" in text else ""
        raise ConfigError(
            f"URDF: {where}: expected {count} finite number(s), got {text!r}", f"correct the URDF{xacro}"
        )
    return values


def _joint(element: Element) -> UrdfJoint:
    name = element.get("name", "")
    where = f"joint {name!r}"
    ends = {}
    for end in ("parent", "child"):
        named = element.find(end)
        link = named.get("link") if named is not None else None
        if not link:
            raise ConfigError(f"URDF: {where}: no <{end} link=...>", "correct the URDF")
        ends[end] = link.lstrip("/")  # which tf ignores
    rpy, xyz = (_numbers(element, "origin", key, "0 0 0", f"{where}, origin {key}") for key in ("rpy", "xyz"))
    axis = _numbers(element, "axis", "xyz", _AXIS_DEFAULT, f"{where}, axis")
    kind, length = element.get("type", ""), math.hypot(*axis)
    if kind not in ("fixed", "floating") and length < 1e-9:
        raise ConfigError(f"URDF: {where}: its axis has zero length", "correct the URDF")
    mimic, mimicked = None, element.find("mimic")
    if mimicked is not None:
        multiplier, offset = (
            float(_numbers(element, "mimic", key, default, f"{where}, mimic {key}", 1)[0])
            for key, default in (("multiplier", "1"), ("offset", "0"))
        )
        mimic = (mimicked.get("joint", ""), multiplier, offset)
    T = se3.transform(se3.from_rpy(rpy), xyz)
    return UrdfJoint(name, kind, ends["parent"], ends["child"], T, axis / length if length else axis, mimic)


def parse_urdf(text: str) -> Urdf:
    """Read a URDF.

    Args:
        text: the XML. Entities and DTDs are refused.

    Raises:
        ConfigError: not XML, no <robot> element, or an invalid joint.
    """
    try:
        root = fromstring(text, forbid_dtd=True)
    except (ParseError, DefusedXmlException, ValueError) as error:
        why = "it has a document type" if isinstance(error, DefusedXmlException) else str(error)
        raise ConfigError(
            f"URDF: not valid XML: {why}; it begins with {text.lstrip()[:30]!r}",
            "give the URDF itself, not a web page; expand xacro files first",
        ) from error
    if root.tag != "robot":
        raise ConfigError(f"URDF: the root element is <{root.tag}>, not <robot>", "give a URDF file")
    if any("xacro}" in element.tag for element in root):
        raise ConfigError("URDF: a xacro file, not expanded yet", "expand it: xacro FILE > robot.urdf")
    # Transmissions and ros2_control blocks also contain <joint> elements; only those of the robot itself count.
    joints = [_joint(element) for element in root.findall("joint")]
    names = [joint.name for joint in joints]
    twice = sorted(name for name, count in Counter(names).items() if count > 1)
    if twice:
        raise ConfigError(f"URDF: two joints have the name {twice[0]!r}", "correct the URDF")
    radii: dict[str, float] = {}
    for link in root.findall("link"):
        name = link.get("name", "").lstrip("/")
        for kind in ("collision", "visual"):
            drawn = [
                float(_numbers(shape, "cylinder", "radius", "", f"link {name!r}, cylinder radius", 1)[0])
                for shape in link.findall(f"{kind}/geometry")
                if shape.find("cylinder") is not None
            ]
            if drawn and name not in radii:
                radii[name] = max(drawn)  # a smaller one is the hub
    return Urdf(root.get("name", ""), {joint.name: joint for joint in joints}, radii)


def chain_links(urdf: Urdf, base: str, head: str) -> tuple[FixedLink | JointLink, ...]:
    """Links of a `HeadChain` from one link down to another.

    Raises:
        ConfigError: no path of joints, an unsupported kind of joint (floating, planar), or an invalid mimic.
    """
    links: list[FixedLink | JointLink] = []
    for joint in urdf.path(base, head):
        if not np.array_equal(joint.T_parent_child, np.eye(4)):
            links.append(FixedLink(joint.T_parent_child))
        if joint.kind == "fixed":
            continue
        if joint.kind not in ("revolute", "continuous", "prismatic"):
            raise ConfigError(
                f"URDF: joint {joint.name!r} is {joint.kind!r}; a head chain supports revolute, continuous, "
                "prismatic and fixed joints",
                "set head.base_frame to a link below it",
            )
        read, multiplier, offset = joint.mimic or (joint.name, 1.0, 0.0)
        if read not in urdf.joints:
            raise ConfigError(
                f"URDF: joint {joint.name!r} mimics {read!r}, which does not exist", "correct the URDF"
            )
        kind = "prismatic" if joint.kind == "prismatic" else "revolute"
        links.append(JointLink(read, joint.axis, kind, multiplier, offset))  # type: ignore[arg-type]
    return tuple(links)


def vehicle_frame(left_m: FloatArray, right_m: FloatArray, up: FloatArray) -> FloatArray:
    """T_base_v from wheel centers and the floor's normal, (3,) each, in base coordinates.

    The origin is midway, y from right to left, z up. The heading is perpendicular to the axle, because the wheels
    define the forward direction.
    """
    axle = left_m - right_m
    y = axle - (axle @ up) * up
    y /= np.linalg.norm(y)
    return se3.transform(np.stack([np.cross(y, up), y, up], axis=1), (left_m + right_m) / 2)
