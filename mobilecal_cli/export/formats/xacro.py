"""Properties to include in a xacro file."""

from mobilecal_cli.export.formats import Exported, Source, of_head_eye


def export(of: Source) -> Exported:
    """Properties to include"""
    return of_head_eye(of.robot, "xacro.xml")
