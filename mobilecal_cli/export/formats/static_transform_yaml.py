"""The head-eye transform with the keys of geometry_msgs/TransformStamped."""

from mobilecal_cli.export.formats import Exported, Source, of_head_eye


def export(of: Source) -> Exported:
    """The head-eye transform with the keys of `geometry_msgs/TransformStamped`"""
    return of_head_eye(of.robot, "static_transform_yaml.yaml")
