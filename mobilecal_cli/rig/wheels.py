"""Sources of the wheels' rotations, and nominal wheels from the URDF."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import Literal

import numpy as np

from mobilecal_cli import ranges
from mobilecal_cli.errors import ConfigError, RecordingError
from mobilecal_cli.kinematics.urdf import Urdf
from mobilecal_cli.likelihood.constants import WHEEL_SIGMA
from mobilecal_cli.model.arrays import FloatArray
from mobilecal_cli.model.rig import SIDES, Side, WheelGeometry, WheelSource
from mobilecal_cli.model.signals import ODOMETRY, NumberField, RobotDescription
from mobilecal_cli.model.text import listed
from mobilecal_cli.rig.config import RigConfig, WheelConfig
from mobilecal_cli.rig.names import (
    CASTER_WORDS,
    COUNTER_WORDS,
    Counters,
    counters,
    is_wheel,
    joint_state_names,
    nearest,
    require_topic,
    tick_counters,
    wheel_place,
    wheel_sets,
    words,
)

#: Wheels that stand for odometry whose driver's wheels are unknown.
ASSUMED = WheelGeometry(0.1, 0.1, 0.4)
#: Relative standard deviation of a separation that nothing states.
UNKNOWN_SHARE = 0.5
#: Message type without its package's ROS release → counter steps per turn of the wheel, and width of the counter, as
#: the drivers of these robots have them.
KNOWN_COUNTERS: dict[str, tuple[float, Literal[16] | None]] = {
    "turtlebot3_msgs/msg/SensorState": (4096.0, None),
    "kobuki_msgs/msg/SensorState": (2578.33, 16),
    "kobuki_ros_interfaces/msg/SensorState": (2578.33, 16),
    "irobot_create_msgs/msg/WheelTicks": (508.8, None),
    "duckietown_msgs/msg/WheelEncoderStamped": (135.0, None),
}
_SERVED = (
    "mobilecal serves robots with differential drive or skid steering that record wheel joints "
    "(sensor_msgs/JointState), tick counters, or wheel odometry (nav_msgs/Odometry)"
)
#: Words of odometry that is not from wheels alone, and of odometry that is not from wheels at all.
_FUSED = {
    "filtered", "ekf", "ukf", "fused", "fusion", "combined", "localization", "imu", "gyro", "map", "amcl",
}  # fmt: skip
_NOT_WHEELS = {
    "visual", "vo", "vio", "svo", "camera", "cam", "stereo", "rgbd", "t265", "zed", "realsense", "oak", "rtabmap",
    "orb", "slam", "vins", "okvis", "lidar", "laser", "velodyne", "ouster", "livox", "lio", "loam", "scan", "icp",
    "rf2o", "mavros", "gps", "gnss", "utm", "truth", "gt", "ground", "groundtruth", "mocap", "vicon",
    "optitrack", "optical",
}  # fmt: skip
_OF_WHEELS = {
    "wheel", "wheels", "encoder", "encoders", "enc", "diff", "drive", "controller", "raw", "unfiltered",
}  # fmt: skip
#: Relative difference of radii up to which wheels may be of one set.
_ALIKE = 0.05
#: Words of joints that steer wheels, except those of casters.
_STEERING = {"steer", "steering"}
#: Drives that are no differential drive, by the words of their topics, types and joints.
_OTHER_DRIVES = {
    "ackermann": "an Ackermann",
    "mecanum": "a mecanum",
    "omni": "an omnidirectional",
    "swerve": "a swerve",
}


def wheel_sources(
    config: RigConfig, description: RobotDescription, images: Collection[str] = ()
) -> dict[Side, WheelSource]:
    """Source of each side's rotation: as configured, or found by names: wheel joints, tick counters, or odometry.

    Args:
        images: image topics of the cameras: of topics that are named alike, those in their namespace are of this robot.

    Raises:
        RecordingError: no wheel is found; the hint lists what is present.
        ConfigError: several sets match, one side alone is known, or a counter lacks its ticks per revolution.
    """
    if config.wheels.odometry is not None:
        return _odometry(config, description, config.wheels.odometry)
    stated = {side: wheel for side, wheel in config.wheels.of_sides.items() if wheel.sources}
    wheels = stated if len(stated) == len(SIDES) else _wheels_by_name(config, description, images) | stated
    sources: dict[Side, WheelSource] = {}
    for side in (side for side in SIDES if side in wheels):
        parts = wheels[side].sources
        first, *others = (replace(part, topic=_topic_of(side, part, description)) for part in parts)
        sources[side] = replace(first, others=tuple(others), unread=wheels[side].unread)
    missing = [side for side in SIDES if side not in sources]
    if len(missing) == len(SIDES):
        sources = _odometry(config, description, _odometry_topic(description, images))
    elif missing:
        (side,) = missing
        raise ConfigError(
            f"only one wheel is stated, and no joint or counter is named as the {side} wheel",
            f"set wheels.{side}, too, or leave both out; joints present: {listed(joint_state_names(description))}",
        )
    read = {side: {(part.topic, part.joint, part.field) for part in sources[side].every} for side in SIDES}
    if sources["left"].baked_in is None and (both := read["left"] & read["right"]):
        topic, joint, field = min(both, key=str)
        raise ConfigError(
            f"wheels.left and wheels.right are both read from {joint or field} on {topic}",
            "set wheels.left and wheels.right to different joints or fields",
        )
    return sources


def _stated(config: RigConfig) -> bool:
    return config.wheels.odometry is not None or all(w.sources for w in config.wheels.of_sides.values())


def wheel_joints(config: RigConfig, description: RobotDescription) -> list[set[str]]:
    """Joints of each set of wheels by name; none if wheels are configured."""
    sets = [] if _stated(config) else _wheel_joints(description)
    return [{*by_side["left"], *by_side["right"]} for by_side in sets]


def needs_numbers(config: RigConfig, description: RobotDescription) -> bool:
    """Whether wheels may be among the numbers in other messages: no wheel is configured or named in joint states."""
    return not _stated(config) and not _wheel_joints(description)


def may_have_wheels(description: RobotDescription) -> bool:
    """Whether joints, or numbers that change, are named as wheels, or there is odometry."""
    odometry = any(topic.type == ODOMETRY and topic.count for topic in description.topics)
    changing = [number for number in description.numbers if not number.still]
    return odometry or bool(_wheel_joints(description) or counters(changing))


def _topic_of(side: Side, part: WheelSource, description: RobotDescription) -> str:
    """Topic of one wheel: as stated, or the first one with its joint."""
    if part.joint is None:
        require_topic(f"wheels.{side}", part.topic, (info.name for info in description.topics))
        return part.topic
    names = description.joint_names
    topics = [topic for topic in names if part.joint in names[topic] and part.topic in ("", topic)]
    if not topics:
        raise RecordingError(
            f"wheels.{side}: no joint {part.joint!r} in the joint states"
            + (f" of {part.topic}" if part.topic else ""),
            f"joints present: {listed(joint_state_names(description))}",
        )
    return topics[0]


def _wheel_joints(description: RobotDescription) -> list[dict[Side, tuple[str, ...]]]:
    return wheel_sets(name for name in joint_state_names(description) if is_wheel(name))


def _wheels_by_name(
    config: RigConfig, description: RobotDescription, images: Collection[str]
) -> dict[Side, WheelConfig]:
    """The configuration completed by wheels that are found by names; empty if there are none."""
    _refuse_other_drives(description)
    sets = _wheel_joints(description)
    if len(sets) > 1:
        several = "; ".join(
            " and ".join(name for side in SIDES for name in by_side[side]) for by_side in sets
        )
        raise ConfigError(
            f"several pairs of joints could be the wheels: {several}",
            "set wheels.left.joint and wheels.right.joint in rig.yaml",
        )
    wheels = config.wheels.of_sides
    if sets:
        return {side: wheel.model_copy(update={"joints": sets[0][side]}) for side, wheel in wheels.items()}
    counted = nearest(counters(description.numbers), lambda by_side: by_side["left"][0].topic, images)
    whole = any(number.integer for by_side in counted for number in by_side["left"])
    odometry = ODOMETRY in {topic.type for topic in description.topics}
    # Numbers that are not whole are in an unknown unit: odometry says more.
    return _with_counters(wheels, description, counted) if counted and (whole or not odometry) else {}


def _refuse_other_drives(description: RobotDescription) -> None:
    """Refuse robots that steer their wheels or move sideways, as far as their names say so.

    Raises:
        RecordingError: naming the joints or the drive.
    """
    names = joint_state_names(description)
    joints = [name for name in names if _STEERING & {*words(name)} and not CASTER_WORDS & {*words(name)}]
    names += [name for topic in description.topics for name in (topic.name, topic.type)]
    present = {word for name in names for word in words(name)}
    drive = next((drive for word, drive in _OTHER_DRIVES.items() if word in present), "")
    what = f"; joints that steer: {listed(joints)}" if joints else ""
    if drive or joints:
        raise RecordingError(
            f"the names in the recording are those of {drive or 'a steered'} drive{what}: "
            "Ackermann, mecanum and other omnidirectional drives are not supported",
            f"{_SERVED}; if this robot is one, name its wheels in rig.yaml (wheels.left, wheels.right or "
            "wheels.odometry)",
        )


def _with_counters(
    wheels: Mapping[Side, WheelConfig], description: RobotDescription, sets: Sequence[Counters]
) -> dict[Side, WheelConfig]:
    """The wheels as tick counters found by name, with the steps per turn of the configuration or of a known driver."""
    types = {topic.name: topic.type for topic in description.topics}
    shown = [", ".join(f"{n.path} on {n.topic}" for side in SIDES for n in by_side[side]) for by_side in sets]
    counted = tick_counters(sets)
    instead = "; or set wheels.odometry" if ODOMETRY in types.values() else ""
    if counted is None:
        raise RecordingError(
            f"no joint is named as a wheel; several numbers could be its counters: {'; '.join(shown)}"
            if len(sets) > 1
            else f"no joint is named as a wheel; {shown[0]} may be, but in an unknown unit",
            f"set topic, field and ticks_per_revolution of wheels.left and wheels.right in rig.yaml{instead}",
        )
    completed: dict[Side, WheelConfig] = {}
    for side, wheel in wheels.items():
        numbers = counted[side]
        ticks, bits = KNOWN_COUNTERS.get(types.get(numbers[0].topic, ""), (None, None))
        ticks = wheel.ticks_per_revolution or ticks
        if ticks is None:
            raise RecordingError(
                f"{shown[0]}: tick counters; their steps per turn of the wheel are not in the recording",
                "count them (encoder steps times gear ratio) and add to rig.yaml: "
                "wheels: {left: {ticks_per_revolution: N}, right: {ticks_per_revolution: N}}" + instead,
            )
        keys = {
            "topics": tuple(number.topic for number in numbers),
            "fields": tuple(number.path for number in numbers),
            "ticks_per_revolution": ticks,
            "bits": wheel.bits or next(filter(None, map(counter_width, numbers)), bits),
        }
        completed[side] = wheel.model_copy(update=keys)
    return completed


def counter_width(number: NumberField) -> int | None:
    """Bits after which a counter starts again: as seen, or those of a narrow type."""
    for bits in (8, 16, 32):
        if number.wraps == bits or (number.bits == bits and bits < 32):
            return bits
    return None


def _odometry_topic(description: RobotDescription, images: Collection[str]) -> str:
    """The odometry that is from the wheels alone, by its topic and frames.

    Raises:
        RecordingError: there is none.
        ConfigError: several are equal candidates, or all are filtered.
    """
    every = [t.name for t in description.topics if t.type == ODOMETRY and t.count != 0]
    frames = {topic: description.odometry_frames.get(topic, ("", "")) for topic in every}  # parent, child
    told = {topic: {*words(topic), *words(child)} for topic, (_, child) in frames.items()}
    own = [topic for topic in every if not told[topic] & _NOT_WHEELS]
    raw = [topic for topic in own if not told[topic] & _FUSED and "map" not in words(frames[topic][0])]
    named = [topic for topic in raw if told[topic] & _OF_WHEELS]
    best = nearest(named or raw, str, images)
    if len(best) == 1:
        return best[0]
    if best:
        raise ConfigError(
            f"no joint is named as a wheel, and several topics could be the wheel odometry: {listed(best)}",
            f"add the one of the wheel driver to rig.yaml: wheels: {{odometry: {best[0]}}}",
        )
    if own:
        raise ConfigError(
            f"no joint is named as a wheel, and the odometry on {listed(own)} is named as fused with other sensors: "
            "its rotation may be that of a gyro, which says nothing of the wheels",
            "record the wheels or the odometry of the wheel driver; to calibrate this odometry nevertheless, add to "
            f"rig.yaml: wheels: {{odometry: {own[0]}}}",
        )
    counted = [t.name for t in description.topics if wheel_place(t.name) and COUNTER_WORDS & {*words(t.name)}]
    fact, key = "no joint is named as a left or right wheel", "wheels.left and wheels.right"
    if every:
        fact += f", and the odometry on {listed(every)} is not named as that of wheels"
        key = f"wheels: {{odometry: {every[0]}}}"
    elif counted:
        fact += f"; {listed(counted)} look like tick counters, but no numbers can be read there"
        key += " (topic, field and ticks_per_revolution)"
    raise RecordingError(
        fact,
        f"{_SERVED}; record one of them, or set {key} in rig.yaml; joints present: "
        f"{listed(joint_state_names(description))}; topics present: {listed(t.name for t in description.topics)}",
    )


def _odometry(config: RigConfig, description: RobotDescription, topic: str) -> dict[Side, WheelSource]:
    """Odometry as the source of both wheels' rotations."""
    present = [info.name for info in description.topics if info.type == ODOMETRY]
    require_topic("wheels.odometry", topic, present, ODOMETRY)
    wheels = config.nominal.wheels
    if wheels is not None:
        return dict.fromkeys(SIDES, WheelSource(topic, baked_in=wheels.geometry))
    stated_m = config.wheels.odometry_separation_m
    assumed = replace(ASSUMED, separation_m=stated_m or ASSUMED.separation_m)
    share = 0.0 if stated_m else UNKNOWN_SHARE
    return dict.fromkeys(SIDES, WheelSource(topic, baked_in=assumed, assumed=True, separation_share=share))


def as_drawn(
    sources: Mapping[Side, WheelSource], joints: WheelJoints, config: RigConfig, urdf: Urdf, base: str
) -> dict[Side, WheelSource]:
    """Sources with the wheels of the URDF that are not read, and those of odometry with its separation.

    The driver of odometry reads all wheels. Of counters, and of joints that have other names in the URDF, any of its
    joints are read. The separation of assumed wheels is that of the URDF, unless the configuration states it.
    """
    drawn = None if config.wheels.odometry_separation_m else wheel_distance_m(urdf, joints, base)
    read = {part.joint for source in sources.values() for part in source.every}
    changed: dict[Side, WheelSource] = {}
    for side, source in sources.items():
        if source.baked_in is None:
            others = [name for name in joints.get(side, ()) if name not in read]
            counted = 0 if source.joint in urdf.joints else len(source.every)
            source = replace(source, unread=tuple(others[counted:]) or source.unread)
        elif source.assumed and drawn is not None and drawn in ranges.WHEEL_SEPARATION:
            wheels = replace(source.baked_in, separation_m=drawn)
            source = replace(source, baked_in=wheels, separation_share=WHEEL_SIGMA)
        changed[side] = source
    return changed


#: Joints of the wheels of each side; empty where they are unknown.
WheelJoints = Mapping[Side, tuple[str, ...]]


def urdf_wheels(urdf: Urdf, sources: Mapping[Side, WheelSource]) -> WheelJoints:
    """Wheel joints of the URDF: of those that are read the whole set, otherwise the set found by name.

    Wheels that are not read carry the base, too: it turns about the middle of all. Joints that are named for the other
    side are there: their readings are exchanged, not their places.

    Raises:
        ConfigError: a wheel that is stated as not read is not in the URDF.
    """
    read = {side: tuple(part.joint or "" for part in source.every) for side, source in sources.items()}
    names = {name for each in read.values() for name in each}
    if len(read) < len(SIDES) or not names <= {*urdf.joints}:
        by_name = wheel_sets(name for name in urdf.joints if is_wheel(name))
        return by_name[0] if len(by_name) == 1 else {}
    stated = {side: source.unread for side, source in sources.items() if source.unread is not None}
    for side, unread in stated.items():
        if missing := {*unread} - {*urdf.joints}:
            raise ConfigError(
                f"wheels.{side}.unread: the URDF has no joint {min(missing)!r}",
                f"joints present: {listed(urdf.joints)}",
            )
    read = {side: (*read[side], *stated.get(side, ())) for side in SIDES}
    names = {name for each in read.values() for name in each}
    further = [] if stated else [name for name in urdf.joints if _alike(urdf, name, names)]
    by_name = wheel_sets({*names, *further})
    return next((each for each in by_name if names <= {*each["left"], *each["right"]}), read)


def _alike(urdf: Urdf, name: str, others: Collection[str]) -> bool:
    """Whether the wheel of a joint turns on the same body as others, with their radius as far as the URDF draws it.

    A wheel on a body that moves itself is a caster's, or is steered.
    """
    joint, beside = urdf.joints[name], [urdf.joints[other] for other in others]
    if joint.kind == "fixed" or urdf.carrier(joint.parent)[0] not in {
        urdf.carrier(o.parent)[0] for o in beside
    }:
        return False
    radius_m, *others_m = (urdf.cylinder_radius_m.get(each.child) for each in (joint, *beside))
    return not radius_m or all(abs(radius_m - m) < _ALIKE * radius_m for m in others_m if m)


def side_centres(urdf: Urdf, joints: WheelJoints, base: str) -> tuple[FloatArray, FloatArray]:
    """Mean center of the left and of the right wheels in base coordinates, (3,) each, m.

    Raises:
        ConfigError: the link of a wheel is not connected to the base.
    """
    poses = ([urdf.pose(base, urdf.joints[name].child) for name in joints[side]] for side in SIDES)
    left, right = (np.mean(T, axis=0)[:3, 3] for T in poses)
    return left, right


def wheel_distance_m(urdf: Urdf, joints: WheelJoints, base: str) -> float | None:
    """Distance of the wheel joints, m; None without them."""
    if not joints:
        return None
    left, right = side_centres(urdf, joints, base)
    return float(np.linalg.norm(left - right)) or None


def nominal_wheels(urdf: Urdf, joints: WheelJoints, base: str) -> WheelGeometry | None:
    """Nominal wheels of the URDF: separation from the wheel joints, radii from the wheels' cylinders."""
    separation = wheel_distance_m(urdf, joints, base)
    if separation is None:
        return None
    radii = {}
    for side, names in joints.items():
        drawn = [urdf.cylinder_radius_m.get(urdf.joints[name].child) or 0.0 for name in names]
        if not all(drawn):
            return None
        for name, radius_m in zip(names, drawn, strict=True):
            where = f"URDF: link {urdf.joints[name].child!r}, cylinder radius"
            ranges.WHEEL_RADIUS.check(where, radius_m)
        radii[side] = sum(drawn) / len(drawn)
    left, right = (" and ".join(repr(name) for name in joints[side]) for side in SIDES)
    ranges.WHEEL_SEPARATION.check(f"URDF: distance of {left} and {right}", separation)
    return WheelGeometry(radii["right"], radii["left"], separation)
