"""The head-eye transform with the keys of geometry_msgs/TransformStamped."""

from __future__ import annotations

from mobilecal_cli.export.formats import CONVENTION, Exported, Source, frame_note, of_head_eye
from mobilecal_cli.export.formats.static_transform_launch import transform_fields
from mobilecal_cli.export.text import quoted
from mobilecal_cli.model.text import visible


def export(of: Source) -> Exported:
    """The head-eye transform with the keys of `geometry_msgs/TransformStamped`"""
    robot, v = of.robot, transform_fields(of.robot)
    text = "\n".join(
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
    return of_head_eye(robot, text)
