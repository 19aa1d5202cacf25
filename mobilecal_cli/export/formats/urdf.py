"""A URDF with the calibration: a few numbers change, all other bytes stay."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path
from xml.parsers.expat import ParserCreate

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.export.formats import Exported, Source, chain_note, frame_note, rectified_note
from mobilecal_cli.export.improved import ImprovedChain, improved_chain, joint_origins
from mobilecal_cli.export.text import attribute, comment
from mobilecal_cli.files.reading import read_bytes
from mobilecal_cli.kinematics.urdf import Urdf, UrdfJoint, parse_urdf
from mobilecal_cli.likelihood.constants import WHEEL_SIGMA
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.calibration import NINE, CalibratedRobot
from mobilecal_cli.model.rig import SIDES, Side
from mobilecal_cli.rig.config import LARGEST_URDF_BYTES
from mobilecal_cli.rig.wheels import urdf_wheels, wheel_distance_m

#: Sizes of a URDF that differ more from the nominal and the calibrated ones are those of another robot.
_OTHER_ROBOT = 0.1
#: A frame is at ground level if the wheel centers are one radius above it, to this much, m.
_GROUND_M = 1e-3
_SAME_PLACE_M = 1e-6
_WHEELS = [
    ["robot", "link", kind, "geometry", shape]
    for kind in ("visual", "collision")
    for shape in ("cylinder", "sphere")
]
#: Elements around the innermost that may change, and one more: deeper ones are all alike.
_DEEPEST = len(_WHEELS[0])


def export(
    of: Source, wheel_joints: Mapping[Side, str], urdf: Path | None = None, with_chain: bool = False
) -> Exported:
    """`--urdf FILE` with updated camera joint, wheel joints and wheel radii, with `--with-chain` also with the
    estimated origins and axes of the head joints; all other bytes are unchanged
    """
    robot, chain, kept = of.robot, None, ""
    if robot.odometry is not None:
        kept = "factors of odometry belong into the controller"
    elif robot.side_joints:
        kept = "the effective separation belongs into the controller"
    joints = {} if kept else wheel_joints
    if with_chain:
        if not robot.constants:
            raise ConfigError(
                f"{of.params}: the head chain was not estimated",
                "calibrate extraction.npz again with this version and --method ml, or omit --with-chain",
            )
        chain = improved_chain(of.measurements().rig.chain, robot.constants)
    if urdf is None:
        raise ConfigError("--to urdf changes an existing file", "give the URDF of the robot with --urdf")
    content = read_bytes(urdf, LARGEST_URDF_BYTES, "check the path after --urdf", "URDF")
    try:
        patched = patched_urdf(content, robot, joints, chain)
    except ConfigError as error:
        raise ConfigError(f"{urdf}: {error.message.removeprefix('URDF: ')}", error.hint) from error
    notes = patched.notes
    notes += (() if with_chain else chain_note(robot)) + rectified_note(robot)
    missing = " and ".join(side for side in SIDES if side not in joints)
    if kept:
        notes += (f"The wheels are unchanged: {kept}.",)
    elif missing:
        notes += (
            f"The joint of the {missing} wheel is unknown: give it with --left-joint or --right-joint.",
        )
    return Exported(patched.content, notes)


#: A cylinder that is smaller than the largest of its link by more than this share is a hub.
_HUB = 0.2
#: First byte of a start tag, whose attributes may change or which gets a child element, and the byte after it.
_Tag = tuple[int, int]
_START_TAG = re.compile(rb"""<(?:[^>"']++|"[^"]*"|'[^']*')*+>""")


#: "joint" or "link", its name, and an element in it ("" for itself, "wheel" for any cylinder or sphere) → tags, in
#: order; ("robot", "", "end") → the place before the robot's end tag.
_Places = dict[tuple[str, str, str], list[_Tag]]


def patched_urdf(
    content: bytes,
    robot: CalibratedRobot,
    wheel_joints: Mapping[Side, str],
    chain: ImprovedChain | None = None,
) -> Exported:
    """A URDF with the calibrated head-eye transform and wheels.

    The first joint from the head link to the camera link gets the head-eye transform; the joints after it stay. If
    the camera has no link, one is added at the end of the file. The wheel joints move along their axle about its
    midpoint, and the cylinders and spheres of the wheels (visual and collision) get the calibrated radii. Where the
    wheel joints start from a frame on the ground, their height becomes the mean radius. With a chain, the moving joints
    from the base to the head get their estimated origins and axes. Unobservable parameters stay as in the URDF.

    Args:
        content: the URDF, UTF-8.
        wheel_joints: names of the wheel joints; the numbers of a missing side stay.
        chain: the head chain to write; None to leave it as it is.

    Returns:
        The file, and sentences on what changed.

    Raises:
        ConfigError: invalid URDF, no fixed joint from the head to the camera, an unknown wheel joint, wheels at one
            place, with one joint or in the head chain, or the URDF of another robot: other joints, or wheels of
            other sizes.
    """
    try:
        urdf = parse_urdf(content.decode("utf-8"))
    except UnicodeDecodeError as error:
        raise ConfigError(f"the URDF is not UTF-8: {error}", "save it as UTF-8") from error
    file = _File(content)
    _check_robot(urdf, robot, wheel_joints)
    changes: list[str] = []
    hidden = ", ".join(name for name, hides in zip(NINE[:6], robot.unobservable, strict=False) if hides)
    if robot.child_frame in urdf.links:
        mount, T_head_mount = _mount(urdf, robot)
        file.set(mount.name, "origin", _origin(T_head_mount))
        changes.append(
            f"joint {mount.name!r}: the origin gives the calibrated pose of {robot.child_frame!r} on "
            f"{robot.parent_frame!r}" + (f"; unobservable, so unchanged: {hidden}" if hidden else "")
        )
    else:
        file.put(file.places["robot", "", "end"][-1], "joint", _added(file, urdf, robot))
        changes.append(
            f"link {robot.child_frame!r}: added with a fixed joint on {robot.parent_frame!r}; no other node may "
            "publish this transform"
        )
    if chain is not None:
        changes += _with_chain(file, urdf, chain)
    no_radius, no_separation = robot.unobservable[6:8].any(), robot.unobservable[8]
    if len(wheel_joints) == len(SIDES):
        height_m, heights = (None, ()) if no_radius else _height(file, urdf, robot, wheel_joints)
        if height_m is not None or not no_separation:
            for name, place in _wheel_places(urdf, robot, wheel_joints):
                if height_m is not None:
                    place[2] = height_m
                file.set(name, "origin", {"xyz": _numbers(place)})
        joints = f"joints {wheel_joints['left']!r} and {wheel_joints['right']!r}"
        apart = f"{robot.wheels.separation_m:.6g} m apart"
        changes.append(f"{joints}: {'separation unchanged, it is unobservable' if no_separation else apart}")
        changes += heights
    for side, name in wheel_joints.items():
        link = _joint(urdf, name).child
        if no_radius:
            changes.append(f"link {link!r}: radius unchanged, it is unobservable")
            continue
        radius_m = robot.wheels.radius_left_m if side == "left" else robot.wheels.radius_right_m
        tags = file.tires(link)
        for tag in tags:
            file.change(tag, {"radius": f"{radius_m:.12g}"})
        radii = f"radius of {len(tags)} shape{'s' * (len(tags) != 1)}: {radius_m:.6g} m"
        changes.append(f"link {link!r}: {radii if tags else 'no cylinder or sphere, no radius set'}")
    return Exported(file.changed(), tuple(changes))


class _File:
    """A URDF as text, and what changes in it.

    Attributes:
        content: the text as it was.
        places: its tags.
    """

    def __init__(self, content: bytes) -> None:
        self.content, self.places = content, _places(content)
        self._new: dict[tuple[_Tag, str], bytes] = {}

    def put(self, tag: _Tag, element: str, new: bytes) -> None:
        """Replace the bytes of a tag; where it has none, insert an element."""
        self._new[tag, element] = new

    def change(self, tag: _Tag, values: Mapping[str, str], element: str = "") -> None:
        """Replace or add the values of some attributes of a tag."""
        text = self.content[slice(*tag)]
        for name, value in values.items():
            pattern = re.compile(rb"(\s" + name.encode() + rb"\s*=\s*)(\"[^\"]*\"|'[^']*')")
            current = pattern.search(text)
            if current is not None:
                quote = current.group(2)[:1]
                text = text[: current.start(2)] + quote + value.encode() + quote + text[current.end(2) :]
            else:
                end = len(text) - (2 if text.endswith(b"/>") else 1)
                text = text[:end].rstrip() + f' {name}="{value}"'.encode() + text[end:]
        self.put(tag, element, text)

    def set(self, joint: str, element: str, values: Mapping[str, str]) -> None:
        """Give an element of a joint some attributes."""
        tags = self.places.get(("joint", joint, element))
        if tags:
            self.change(tags[0], values, element)
        else:
            inside = self.places["joint", joint, ""][-1][1]
            self.put((inside, inside), element, _element(element, values).encode())

    def tires(self, link: str) -> list[_Tag]:
        """The cylinders and spheres of a wheel's link that are the tire: the largest, and what is hardly smaller."""
        radii = {tag: self.radius_m(tag) for tag in self.places.get(("link", link, "wheel"), [])}
        least_m = (1 - _HUB) * max(radii.values(), default=0.0)
        return [tag for tag, radius_m in radii.items() if radius_m >= least_m]

    def radius_m(self, tag: _Tag) -> float:
        """The radius that a tag states; 0 if it states none."""
        stated = re.search(rb"\sradius\s*=\s*[\"']([^\"']*)", self.content[slice(*tag)])
        try:
            return float(stated[1]) if stated else 0.0
        except ValueError:
            return 0.0

    def changed(self) -> bytes:
        """The text with the changes."""
        content = self.content
        in_order = sorted(self._new.items(), key=lambda item: item[0][0])
        for ((start, end), _), new in in_order[::-1]:  # of those inserted at one place, the last one first
            content = content[:start] + new + content[end:]
        return content


def _with_chain(file: _File, urdf: Urdf, chain: ImprovedChain) -> list[str]:
    """Give the head's joints their estimated origins and axes; returns notes."""
    notes = []
    for name, T_parent_child, axis in joint_origins(urdf, chain):
        file.set(name, "origin", _origin(T_parent_child))
        file.set(name, "axis", {"xyz": _numbers(axis)})
        zero = chain.zeros.get(name, 0.0)
        unit = "m" if urdf.joints[name].kind == "prismatic" else "rad"
        with_zero = f", with the zero offset {zero:+.6g} {unit}" if zero else ""
        notes.append(f"joint {name!r}: estimated origin and axis{with_zero}")
    if chain.others:
        notes.append(
            f"not in the URDF, which has no scale and no backlash of joints: {', '.join(chain.others)}"
        )
    return notes


def _mount(urdf: Urdf, robot: CalibratedRobot) -> tuple[UrdfJoint, FloatArray]:
    """The joint that gets the head-eye transform, and its new origin."""
    path = urdf.path(robot.parent_frame, robot.child_frame)
    moving = [joint.name for joint in path if joint.kind != "fixed"]
    if moving or not path:
        raise ConfigError(
            f"URDF: {robot.child_frame!r} is not fixed to {robot.parent_frame!r}: joint "
            f"{moving[0] if moving else 'none'!r} is between them",
            "give the URDF of the robot that was calibrated",
        )
    T_mount_camera = urdf.pose(path[0].child, robot.child_frame)
    T = _where_observable(robot, path[0].T_parent_child @ T_mount_camera)
    return path[0], T @ se3.inverse(T_mount_camera)


def _where_observable(robot: CalibratedRobot, T_before: FloatArray) -> FloatArray:
    """The calibrated head-eye transform (4, 4), with the unobservable parameters of the one before."""
    hides = robot.unobservable
    if not hides[:6].any():
        return robot.T_parent_child
    R_before = T_before[:3, :3]
    change = np.where(hides[:3], 0.0, se3.log_so3(robot.T_parent_child[:3, :3] @ R_before.T))
    place = np.where(hides[3:6], T_before[:3, 3], robot.T_parent_child[:3, 3])
    return se3.transform(se3.exp_so3(change) @ R_before, place)


def _check_robot(urdf: Urdf, robot: CalibratedRobot, wheel_joints: Mapping[Side, str]) -> None:
    """Refuse the URDF of another robot, by its joints and the sizes of its wheels; and wheel joints that are none."""
    missing = [name for name in robot.head_joints if name not in urdf.joints]
    if missing:
        raise ConfigError(
            f"URDF: no joint {missing[0]!r}, which moves the calibrated head",
            "give the URDF of the robot that was calibrated",
        )
    above = {joint.child: joint for joint in urdf.joints.values()}
    carrying, link = set[str](), robot.parent_frame
    while link in above and above[link].name not in carrying:
        carrying.add(above[link].name)
        link = above[link].parent
    for side, name in wheel_joints.items():
        joint = _joint(urdf, name)
        if joint.kind not in ("continuous", "revolute") or name in carrying:
            kind = "carries the head" if name in carrying else f"is {joint.kind}"
            raise ConfigError(
                f"URDF: joint {name!r} {kind}, so it is not that of the {side} wheel",
                f"give the joint of the {side} wheel with --{side}-joint",
            )
    sizes = {
        f"radius_{side}_m": urdf.cylinder_radius_m.get(_joint(urdf, name).child) or 0.0
        for side, name in wheel_joints.items()
    }
    places = {side: _wheel_center(urdf, name)[1] for side, name in wheel_joints.items()}
    middle = np.zeros(3)
    if len(places) == len(SIDES):
        sizes["separation_m"] = float(np.linalg.norm(places["left"] - places["right"]))
        middle = (places["left"] + places["right"]) / 2
    for side, place in places.items():
        to_its_side_m = (place - middle)[1] * (1 if side == "left" else -1)  # x of a base is forward
        named = wheel_joints[side] != robot.wheel_joints.get(side)
        if named and to_its_side_m < -robot.wheels.separation_m / 4:
            raise ConfigError(
                f"URDF: joint {wheel_joints[side]!r} is on the other side of the robot than the {side} wheel",
                "exchange --left-joint and --right-joint",
            )
    odometry = robot.odometry
    if odometry is not None and odometry.separation_share == WHEEL_SIGMA:  # the separation is that of a URDF
        drawn_m = wheel_distance_m(urdf, urdf_wheels(urdf, {}), urdf.root)
        assumed_m = odometry.wheels.separation_m
        if drawn_m is not None and abs(drawn_m / assumed_m - 1) > _OTHER_ROBOT:
            raise ConfigError(
                f"URDF: the wheels are {drawn_m:.6g} m apart; in the calibration {assumed_m:.6g} m are assumed",
                "give the URDF of the robot that was calibrated",
            )
    for name, drawn_m in sizes.items():
        if not drawn_m or robot.nominal_wheels is None:
            continue
        size_m, nominal_m = (getattr(wheels, name) for wheels in (robot.wheels, robot.nominal_wheels))
        if min(abs(drawn_m / size_m - 1), abs(drawn_m / nominal_m - 1)) > _OTHER_ROBOT:
            raise ConfigError(
                f"URDF: {name} is {drawn_m:.6g}; in the calibration it is {size_m:.6g} (nominal {nominal_m:.6g})",
                "give the URDF of the robot that was calibrated",
            )


def _added(file: _File, urdf: Urdf, robot: CalibratedRobot) -> bytes:
    """The camera's joint, and its link if there is none."""
    if robot.parent_frame not in urdf.links:
        raise ConfigError(
            f"URDF: neither {robot.child_frame!r} nor {robot.parent_frame!r} is a link",
            f"links: {', '.join(urdf.links) or 'none'}",
        )
    name, number = f"{robot.child_frame}_joint", 2
    while name in urdf.joints:
        name, number = f"{robot.child_frame}_joint{number}", number + 1
    has_link = ("link", robot.child_frame, "") in file.places
    lines = (
        *([] if has_link else [f"<link name={attribute(robot.child_frame)}/>"]),
        f'<joint name={attribute(name)} type="fixed">',
        f"  <parent link={attribute(robot.parent_frame)}/><child link={attribute(robot.child_frame)}/>",
        f"  {_element('origin', _origin(robot.T_parent_child))}",
        "</joint>",
        *([f"<!-- {comment(frame_note(robot))} -->"] if robot.rectified else []),
    )
    return "".join(f"  {line}\n" for line in lines).encode()


def _wheel_places(
    urdf: Urdf, robot: CalibratedRobot, wheel_joints: Mapping[Side, str]
) -> Iterable[tuple[str, FloatArray]]:
    """New places of both wheel joints in their parents, (3,) m: on the old axle, about its old midpoint."""
    T = {side: _wheel_center(urdf, name) for side, name in wheel_joints.items()}
    axle = T["left"][1] - T["right"][1]
    if np.linalg.norm(axle) < _SAME_PLACE_M:
        raise ConfigError(
            f"URDF: joints {wheel_joints['left']!r} and {wheel_joints['right']!r} are at the same place",
            "correct their origins, or give the wheel joints with --left-joint and --right-joint",
        )
    middle, drawn_m = (T["left"][1] + T["right"][1]) / 2, np.linalg.norm(axle)
    separation_m = drawn_m if robot.unobservable[8] else robot.wheels.separation_m
    for side, sign in zip(SIDES, (0.5, -0.5), strict=True):
        place = middle + sign * separation_m * axle / drawn_m
        yield wheel_joints[side], se3.act(se3.inverse(T[side][0]), place[None])[0]


def _wheel_center(urdf: Urdf, name: str) -> tuple[FloatArray, FloatArray]:
    """Frame in which a joint is placed, (4, 4) to the root's coordinates, and the joint's place in the root, (3,) m."""
    joint = _joint(urdf, name)
    T_root_parent = urdf.pose(urdf.root, joint.parent)
    return T_root_parent, (T_root_parent @ joint.T_parent_child)[:3, 3]


def _height(
    file: _File, urdf: Urdf, robot: CalibratedRobot, wheel_joints: Mapping[Side, str]
) -> tuple[float | None, tuple[str, ...]]:
    """New height of the wheel joints in their parent, m, None to keep it; and a note on it.

    A height that follows from the wheel radius has to change with it. It does in the wheel joints. Another joint, such
    as that of a base_footprint, places the whole robot: it is named.
    """
    joints = [_joint(urdf, wheel_joints[side]) for side in SIDES]
    radii = [max(map(file.radius_m, file.tires(joint.child)), default=0.0) for joint in joints]
    if min(radii) <= 0:
        return None, ()
    old_m = sum(radii) / 2
    new_m = (robot.wheels.radius_left_m + robot.wheels.radius_right_m) / 2
    own = [float(joint.T_parent_child[2, 3]) for joint in joints]
    if max(abs(height - old_m) for height in own) <= _GROUND_M:
        names = " and ".join(repr(joint.name) for joint in joints)
        return new_m, (f"joints {names}: height {new_m:.6g} m, the mean wheel radius",)

    if abs(old_m - new_m) <= 1e-9:
        return None, ()
    axle = {joints[0].parent: joints[0].T_parent_child[:3, 3]}  # a place on it, in the frames that carry it
    for joint in reversed(urdf.path(urdf.root, joints[0].parent)):
        axle[joint.parent] = se3.act(joint.T_parent_child, axle[joint.child][None])[0]

    def on_ground(place: FloatArray) -> bool:
        return bool(abs(place[2] - old_m) <= _GROUND_M)

    changed = f"the mean wheel radius is now {new_m:.6g} m, before {old_m:.6g} m"
    placing = tuple(
        f"joint {joint.name!r}: height {joint.T_parent_child[2, 3]:.6g} m is unchanged; {changed}: correct it by hand"
        for joint in urdf.joints.values()
        if joint.kind == "fixed"
        and joint.parent in axle
        and on_ground(axle[joint.parent])
        != on_ground(se3.act(se3.inverse(joint.T_parent_child), axle[joint.parent][None])[0])
    )
    return None, placing or (f"{changed}: no height follows from it, no frame is on the ground",)


def _joint(urdf: Urdf, name: str) -> UrdfJoint:
    if name not in urdf.joints:
        raise ConfigError(f"URDF: no joint {name!r}", f"joints: {', '.join(urdf.joints)}")
    return urdf.joints[name]


def _origin(T: FloatArray) -> dict[str, str]:
    """Attributes of an origin."""
    return {"xyz": _numbers(T[:3, 3]), "rpy": _numbers(se3.to_rpy(T[:3, :3]))}


def _element(name: str, values: Mapping[str, str]) -> str:
    return f"<{name} {' '.join(f'{name}={attribute(value)}' for name, value in values.items())}/>"


def _numbers(values: FloatArray) -> str:
    return " ".join(f"{value + 0.0:.12g}" for value in np.round(values, 12))


def _places(content: bytes) -> _Places:
    """Byte ranges of the tags that may change, in a file that is known to be well-formed and without a DTD."""
    places: _Places = {}
    stack: list[tuple[str, str]] = []
    parser = ParserCreate("utf-8")  # whatever the declaration says: the text was decoded so

    def start(name: str, attributes: dict[str, str]) -> None:
        whole = _START_TAG.match(content, parser.CurrentByteIndex)
        assert whole is not None  # the file is well-formed
        elements = [element for element, _ in stack[:_DEEPEST]] + [name]
        own = attributes.get("name", "").lstrip("/" if name == "link" else "")
        place = None
        if elements in (["robot", "joint"], ["robot", "link"]):
            place = (name, own, "")
        elif elements in (["robot", "joint", "origin"], ["robot", "joint", "axis"]):
            place = ("joint", stack[1][1], name)
        elif elements in _WHEELS:
            place = ("link", stack[1][1], "wheel")
        if place is not None:
            places.setdefault(place, []).append(whole.span())
        stack.append((name, own))

    def end(_: str) -> None:
        stack.pop()
        # The last one is that of the robot.
        places["robot", "", "end"] = [(parser.CurrentByteIndex, parser.CurrentByteIndex)]

    parser.StartElementHandler = start
    parser.EndElementHandler = end
    parser.Parse(content, True)
    return places
