"""The head-eye transform as a ROS 2 launch file."""

import shlex

from mobilecal_cli.errors import ConfigError
from mobilecal_cli.export.formats import Exported, Source, of_head_eye


def export(of: Source) -> Exported:
    """Launch file for tf2"""
    robot = of.robot
    for frame in (robot.parent_frame, robot.child_frame):
        if "$(" in frame:
            raise ConfigError(f"a launch file substitutes $( in the frame name {frame!r}", "rename the frame")
    frames = f"--frame-id {shlex.quote(robot.parent_frame)} --child-frame-id {shlex.quote(robot.child_frame)}"
    return of_head_eye(robot, "static_transform_launch.xml", frames=frames)
