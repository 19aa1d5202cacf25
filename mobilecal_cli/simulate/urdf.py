"""URDF of a simulated robot, published on /robot_description."""

from __future__ import annotations

from collections.abc import Iterable
from xml.sax.saxutils import quoteattr

from mobilecal_cli.simulate.robot import SimulatedRobot


def _numbers(values: Iterable[float]) -> str:
    return quoteattr(" ".join(repr(float(value)) for value in values))


def urdf_text(robot: SimulatedRobot) -> str:
    """URDF with the head's joints and the nominal wheels."""
    lines = ['<?xml version="1.0"?>', f"<robot name={quoteattr(robot.name)}>", '  <link name="base_link"/>']
    parent = robot.base_frame
    for joint in robot.joints:
        kind = "revolute" if joint.name else "fixed"
        lines += [
            f"  <link name={quoteattr(joint.link)}/>",
            f"  <joint name={quoteattr(joint.name or joint.link + '_fixed')} type={quoteattr(kind)}>",
            f"    <parent link={quoteattr(parent)}/><child link={quoteattr(joint.link)}/>",
            f"    <origin xyz={_numbers(joint.xyz_m)} rpy={_numbers(joint.rpy_rad)}/>",
        ]
        if joint.name:
            limit = _numbers([joint.limit_rad])
            lines.append(f"    <axis xyz={_numbers(joint.axis)}/>")
            lines.append(f'    <limit lower="{-joint.limit_rad!r}" upper={limit} effort="10" velocity="2"/>')
        lines.append("  </joint>")
        parent = joint.link
    wheels = robot.nominal_wheels
    for side, y, radius in (
        ("left", wheels.separation_m / 2, wheels.radius_left_m),
        ("right", -wheels.separation_m / 2, wheels.radius_right_m),
    ):
        lines += [
            f'  <link name="wheel_{side}_link"><collision><geometry>',
            f'    <cylinder radius="{radius!r}" length="0.05"/></geometry></collision></link>',
            f'  <joint name="wheel_{side}_joint" type="continuous">',
            f'    <parent link="base_link"/><child link="wheel_{side}_link"/>',
            f'    <origin xyz={_numbers((0.0, y, 0.0))}/><axis xyz="0 1 0"/>',
            "  </joint>",
        ]
    return "\n".join([*lines, "</robot>"]) + "\n"
