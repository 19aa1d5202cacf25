"""The head-eye transform with the keys of geometry_msgs/TransformStamped."""

from __future__ import annotations

from mobilecal_cli.export.formats import CONVENTION, HeadEyeFormat, frame_note
from mobilecal_cli.export.formats.static_transform_launch import transform_fields
from mobilecal_cli.export.text import quoted
from mobilecal_cli.model import CalibratedRobot
from mobilecal_cli.model.text import visible


class StaticTransformYaml(HeadEyeFormat):
    """The head-eye transform with the keys of `geometry_msgs/TransformStamped`"""

    def text(self, robot: CalibratedRobot) -> str:
        v = transform_fields(robot)
        return "\n".join(
            [
                f"# {CONVENTION}",
                "# The parent is frame_id, the head; the child is child_frame_id, the camera.",
                f"# {visible(frame_note(robot))}",
                "header:",
                f"  frame_id: {quoted(robot.parent_frame)}",
                f"child_frame_id: {quoted(robot.child_frame)}",
                "transform:",
                f'  translation: {{x: {v["x"]}, "y": {v["y"]}, z: {v["z"]}}}',
                f'  rotation: {{x: {v["qx"]}, "y": {v["qy"]}, z: {v["qz"]}, w: {v["qw"]}}}',
                "",
            ]
        )
