"""Pan and tilt joints, and sources of the head's joint readings."""

from __future__ import annotations

import math
from collections.abc import Collection, Container, Iterable

from mobilecal_cli.errors import ConfigError, RecordingError
from mobilecal_cli.kinematics.urdf import Urdf
from mobilecal_cli.model import (
    TRANSFORMS,
    HeadChain,
    JointField,
    JointLink,
    JointTransform,
    RobotDescription,
    listed,
)
from mobilecal_cli.rig.config import RigConfig
from mobilecal_cli.rig.names import (
    HEAD_WORDS,
    PAN_WORDS,
    TILT_WORDS,
    joint_state_names,
    require_topic,
    words,
)


def named_joint(role: str, kinds: set[str], names: Iterable[str]) -> str:
    """The joint named pan (or tilt), preferably also named head; "" if there is none."""
    of_kind = [name for name in names if kinds & set(words(name))]
    best = [name for name in of_kind if HEAD_WORDS & set(words(name))] or of_kind
    if len(best) > 1:
        raise ConfigError(
            f"several joints could be the {role} joint: {listed(best)}", f"set joints.{role} in rig.yaml"
        )
    return best[0] if best else ""


def pan_and_tilt(config: RigConfig, names: Collection[str]) -> tuple[str, str]:
    """Names of the pan and tilt joint, as configured or found by name.

    Raises:
        ConfigError: several joints match.
    """
    pan = config.joints.pan or named_joint("pan", PAN_WORDS, names)
    tilt = config.joints.tilt or named_joint("tilt", TILT_WORDS, [name for name in names if name != pan])
    if pan and pan == tilt:
        raise ConfigError(f"joints.pan and joints.tilt are both {pan!r}", "set them to different joints")
    return pan, tilt


def outside_chain(chain: HeadChain, description: RobotDescription) -> list[str]:
    """Joints in the joint states that are named pan or tilt, where the chain has no joint of this name."""
    return [
        name
        for word in ("pan", "tilt")
        if not any(word in words(joint) for joint in chain.joints)
        for name in joint_state_names(description)
        if word in words(name)
    ]


def joint_fields(config: RigConfig, description: RobotDescription, chain: HeadChain) -> dict[str, JointField]:
    """Joints of the chain that the configuration reads from messages other than JointState.

    Raises:
        ConfigError: a joint is not in the chain.
        RecordingError: a topic is missing; the hint lists those present.
    """
    fields = {}
    for joint, source in config.joints.fields.items():
        if joint not in chain.joints:
            raise ConfigError(
                f"joints.fields: {joint!r} is not a joint between {chain.base_frame} and {chain.head_frame}",
                f"joints of the chain: {listed(chain.joints)}",
            )
        require_topic("joints.fields", source.topic, description)
        scale = math.radians(1) if source.unit == "deg" else 1.0
        fields[joint] = JointField(source.topic, source.field, scale)
    return fields


def joint_transforms(
    config: RigConfig, description: RobotDescription, chain: HeadChain, urdf: Urdf | None
) -> dict[str, JointTransform]:
    """Joints of the chain without joint states that /tf may provide, by the URDF's links and axes."""
    topic = next(
        (info.name for info in description.topics if info.type == TRANSFORMS and info.name.endswith("/tf")),
        None,
    )
    if topic is None or urdf is None:
        return {}
    told = {*joint_state_names(description), *config.joints.fields}
    kinds = {link.joint: link.kind for link in chain.links if isinstance(link, JointLink)}
    return {
        name: JointTransform(topic, joint.parent, joint.child, joint.T_parent_child, joint.axis, kinds[name])
        for name in chain.joints
        if name not in told and (joint := urdf.joints.get(name)) is not None and joint.mimic is None
    }


def joint_topics(
    config: RigConfig, description: RobotDescription, chain: HeadChain, elsewhere: Container[str]
) -> tuple[str, ...]:
    """JointState topics with the chain's joints, except those read elsewhere.

    Raises:
        RecordingError: a topic or a joint is missing; the hint lists those present.
    """
    topic = config.joints.topic
    if topic is not None and topic not in description.joint_names:
        raise RecordingError(
            f"joints.topic: {topic} contains no joint states in this recording",
            f"joint-state topics present: {listed(description.joint_names)}",
        )
    names = {topic: description.joint_names[topic]} if topic is not None else description.joint_names
    for joint in [name for name in chain.joints if name not in elsewhere]:
        if not any(joint in present for present in names.values()):
            raise RecordingError(
                f"no joint state for {joint!r}, a joint between {chain.base_frame} and {chain.head_frame}",
                f"joints present: {listed(sorted({n for present in names.values() for n in present}))}",
            )
    return tuple(t for t, present in names.items() if set(chain.joints) & set(present))
