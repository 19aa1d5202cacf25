"""The head-eye transform as a ROS 2 launch file."""

from __future__ import annotations

import shlex

from mobilecal_cli import se3
from mobilecal_cli.errors import ConfigError
from mobilecal_cli.export.formats import CONVENTION, Exported, Source, frame_note, of_head_eye
from mobilecal_cli.export.text import decimal, rendered
from mobilecal_cli.model import CalibratedRobot


def transform_fields(robot: CalibratedRobot) -> dict[str, str]:
    """Position and unit quaternion of the head-eye transform, as text."""
    T = robot.T_parent_child
    names = ("x", "y", "z", "qx", "qy", "qz", "qw")
    values = (*T[:3, 3], *se3.quaternion_xyzw(T[:3, :3]))
    return {name: decimal(float(value)) for name, value in zip(names, values, strict=True)}


def export(of: Source) -> Exported:
    """Launch file for tf2"""
    robot = of.robot
    for frame in (robot.parent_frame, robot.child_frame):
        if "$(" in frame:
            raise ConfigError(f"a launch file substitutes $( in the frame name {frame!r}", "rename the frame")
    args = [f"--{name} {value}" for name, value in transform_fields(robot).items()]
    args += [
        f"--frame-id {shlex.quote(robot.parent_frame)}",
        f"--child-frame-id {shlex.quote(robot.child_frame)}",
    ]
    note = f"{CONVENTION} {frame_note(robot)}"
    return of_head_eye(robot, rendered("static_transform_launch.xml", note=note, args=" ".join(args)))
