"""Sources of the wheels' rotations, and nominal wheels from the URDF."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from mobilecal_cli import ranges
from mobilecal_cli.errors import ConfigError, RecordingError
from mobilecal_cli.kinematics.urdf import Urdf, wheel_centres
from mobilecal_cli.model import SIDES, RobotDescription, Side, WheelGeometry, WheelSource, listed
from mobilecal_cli.rig.config import RigConfig, WheelConfig
from mobilecal_cli.rig.names import COUNTER_WORDS, joint_state_names, pairs, side_of, words

ODOMETRY = "nav_msgs/msg/Odometry"
_AS_THE_DRIVER = "nominal.wheels in rig.yaml to the exact values of the robot's driver"


def wheel_sources(config: RigConfig, description: RobotDescription) -> dict[Side, WheelSource]:
    """Source of each wheel's rotation: as configured, or the pair of joints named as wheels.

    Raises:
        RecordingError: no wheel is found; the hint lists what is present.
        ConfigError: several pairs match, or a counter lacks its ticks per revolution.
    """
    if config.wheels.odometry is not None:
        return _odometry(config, description, config.wheels.odometry)
    wheel_joints = pairs(name for name in joint_state_names(description) if _is_wheel(name))
    sources: dict[Side, WheelSource] = {}
    for side in SIDES:
        wheel: WheelConfig = getattr(config.wheels, side)
        counted = (wheel.ticks_per_revolution, wheel.bits, wheel.sign)
        if wheel.field is not None and wheel.topic is not None:
            if wheel.topic not in {topic.name for topic in description.topics}:
                raise RecordingError(
                    f"wheels.{side}: no topic {wheel.topic} in this recording",
                    f"topics present: {listed(topic.name for topic in description.topics)}",
                )
            sources[side] = WheelSource(wheel.topic, None, wheel.field, *counted)
            continue
        joint = wheel.joint
        if joint is None:
            if len(wheel_joints) > 1:
                several = "; ".join(f"{pair['left']} and {pair['right']}" for pair in wheel_joints)
                raise ConfigError(
                    f"several pairs of joints could be the wheels: {several}",
                    "set wheels.left.joint and wheels.right.joint in rig.yaml",
                )
            if not wheel_joints:
                raise _no_wheels(side, description)
            joint = wheel_joints[0][side]
        topics = [topic for topic, names in description.joint_names.items() if joint in names]
        if wheel.topic:
            topics = [wheel.topic]
        if not topics or joint not in description.joint_names.get(topics[0], ()):
            raise RecordingError(
                f"wheels.{side}: no joint {joint!r} in the joint states"
                + (f" of {wheel.topic}" if wheel.topic else ""),
                f"joints present: {listed(joint_state_names(description))}",
            )
        sources[side] = WheelSource(topics[0], joint, None, *counted)
    left, right = sources["left"], sources["right"]
    if (left.topic, left.joint, left.field) == (right.topic, right.joint, right.field):
        raise ConfigError(
            f"wheels.left and wheels.right are both read from {left.joint or left.field} on {left.topic}",
            "set wheels.left and wheels.right to different joints or fields",
        )
    return sources


def _odometry(config: RigConfig, description: RobotDescription, topic: str) -> dict[Side, WheelSource]:
    """Odometry as the source of both wheels' rotations."""
    present = {info.name: info.type for info in description.topics}
    if present.get(topic) != ODOMETRY:
        others = listed(name for name, kind in present.items() if kind == ODOMETRY)
        raise RecordingError(
            f"wheels.odometry: {topic} contains no {ODOMETRY} in this recording",
            f"topics with odometry: {others}",
        )
    wheels = config.nominal.wheels
    if wheels is None:
        raise ConfigError(
            f"wheels.odometry: the poses on {topic} depend on the driver's wheel radii and separation, which are "
            "not given",
            f"set {_AS_THE_DRIVER}",
        )
    baked_in = WheelGeometry(**wheels.model_dump())
    return {side: WheelSource(topic, baked_in=baked_in) for side in SIDES}


def _no_wheels(side: Side, description: RobotDescription) -> RecordingError:
    odometry = [topic.name for topic in description.topics if topic.type == ODOMETRY]
    counters = [t.name for t in description.topics if COUNTER_WORDS & set(words(t.name)) and side_of(t.name)]
    if odometry and not counters:
        return RecordingError(
            f"wheels.{side}: no joint is named as a wheel; odometry is present on {listed(odometry)}",
            f"set wheels.odometry to {odometry[0]}, and {_AS_THE_DRIVER}",
        )
    if counters:
        return RecordingError(
            f"wheels.{side}: no joint is named as a wheel; {listed(counters)} look like tick counters",
            "set topic, field and ticks_per_revolution of wheels.left and wheels.right in rig.yaml",
        )
    if not description.joint_names:
        return RecordingError(
            f"wheels.{side}: no joint states (sensor_msgs/JointState), odometry or tick counters were recorded",
            "record /joint_states, or set topic and field of wheels.left and wheels.right in rig.yaml; topics present: "
            f"{listed(topic.name for topic in description.topics)}",
        )
    return RecordingError(
        f"wheels.{side}: no pair of joints is named as left and right wheel",
        f"set wheels.left and wheels.right in rig.yaml; joints present: {listed(joint_state_names(description))}; "
        f"topics present: {listed(topic.name for topic in description.topics)}",
    )


def urdf_wheels(urdf: Urdf, sources: Mapping[Side, WheelSource]) -> dict[Side, str]:
    """Wheel joints of the URDF: those that are read, otherwise a pair found by name."""
    named = {side: source.joint for side, source in sources.items() if source.joint in urdf.joints}
    if len(named) == 2:
        return {side: joint for side, joint in named.items() if joint}
    by_name = pairs(name for name in urdf.joints if _is_wheel(name))
    return by_name[0] if len(by_name) == 1 else {}


def wheel_distance_m(urdf: Urdf, sources: dict[Side, WheelSource], base: str) -> float | None:
    """Distance of the URDF's wheel joints, m; None if it has no pair of them."""
    wheels = urdf_wheels(urdf, sources)
    if len(wheels) < 2:
        return None
    left, right = wheel_centres(urdf, base, wheels["left"], wheels["right"])
    return float(np.linalg.norm(left - right)) or None


def nominal_wheels(urdf: Urdf, sources: dict[Side, WheelSource], base: str) -> WheelGeometry | None:
    """Nominal wheels of the URDF: separation from the wheel joints, radii from the wheels' cylinders."""
    wheels, separation = urdf_wheels(urdf, sources), wheel_distance_m(urdf, sources, base)
    if separation is None:
        return None
    radii = {side: urdf.cylinder_radius_m.get(urdf.joints[name].child) for side, name in wheels.items()}
    if not radii["left"] or not radii["right"]:
        return None
    for side, name in wheels.items():
        where = f"URDF: link {urdf.joints[name].child!r}, cylinder radius"
        ranges.WHEEL_RADIUS.check(where, radii[side] or 0.0)
    ranges.WHEEL_SEPARATION.check(f"URDF: distance of {wheels['left']!r} and {wheels['right']!r}", separation)
    return WheelGeometry(radii["right"], radii["left"], separation)


def _is_wheel(name: str) -> bool:
    return "wheel" in "".join(words(name)) and not {"caster", "castor"} & set(words(name))
