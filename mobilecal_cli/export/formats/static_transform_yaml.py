"""The head-eye transform with the keys of geometry_msgs/TransformStamped."""

from __future__ import annotations

from mobilecal_cli.export.formats import CONVENTION, Exported, Source, frame_note, of_head_eye
from mobilecal_cli.export.formats.static_transform_launch import transform_fields
from mobilecal_cli.export.text import rendered


def export(of: Source) -> Exported:
    """The head-eye transform with the keys of `geometry_msgs/TransformStamped`"""
    values = {"robot": of.robot, "convention": CONVENTION, "frame_note": frame_note(of.robot)}
    return of_head_eye(
        of.robot, rendered("static_transform_yaml.yaml", **values, **transform_fields(of.robot))
    )
