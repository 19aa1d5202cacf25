"""The export formats, in a module that imports nothing heavy, for the command line."""

from __future__ import annotations

from enum import StrEnum


class Target(StrEnum):
    """A format of `mobilecal export`."""

    urdf = "urdf"
    xacro = "xacro"
    ros2_control = "ros2_control"
    static_transform_launch = "static_transform_launch"
    static_transform_yaml = "static_transform_yaml"
    camera_info_left = "camera_info_left"
    camera_info_right = "camera_info_right"
    camchain = "camchain"
    json = "json"
