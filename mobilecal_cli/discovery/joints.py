"""Which joints are pan, tilt and the wheels, and the chain from base to head."""

from __future__ import annotations

import math
from collections.abc import Iterable

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.config import ChainLink, RigConfig, WheelConfig
from mobilecal_cli.discovery.names import pairs, side_of, words
from mobilecal_cli.errors import ConfigError, RecordingError
from mobilecal_cli.kinematics.urdf import Urdf, head_chain, vehicle_frame, wheel_centres
from mobilecal_cli.model import (
    FixedLink,
    FloatArray,
    HeadChain,
    JointField,
    JointLink,
    Prelude,
    Side,
    WheelGeometry,
    WheelSource,
)

_HEAD_WORDS = {"head", "neck", "ptu", "camera", "cam", "gimbal", "mast"}
_PAN_WORDS = {"pan", "yaw"}
_TILT_WORDS = {"tilt", "pitch"}
_COUNTER_WORDS = {"tick", "ticks", "encoder", "encoders", "count", "counts"}
_MIDWAY_M = 1e-6
ODOMETRY = "nav_msgs/msg/Odometry"
_AS_THE_DRIVER = "nominal.wheels in rig.yaml exactly as the robot's driver has them"


def _joint_state_names(prelude: Prelude) -> list[str]:
    return sorted({name for names in prelude.joint_names.values() for name in names})


def _listed(names: Iterable[str]) -> str:
    return ", ".join(names) or "none"


def named_joint(role: str, kinds: set[str], names: Iterable[str]) -> str:
    """The joint whose name says pan (or tilt), one that also says head before others; "" where none does."""
    found = [name for name in names if kinds & set(words(name))]
    best = [name for name in found if _HEAD_WORDS & set(words(name))] or found
    if len(best) > 1:
        raise ConfigError(
            f"several joints could be the head's {role}: {_listed(best)}", f"set joints.{role} in rig.yaml"
        )
    return best[0] if best else ""


def pan_and_tilt(config: RigConfig, prelude: Prelude, candidates: Iterable[str]) -> tuple[str, str]:
    """Names of the pan and the tilt joint, as configured or by their names.

    Raises:
        ConfigError: several joints fit.
    """
    names = list(candidates)
    pan = config.joints.pan or named_joint("pan", _PAN_WORDS, names)
    tilt = config.joints.tilt or named_joint("tilt", _TILT_WORDS, [name for name in names if name != pan])
    return pan, tilt


def explicit_chain(config: RigConfig, base_frame: str, head_frame: str, pan: str, tilt: str) -> HeadChain:
    """The chain that rig.yaml spells out."""
    links = tuple(_chain_link(link) for link in config.head.chain or ())
    return HeadChain(base_frame, head_frame, links, pan, tilt)


def _chain_link(link: ChainLink) -> FixedLink | JointLink:
    if link.joint is not None and link.axis is not None:
        axis = np.array(link.axis)
        return JointLink(link.joint, axis / math.hypot(*link.axis), link.kind)
    rotation = se3.from_rpy(np.array(link.rpy_rad or (0, 0, 0)))
    return FixedLink(se3.transform(rotation, np.array(link.xyz_m or (0, 0, 0))))


def frames(config: RigConfig, urdf: Urdf, tilt: str) -> tuple[str, str]:
    """Base and head link of a URDF: as configured, or base_link and what the tilt joint carries.

    Raises:
        ConfigError: there is no tilt joint to hang the head on.
    """
    base = config.head.base_frame
    if base is None:
        base = next((name for name in ("base_link", "base_footprint") if name in urdf.links), urdf.root)
    if config.head.head_frame is not None:
        return base, config.head.head_frame
    if tilt not in urdf.joints:
        raise ConfigError(
            f"no joint of the URDF {urdf.name!r} is called tilt: which link carries the camera is not known",
            f"set joints.tilt or head.head_frame in rig.yaml; its joints: {_listed(urdf.joints)}",
        )
    carried = urdf.joints[tilt].child
    if "head_link" in urdf.links and carried != "head_link":
        above = {joint.child: joint for joint in urdf.joints.values()}
        link = "head_link"
        while link in above and above[link].kind == "fixed":
            link = above[link].parent
        if link == carried:
            return base, "head_link"
    return base, carried


def urdf_wheels(urdf: Urdf, sources: dict[Side, WheelSource], base: str) -> dict[Side, str]:
    """Wheel joints of the URDF: those that the wheels are read from, or else those whose names fit."""
    named = {side: source.joint for side, source in sources.items() if source.joint in urdf.joints}
    if len(named) == 2:
        return {side: joint for side, joint in named.items() if joint}
    found = pairs(name for name in urdf.joints if _is_wheel(name))
    return found[0] if len(found) == 1 else {}


def chain_from_urdf(
    config: RigConfig, urdf: Urdf, sources: dict[Side, WheelSource], pan: str, tilt: str
) -> tuple[HeadChain, list[str]]:
    """The chain from v to the head, and notes on where v is.

    The vehicle frame v lies midway between the wheels, facing across their axle. Where the URDF's base link
    does not, the difference is taken out of the wheel joints' origins.

    Raises:
        ConfigError: links missing or not connected.
    """
    base, head = frames(config, urdf, tilt)
    wheels = urdf_wheels(urdf, sources, base)
    if len(wheels) < 2:
        return head_chain(urdf, base, head, pan, tilt), []
    T_base_v = vehicle_frame(*wheel_centres(urdf, base, wheels["left"], wheels["right"]))
    shift, turn = T_base_v[:2, 3], math.degrees(math.atan2(T_base_v[1, 0], T_base_v[0, 0]))
    if float(np.linalg.norm(shift)) < _MIDWAY_M and abs(turn) < 1e-4:
        return head_chain(urdf, base, head, pan, tilt), []
    note = (
        f"The URDF's {base} is not midway between the wheels: the vehicle frame was put there, "
        f"at x {shift[0] * 1e3:.1f} mm, y {shift[1] * 1e3:.1f} mm, turned by {turn:.2f} degrees."
    )
    return head_chain(urdf, base, head, pan, tilt, T_base_v), [note]


def drawn_head_eye(urdf: Urdf, head: str, camera_frame: str) -> FloatArray | None:
    """What the URDF draws: (4, 4) camera to head, where fixed joints lead from the head to the camera's frame."""
    if camera_frame not in urdf.links:
        return None
    try:
        path = urdf.path(head, camera_frame)
    except ConfigError:
        return None  # the camera hangs elsewhere
    if any(joint.kind != "fixed" for joint in path):
        return None
    T_h_reference = np.eye(4)
    for joint in path:
        T_h_reference = T_h_reference @ joint.T_parent_child
    return T_h_reference


def nominal_wheels(urdf: Urdf, sources: dict[Side, WheelSource], base: str) -> WheelGeometry | None:
    """What the URDF draws: separation from the wheel joints, radii from the wheels' cylinders."""
    wheels = urdf_wheels(urdf, sources, base)
    if len(wheels) < 2:
        return None
    radii = {side: urdf.cylinder_radius_m.get(urdf.joints[name].child) for side, name in wheels.items()}
    left, right = wheel_centres(urdf, base, wheels["left"], wheels["right"])
    separation = float(np.linalg.norm(left - right))
    if not radii["left"] or not radii["right"] or separation <= 0:
        return None
    return WheelGeometry(radii["right"], radii["left"], separation)


def _is_wheel(name: str) -> bool:
    found = set(words(name))
    return "wheel" in "".join(words(name)) and "caster" not in found and "castor" not in found


def wheel_sources(config: RigConfig, prelude: Prelude) -> dict[Side, WheelSource]:
    """Where each wheel's rotation is: as configured, or the pair of joints that are called wheels.

    Raises:
        RecordingError: no wheel is found; what is there is listed.
        ConfigError: several pairs fit, or a counter lacks its ticks per revolution.
    """
    if config.wheels.odometry is not None:
        return _odometry(config, prelude, config.wheels.odometry)
    found = pairs(name for name in _joint_state_names(prelude) if _is_wheel(name))
    result: dict[Side, WheelSource] = {}
    sides: tuple[tuple[Side, WheelConfig], ...] = (
        ("left", config.wheels.left),
        ("right", config.wheels.right),
    )
    for side, wheel in sides:
        if wheel.field is not None and wheel.topic is not None:
            if wheel.topic not in {topic.name for topic in prelude.topics}:
                raise RecordingError(
                    f"wheels.{side}: no topic {wheel.topic} in this recording",
                    f"topics present: {_listed(topic.name for topic in prelude.topics)}",
                )
            result[side] = WheelSource(
                wheel.topic, None, wheel.field, wheel.ticks_per_revolution, wheel.bits, wheel.sign
            )
            continue
        joint = wheel.joint
        if joint is None:
            if len(found) > 1:
                listed = "; ".join(f"{pair['left']} and {pair['right']}" for pair in found)
                raise ConfigError(
                    f"several pairs of joints could be the wheels: {listed}",
                    "set wheels.left.joint and wheels.right.joint in rig.yaml",
                )
            if not found:
                raise _no_wheels(side, prelude)
            joint = found[0][side]
        topics = (
            [wheel.topic]
            if wheel.topic
            else [t for t, names in prelude.joint_names.items() if joint in names]
        )
        if not topics or joint not in prelude.joint_names.get(topics[0], ()):
            raise RecordingError(
                f"wheels.{side}: no joint {joint!r} in the joint states"
                + (f" of {wheel.topic}" if wheel.topic else ""),
                f"joints present: {_listed(_joint_state_names(prelude))}",
            )
        result[side] = WheelSource(topics[0], joint, None, wheel.ticks_per_revolution, wheel.bits, wheel.sign)
    return result


def _odometry(config: RigConfig, prelude: Prelude, topic: str) -> dict[Side, WheelSource]:
    """Odometry as the source of both wheels' rotation.

    Raises:
        RecordingError: there is no odometry on the topic.
        ConfigError: the wheels that it was made with are not stated.
    """
    present = {info.name: info.type for info in prelude.topics}
    if present.get(topic) != ODOMETRY:
        others = _listed(name for name, kind in present.items() if kind == ODOMETRY)
        raise RecordingError(
            f"wheels.odometry: {topic} holds no {ODOMETRY} in this recording", f"topics that do: {others}"
        )
    wheels = config.nominal.wheels
    if wheels is None:
        raise ConfigError(
            f"wheels.odometry: the poses on {topic} were made from the wheels' rotations with some radii and "
            "separation, and the rotations cannot be had back without them",
            f"state {_AS_THE_DRIVER}",
        )
    baked_in = WheelGeometry(wheels.radius_right_m, wheels.radius_left_m, wheels.separation_m)
    sides: tuple[Side, Side] = ("left", "right")
    return {side: WheelSource(topic, baked_in=baked_in) for side in sides}


def _no_wheels(side: Side, prelude: Prelude) -> RecordingError:
    odometry = [topic.name for topic in prelude.topics if topic.type == ODOMETRY]
    if odometry and not any(_COUNTER_WORDS & set(words(t.name)) and side_of(t.name) for t in prelude.topics):
        return RecordingError(
            f"wheels.{side}: no joint is called a wheel; there is odometry on {_listed(odometry)}",
            f"set wheels.odometry to {odometry[0]}, and state {_AS_THE_DRIVER}",
        )
    counters = [t.name for t in prelude.topics if _COUNTER_WORDS & set(words(t.name)) and side_of(t.name)]
    if counters:
        return RecordingError(
            f"wheels.{side}: no joint is called a wheel; {_listed(counters)} look like tick counters",
            "set topic, field and ticks_per_revolution of wheels.left and wheels.right in rig.yaml",
        )
    return RecordingError(
        f"wheels.{side}: no pair of joints is called left and right wheel",
        f"set wheels.left and wheels.right in rig.yaml; joints present: {_listed(_joint_state_names(prelude))}; "
        f"topics present: {_listed(topic.name for topic in prelude.topics)}",
    )


def joint_fields(config: RigConfig, prelude: Prelude, chain: HeadChain) -> dict[str, JointField]:
    """The chain's joints that the configuration finds in other messages than joint states.

    Raises:
        ConfigError: a joint that is not on the chain.
        RecordingError: a topic is missing; those present are listed.
    """
    present = {topic.name for topic in prelude.topics}
    found = {}
    for joint, source in config.joints.fields.items():
        if joint not in chain.joints:
            raise ConfigError(
                f"joints.fields: {joint!r} is no joint between {chain.base_frame} and {chain.head_frame}",
                f"its joints: {_listed(chain.joints)}",
            )
        if source.topic not in present:
            raise RecordingError(
                f"joints.fields: no topic {source.topic} in this recording",
                f"topics present: {_listed(sorted(present))}",
            )
        found[joint] = JointField(
            source.topic, source.field, math.radians(1) if source.unit == "deg" else 1.0
        )
    return found


def joint_topics(config: RigConfig, prelude: Prelude, chain: HeadChain) -> tuple[str, ...]:
    """The joint-state topics that carry the chain's joints, but for those that `joint_fields` gives.

    Raises:
        RecordingError: a topic or a joint is missing; those present are listed.
    """
    topic = config.joints.topic
    if topic is not None and topic not in prelude.joint_names:
        raise RecordingError(
            f"joints.topic: {topic} holds no joint states in this recording",
            f"joint-state topics present: {_listed(prelude.joint_names)}",
        )
    names = {topic: prelude.joint_names[topic]} if topic is not None else prelude.joint_names
    for joint in set(chain.joints) - set(config.joints.fields):
        if not any(joint in present for present in names.values()):
            raise RecordingError(
                f"no joint state for {joint!r}, a joint between {chain.base_frame} and {chain.head_frame}",
                f"joints present: {_listed(sorted({n for present in names.values() for n in present}))}",
            )
    return tuple(t for t, present in names.items() if set(chain.joints) & set(present))


def nominal_head_eye(config: RigConfig) -> FloatArray | None:
    """(4, 4) nominal T_h_reference of the configuration."""
    prior = config.nominal.head_eye
    if prior is None:
        return None
    rotation = se3.from_quaternion_xyzw(np.array(prior.quaternion_xyzw))
    return se3.transform(rotation, np.array(prior.translation_m))
