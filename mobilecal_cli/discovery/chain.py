"""Kinematic chain from base to head, and nominal head-eye transform from the URDF or configuration."""

from __future__ import annotations

import math

import numpy as np

from mobilecal_cli import se3
from mobilecal_cli.config import ChainLink, RigConfig
from mobilecal_cli.discovery.wheels import urdf_wheels
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.kinematics.urdf import Urdf, head_chain, vehicle_frame, wheel_centres
from mobilecal_cli.model import (
    FixedLink,
    FloatArray,
    HeadChain,
    JointLink,
    Nominal,
    Side,
    WheelGeometry,
    WheelSource,
    listed,
)

_MIDWAY_M = 1e-6


def explicit_chain(config: RigConfig, base_frame: str, head_frame: str, pan: str, tilt: str) -> HeadChain:
    """The chain given in rig.yaml."""
    links = tuple(_chain_link(link) for link in config.head.chain or ())
    return HeadChain(base_frame, head_frame, links, pan, tilt)


def _chain_link(link: ChainLink) -> FixedLink | JointLink:
    if link.joint is not None and link.axis is not None:
        axis = np.array(link.axis)
        return JointLink(link.joint, axis / math.hypot(*link.axis), link.kind)
    rotation = se3.from_rpy(np.array(link.rpy_rad or (0, 0, 0)))
    return FixedLink(se3.transform(rotation, np.array(link.xyz_m or (0, 0, 0))))


def frames(config: RigConfig, urdf: Urdf, tilt: str) -> tuple[str, str]:
    """Base and head link of a URDF: as configured, or base_link and the child of the tilt joint.

    Raises:
        ConfigError: no tilt joint to derive the head link from.
    """
    base = config.head.base_frame
    if base is None:
        base = next((name for name in ("base_link", "base_footprint") if name in urdf.links), urdf.root)
    if config.head.head_frame is not None:
        return base, config.head.head_frame
    if tilt not in urdf.joints:
        raise ConfigError(
            f"URDF {urdf.name!r}: no joint is named tilt, so the link that carries the camera is unknown",
            f"set joints.tilt or head.head_frame in rig.yaml; joints present: {listed(urdf.joints)}",
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


def chain_from_urdf(
    config: RigConfig, urdf: Urdf, sources: dict[Side, WheelSource], pan: str, tilt: str
) -> tuple[HeadChain, list[str]]:
    """Kinematic chain from v to the head, and notes on the position of v.

    The vehicle frame v lies midway between the wheels, with x perpendicular to the axle. If the URDF's base link
    differs, the offset is computed from the origins of the wheel joints.

    Raises:
        ConfigError: a link is missing or not connected.
    """
    base, head = frames(config, urdf, tilt)
    wheels = urdf_wheels(urdf, sources, base)
    if len(wheels) < 2:
        return head_chain(urdf, base, head, pan, tilt), []
    T_base_v = vehicle_frame(*wheel_centres(urdf, base, wheels["left"], wheels["right"]))
    notes = _moving_wheels(urdf, base, wheels)
    shift, turn = T_base_v[:2, 3], math.degrees(math.atan2(T_base_v[1, 0], T_base_v[0, 0]))
    if float(np.linalg.norm(shift)) < _MIDWAY_M and abs(turn) < 1e-4:
        return head_chain(urdf, base, head, pan, tilt), notes
    note = (
        f"The URDF's {base} is not midway between the wheels. The vehicle frame is placed there, "
        f"at x {shift[0] * 1e3:.1f} mm, y {shift[1] * 1e3:.1f} mm, rotated by {turn:.2f} degrees."
    )
    return head_chain(urdf, base, head, pan, tilt, T_base_v), [note, *notes]


def _moving_wheels(urdf: Urdf, base: str, wheels: dict[Side, str]) -> list[str]:
    """A note if the wheels move against the base, as on a robot that steers its axle."""
    path = urdf.path(base, urdf.joints[wheels["left"]].parent)
    moving = [joint.name for joint in path if joint.kind != "fixed"]
    if not moving:
        return []
    return [
        f"According to the URDF, the wheels move against {base} with {listed(moving)}. A differential drive is "
        "calibrated, with these joints at zero."
    ]


def drawn_head_eye(urdf: Urdf, head: str, camera_frame: str) -> FloatArray | None:
    """(4, 4) camera-to-head transform of the URDF; None unless only fixed joints connect the two frames."""
    if camera_frame not in urdf.links:
        return None
    try:
        path = urdf.path(head, camera_frame)
    except ConfigError:
        return None  # the camera is not below the head
    if any(joint.kind != "fixed" for joint in path):
        return None
    T_h_reference = np.eye(4)
    for joint in path:
        T_h_reference = T_h_reference @ joint.T_parent_child
    return T_h_reference


def nominal_of(config: RigConfig) -> Nominal:
    """Nominal values that the configuration gives; None where it gives none."""
    head_eye, wheels = config.nominal.head_eye, config.nominal.wheels
    T_h_reference = None
    if head_eye is not None:
        rotation = se3.from_quaternion_xyzw(np.array(head_eye.quaternion_xyzw))
        T_h_reference = se3.transform(rotation, np.array(head_eye.translation_m))
    return Nominal(
        T_h_reference,
        None
        if wheels is None
        else WheelGeometry(wheels.radius_right_m, wheels.radius_left_m, wheels.separation_m),
    )
