"""The formats that a calibration can be written in; named here, so that the command line knows them without work."""

from __future__ import annotations

from enum import StrEnum


class Target(StrEnum):
    """What a calibration can be written as."""

    urdf = "urdf"
    xacro = "xacro"
    ros2_control = "ros2_control"
    static_transform_launch = "static_transform_launch"
    static_transform_yaml = "static_transform_yaml"
    camera_info_left = "camera_info_left"
    camera_info_right = "camera_info_right"
    camchain = "camchain"
    json = "json"
