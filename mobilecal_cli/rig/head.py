"""The head: chain from the base, by rig.yaml, a URDF or the recording's transforms; its camera pose and its joints."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass, replace

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.errors import ConfigError, RecordingError
from mobilecal_cli.kinematics.urdf import Urdf, UrdfJoint, chain_links, parse_urdf, vehicle_frame
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.rig import (
    FixedLink,
    HeadChain,
    JointField,
    JointLink,
    JointSource,
    JointTransform,
    Nominal,
    Side,
    WheelSource,
)
from mobilecal_cli.model.signals import CHAIN_ENDS, STRING, TRANSFORMS, RobotDescription
from mobilecal_cli.model.text import listed
from mobilecal_cli.ranges import POSITION
from mobilecal_cli.rig.config import RigConfig
from mobilecal_cli.rig.names import (
    HEAD_WORDS,
    PAN_WORDS,
    TILT_WORDS,
    is_wheel,
    joint_state_names,
    may_carry_camera,
    require_topic,
    words,
)
from mobilecal_cli.rig.wheels import WheelJoints, as_drawn, nominal_wheels, side_centres, urdf_wheels

#: A base link that is nearer to the place and the heading of the vehicle frame is this frame: rounding in a URDF.
_MIDWAY_M, _AHEAD_DEG = 1e-6, 1e-4
#: The frame on the floor under the base, if there is one (REP 120).
FOOTPRINT = "base_footprint"
#: A transform that changes by less is fixed; the transform of a fixed mount does not change at all.
_STILL_RAD, _STILL_M = 2e-3, 5e-4
#: A transform that deviates by more from the motion of a joint is not a joint.
_OFF_RAD, _OFF_M = 0.02, 0.005


@dataclass(frozen=True, slots=True, eq=False)
class Head:
    """The head chain and its source.

    Attributes:
        chain: base to head.
        urdf: its URDF, None for a chain given in the configuration.
        drawn: nominal values of the URDF.
        wheels: sources of the wheels, completed by the URDF.
        origin: source of the chain, in words.
        notes: remarks for the report.
        prefix: what stands before the names of the URDF's links in the transforms.
    """

    chain: HeadChain
    urdf: Urdf | None
    drawn: Nominal
    wheels: dict[Side, WheelSource]
    origin: str
    notes: tuple[str, ...]
    prefix: str = ""

    def fixed_pose(self, frame: str, other: str) -> FloatArray | None:
        """(4, 4) pose of another frame of the recording in a frame, see `fixed_pose`."""
        return fixed_pose(self.urdf, *(name.removeprefix(self.prefix) for name in (frame, other)))


def head_of(
    config: RigConfig,
    description: RobotDescription,
    urdf_text: str | None,
    wheels: dict[Side, WheelSource],
    camera_frame: str,
) -> Head:
    """The head chain of the configuration, of a URDF, or of the recording's transforms.

    Raises:
        RecordingError: none of them gives it.
        ConfigError: several joints match, a configured one is not in the chain, or the URDF is invalid.
    """
    if config.head.chain is not None:
        pan, tilt = pan_and_tilt(
            config, dict.fromkeys(link.joint for link in config.head.chain if link.joint)
        )
        base = config.head.base_frame or "base_link"
        head = config.head.head_frame or ("head_link" if config.head.chain else base)
        chain = HeadChain(base, head, tuple(link.stated for link in config.head.chain), pan, tilt)
        _check_configured(config, chain)
        return Head(chain, None, Nominal(), wheels, "head.chain of the configuration", ())
    origin, prefix, notes = "head.urdf of the configuration", "", []
    read = {*joint_state_names(description), *config.joints.fields}
    if urdf_text is None and not description.urdfs:
        origin = "transforms in the recording"
        urdf = _moving_transforms(description, camera_frame)
        read = {*urdf.joints}  # each that moves is seen to move
        notes.append(
            "The recording contains no URDF. The head's joints are derived from the motion of its transforms; "
            "joint angles are zero at the first transform."
        )
    else:
        if urdf_text is None:
            topic, urdf_text = next(iter(sorted(description.urdfs.items())))
            origin = f"URDF on {topic}"
            if len(set(description.urdfs.values())) > 1:
                notes.append(f"The recording contains several URDFs. The one on {topic} is used.")
        urdf = parse_urdf(urdf_text)
        prefix = _frame_prefix(urdf, description.transforms)
        camera_frame = camera_frame.removeprefix(prefix)
        static = {
            (parent.removeprefix(prefix), child.removeprefix(prefix)): T
            for (parent, child), T in description.transforms.items()
        }
        # A camera's driver publishes its own frames.
        fixed = {
            f"fixed transform to {name}": joint
            for name, joint in urdf_of_transforms(static).joints.items()
            if joint.kind == "fixed" and name not in urdf.links
        }
        urdf = replace(urdf, joints={**urdf.joints, **fixed})
    base = _base_of(config, urdf, camera_frame)
    way = _moving_to(urdf, base, camera_frame)
    on_way = way is not None
    offered = [joint.name for joint in (urdf.joints.values() if way is None else way)]
    pan, tilt = pan_and_tilt(config, [name for name in offered if name in read], on_way)
    if not tilt and config.head.head_frame is None:
        # Joint states may lack some of the head's joints; the URDF still names them.
        pan, tilt = pan_and_tilt(config, offered, on_way)
    turning = [joint.name for joint in way or () if joint.kind == "revolute"]
    if (
        not tilt and turning and urdf_text is None
    ):  # no frame is named tilt: the last moving joint is the tilt
        tilt, pan = turning[-1], pan or (turning[0] if len(turning) > 1 else "")
    head = _head_link_of(config, urdf, base, pan, tilt, camera_frame, read)
    wheel_joints = urdf_wheels(urdf, wheels)
    wheels = as_drawn(wheels, wheel_joints, config, urdf, base)
    offset, offset_notes = _vehicle_offset(urdf, wheel_joints, wheels, base, description)
    if head == base and camera_frame not in urdf.links and config.head.head_frame is None:
        notes.append(
            f"Only wheels move in the URDF, which lacks the camera's frame: the camera is taken as fixed to {base}."
        )
    chain = HeadChain(base, head, (*offset, *chain_links(urdf, base, head)))
    _check_configured(config, chain)
    notes += [
        f"Joint {joint.name} moves the camera, but {CHAIN_ENDS} before it, at {head}. "
        f"Set head.head_frame to {joint.child}."
        for joint in _moving_to(urdf, head, camera_frame) or ()
        if joint.name in read
    ]
    # A joint found by name may be fixed, or that of an arm.
    pan, tilt = (name if name in chain.joints else "" for name in (pan, tilt))
    chain = replace(chain, pan=pan, tilt=tilt)
    T_h_c = None if camera_frame == head else fixed_pose(urdf, head, camera_frame)  # no frame of its own
    drawn = Nominal(T_h_c, nominal_wheels(urdf, wheel_joints, base))
    return Head(chain, urdf, drawn, wheels, origin, (*notes, *offset_notes), prefix)


def _moving_transforms(description: RobotDescription, camera_frame: str) -> Urdf:
    """The transforms of a recording without a URDF as one.

    Raises:
        RecordingError: they do not lead to the camera.
    """
    urdf = urdf_of_transforms(description.transforms)
    if camera_frame not in urdf.links:
        to = f"no transforms to the camera frame {camera_frame!r}, " if camera_frame else ""
        unread = [t.name for t in description.topics if t.type == STRING and "robot_description" in t.name]
        urdf_is = (
            f"{unread[0]} is empty or cannot be read" if unread else "no robot_description in the recording"
        )
        raise RecordingError(
            f"the head chain is unknown: {urdf_is}, {to}and no head.urdf or head.chain in the configuration",
            "set head.urdf or head.chain in rig.yaml (a camera on the base: chain: []); mobilecal init LOG --urdf FILE "
            "drafts it",
        )
    return urdf


def _base_of(config: RigConfig, urdf: Urdf, camera_frame: str) -> str:
    """The base link, as configured or by its name, also with a prefix; one with camera and wheels, if any.

    Without such a name, it is what moves freely in the world under the camera, or the root.
    """
    if config.head.base_frame:
        return config.head.base_frame
    usual = ("base_link", FOOTPRINT)
    named = [link for name in usual for link in urdf.links if link.split("/")[-1] == name]
    if named:
        wheels = (joint.child for joint in urdf.joints.values() if is_wheel(joint.name))
        tips = [tip for tip in (camera_frame, *wheels) if tip in urdf.links]
        carry = (link for link in named if all(_moving_to(urdf, link, tip) is not None for tip in tips))
        return next(carry, named[0])
    above, link = {joint.child: joint for joint in urdf.joints.values()}, camera_frame
    for _ in above:
        if link not in above or above[link].kind == "floating":
            break
        link = above[link].parent
    return link if link in above else urdf.root


def _head_link_of(
    config: RigConfig, urdf: Urdf, base: str, pan: str, tilt: str, camera_frame: str, read: Collection[str]
) -> str:
    """Head link of a URDF: as configured, or the last link that a joint moves on the way to the camera.

    Joints behind the tilt joint count only if they, or those that they mimic, are read: a bracket may be set by hand.
    If no joint moves the camera, it is fixed to the base, which is the head then. A camera that is not in the URDF is
    on the child of the tilt joint, or of a pan joint that carries no other moving joint, or on the base if nothing but
    wheels moves. Head_link stands for the link that carries it.

    Args:
        read: joints whose positions are read.

    Raises:
        ConfigError: the camera's own frame is configured; without a tilt joint, the URDF does not connect the base with
            the camera, or lacks it.
    """
    if config.head.head_frame is not None:
        own = [joint.kind for joint in urdf.joints.values() if joint.child == camera_frame]
        if config.head.head_frame == camera_frame and own == ["fixed"]:
            raise ConfigError(
                f"head.head_frame: {camera_frame} is the frame of the camera, not of the head",
                "leave it out, or set the last link that a joint moves (the base link for a camera on the base)",
            )
        return config.head.head_frame
    way = _moving_to(urdf, base, camera_frame)
    if way is None and tilt not in urdf.joints and camera_frame in urdf.links:
        urdf.path(base, camera_frame)  # raises
    if way is not None:
        names = [joint.name for joint in way]
        known = names.index(tilt) + 1 if tilt in names else len(names)
        moved_by = [joint.mimic[0] if joint.mimic else joint.name for joint in way]
        behind = [number for number, name in enumerate(moved_by, 1) if number > known and name in read]
        return _named_head(urdf, way[max([known, *behind]) - 1].child) if way else base
    if tilt not in urdf.joints and pan in urdf.joints:
        head = urdf.joints[pan].child
        roots = {urdf.carrier(joint.parent)[0] for joint in urdf.joints.values() if joint.kind != "fixed"}
        if head not in roots:
            return head
    moving = (joint.name for joint in urdf.joints.values() if joint.kind != "fixed")
    if not any(map(may_carry_camera, (*moving, *read))):
        return base
    if tilt not in urdf.joints:
        camera = f"the camera's frame {camera_frame!r} is not in it, and " if camera_frame else ""
        raise ConfigError(
            f"URDF {urdf.name!r}: {camera}no joint is named tilt, so the link that carries the camera is unknown",
            "set head.head_frame in rig.yaml to the link that carries the camera (the base link for a camera on the "
            f"base), or joints.tilt; links present: {listed(urdf.links)}; joints present: {listed(urdf.joints)}",
        )
    return _named_head(urdf, urdf.joints[tilt].child)


def _moving_to(urdf: Urdf, base: str, camera_frame: str) -> list[UrdfJoint] | None:
    """Joints that move the camera against the base; None if the URDF does not connect it with the base."""
    if camera_frame not in urdf.links:
        return None
    try:
        return [joint for joint in urdf.path(base, camera_frame) if joint.kind != "fixed"]
    except ConfigError:
        return None


def _named_head(urdf: Urdf, carried: str) -> str:
    """Head_link if it is fixed to the link that carries the camera, else that link."""
    fixed = "head_link" in urdf.links and urdf.carrier("head_link")[0] == carried
    return "head_link" if fixed else carried


def _vehicle_offset(
    urdf: Urdf,
    joints: WheelJoints,
    sources: Mapping[Side, WheelSource],
    base: str,
    description: RobotDescription,
) -> tuple[list[FixedLink], list[str]]:
    """The link from the vehicle frame v to the base link, none if they are the same, and notes on it.

    The vehicle frame lies midway between the wheels, with x perpendicular to the axle and z to the floor, on which
    base_footprint stands. If the URDF's base link differs, the offset is computed from the origins of the wheel joints.
    Without these, it is as odometry shows it.
    """
    links, notes, source = [], [], next(iter(sources.values()), None)
    footprint = next((link for link in urdf.links if link.split("/")[-1] == FOOTPRINT), base)
    T_base_floor = fixed_pose(urdf, base, footprint)
    up = np.array([0.0, 0.0, 1.0]) if T_base_floor is None else T_base_floor[:3, 2]
    leans_deg = math.degrees(math.acos(np.clip(up[2], -1.0, 1.0)))
    if leans_deg >= _AHEAD_DEG:
        notes.append(
            f"The URDF's {base} leans by {leans_deg:.2f} degrees against {footprint}, which is on the floor."
        )
    ahead_m = description.odometry_ahead_m
    if not joints:
        left = np.array([0.0, 1.0, 0.0])
        T_v_base = se3.inverse(vehicle_frame(left, -left, up))
        if ahead_m and source is not None:
            frame = description.odometry_frames.get(source.topic, ("", base))[1]
            T_frame_base = None if frame == base else fixed_pose(urdf, frame, base)
            T_v_frame = se3.transform(np.eye(3), np.array([ahead_m, 0.0, 0.0]))
            T_v_base = T_v_frame @ (T_v_base if T_frame_base is None else T_frame_base)
            notes.append(
                "The robot description names no wheels. The vehicle frame is on the axle about which odometry turns."
            )
        elif source is not None and source.baked_in is None:
            notes.append(
                f"The robot description names no wheels: {base} is taken as midway between them, with its x axis ahead."
            )
        if not np.allclose(T_v_base, np.eye(4), rtol=0, atol=_MIDWAY_M):
            links.append(FixedLink(T_v_base))
    if joints:
        unread = [name for source in sources.values() for name in source.unread or ()]
        if unread:
            notes.append(
                f"According to the URDF, the robot has further wheels that are not read: {listed(unread)}. The vehicle "
                "frame is midway between all wheels, and the base turns with slip. If they are casters, set "
                "wheels.left.unread and wheels.right.unread to []."
            )
        T_base_v = vehicle_frame(*side_centres(urdf, joints, base), up)
        shift, turn = T_base_v[:2, 3], math.degrees(math.atan2(T_base_v[1, 0], T_base_v[0, 0]))
        if float(np.linalg.norm(shift)) >= _MIDWAY_M or max(abs(turn), leans_deg) >= _AHEAD_DEG:
            links.append(FixedLink(se3.inverse(T_base_v)))
            notes.append(
                f"The URDF's {base} is not midway between the wheels. The vehicle frame is placed there, "
                f"at x {shift[0] * 1e3:.1f} mm, y {shift[1] * 1e3:.1f} mm, rotated by {turn:.2f} degrees."
            )
        axle = urdf.path(base, urdf.joints[joints["left"][0]].parent)
        moving = [joint.name for joint in axle if joint.kind != "fixed"]
        if moving:  # as on a robot that steers its axle
            notes.append(
                f"According to the URDF, the wheels move against {base} with {listed(moving)}. A differential drive "
                "is calibrated, with these joints at zero."
            )
    return links, notes


def fixed_pose(urdf: Urdf | None, frame: str, other: str) -> FloatArray | None:
    """(4, 4) pose of another frame in a frame, by fixed joints of the URDF; None unless these connect them."""
    if urdf is None or not {frame, other} <= set(urdf.links):
        return None
    (root, T_root_frame), (other_root, T_root_other) = urdf.carrier(frame), urdf.carrier(other)
    T = se3.inverse(T_root_frame) @ T_root_other
    return T if root == other_root and all(value in POSITION for value in T[:3, 3]) else None


def urdf_of_transforms(transforms: Mapping[tuple[str, str], FloatArray]) -> Urdf:
    """Joints that would publish these transforms, each named by its child frame.

    A transform that does not change is a fixed joint. One that only rotates about one axis is revolute, and one that
    only translates along one axis is prismatic. Any other is "floating". A joint is at zero at the first sample; this
    choice does not change the poses of the links. `transforms`: see `RobotDescription`.
    """
    joints = {child: _joint(parent, child, T) for (parent, child), T in sorted(transforms.items())}
    return Urdf("transforms", joints, {})


def _joint(parent: str, child: str, T: FloatArray) -> UrdfJoint:
    moved = se3.inverse(T[0]) @ T
    turn, way = se3.log_so3(moved[:, :3, :3]), moved[:, :3, 3]
    turned, slid = (float(np.linalg.norm(values, axis=1).max()) for values in (turn, way))
    if turned < _STILL_RAD and slid < _STILL_M:
        return UrdfJoint(child, "fixed", parent, child, T[0], np.array([1.0, 0.0, 0.0]), None)
    values, kind, other = (
        (turn, "revolute", slid < _OFF_M) if turned >= _STILL_RAD else (way, "prismatic", True)
    )
    axis = np.linalg.svd(values, full_matrices=False)[2][0]
    axis = axis * np.sign(axis[np.argmax(np.abs(axis))])  # its largest component is positive
    off = float(np.linalg.norm(values - np.outer(values @ axis, axis), axis=1).max())
    limit = _OFF_RAD if kind == "revolute" else _OFF_M
    return UrdfJoint(child, kind if other and off < limit else "floating", parent, child, T[0], axis, None)


def named_joint(role: str, kinds: set[str], names: Iterable[str], on_way: bool) -> str:
    """The joint named pan (or tilt), preferably also named head; "" if there is none.

    Of several that move the camera, `on_way` to it, it is the last.
    """
    of_kind = [name for name in names if kinds & set(words(name))]
    best = [name for name in of_kind if HEAD_WORDS & set(words(name))] or of_kind
    if len(best) > 1 and not on_way:
        raise ConfigError(
            f"several joints could be the {role} joint: {listed(best)}", f"set joints.{role} in rig.yaml"
        )
    return best[-1] if best else ""


def pan_and_tilt(config: RigConfig, names: Collection[str], on_way: bool = False) -> tuple[str, str]:
    """Names of the pan and tilt joint, as configured or found by name; see `named_joint`.

    Raises:
        ConfigError: several joints match.
    """
    pan = config.joints.pan or named_joint("pan", PAN_WORDS, names, on_way)
    tilt = config.joints.tilt or named_joint(
        "tilt", TILT_WORDS, [name for name in names if name != pan], on_way
    )
    if pan and pan == tilt:
        raise ConfigError(f"joints.pan and joints.tilt are both {pan!r}", "set them to different joints")
    return pan, tilt


def _check_configured(config: RigConfig, chain: HeadChain) -> None:
    """Refuse names that are not in the chain; those of a camera that no joint moves mean nothing."""
    for role in ("pan", "tilt"):
        name = getattr(config.joints, role)
        if name and chain.joints and name not in chain.joints:
            raise ConfigError(
                f"joints.{role}: no joint {name!r} in the head chain", f"its joints: {listed(chain.joints)}"
            )


def outside_chain(chain: HeadChain, description: RobotDescription) -> list[str]:
    """Joints in the joint states that are named pan or tilt, where the chain has no joint of this name.

    Of a chain whose joints are named otherwise than all these, as one of transforms, nothing can be said.
    """
    stated = joint_state_names(description)
    if chain.joints and not {*chain.joints} & {*stated}:
        return []
    of_chain = {word for joint in chain.joints for word in words(joint)}
    missing = [word for word in ("pan", "tilt") if word not in of_chain]
    return [name for word in missing for name in stated if word in words(name)]


def _frame_prefix(urdf: Urdf, static: Iterable[tuple[str, str]]) -> str:
    """What stands before all names of the links in the transforms: the `frame_prefix` of robot_state_publisher."""
    prefixes = {
        parent.removesuffix(joint.parent)
        for parent, child in static
        for joint in urdf.joints.values()
        if parent.endswith(joint.parent) and child == parent.removesuffix(joint.parent) + joint.child
    }
    return prefixes.pop() if len(prefixes) == 1 else ""


def joint_sources(config: RigConfig, description: RobotDescription, head: Head) -> dict[str, JointSource]:
    """The chain's joints → their joint-state topics, or the sources of those that are read elsewhere.

    These are the fields of other messages that the configuration names, then the transforms on /tf, by the URDF's links
    and axes, of joints without joint states.

    Raises:
        ConfigError: a configured joint is not in the chain.
        RecordingError: a topic or a joint is missing; the hint lists those present.
    """
    chain = head.chain
    sources: dict[str, JointSource] = {}
    for name, source in config.joints.fields.items():
        if name not in chain.joints:
            raise ConfigError(
                f"joints.fields: {name!r} is not a joint between {chain.base_frame} and {chain.head_frame}",
                f"joints of the chain: {listed(chain.joints)}",
            )
        require_topic("joints.fields", source.topic, (info.name for info in description.topics))
        scale = math.radians(1) if source.unit == "deg" else 1.0
        sources[name] = JointField(source.topic, source.field, scale)
    stated, topic = description.joint_names, config.joints.topic
    told = {*joint_state_names(description), *sources}
    kinds = {link.joint: link.kind for link in chain.links if isinstance(link, JointLink)}
    tf = [info.name for info in description.topics if info.type == TRANSFORMS and info.name.endswith("/tf")]
    drawn = head.urdf.joints if tf and head.urdf is not None else {}
    for name, kind in kinds.items():
        joint = drawn.get(name)
        if joint is not None and joint.mimic is None and name not in told:
            ends = head.prefix + joint.parent, head.prefix + joint.child, joint.T_parent_child
            sources[name] = JointTransform(tf[0], *ends, joint.axis, kind)
    if topic is not None:
        require_topic("joints.topic", topic, stated, "joint states")
        stated = {topic: stated[topic]}
    for name in (name for name in chain.joints if name not in sources):
        topic = next((on for on, present in stated.items() if name in present), None)
        if topic is None:
            raise RecordingError(
                f"no joint state for {name!r}, a joint between {chain.base_frame} and {chain.head_frame}",
                "record it, or set its topic and field in joints.fields in rig.yaml; joints present: "
                f"{listed(sorted({n for present in stated.values() for n in present}))}",
            )
        sources[name] = topic
    return sources
